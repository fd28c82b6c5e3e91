//! `ubbmap store`: what it prints, its exit codes, and that it leaves alone what is none of its business.

use crate::cli_support::{Done, ubbmap};
use crate::store_damage::{framed, raw};
use crate::store_rewrite::entries;
use crate::store_support::{assert_same, config, fill};
use std::path::Path;
use ubbmap::quadtree::BlockAddress;
use ubbmap::store::{MapStore, SledOptions, SledStore};

fn store(arguments: &[&str], directory: &Path) -> Done {
    Done::of(ubbmap().arg("store").args(arguments).arg("--data").arg(directory).output().unwrap())
}

fn open(directory: &Path) -> SledStore {
    SledStore::open(directory, SledOptions::default()).unwrap()
}

#[test]
fn a_sound_store_is_verified_and_rewritten() {
    let directory = tempfile::tempdir().unwrap();
    let (id, model) = fill(&open(directory.path()), "plant", config(10, 10, 2), 3, 40);
    let done = store(&["verify"], directory.path()).ok();
    assert!(done.stdout.contains("maps     1\n") && done.stdout.ends_with("every record is sound\n"), "{done:?}");
    let before = store(&["verify", "--json"], directory.path()).ok().json();
    assert_eq!((&before["maps"], &before["problems"]), (&1.into(), &serde_json::json!([])));

    let done = store(&["rewrite", "--json"], directory.path()).ok().json();
    assert_eq!(done["records"].as_u64().unwrap() + 1, before["records"].as_u64().unwrap());
    assert!(done["after_bytes"].as_u64().unwrap() < done["before_bytes"].as_u64().unwrap(), "{done}");
    assert_eq!(entries(directory.path()), ["acknowledged", "current", "lock", "sled-2"]);
    let after = store(&["verify", "--json"], directory.path()).ok().json();
    assert_eq!((&after["records"], &after["live_bytes"]), (&before["records"], &before["live_bytes"]));
    let done = store(&["rewrite"], directory.path()).ok();
    assert!(done.stdout.contains("held") && done.stdout.contains("on disk before"), "{done:?}");
    assert_same(&open(directory.path()).load(id).unwrap(), &model.loaded());
}

#[test]
fn every_damaged_record_is_named_and_the_exit_code_is_1() {
    let directory = tempfile::tempdir().unwrap();
    let (id, model) = fill(&open(directory.path()), "plant", config(10, 10, 2), 3, 40);
    let mut blocks = Vec::new();
    model.tree.visit_blocks(&mut |at, _| blocks.push(at));
    for BlockAddress { x, y } in &blocks[..3] {
        let key = [&[0x30][..], &id.0.to_be_bytes(), &BlockAddress { x: *x, y: *y }.morton().to_be_bytes()].concat();
        raw(directory.path(), |db| db.insert(&key, &b"nonsense"[..]).unwrap());
    }
    let done = store(&["verify"], directory.path()).fails(1, "problems found");
    for BlockAddress { x, y } in &blocks[..3] {
        assert!(done.stdout.contains(&format!("map {}, block ({x}, {y})", id.0)), "{done:?}");
    }
    let done = store(&["verify", "--json"], directory.path()).fails(1, "problems found");
    assert!(done.json()["problems"].as_array().unwrap().len() >= 3);

    // What keeps it from opening is damage too.
    raw(directory.path(), |db| db.insert([0x02], framed(&[0x02], 1, 0, b"nonsense")).unwrap());
    let done = store(&["verify", "--json"], directory.path()).fails(1, "1 problem found");
    assert!(done.json()["problems"][0].as_str().unwrap().contains("the counter of map numbers"));
    store(&["rewrite"], directory.path()).fails(1, "the counter of map numbers");
}

#[test]
fn a_directory_without_a_store_or_in_use_is_left_alone() {
    let directory = tempfile::tempdir().unwrap();
    let nowhere = directory.path().join("nowhere");
    for command in ["verify", "rewrite"] {
        store(&[command], &nowhere).fails(1, "there is no store in it");
        store(&[command], directory.path()).fails(1, "there is no store in it");
        let told = store(&[command, "--json"], &nowhere).fails(1, "there is no store in it").json();
        assert!(told["error"].as_str().unwrap().contains("there is no store in it"), "{told}");
    }
    assert!(entries(directory.path()).is_empty());
    let used = tempfile::tempdir().unwrap();
    let held = open(used.path());
    for command in ["verify", "rewrite"] {
        store(&[command], used.path()).fails(1, "another ubbmap has this store open");
    }
    drop(held);
}

#[test]
fn help_has_an_example() {
    for command in [&["--help"][..], &["verify", "--help"], &["rewrite", "--help"]] {
        let done = Done::of(ubbmap().arg("store").args(command).output().unwrap()).ok();
        assert!(done.stdout.contains("Example:\n  ubbmap store "), "{done:?}");
    }
}

//! Which database of a data directory is the store: never an older one in silence, never one that is half a copy.

use crate::store_rewrite::{copy_directory, entries};
use crate::store_support::{Model, assert_same, config, fill, name};
use std::fs;
use std::path::Path;
use ubbmap::store::{MapId, MapStore, SledOptions, SledStore, StoreError};

fn open(directory: &Path) -> Result<SledStore, StoreError> {
    SledStore::open(directory, SledOptions::default())
}

/// A store that was rewritten once, a copy of its first generation, and a commit after it.
fn rewritten(directory: &Path, first: &Path) -> (MapId, Model) {
    let store = open(directory).unwrap();
    let (id, mut model) = fill(&store, "plant", config(10, 10, 2), 3, 12);
    let mut copied = false;
    let done = store.rewrite(&mut |_| {
        if !copied {
            copy_directory(&directory.join("sled"), &first.join("sled"));
            copied = true;
        }
        Ok(())
    });
    done.unwrap();
    store.commit(id, &model.step(5)).unwrap();
    (id, model)
}

/// `current` as it is from the beginning of the first rewrite to its end.
fn name_first(directory: &Path) {
    let number = 1_u32.to_be_bytes();
    fs::write(directory.join("current"), [number, crc32c::crc32c(&number).to_be_bytes()].concat()).unwrap();
}

/// The store is the rewritten one, nothing else is left, and `current` says so.
#[track_caller]
fn is_whole(directory: &Path, id: MapId, model: &Model) {
    let store = open(directory).unwrap();
    assert_same(&store.load(id).unwrap(), &model.loaded());
    assert_eq!(entries(directory), ["acknowledged", "current", "lock", "sled-2"]);
    let number = 2_u32.to_be_bytes();
    let bytes = [number, crc32c::crc32c(&number).to_be_bytes()].concat();
    assert_eq!(fs::read(directory.join("current")).unwrap(), bytes);
}

#[test]
fn the_file_that_names_the_store_is_made_anew_where_only_one_database_is_left() {
    let (directory, first) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    let (id, model) = rewritten(directory.path(), first.path());
    is_whole(directory.path(), id, &model);
    let current = directory.path().join("current");
    let sound = fs::read(&current).unwrap();
    fs::remove_file(&current).unwrap();
    is_whole(directory.path(), id, &model);
    for bit in 0..64 {
        let mut bytes = sound.clone();
        bytes[bit / 8] ^= 1 << (bit % 8);
        fs::write(&current, bytes).unwrap();
        is_whole(directory.path(), id, &model);
    }
    for bytes in [&b""[..], &sound[..7], &[&sound[..], b"x"].concat(), &[0; 8]] {
        fs::write(&current, bytes).unwrap();
        is_whole(directory.path(), id, &model);
    }
}

#[test]
fn an_older_database_is_never_served_in_silence() {
    let (directory, first) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    let (id, model) = rewritten(directory.path(), first.path());
    let current = directory.path().join("current");
    let sound = fs::read(&current).unwrap();
    let older = || copy_directory(&first.path().join("sled"), &directory.path().join("sled"));
    let refused = |what: &str| {
        let before = entries(directory.path());
        let error = open(directory.path()).unwrap_err().to_string();
        assert!(error.contains(directory.path().to_str().unwrap()), "{what}: {error}");
        let mut after = entries(directory.path());
        // A copy of what was there before an opening that failed.
        if !before.iter().any(|entry| entry == "damaged") {
            after.retain(|entry| entry != "damaged");
        }
        assert_eq!(after, before, "{what}: nothing is removed");
        error
    };
    older();
    fs::write(&current, b"nonsense").unwrap();
    let error = refused("damaged");
    assert!(error.contains("\"current\"") && error.contains("sled, sled-2"), "{error}");
    fs::remove_file(&current).unwrap();
    let error = refused("missing");
    assert!(error.contains("is missing") && error.contains("sled, sled-2"), "{error}");
    // Even where it is named again, its writes are fewer than were acknowledged.
    name_first(directory.path());
    assert!(refused("named").contains("were acknowledged"));
    // A file that names what is not there.
    fs::rename(directory.path().join("sled-2"), directory.path().join("elsewhere")).unwrap();
    fs::write(&current, &sound).unwrap();
    assert!(refused("moved away").contains("sled-2, which is not there"));
    fs::remove_dir_all(directory.path().join("sled")).unwrap();
    assert!(refused("alone").contains("sled-2, which is not there"));
    fs::remove_file(&current).unwrap();
    assert!(refused("nothing").contains("a new store is not started"));
    fs::write(&current, b"nonsense").unwrap();
    assert!(refused("a damaged file alone").contains("no database"));
    // Put back, all is as it was; what is left of the first generation goes.
    fs::rename(directory.path().join("elsewhere"), directory.path().join("sled-2")).unwrap();
    fs::write(&current, &sound).unwrap();
    older();
    fs::remove_dir_all(directory.path().join("damaged")).unwrap();
    is_whole(directory.path(), id, &model);
}

#[test]
fn what_is_left_of_a_rewrite_that_was_not_finished_is_removed() {
    let directory = tempfile::tempdir().unwrap();
    let (id, model) = fill(&open(directory.path()).unwrap(), "plant", config(10, 10, 2), 3, 12);
    let left = directory.path().join("sled-2");
    copy_directory(&directory.path().join("sled"), &left);
    name_first(directory.path());
    fs::write(directory.path().join("current.writing"), b"half").unwrap();
    // Not of the form that is written: somebody else's.
    for name in ["sled-1", "sled-02", "sled-x", "sled-3.before", "sled-99999999999"] {
        fs::create_dir(directory.path().join(name)).unwrap();
    }
    let others = ["sled", "sled-02", "sled-1", "sled-3.before", "sled-99999999999", "sled-x"];
    let store = open(directory.path()).unwrap();
    assert_same(&store.load(id).unwrap(), &model.loaded());
    assert_eq!(entries(directory.path()), [&["acknowledged", "current", "lock"][..], &others].concat());
}

/// Half a copy that is the only database left: the header is written last.
#[test]
fn half_a_copy_is_not_a_store() {
    let (directory, half) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    let store = open(directory.path()).unwrap();
    fill(&store, "plant", config(10, 10, 2), 3, 12);
    for step in ["Reopened", "Held"] {
        let to = half.path().join(step);
        let mut copy = |at: ubbmap::store::RewriteStep| {
            if format!("{at:?}") == step {
                copy_directory(directory.path(), &to);
            }
            Ok(())
        };
        store.rewrite(&mut copy).unwrap();
        for name in entries(&to).into_iter().filter(|name| name == "sled" || (step == "Held" && name == "sled-2")) {
            fs::remove_dir_all(to.join(name)).unwrap();
        }
        let _ = fs::remove_file(to.join("current"));
        let error = open(&to).unwrap_err().to_string();
        assert!(error.contains("no header"), "{step}: {error}");
    }
}

#[test]
fn beside_a_damaged_store_its_older_self_is_kept() {
    let (directory, first) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    let (id, _) = rewritten(directory.path(), first.path());
    copy_directory(&first.path().join("sled"), &directory.path().join("sled"));
    copy_directory(&first.path().join("sled"), &directory.path().join("sled-3"));
    let key = [&[0x11][..], &id.0.to_be_bytes()].concat();
    let edited = sled::Config::new().path(directory.path().join("sled-2")).flush_every_ms(None).open().unwrap();
    edited.insert(key, b"nonsense").unwrap();
    edited.flush().unwrap();
    drop(edited);
    let store = open(directory.path()).unwrap();
    assert_eq!(store.damaged()[0].name, Some(name("plant")));
    assert_eq!(entries(directory.path()), ["acknowledged", "current", "lock", "sled", "sled-2"]);
    // Once the damage is dealt with it is removed.
    store.delete(id).unwrap();
    drop(store);
    open(directory.path()).unwrap();
    assert_eq!(entries(directory.path()), ["acknowledged", "current", "lock", "sled-2"]);
}

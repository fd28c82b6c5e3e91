//! `ubbmap serve --check` and `ubbmap health`: what is told, and that nothing is touched.

#![allow(clippy::unwrap_used, clippy::panic, reason = "tests")]

use super::cli_support::{Done, Server, run, ubbmap};
use super::store_rewrite::entries;
use std::collections::BTreeMap;
use std::path::Path;
use ubbmap::store::{SledOptions, SledStore};

/// Every file below a directory with its bytes.
fn contents(directory: &Path) -> BTreeMap<String, Vec<u8>> {
    let mut found = BTreeMap::new();
    for entry in std::fs::read_dir(directory).unwrap().map(|entry| entry.unwrap().path()) {
        if entry.is_dir() {
            let inner = contents(&entry).into_iter();
            found.extend(inner.map(|(name, bytes)| (format!("{}/{name}", entry.display()), bytes)));
        } else {
            found.insert(entry.display().to_string(), std::fs::read(&entry).unwrap());
        }
    }
    found
}

fn check(flags: &[&str], data: &Path) -> Done {
    let listen = ["serve", "--check", "--listen", "127.0.0.1:0", "--data"];
    Done::of(ubbmap().args(listen).arg(data).args(flags).output().unwrap())
}

#[test]
fn settings_are_shown_with_where_they_were_given() {
    let folder = tempfile::tempdir().unwrap();
    let data = folder.path().join("data");
    let file = folder.path().join("serve.toml");
    std::fs::write(&file, "[limits]\nmaps = 12\nrequests = 9\n").unwrap();
    let mut command = ubbmap();
    command.env("UBBMAP_LIMITS__MAPS", "13").env("UBBMAP_CONFIG", &file);
    command.args(["serve", "--check", "--listen", "127.0.0.1:0", "--data"]).arg(&data);
    let text = Done::of(command.output().unwrap()).ok().stdout;
    let line = |key: &str| text.lines().find(|line| line.starts_with(&format!("{key} = "))).unwrap().to_owned();
    assert!(line("listen").starts_with("listen = \"127.0.0.1:0\" ") && line("listen").ends_with("# the command line"));
    assert!(
        line("limits.maps").starts_with("limits.maps = 13 ") && line("limits.maps").ends_with("# UBBMAP_LIMITS__MAPS")
    );
    assert!(line("limits.requests").ends_with(&format!("# {}", file.display())));
    assert!(line("log").starts_with("log = \"info\"") && line("log").ends_with("# default"));
    assert!(text.contains("an empty one is made") && !data.exists(), "nothing is made: {text}");

    let json = check(&["--json"], &data).ok().json();
    assert_eq!((&json["ok"], &json["problems"]), (&true.into(), &serde_json::json!([])));
    assert_eq!(json["settings"]["limits.maps"], serde_json::json!({"value": 10000, "from": "default"}));
    // All there is: those of the file of defaults.
    let defaults = include_str!("../../config/default.toml").lines().filter(|line| {
        line.split_once(" = ")
            .is_some_and(|(name, _)| name.bytes().all(|byte| byte.is_ascii_lowercase() || byte == b'_'))
    });
    assert_eq!(json["settings"].as_object().unwrap().len(), defaults.count());
    run(["serve", "--json"]).fails(2, "--check");
}

#[test]
fn what_keeps_a_server_from_starting_is_told_with_64() {
    let folder = tempfile::tempdir().unwrap();
    let data = folder.path().join("data");
    let server = Server::start(&data, "127.0.0.1:0");
    let taken = check(&["--listen", server.address()], &folder.path().join("other"));
    assert_eq!(taken.code, 2, "given twice: {taken:?}");
    let other = folder.path().join("other");
    let taken = Done::of(
        ubbmap().args(["serve", "--check", "--listen", server.address(), "--data"]).arg(&other).output().unwrap(),
    );
    taken.fails(64, &format!("cannot listen on {}", server.address()));
    let used = check(&["--json"], &data).fails(64, "another ubbmap has this store open");
    assert_eq!(used.json()["ok"], false);
    assert!(used.json()["problems"][0].as_str().unwrap().contains("has this store open"));
    assert_eq!(server.terminate(), 0);
    check(&[], &data).ok();

    std::fs::write(folder.path().join("file"), "").unwrap();
    check(&[], &folder.path().join("file")).fails(64, "it is no directory");
    check(&[], &folder.path().join("file/below")).fails(64, "file is no directory");
    let left = folder.path().join("left");
    std::fs::create_dir(&left).unwrap();
    std::fs::write(left.join("acknowledged"), "").unwrap();
    check(&[], &left).fails(64, "a new store is not started beside what is left of one");
    let bad = Done::of(ubbmap().env("UBBMAP_LISTN", "x").args(["serve", "--check", "--json"]).output().unwrap());
    let bad = bad.fails(64, "did you mean `listen`?");
    assert!(bad.json()["problems"][0].as_str().unwrap().contains("listn"));
    for (name, words) in [("UBBMAP_ACCESS__TOKENS", "access.tokens"), ("UBBMAP_TLS__CERT", "tls.cert")] {
        let mut command = ubbmap();
        command.env(name, folder.path().join("none.pem"));
        if name == "UBBMAP_TLS__CERT" {
            command.env("UBBMAP_TLS__KEY", folder.path().join("none.key"));
        }
        command.args(["serve", "--check", "--listen", "127.0.0.1:0", "--data"]).arg(&data);
        Done::of(command.output().unwrap()).fails(64, words);
    }
    let zenoh = ["UBBMAP_ZENOH__MODE", "UBBMAP_ZENOH__FILE"];
    let mut command = ubbmap();
    command.env(zenoh[0], "router").env(zenoh[1], folder.path().join("none.json5"));
    command.args(["serve", "--check", "--listen", "127.0.0.1:0", "--data"]).arg(&data);
    Done::of(command.output().unwrap()).fails(64, "none.json5 (zenoh.file)");
}

#[test]
fn the_format_of_a_store_is_told_and_nothing_in_it_changes() {
    let folder = tempfile::tempdir().unwrap();
    for version in 1..=3 {
        let unpacked = super::store_fixtures::unpacked(&format!("store-v{version}"));
        let data = unpacked.path().to_owned();
        let before = contents(&data);
        let done = check(&[], &data).ok();
        assert!(done.stdout.contains(&format!("holds one of format {version}\n")), "{done:?}");
        assert!(contents(&data) == before, "version {version} was changed");
    }
    let data = folder.path().join("data");
    drop(SledStore::open(&data, SledOptions::default()).unwrap());
    let before = contents(&data);
    check(&[], &data).ok();
    assert!(contents(&data) == before);
    // A later format: the header's first four bytes, under a checksum of its own.
    crate::store_damage::raw(&data, |db| {
        let key = db.iter().keys().next().unwrap().unwrap();
        let value = db.get(&key).unwrap().unwrap();
        let mut content = value[14..value.len() - 4].to_vec();
        content[..4].copy_from_slice(&77_u32.to_be_bytes());
        db.insert(&key, crate::store_damage::framed(&key, value[0], 0, &content)).unwrap();
    });
    check(&[], &data).fails(64, "format version 77");
}

#[test]
fn a_taken_address_made_a_fresh_store_before_the_start_failed() {
    let folder = tempfile::tempdir().unwrap();
    let server = Server::start(&folder.path().join("data"), "127.0.0.1:0");
    let other = folder.path().join("other");
    for command in [&["serve"][..], &["demo", "--exit"]] {
        let mut run = ubbmap();
        run.args(command).args(["--listen", server.address(), "--data"]).arg(&other);
        Done::of(run.output().unwrap()).fails(1, server.address());
    }
    assert_eq!(entries(folder.path()), ["data"]);
    assert_eq!(server.terminate(), 0);
}

#[test]
fn health_tells_whether_a_server_takes_work() {
    let folder = tempfile::tempdir().unwrap();
    let server = Server::start(&folder.path().join("data"), "127.0.0.1:0");
    let (url, address) = (server.url.clone(), server.address().to_owned());
    assert_eq!(server.run(&["health"]).ok().stdout, format!("{url} is ready\n"));
    assert_eq!(server.run(&["health", "--json"]).ok().json()["ready"], true);
    assert_eq!(server.terminate(), 0);
    run(["health", "--server", &url]).fails(1, &address);
    let away = run(["health", "--json", "--server", &url]).fails(1, "cannot reach the server").json();
    assert!(away["ready"] == false && away["problem"].as_str().unwrap().contains(&address), "{away}");
}

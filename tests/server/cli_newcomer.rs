//! What those who typed a command for the first time met: refusals that did not say what would do, and silence where a word
//! was due.

#![allow(clippy::unwrap_used, clippy::panic, reason = "tests")]

use super::cli_support::{Folder, Server, room_json, run, ubbmap};
use std::process::Command;

/// A folder with the log of a room, `room.jsonl`.
fn with_room() -> (Folder, String) {
    let folder = Folder::new();
    std::fs::write(folder.path("room.jsonl"), room_json(30)).unwrap();
    let log = folder.text("room.jsonl");
    (folder, log)
}

#[test]
fn localhost_was_no_address_and_a_bare_port_told_no_way_out() {
    let folder = Folder::new();
    let server = Server::start(&folder.path("data"), "localhost:0");
    assert!(server.url.starts_with("http://127.0.0.1:"), "{}", server.url);
    for wrong in ["8080", "localhost", "localhost:99999", "no.such.host:8080"] {
        run(["serve", "--check", "--listen", wrong]).fails(2, "such as 127.0.0.1:8080, localhost:8080");
    }
    let mut settings = Command::new(env!("CARGO_BIN_EXE_ubbmap"));
    let done = settings.args(["serve", "--check"]).env("UBBMAP_LISTEN", "127.0.0.1:99999").output().unwrap();
    let text = String::from_utf8(done.stderr).unwrap();
    assert_eq!(done.status.code(), Some(64));
    let told = ["setting `listen`", "such as 127.0.0.1:8080", "got \"127.0.0.1:99999\"", "(given in UBBMAP_LISTEN)"];
    assert!(told.iter().all(|words| text.contains(words)), "{text}");
}

#[test]
fn a_word_that_is_no_value_of_a_setting_was_refused_without_those_that_are() {
    let refused = |setting: &str, words: &str| {
        let folder = Folder::new();
        std::fs::write(folder.path("settings.toml"), setting).unwrap();
        let done = run(["serve", "--check", "--config", &folder.text("settings.toml")]).fails(64, words);
        assert!(done.stderr.contains("settings.toml)"), "where it was given: {done:?}");
    };
    refused("store = \"foo\"", "must be one of sled, memory, got \"foo\"");
    refused("log_format = \"xml\"", "must be one of text, json, got \"xml\"");
    refused("tls.client_auth = \"yes\"", "must be one of off, optional, required, got \"yes\"");
    refused("zenoh.mode = \"on\"", "must be one of off, peer, client, router, got \"on\"");
    refused("limits.maps = \"ten\"", "setting `limits.maps`");
    refused("limits.maps = 0", "must be between 1 and");
    run(["serve", "--check", "--store", "foo"]).fails(64, "(given in the command line)");
}

#[test]
fn a_missing_file_of_tokens_was_told_when_the_store_had_been_made() {
    let folder = Folder::new();
    let flags = ["--data", &folder.text("data"), "--tokens", &folder.text("none.toml")];
    run(["serve", "--listen", "127.0.0.1:0"].iter().chain(&flags)).fails(64, "none.toml");
    assert!(!folder.path("data").exists());
}

#[test]
fn a_taken_address_is_found_by_check_with_the_way_out() {
    let taken = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
    let address = taken.local_addr().unwrap().to_string();
    run(["serve", "--check", "--listen", &address]).fails(64, "--listen names another address");
}

#[test]
fn a_token_that_sends_nothing_was_bound_to_a_robot() {
    let folder = Folder::new();
    let flags = ["--file", &folder.text("tokens.toml"), "--name", "x", "--robot", "amr-7", "--role"];
    run(["token", "create"].iter().chain(&flags).chain(&["read"])).fails(2, "say --role write, or leave --robot out");
    assert!(!folder.path("tokens.toml").exists());
    run(["token", "create"].iter().chain(&flags).chain(&["write"])).ok();
}

#[test]
fn a_region_that_makes_no_sense_was_told_by_a_path_that_nobody_typed() {
    let (folder, log) = with_room();
    let server = Server::start(&folder.path("data"), "127.0.0.1:0");
    server.run(&["replay", &log, "--map", "room"]).ok();
    let check = |more: &[&str]| server.run(&[&["check", "--map", "room"], more].concat());
    let done = check(&["--box", "0,0,1,1", "--disc", "0,0,1", "--disc", "1,2,-1"])
        .fails(2, "disc 2: disc.radius must not be negative, got -1 (INVALID_REGION)");
    assert!(!done.stderr.contains("regions["), "{done:?}");
    let done = check(&["--disc", "0,0,1", "--tolerance", "9"]).fails(1, "tolerance");
    assert_eq!(done.stderr.matches("tolerance").count(), 1, "{done:?}");
}

#[test]
fn a_snapshot_could_be_asked_over_the_interface_alone() {
    let (folder, log) = with_room();
    let server = Server::start(&folder.path("data"), "127.0.0.1:0");
    server.run(&["map", "create", "room"]).ok();
    server.run(&["map", "snapshot", "room", "empty"]).ok();
    server.run(&["replay", &log, "--map", "room"]).ok();
    let check = |more: &[&str]| server.run(&[&["check", "--map", "room", "--disc", "1.5,1.2,0.3"], more].concat());
    assert!(check(&[]).ok().stdout.starts_with("disc 1: free"));
    assert!(check(&["--snapshot", "empty"]).ok().stdout.starts_with("disc 1: not free: unknown"));
    check(&["--snapshot", "emty"]).fails(1, "no snapshot 'emty'; did you mean 'empty'?");
}

#[test]
fn a_map_unlike_the_one_that_a_replay_describes_was_used_without_a_word() {
    let (folder, log) = with_room();
    let server = Server::start(&folder.path("data"), "127.0.0.1:0");
    server.run(&["map", "create", "room", "--min-obstacle-width", "0.05", "--range-max", "20"]).ok();
    let done = server.run(&["replay", &log, "--map", "room"]).ok();
    let words = "by the log and the defaults it would differ: min_obstacle_width 0.05, not 0.02, sensors";
    assert!(done.stderr.contains(words), "{done:?}");
    let again = server.run(&["replay", &log, "--map", "room"]).ok();
    assert_eq!(again.stdout, "nothing to send: all 30 scans were there before; revision 1\n", "{again:?}");
    assert!(again.stderr.contains("stay there with the poses that they were sent with"), "{again:?}");

    let done = server.run(&["replay", &log, "--map", "other"]).ok();
    assert_eq!(done.stderr, "created map 'other'\n", "nothing to say of one that was just made");
    let again = server.run(&["replay", &log, "--map", "other", "--limit", "30"]).ok();
    assert!(!again.stderr.contains("differ"), "{again:?}");
}

#[test]
fn scans_beyond_the_map_were_lost_without_a_word() {
    let (folder, log) = with_room();
    let build = |more: &[&str]| run([&["build", &log, "--out", &folder.text("map.ubbmap")], more].concat()).ok();
    assert_eq!(build(&[]).stderr, "");
    let done = build(&["--depth", "3", "--origin", "50,50"]);
    assert!(done.stderr.contains("30 scans were taken beyond the map, which is 0.8 m wide from 50,50 on"), "{done:?}");
    assert!(done.stderr.contains("--depth or --origin"), "{done:?}");
}

#[test]
fn the_corners_of_the_box_of_what_is_known_had_the_last_digits_of_the_arithmetic() {
    let (folder, log) = with_room();
    let counts = run(["build", &log, "--out", &folder.text("map.ubbmap"), "--json"]).ok().json();
    for corner in ["min_x", "min_y", "max_x", "max_y"] {
        let text = counts["bounds"][corner].to_string();
        assert!(text.len() <= "-123.4".len(), "{corner}: {text}");
    }
}

#[test]
fn counts_spans_and_pictures_are_refused_with_what_would_do() {
    let (folder, log) = with_room();
    let (map, jpg) = (folder.text("map.ubbmap"), folder.text("map.jpg"));
    let build = |more: &[&str]| run([&["build", &log, "--out", &map], more].concat());
    build(&["--png", &jpg]).fails(2, "let the name end with .png");
    for flag in ["--every", "--limit", "--threads"] {
        build(&[flag, "0"]).fails(2, "must be a whole number of at least 1");
    }
    build(&["--pose-error", "-0.1,3deg"]).fails(2, "--pose-error");
    run(["replay", &log, "--map", "room", "--robots", "0"]).fails(2, "must be a whole number of at least 1");
    run(["demo", "--duration", "soon"]).fails(2, "as in 30s or 2m");
    let demo = ["demo", "--listen", "127.0.0.1:0", "--duration", "1s", "--exit", "--json"];
    assert_eq!(run(demo).ok().json()["rejected"], 0);
    // A picture without an ending is one by the flag's word.
    let plain = folder.text("picture");
    assert_eq!(ubbmap().args(["build", &log, "--out", &map, "--png", &plain]).output().unwrap().status.code(), Some(0));
    assert!(std::fs::read(folder.path("picture")).unwrap().starts_with(b"\x89PNG"));
}

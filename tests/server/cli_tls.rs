//! TLS with the real binary: a server with certificates, commands that trust it, and what is said when they do not.

#![allow(clippy::unwrap_used, clippy::panic, reason = "tests")]

use crate::cli_support::{Done, Server, room_json, ubbmap, until};
use crate::tls_support::{Leaf, Office, Pair, replace};
use std::process::Command;

/// The settings of a server in a folder as a file.
fn settings(office: &Office, more: &str) -> String {
    let (cert, key) = (office.text("server.pem"), office.text("server.key"));
    office.write("ubbmap.toml", &format!("[tls]\ncert = {cert:?}\nkey = {key:?}\n{more}"));
    office.text("ubbmap.toml")
}

fn serve(office: &Office, more: &str) -> Server {
    let file = settings(office, more);
    Server::start_with(&office.path("data"), "127.0.0.1:0", &["--store", "memory", "--config", &file])
}

fn run(server: &str, args: &[&str]) -> Done {
    Done::of(ubbmap().env("UBBMAP_SERVER", server).args(args).output().unwrap())
}

#[test]
fn commands_speak_tls_with_a_server_that_they_trust() {
    let office = Office::new();
    let server = serve(&office, "");
    assert!(server.url.starts_with("https://"), "{}", server.url);
    let ca = office.text("ca.pem");
    run(&server.url, &["map", "create", "hall", "--ca", &ca]).ok();
    office.write("room.jsonl", &room_json(20));
    let replayed =
        run(&server.url, &["replay", &office.text("room.jsonl"), "--map", "room", "--ca", &ca, "--json"]).ok();
    assert_eq!(replayed.json()["applied"], 20, "{replayed:?}");
    run(&server.url, &["check", "--map", "room", "--disc", "0,0,0.1", "--ca", &ca, "--json"]);
    let by_environment = Done::of(
        ubbmap().env("UBBMAP_SERVER", &server.url).env("UBBMAP_CA", &ca).args(["map", "list"]).output().unwrap(),
    );
    assert!(by_environment.ok().stdout.contains("hall"));
    // A name that stands in the certificate is as good as its address.
    let named = server.url.replace("127.0.0.1", "localhost");
    run(&named, &["map", "list", "--ca", &ca]).ok();
    assert_eq!(server.terminate(), 0);
}

#[test]
fn what_keeps_a_command_from_a_server_is_said_with_the_way_out() {
    let office = Office::new();
    let server = serve(&office, "");
    let plain = tempfile::tempdir().unwrap();
    let open = Server::start_with(&plain.path().join("data"), "127.0.0.1:0", &["--store", "memory"]);
    let ca = office.text("ca.pem");
    let list = |url: &str, more: &[&str]| run(url, &[&["map", "list"], more].concat());
    list(&server.url, &[]).fails(1, "--ca");
    list(&server.url, &["--ca", &office.text("robots.pem")]).fails(1, "--ca");
    list(&server.url.replace("https://", "http://"), &[]).fails(1, "begins with https://");
    list(&open.url.replace("http://", "https://"), &["--ca", &ca]).fails(1, "http://?");
    list(&server.url.replace("127.0.0.1", "127.0.0.2"), &["--ca", &ca]).fails(1, "another name");
    list(&open.url, &["--ca", &ca]).fails(2, "https://");
    list(&server.url, &["--ca", &office.text("none.pem")]).fails(2, "none.pem");
    list(&server.url, &["--ca", &ca, "--cert", &ca]).fails(2, "--key");
    let other = office.robots.sign(&Leaf::of(&["amr-7"]));
    office.write("other.key", &other.key);
    let mixed = ["--ca", &ca, "--cert", &office.text("server.pem"), "--key", &office.text("other.key")];
    list(&server.url, &mixed).fails(2, "is not the key of the certificate");
    assert_eq!((server.terminate(), open.terminate()), (0, 0));
}

#[test]
fn a_replay_to_a_server_that_is_not_trusted_ends_at_once() {
    let office = Office::new();
    let server = serve(&office, "");
    office.write("room.jsonl", &room_json(5));
    run(&server.url, &["replay", &office.text("room.jsonl"), "--map", "room"]).fails(1, "--ca");
}

#[test]
fn commands_show_a_certificate_where_the_server_asks_for_one() {
    let office = Office::new();
    let robots = office.text("robots.pem");
    let server = serve(&office, &format!("client_ca = {robots:?}\nclient_auth = \"required\"\n"));
    let own: Pair = office.robots.sign(&Leaf::of(&["amr-7"]));
    office.write("own.pem", &own.cert);
    office.write("own.key", &own.key);
    let ca = office.text("ca.pem");
    let (cert, key) = (office.text("own.pem"), office.text("own.key"));
    run(&server.url, &["map", "list", "--ca", &ca, "--cert", &cert, "--key", &key]).ok();
    run(&server.url, &["map", "list", "--ca", &ca]).fails(1, "--cert and --key");
    let strange = office.ca.sign(&Leaf::of(&["amr-7"]));
    office.write("own.pem", &strange.cert);
    office.write("own.key", &strange.key);
    run(&server.url, &["map", "list", "--ca", &ca, "--cert", &cert, "--key", &key]).fails(1, "refused the certificate");
    assert_eq!(server.terminate(), 0);
}

#[test]
fn a_server_whose_files_cannot_be_used_ends_with_code_64_and_makes_no_store() {
    let office = Office::new();
    let data = office.text("data");
    let start = |more: &[&str]| {
        let file = settings(&office, "");
        Done::of(ubbmap().args(["serve", "--config", &file, "--data", &data]).args(more).output().unwrap())
    };
    office.write("server.key", &office.ca.sign(&Leaf::server()).key);
    start(&[]).fails(64, "setting `tls.key`").fails(64, "server.key");
    std::fs::remove_file(office.path("server.pem")).unwrap();
    start(&[]).fails(64, "setting `tls.cert`").fails(64, "server.pem");
    assert!(!office.path("data").exists());
    let alone = |text: &str, words: &str| {
        office.write("ubbmap.toml", text);
        let file = office.text("ubbmap.toml");
        Done::of(ubbmap().args(["serve", "--config", &file, "--data", &data]).output().unwrap()).fails(64, words);
    };
    alone("[tls]\ncert = \"a\"\n", "setting `tls.key`");
    alone("[tls]\nkey = \"a\"\n", "setting `tls.cert`");
    alone("[tls]\nclient_auth = \"required\"\n", "setting `tls.client_auth`");
    alone("[tls]\ncert = \"a\"\nkey = \"b\"\nclient_auth = \"optional\"\n", "setting `tls.client_ca`");
    alone("[tls]\ncert = \"a\"\nkey = \"b\"\nclient_ca = \"c\"\n", "setting `tls.client_auth`");
    alone("[tls]\nclient_auth = \"perhaps\"\n", "tls.client_auth");
}

#[test]
fn a_hangup_reads_the_certificate_anew_and_ends_no_server() {
    let office = Office::new();
    let server = serve(&office, "");
    let next = crate::tls_support::Authority::new("next");
    let pair = next.sign(&Leaf::server());
    replace(&office.path("server.pem"), &pair.cert);
    replace(&office.path("server.key"), &pair.key);
    office.write("next.pem", &next.pem);
    let pid = server.child.id().to_string();
    assert!(Command::new("kill").args(["-HUP", &pid]).status().unwrap().success());
    let ca = office.text("next.pem");
    until("the new certificate", || run(&server.url, &["map", "list", "--ca", &ca]).code == 0);
    assert_eq!(server.terminate(), 0);
    // One that has nothing to read stays as well.
    let folder = tempfile::tempdir().unwrap();
    let open = Server::start_with(&folder.path().join("data"), "127.0.0.1:0", &["--store", "memory"]);
    let pid = open.child.id().to_string();
    assert!(Command::new("kill").args(["-HUP", &pid]).status().unwrap().success());
    open.run(&["map", "list"]).ok();
    assert_eq!(open.terminate(), 0);
}

//! `serve`, `map`, `check`, `replay` and `demo` with the real binary: crashes, resuming, exit codes.

#![allow(clippy::unwrap_used, clippy::panic, reason = "tests")]

use super::cli_support::{Done, Folder, Server, room_json, run, ubbmap, until};
use std::path::Path;
use std::process::{Child, Stdio};
use ubbmap::quadtree::{LeafRange, OccupancyTree};
use ubbmap::store::read_map_file;

const ANY: &str = "127.0.0.1:0";
const SCANS: usize = 600;

impl Folder {
    fn room(&self, scans: usize) -> String {
        std::fs::write(self.path("room.jsonl"), room_json(scans)).unwrap();
        self.text("room.jsonl")
    }

    fn serve(&self, listen: &str) -> Server {
        Server::start(&self.path("data"), listen)
    }
}

fn replay(server: &Server, log: &str, more: &[&str]) -> Child {
    ubbmap()
        .args(["replay", log, "--server", &server.url, "--json"])
        .args(more)
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap()
}

fn finish(child: Child) -> Done {
    Done::of(child.wait_with_output().unwrap())
}

/// Numbered scans of each robot that the map has.
fn applied(server: &Server, map: &str) -> Vec<(String, u64)> {
    let shown = server.show(map);
    let robots = shown["robots"].as_array().cloned().unwrap_or_default();
    let count = |robot: &serde_json::Value| robot["applied"].as_str().unwrap().parse().unwrap();
    robots.iter().map(|robot| (robot["robot"].as_str().unwrap().to_owned(), count(robot))).collect()
}

fn total(server: &Server, map: &str) -> u64 {
    applied(server, map).iter().map(|robot| robot.1).sum()
}

/// The leaves of a map file, in the form of the interface.
fn leaves_of_file(path: &Path) -> serde_json::Value {
    let (_, map) = read_map_file(&mut std::fs::File::open(path).unwrap()).unwrap();
    leaves_of(&map.tree)
}

fn leaves_of(tree: &OccupancyTree) -> serde_json::Value {
    let side = 1 << tree.depth();
    let mut leaves = Vec::new();
    tree.visit_leaves(&LeafRange { min_x: 0, min_y: 0, max_x: side, max_y: side }, tree.depth(), &mut |leaf| {
        let node = leaf.node;
        leaves.push(serde_json::json!({"depth": node.depth, "x": node.x, "y": node.y, "class": leaf.class}));
        true
    });
    leaves.into()
}

#[test]
fn a_server_killed_in_the_middle_of_a_replay_ends_with_the_same_map() {
    let bench = Folder::new();
    let log = bench.room(SCANS);
    run(["build", &log, "--out", &bench.text("calm.ubbmap"), "--pose-error", "0.03,0.5deg"]).ok();

    let mut server = bench.serve(ANY);
    let address = server.address().to_owned();
    let flags = ["--map", "room", "--pose-error", "0.03,0.5deg"];
    // So many scans a second that there is time to kill the server twice before the end.
    let slow = [&flags[..], &["--rate", "500", "--batch", "16"]].concat();
    let sending = replay(&server, &log, &slow);
    let mut before = 0;
    for least in [100, 300] {
        until("some scans are applied", || {
            let shown = server.run(&["map", "show", "room", "--json"]);
            shown.code == 0 && total(&server, "room") >= least
        });
        server.child.kill().unwrap();
        server.child.wait().unwrap();
        server = bench.serve(&address);
        let after = total(&server, "room");
        assert!(after >= least && after >= before, "acknowledged scans are there: {after}");
        assert!(after < SCANS as u64, "killed in the middle");
        before = after;
    }
    let counts = finish(sending).ok().json();
    assert_eq!((&counts["sent"], &counts["rejected"]), (&SCANS.into(), &0.into()), "{counts}");
    let duplicates = counts["duplicates"].as_u64().unwrap();
    assert_eq!(counts["applied"].as_u64().unwrap() + duplicates, SCANS as u64, "{counts}");
    assert_eq!(applied(&server, "room"), [("room-1of1".to_owned(), SCANS as u64)]);
    assert!(server.leaves("room") == leaves_of_file(&bench.path("calm.ubbmap")), "leaf for leaf");

    // Once more: nothing is sent, nothing changes.
    let again = finish(replay(&server, &log, &flags)).ok().json();
    assert_eq!((&again["sent"], &again["skipped"], &again["applied"]), (&0.into(), &SCANS.into(), &0.into()));
    assert_eq!(again["revision"], server.show("room")["revision"], "a string, as the interface has it");
    assert_eq!(server.terminate(), 0);
}

#[test]
fn a_replay_by_four_robots_resumes_after_both_ends_were_killed() {
    let bench = Folder::new();
    let log = bench.room(SCANS);
    let mut server = bench.serve(ANY);
    let flags = ["--map", "room", "--robots", "4"];
    let mut sending = replay(&server, &log, &[&flags[..], &["--rate", "600", "--batch", "8"]].concat());
    until("some scans are applied", || {
        server.run(&["map", "show", "room", "--json"]).code == 0 && total(&server, "room") >= 150
    });
    sending.kill().unwrap();
    sending.wait().unwrap();
    server.child.kill().unwrap();
    server.child.wait().unwrap();

    let server = bench.serve(ANY);
    let there = total(&server, "room");
    assert!((150..SCANS as u64).contains(&there), "{there}");
    let other = finish(replay(&server, &log, &["--map", "room", "--robots", "3"]));
    other.fails(1, "go on with that many --robots");
    let counts = finish(replay(&server, &log, &flags)).ok().json();
    assert_eq!(counts["skipped"], there, "{counts}");
    assert_eq!(counts["applied"], SCANS as u64 - there, "{counts}");
    assert_eq!((&counts["duplicates"], &counts["rejected"]), (&0.into(), &0.into()), "{counts}");
    let each = applied(&server, "room");
    assert_eq!(each, [1, 2, 3, 4].map(|robot| (format!("room-{robot}of4"), SCANS as u64 / 4)));
    assert_eq!(server.terminate(), 0);
}

#[test]
fn a_replay_gives_up_on_a_server_that_stays_away() {
    let bench = Folder::new();
    let log = bench.room(300);
    let mut server = bench.serve(ANY);
    let sending = replay(&server, &log, &["--map", "room", "--rate", "100", "--batch", "4", "--retry-for", "4"]);
    until("some scans are applied", || {
        server.run(&["map", "show", "room", "--json"]).code == 0 && total(&server, "room") >= 8
    });
    server.child.kill().unwrap();
    server.child.wait().unwrap();
    let done = finish(sending).fails(1, "cannot reach the server at http://127.0.0.1:");
    let told = done.stderr.lines().find(|line| line.starts_with("waiting for the server, attempt ")).unwrap();
    assert!(told.contains(": cannot reach the server at "), "{told}");
    assert!(done.stderr.contains("the same command goes on from there"), "{done:?}");
    let acknowledged = done.json()["sent"].as_u64().unwrap();
    assert!(done.stderr.contains(&format!("stopped with {acknowledged} scans acknowledged")), "{done:?}");

    run(["map", "list", "--server", &server.url]).fails(1, "cannot reach the server");
    run(["map", "list", "--server", "localhost:1"]).fails(2, "http://");
    let silent = ["replay", &log, "--map", "room", "--server", &server.url, "--retry-for", "0.2"];
    run(silent).fails(1, "cannot reach the server");
}

#[test]
fn a_damaged_log_and_rejected_scans_are_named() {
    let bench = Folder::new();
    let log = bench.room(30);
    let server = bench.serve(ANY);
    let text = std::fs::read_to_string(&log).unwrap();
    // Nothing is made for a log without a scan that can be read.
    for (name, text, words) in [
        ("empty.jsonl", "", "no scans: it has no FLASER"),
        ("bad.jsonl", "nonsense\n", "line 1"),
        ("no.jsonl", "{}\n", "no scans"),
    ] {
        std::fs::write(bench.path(name), text).unwrap();
        finish(replay(&server, &bench.text(name), &["--map", "nothing"])).fails(1, words);
        server.run(&["map", "show", "nothing"]).fails(1, "no map 'nothing'");
    }
    let cut = bench.text("cut.jsonl");
    std::fs::write(&cut, &text[..text.len() - 100]).unwrap();
    let done = finish(replay(&server, &cut, &["--map", "cut"])).fails(1, "line 31");
    assert_eq!(done.json()["applied"], 29);
    assert!(done.stderr.contains("the 29 scans before were sent"), "{done:?}");

    // A pose box that is wider than the server takes.
    let wide = finish(replay(&server, &log, &["--map", "wide", "--pose-error", "1.5,1deg"]));
    let wide = wide.fails(1, "30 scans were rejected");
    assert_eq!((&wide.json()["rejected"], &wide.json()["applied"]), (&30.into(), &0.into()));
    assert!(wide.stderr.contains("line 2: rejected: "), "{wide:?}");

    finish(replay(&server, &log, &["--map", "none", "--existing"])).fails(1, "no map 'none'");
    finish(replay(&server, &log, &["--map", "wide", "--existing", "--classes", "4"]))
        .fails(2, "--classes describes a new map");
    finish(replay(&server, &log, &["--map", "cut", "--classes", "4"])).fails(1, "MAP_EXISTS");
    finish(replay(&server, &log, &["--map", "Cut!"])).fails(2, "[a-z0-9]");
    finish(replay(&server, &log, &["--map", "cut", "--robots", "0"])).fails(2, "--robots");
    finish(replay(&server, &log, &["--map", "cut", "--robots", "999"])).fails(2, "at most 256");
    finish(replay(&server, &log, &["--map", "cut", "--rate", "0"])).fails(2, "--rate");
    finish(replay(&server, &log, &["--map", "cut", "--robot-prefix", "a b"])).fails(2, "robot name");
    finish(replay(&server, &bench.text("missing"), &["--map", "cut"])).fails(1, "missing");
    assert_eq!(server.terminate(), 0);
}

#[test]
fn maps_are_created_listed_shown_and_deleted() {
    let bench = Folder::new();
    let server = bench.serve(ANY);
    assert!(server.run(&["map", "list"]).ok().stderr.contains("no maps"));
    server.run(&["map", "create", "hall", "--resolution", "0.05", "--evidence", "inner"]).ok();
    let again = server.run(&["map", "create", "hall", "--resolution", "0.05", "--evidence", "inner"]).ok();
    assert!(again.stdout.contains("was there"), "{again:?}");
    server.run(&["map", "create", "hall"]).fails(1, "MAP_EXISTS");
    server.run(&["map", "create", "Hall"]).fails(2, "[a-z0-9]");
    server.run(&["map", "create", "yard", "--classes", "3"]).fails(2, "got 3");
    server.run(&["map", "create", "yard", "--range-max", "30", "--json"]).ok();
    let list = server.run(&["map", "list", "--json"]).ok().json();
    assert_eq!(list["maps"].as_array().unwrap().len(), 2);
    let table = server.run(&["map", "list"]).ok().stdout;
    assert!(table.contains("hall") && table.contains("0.05 m") && table.contains("inner"), "{table}");
    let shown = server.show("yard");
    assert_eq!(shown["config"]["sensors"]["default"]["range_max"], 30.0);
    let text = server.run(&["map", "show", "hall"]).ok().stdout;
    assert!(text.contains("inner") && text.contains("0.05 m"), "{text}");
    server.run(&["map", "show", "hal"]).fails(1, "no map 'hal'; did you mean 'hall'?");
    server.run(&["map", "delete", "hall"]).ok();
    server.run(&["map", "delete", "hall"]).fails(1, "no map 'hall'");
    server.run(&["map", "drop", "hall"]).fails(2, "drop");
    assert_eq!(server.terminate(), 0);
}

#[test]
fn regions_are_checked() {
    let bench = Folder::new();
    let log = bench.room(200);
    let server = bench.serve(ANY);
    finish(replay(&server, &log, &["--map", "room"])).ok();
    let free = ["check", "--map", "room", "--disc", "1.5,1.2,0.3", "--box", "-2,-1.5,-1.5,-1", "--require-free"];
    let done = server.run(&free).ok();
    assert_eq!(done.stdout, "box 1: free\ndisc 1: free\n");
    // Through the pillar, through the wall, and far outside.
    let mixed = [
        "check",
        "--map",
        "room",
        "--path",
        "-2,0,2,0,0.1",
        "--polygon",
        "3.8,0,4.2,0,4.2,0.4 3.8,0.4",
        "--disc",
        "90 90 1",
        "--json",
    ];
    let answer = server.run(&mixed).ok().json();
    assert_eq!(answer["sound"], true);
    let results = answer["results"].as_array().unwrap();
    assert!(results.iter().all(|result| result["free"] == false), "{answer}");
    assert_eq!(results[0]["reason"], "REASON_UNKNOWN", "the disc outside comes first: {answer}");
    assert_eq!((&results[1]["reason"], &results[2]["reason"]), (&"REASON_OCCUPIED".into(), &"REASON_OCCUPIED".into()));
    let along = results[2]["witness"]["distance"].as_f64().unwrap();
    assert!((1.3..1.7).contains(&along), "the pillar begins 1.7 m along the path: {along}");
    let path = ["check", "--map", "room", "--path", "-2,0,2,0,0.1", "--require-free"];
    let done = server.run(&path).fails(1, "1 of 1 regions are not guaranteed free");
    assert!(done.stdout.starts_with("path 1: not free: occupied at "), "{done:?}");
    server.run(&["check", "--map", "room", "--disc", "1.5,1.2,0.3", "--tolerance", "3"]).ok();
    server.run(&["check", "--map", "room", "--disc", "1.5,1.2,0.3", "--tolerance", "4"]).fails(1, "TOLERANCE_TOO_HIGH");
    server.run(&["check", "--map", "roam", "--disc", "1,1,1"]).fails(1, "did you mean 'room'?");
    server.run(&["check", "--map", "room", "--box", "1,1,0,0"]).fails(2, "INVALID_REGION");
    for (flags, words) in [
        (&["--disc", "1,2"][..], "X,Y,RADIUS"),
        (&["--disc", "1,2,x"], "\"x\" is not a number"),
        (&["--disc", "1,2,inf"], "not finite"),
        (&["--box", "1,2,3"], "MIN_X,MIN_Y,MAX_X,MAX_Y"),
        (&["--polygon", "1,2,3,4"], "three corners"),
        (&["--path", "1,2,3,4"], "then its radius"),
        (&["--tolerance", "-1", "--disc", "0,0,1"], "--tolerance"),
        (&[], "name a region"),
    ] {
        server.run(&[&["check", "--map", "room"], flags].concat()).fails(2, words);
    }
    assert_eq!(server.terminate(), 0);
}

#[test]
fn a_bad_configuration_ends_with_64() {
    let bench = Folder::new();
    let file = |name: &str, text: &str| {
        std::fs::write(bench.path(name), text).unwrap();
        bench.text(name)
    };
    for (config, words) in [
        (file("a.toml", "listn = \"127.0.0.1:0\"\n"), "did you mean `listen`?"),
        (file("b.toml", "listen = 7\n"), "listen"),
        (file("c.toml", "listen = \n"), "c.toml"),
        (file("d.toml", "listen = \"0.0.0.0:0\"\n"), "--insecure"),
        (file("e.toml", "[limits]\nmaps = 0\n"), "limits.maps"),
        (bench.text("missing.toml"), "missing.toml"),
    ] {
        let done = run(["serve", "--config", &config, "--data", &bench.text("data")]).fails(64, words);
        assert!(done.stdout.is_empty(), "{done:?}");
    }
    run(["serve", "--listen", "0.0.0.0:0", "--data", &bench.text("data")]).fails(64, "--insecure");
    run(["serve", "--store", "cloud"]).fails(64, "store");
    run(["serve", "--listen", "here"]).fails(2, "--listen");
    let wrong = ubbmap().env("UBBMAP_LISTN", "127.0.0.1:0").arg("serve").output().unwrap();
    Done::of(wrong).fails(64, "UBBMAP_LISTN");
    assert!(!bench.path("data").exists(), "nothing is opened before the configuration is right");
    std::fs::write(bench.path("file"), "").unwrap();
    run(["serve", "--listen", ANY, "--data", &bench.text("file")]).fails(1, "file");
}

#[test]
fn two_servers_do_not_share_an_address_or_a_store() {
    let bench = Folder::new();
    let server = bench.serve(ANY);
    let taken = run(["serve", "--listen", server.address(), "--data", &bench.text("other")]);
    let taken = taken.fails(1, server.address());
    assert!(taken.stderr.contains("port 0 takes a free one"), "{taken:?}");
    run(["demo", "--listen", server.address(), "--exit"]).fails(1, "port 0 takes a free one");
    let done = run(["serve", "--listen", ANY, "--data", &bench.text("data")]);
    assert_eq!((done.code, done.stdout.as_str()), (1, ""), "{done:?}");
    assert_eq!(server.terminate(), 0);
}

#[test]
fn the_demo_maps_a_building_and_ends() {
    let bench = Folder::new();
    let (data, png) = (bench.text("demo"), bench.text("demo.png"));
    let flags = ["demo", "--listen", ANY, "--robots", "3", "--speed", "20", "--exit", "--data", &data];
    let done = run(flags.iter().chain(&["--duration", "2", "--json", "--png", &png])).ok();
    let summary = done.json();
    let applied = summary["applied"].as_u64().unwrap();
    assert!(applied >= 300 && applied % 3 == 0 && summary["rejected"] == 0, "{summary}");
    assert!(summary["area_free"].as_f64().unwrap() > 20.0, "{summary}");
    assert_eq!(summary["examples"][0]["free"], true, "where a robot stands: {summary}");
    assert_eq!(summary["examples"][1]["free"], false, "the building's corner: {summary}");
    assert!(std::fs::read(bench.path("demo.png")).unwrap().starts_with(b"\x89PNG"));
    // The same store again goes on; the text form this time.
    let again = run(flags.iter().chain(&["--duration", "0.5"])).ok();
    assert!(again.stdout.starts_with("ubbmap demo on http://127.0.0.1:"), "{again:?}");
    assert!(again.stdout.contains("scans applied, 0 rejected"), "{again:?}");
    assert!(again.stdout.contains("m2 proven free") && again.stdout.contains(": guaranteed free"), "{again:?}");
    run(["demo", "--robots", "0"]).fails(2, "--robots");
}

#[test]
fn a_demo_of_which_no_port_was_asked_takes_a_free_one_where_its_own_is_taken() {
    // Somebody else may have it as well.
    let _taken = std::net::TcpListener::bind("127.0.0.1:8080");
    let done = run(["demo", "--robots", "1", "--duration", "0.2", "--exit"]).ok();
    let url = done.stdout.split_whitespace().find_map(|word| word.strip_prefix("http://127.0.0.1:"));
    assert!(url.is_some_and(|port| !port.starts_with("8080")), "{done:?}");
}

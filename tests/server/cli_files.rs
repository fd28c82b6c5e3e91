//! `ubbmap map snapshot, snapshots, restore, delete-snapshot, export, import` with the real binary.

#![allow(clippy::unwrap_used, clippy::panic, reason = "tests")]

use super::cli_support::{Done, Folder, Server, room_json, run};
use super::http_support::{agent, send};
use std::path::Path;
use ubbmap::store::read_map_file;

fn serve(folder: &Path) -> Server {
    Server::start_with(&folder.join("data"), "127.0.0.1:0", &[])
}

#[test]
fn maps_are_kept_restored_and_carried_to_another_server() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    std::fs::write(path("short.jsonl"), room_json(40)).unwrap();
    std::fs::write(path("long.jsonl"), room_json(90)).unwrap();
    let server = serve(folder.path());
    let replay = |log: &str| {
        let robot = ["--robot-prefix", "r", "--depth", "10"];
        server.run(&[&["replay", &path(log), "--map", "room", "--json"], &robot[..]].concat()).ok()
    };
    replay("short.jsonl");
    assert!(server.run(&["map", "snapshots", "room"]).ok().stderr.contains("no snapshots"));
    server.run(&["map", "restore", "room", "first"]).fails(1, "no snapshot 'first'; the map has no snapshots");
    let revision = server.show("room")["revision"].as_str().unwrap().to_owned();
    let taken = server.run(&["map", "snapshot", "room", "first"]).ok().stdout;
    assert_eq!(taken, format!("snapshot 'first' of map 'room' taken, revision {revision}\n"));
    server.run(&["map", "snapshot", "room", "first"]).fails(1, "SNAPSHOT_EXISTS");
    let first = server.leaves("room");
    replay("long.jsonl");
    let long = server.leaves("room");
    assert_ne!(first, long);
    let text = server.run(&["map", "show", "room"]).ok().stdout;
    let changed = text.lines().find_map(|line| line.strip_prefix("changed     ")).unwrap();
    assert!(changed.len() == 20 && changed.starts_with("20") && changed.ends_with('Z'), "{changed}");
    assert!(
        server.run(&["map", "snapshot", "room", "second", "--json"]).ok().json()["created"].as_f64().unwrap() > 1e9
    );

    server.run(&["map", "restore", "room", "firts"]).fails(1, "no snapshot 'firts'; did you mean 'first'?");
    server.run(&["map", "restore", "roam", "first"]).fails(1, "no map 'roam'; did you mean 'room'?");
    server.run(&["map", "restore", "room", "a b"]).fails(2, "[A-Za-z0-9]");
    let restored = server.run(&["map", "restore", "room", "first"]).ok().stdout;
    assert!(restored.starts_with("map 'room' is as in snapshot 'first', at revision "), "{restored}");
    assert_eq!(server.leaves("room"), first);
    // The scans that were taken back are sent again by the same command.
    replay("long.jsonl");
    assert_eq!(server.leaves("room"), long);
    let table = server.run(&["map", "snapshots", "room"]).ok().stdout;
    let lines: Vec<&str> = table.lines().collect();
    assert!(lines.len() == 3 && lines[0].starts_with("name") && lines[1].starts_with("first "), "{table}");
    let list = server.run(&["map", "snapshots", "room", "--json"]).ok().json();
    assert_eq!((&list["snapshots"][0]["name"], &list["snapshots"][0]["revision"]), (&"first".into(), &revision.into()));

    let done = server.run(&["map", "export", "room", "--out", &path("room.ubbmap"), "--json"]).ok().json();
    assert_eq!(done["bytes"].as_u64().unwrap(), std::fs::metadata(path("room.ubbmap")).unwrap().len());
    server.run(&["map", "export", "room", "--snapshot", "first", "--out", &path("first.ubbmap")]).ok();
    let other_folder = tempfile::tempdir().unwrap();
    let other = serve(other_folder.path());
    assert_eq!(other.run(&["map", "import", "hall", &path("first.ubbmap")]).ok().stdout.lines().count(), 1);
    assert_eq!(other.leaves("hall"), first);
    other.run(&["map", "import", "room", &path("room.ubbmap")]).ok();
    assert_eq!((other.leaves("room"), &other.show("room")["robots"]), (long, &server.show("room")["robots"]));
    other.run(&["map", "import", "room", &path("room.ubbmap")]).fails(1, "MAP_EXISTS");
    server.run(&["map", "delete-snapshot", "room", "first"]).ok();
    server.run(&["map", "delete-snapshot", "room", "first"]).fails(1, "no snapshot 'first'");
    assert_eq!((server.terminate(), other.terminate()), (0, 0));
}

#[test]
fn scans_that_a_restore_took_back_between_others_counted_as_sent() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    std::fs::write(path("short.jsonl"), room_json(40)).unwrap();
    std::fs::write(path("long.jsonl"), room_json(90)).unwrap();
    let server = serve(folder.path());
    let replay = |log: &str| {
        server.run(&["replay", &path(log), "--map", "room", "--json", "--robot-prefix", "r", "--depth", "10"]).ok()
    };
    replay("short.jsonl");
    server.run(&["map", "snapshot", "room", "first"]).ok();
    replay("long.jsonl");
    server.run(&["map", "restore", "room", "first"]).ok();
    // One that was on its way.
    let late = r#"{"robot": "r-1of1", "sequence": 60, "angle_min": 0, "angle_increment": 0.1, "ranges": [1.0],
        "pose": {"x": {"min": 0, "max": 0}, "y": {"min": 0, "max": 0}, "theta": {"min": 0, "max": 0}}}"#;
    let url = format!("{}/v1/maps/room/scans", server.url);
    assert_eq!(send(&agent(), "POST", &url, &[], late.as_bytes()).json()["applied"], 1);
    let again = replay("long.jsonl");
    assert_eq!((&again.json()["applied"], &again.json()["duplicates"]), (&49.into(), &41.into()));
    let robot = &server.show("room")["robots"][0];
    assert_eq!((&robot["highest_sequence"], &robot["applied"]), (&"90".into(), &"90".into()));
    assert_eq!(server.terminate(), 0);
}

#[test]
#[cfg(unix)]
fn a_link_is_followed_and_what_is_no_file_was_replaced_by_one() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    std::fs::write(path("room.jsonl"), room_json(5)).unwrap();
    let build = |out: &str| run(["build", &path("room.jsonl"), "--out", &path(out)]);
    std::os::unix::fs::symlink("target.ubbmap", path("link.ubbmap")).unwrap();
    std::fs::write(path("target.ubbmap"), "what was there").unwrap();
    build("link.ubbmap").ok();
    assert!(std::fs::symlink_metadata(path("link.ubbmap")).unwrap().is_symlink());
    read_map_file(&mut std::fs::read(path("target.ubbmap")).unwrap().as_slice()).unwrap();
    let made = std::process::Command::new("mkfifo").arg(path("pipe")).status().unwrap();
    assert!(made.success());
    build("pipe").fails(1, "no regular file");
    let still = std::os::unix::fs::FileTypeExt::is_fifo(&std::fs::metadata(path("pipe")).unwrap().file_type());
    assert!(still);
}

#[test]
#[cfg(unix)]
fn a_full_disk_during_an_export_was_told_as_a_file_that_broke_off() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    std::fs::write(path("room.jsonl"), room_json(40)).unwrap();
    let server = serve(folder.path());
    server.run(&["replay", &path("room.jsonl"), "--map", "room"]).ok();
    // No file may grow beyond a block: what comes after it is an error of the write.
    let limited = format!(
        "trap '' XFSZ; ulimit -f 1; exec \"$0\" map export room --format nav2 --mode scale --out {} --server {}",
        path("room.zip"),
        server.url
    );
    let output =
        std::process::Command::new("sh").args(["-c", &limited, env!("CARGO_BIN_EXE_ubbmap")]).output().unwrap();
    let done = Done::of(output).fails(1, &format!("cannot write {}", path("room.zip")));
    assert!(done.stderr.contains("File too large"), "{done:?}");
    assert!(!std::fs::exists(path("room.zip")).unwrap());
    assert_eq!(server.terminate(), 0);
}

#[test]
fn files_are_whole_or_not_there() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    std::fs::write(path("room.jsonl"), room_json(40)).unwrap();
    run(["build", &path("room.jsonl"), "--out", &path("built.ubbmap")]).ok();
    let server = serve(folder.path());
    let imported = server.run(&["map", "import", "room", &path("built.ubbmap"), "--json"]).ok().json();
    let (_, built) = read_map_file(&mut std::fs::File::open(path("built.ubbmap")).unwrap()).unwrap();
    assert_eq!(imported["revision"], built.revision.to_string(), "a file of `build` can be imported");

    server.run(&["map", "export", "room", "--format", "nav2", "--out", &path("room.zip"), "--depth", "12"]).ok();
    assert!(std::fs::read(path("room.zip")).unwrap().starts_with(b"PK"));
    server.run(&["map", "export", "room", "--format", "nav2", "--out", &path("nav2/"), "--mode", "scale"]).ok();
    let yaml = std::fs::read_to_string(path("nav2/map.yaml")).unwrap();
    assert!(yaml.contains("\nmode: scale\nresolution: 0.1\norigin: ["), "{yaml}");
    assert!(std::fs::read(path("nav2/map.pgm")).unwrap().starts_with(b"P5\n"));

    std::fs::write(path("cut.ubbmap"), &std::fs::read(path("built.ubbmap")).unwrap()[..500]).unwrap();
    server.run(&["map", "import", "cut", &path("cut.ubbmap")]).fails(1, "INVALID_FILE");
    server.run(&["map", "import", "cut", &path("none.ubbmap")]).fails(1, "cannot read");
    // What is no map file is told before anything is sent, whether or not there is a server.
    std::fs::write(path("notes.txt"), "notes").unwrap();
    for (file, words) in [
        (path(""), "is a folder, no map file"),
        (path("none.ubbmap"), "none.ubbmap: No such file"),
        (path("notes.txt"), "notes.txt is no map file"),
    ] {
        run(["map", "import", "cut", &file, "--server", "http://127.0.0.1:1"])
            .fails(1, &words.replace("none.ubbmap: ", ""));
        let done = server.run(&["map", "import", "cut", &file]).fails(1, words);
        assert!(!done.stderr.contains("server"), "{done:?}");
    }
    server.run(&["map", "show", "cut"]).fails(1, "no map 'cut'");
    server.run(&["map", "export", "rom", "--out", &path("x.ubbmap")]).fails(1, "did you mean 'room'?");
    server.run(&["map", "export", "room", "--snapshot", "s", "--out", &path("x.ubbmap")]).fails(1, "no snapshot 's'");
    server.run(&["map", "export", "room", "--out", &path("none/x.ubbmap")]).fails(1, "cannot write");
    server.run(&["map", "export", "room", "--out", &path("x.ubbmap"), "--depth", "3"]).fails(2, "--format nav2");
    server.run(&["map", "export", "room", "--out", &path("x/")]).fails(2, "needs a name");
    server.run(&["map", "export", "room"]).fails(2, "--out");
    let left: Vec<_> = std::fs::read_dir(folder.path()).unwrap().map(|entry| entry.unwrap().file_name()).collect();
    assert!(!left.iter().any(|name| name.to_str().unwrap().starts_with('x')), "{left:?}");
    assert!(!left.iter().any(|name| name.to_str().unwrap().ends_with(".partial")), "{left:?}");
    assert_eq!(server.terminate(), 0);
}

#[cfg(unix)]
#[test]
fn a_link_that_lay_in_the_way_of_a_file_was_followed() {
    let folder = Folder::new();
    std::fs::write(folder.path("precious"), "precious").unwrap();
    // The shell's number is the command's, so its name beside the file is known before.
    let laid = "ln -s \"$1/precious\" \"$1/.tokens.toml.$$.partial\" && \
                exec \"$0\" token create --name a --role read --file \"$1/tokens.toml\"";
    let done = std::process::Command::new("sh")
        .args(["-c", laid, env!("CARGO_BIN_EXE_ubbmap"), &folder.text("")])
        .output()
        .unwrap();
    assert!(done.status.success(), "{done:?}");
    assert_eq!(std::fs::read_to_string(folder.path("precious")).unwrap(), "precious");
    assert!(std::fs::read_to_string(folder.path("tokens.toml")).unwrap().contains("name = \"a\""));
    assert!(!std::fs::symlink_metadata(folder.path("tokens.toml")).unwrap().is_symlink());
}

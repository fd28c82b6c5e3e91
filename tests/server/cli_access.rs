//! Tokens by the command line, and what the real binary does with them: addresses, signals, the log.

#![allow(clippy::unwrap_used, reason = "a test may end where its ground is not as it should be")]

use super::cli_support::{Done, Folder, run, ubbmap, until};
use std::fs;
use std::io::{BufRead, BufReader};
use std::ops::Deref;
use std::process::{Child, Command, Stdio};
use ubbmap::transport::access::Roll;

struct Desk(Folder);

impl Deref for Desk {
    type Target = Folder;

    fn deref(&self) -> &Folder {
        &self.0
    }
}

impl Desk {
    fn new() -> Self {
        Self(Folder::new())
    }

    fn tokens(&self) -> String {
        fs::read_to_string(self.path("tokens.toml")).unwrap()
    }

    fn token(&self, args: &[&str]) -> Done {
        run([&["token"], args, &["--file", &self.text("tokens.toml")]].concat())
    }

    fn create(&self, name: &str, role: &str, more: &[&str]) -> String {
        let done = self.token(&[&["create", "--name", name, "--role", role], more].concat()).ok();
        assert!(done.stderr.contains(name) && !done.stderr.contains("ubbmap_"), "{done:?}");
        done.stdout.trim().to_owned()
    }

    fn serve(&self, flags: &[&str]) -> Running {
        let log = fs::File::create(self.path("log")).unwrap();
        let mut child = ubbmap()
            .args(["serve", "--store", "memory", "--log", "info"])
            .args(flags)
            .stdout(Stdio::piped())
            .stderr(log)
            .spawn()
            .unwrap();
        let mut line = String::new();
        BufReader::new(child.stdout.take().unwrap()).read_line(&mut line).unwrap();
        let port = line.trim().rsplit(':').next().unwrap_or_default().to_owned();
        assert!(!port.is_empty(), "{}", self.log());
        Running { child, url: format!("http://127.0.0.1:{port}") }
    }

    fn log(&self) -> String {
        fs::read_to_string(self.path("log")).unwrap()
    }
}

/// A server; killed when dropped.
struct Running {
    child: Child,
    url: String,
}

impl Running {
    fn signal(&self, name: &str) {
        let pid = self.child.id().to_string();
        assert!(Command::new("kill").args([name, &pid]).status().unwrap().success());
    }

    fn run(&self, token: &str, args: &[&str]) -> Done {
        Done::of(ubbmap().env("UBBMAP_SERVER", &self.url).env("UBBMAP_TOKEN", token).args(args).output().unwrap())
    }
}

impl Drop for Running {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

#[test]
fn tokens_are_made_listed_and_revoked() {
    let desk = Desk::new();
    let planner = desk.create("planner", "read", &["--expires", "90d"]);
    let robot = desk.create("amr-7", "write", &["--maps", "hall, yard-*", "--robot", "amr-7"]);
    assert!(
        planner != robot && [&planner, &robot].iter().all(|t| t.starts_with("ubbmap_") && t.len() == 50),
        "{robot}"
    );
    let written = desk.tokens();
    assert!(!written.contains(&planner) && !written.contains(&robot), "{written}");
    #[cfg(unix)]
    {
        use std::os::unix::fs::PermissionsExt;
        assert_eq!(fs::metadata(desk.path("tokens.toml")).unwrap().permissions().mode() & 0o777, 0o600);
    }
    let roll = Roll::parse(&written).unwrap();
    assert_eq!(roll.by_token(&planner).unwrap().name(), "planner");
    assert_eq!(roll.by_token(&robot).unwrap().grant().maps.patterns(), ["hall", "yard-*"]);
    assert!(roll.by_token("ubbmap_").is_none());

    desk.token(&["create", "--name", "planner", "--role", "admin"]).fails(1, "token revoke");
    assert_eq!(desk.tokens(), written);
    let list = desk.token(&["list"]).ok().stdout;
    assert!(
        list.contains("planner") && list.contains("hall, yard-* (robot amr-7)") && list.contains("never"),
        "{list}"
    );
    let json = desk.token(&["list", "--json"]).ok().json();
    assert_eq!((&json["entries"][1]["robot"], &json["entries"][0]["expired"]), (&"amr-7".into(), &false.into()));

    // What people wrote stays, down to the comment above the next entry.
    let noted = written.replace("[[token]]\nname = \"amr-7\"", "# The robot in the hall.\n[[token]]\nname = \"amr-7\"");
    assert_ne!(noted, written);
    fs::write(desk.path("tokens.toml"), &noted).unwrap();
    desk.token(&["revoke", "planner"]).ok();
    let left = desk.tokens();
    assert!(
        left.contains("# The robot in the hall.\n[[token]]\nname = \"amr-7\"") && !left.contains("planner"),
        "{left}"
    );
    assert!(left.starts_with("# Who may do what"), "{left}");
    desk.token(&["revoke", "planner"]).fails(1, "token list");
    desk.token(&["revoke", "amr-7"]).ok();
    assert!(Roll::parse(&desk.tokens()).unwrap().entries().is_empty());
}

#[test]
fn what_makes_no_token_is_named() {
    let desk = Desk::new();
    let create = |more: &[&str]| desk.token(&[&["create"], more].concat());
    create(&["--name", "a", "--role", "root"]).fails(2, "read, write or admin");
    create(&["--name", "", "--role", "read"]).fails(2, "1 to 80 characters");
    create(&["--name", "a", "--role", "read", "--maps", "Hall"]).fails(2, "\"Hall\" must be a map's name");
    create(&["--name", "a", "--role", "read", "--maps", ","]).fails(2, "names no map");
    create(&["--name", "a", "--role", "read", "--expires", "soon"]).fails(2, "90d");
    create(&["--name", "a", "--role", "read", "--expires", "9999y"]).fails(2, "year 9999");
    create(&["--name", "a", "--role", "read", "--robot", "a/b"]).fails(2, "robot");
    assert!(!desk.path("tokens.toml").exists());
    desk.token(&["list"]).fails(1, "cannot read");
    run(["token", "list"]).fails(2, "--file");
    fs::write(
        desk.path("tokens.toml"),
        "[[token]]\nname = \"a\"\nrole = \"read\"\nmaps = [\"*\"]\ntoken = \"ubbmap_c2VjcmV0\"\n",
    )
    .unwrap();
    let done = create(&["--name", "b", "--role", "read"]).fails(1, "line 5");
    assert!(done.stderr.contains("unknown field `token`") && !done.stderr.contains("c2VjcmV0"), "{done:?}");
    // Without a file the entry is shown, to be put into one.
    let done = run(["token", "create", "--name", "it's \"me\"", "--role", "read"]).ok();
    let entry = done.stderr.split_once("\n").unwrap().1;
    assert_eq!(Roll::parse(entry).unwrap().by_token(done.stdout.trim()).unwrap().name(), "it's \"me\"");
}

#[test]
fn an_address_beyond_loopback_takes_tokens_or_the_word() {
    let desk = Desk::new();
    let serve = |flags: &[&str]| run([&["serve", "--store", "memory", "--listen", "0.0.0.0:0"], flags].concat());
    serve(&[]).fails(64, "--insecure");
    serve(&[]).fails(64, "ubbmap token create");
    serve(&["--tokens", &desk.text("none.toml")]).fails(64, "cannot read the file of tokens");
    fs::write(desk.path("bad.toml"), "[[token]]\nname = \"a\"\n").unwrap();
    serve(&["--tokens", &desk.text("bad.toml")]).fails(64, "is not valid");
    let loopback = ["serve", "--store", "memory", "--listen", "127.0.0.1:0"];
    run([&loopback[..], &["--admin-listen", "0.0.0.0:0"]].concat()).fails(64, "--insecure");
    run([&loopback[..], &["--admin-listen", "nowhere"]].concat()).fails(2, "--admin-listen");

    let admin = desk.create("admin", "admin", &[]);
    let server = desk.serve(&["--listen", "0.0.0.0:0", "--tokens", &desk.text("tokens.toml")]);
    server.run("", &["map", "list"]).fails(1, "UBBMAP_TOKEN");
    server.run(&admin, &["map", "list"]).ok();
    drop(server);

    let server = desk.serve(&["--listen", "0.0.0.0:0", "--insecure"]);
    let ready = ureq::get(format!("{}/readyz", server.url)).call().unwrap().body_mut().read_to_string().unwrap();
    let ready: serde_json::Value = serde_json::from_str(&ready).unwrap();
    assert_eq!((&ready["status"], &ready["insecure"]), (&"ready".into(), &true.into()));
    assert!(ready["warning"].as_str().unwrap().contains("--insecure"), "{ready}");
    server.run("", &["map", "create", "hall"]).ok();
    let log = desk.log();
    let warned: Vec<&str> = log.lines().filter(|line| line.contains("WARN")).collect();
    assert!(warned[0].contains("anyone who reaches this server"), "{log}");
    assert!(warned[1].contains("CreateMap") && warned[1].contains("insecure=true"), "{log}");
}

#[test]
fn the_command_line_shows_its_token_and_never_prints_it() {
    let desk = Desk::new();
    let (admin, reader) = (desk.create("admin", "admin", &[]), desk.create("reader", "read", &[]));
    let server = desk.serve(&["--listen", "127.0.0.1:0", "--tokens", &desk.text("tokens.toml")]);
    fs::write(desk.path("token"), format!("{admin}\n")).unwrap();
    server.run("", &["map", "create", "hall", "--token-file", &desk.text("token")]).ok();
    server.run("", &["map", "show", "hall", "--token", &reader]).ok();
    // A flag stands above the environment.
    server.run(&admin, &["map", "delete", "hall", "--token", &reader]).fails(1, "\"reader\" has the role read");
    server.run("two words", &["map", "list"]).fails(2, "UBBMAP_TOKEN is no token");
    let file = server.run("", &["map", "list", "--token-file", &desk.text("none")]).fails(2, "--token-file");
    assert!(file.stderr.contains("cannot read"), "{file:?}");
    server.run("ubbmap_c2VjcmV0", &["map", "list"]).fails(1, "not known to this server");
    fs::write(desk.path("room.jsonl"), super::cli_support::room_json(20)).unwrap();
    let replay = ["replay", &desk.text("room.jsonl"), "--map", "hall"];
    server.run(&reader, &replay).fails(1, "PERMISSION_DENIED");
    server.run(&admin, &replay).ok();
    server.run(&admin, &["map", "delete", "hall"]).ok();
    let log = desk.log();
    for secret in [&admin, &reader, "c2VjcmV0"] {
        assert!(!log.contains(secret.trim_start_matches("ubbmap_")), "a token is in the log");
    }
}

#[test]
fn every_change_by_an_administrator_is_in_the_log() {
    let desk = Desk::new();
    let (admin, reader) = (desk.create("boss", "admin", &[]), desk.create("reader", "read", &[]));
    let server = desk.serve(&["--listen", "127.0.0.1:0", "--tokens", &desk.text("tokens.toml")]);
    let file = desk.text("hall.ubbmap");
    for args in [
        &["map", "create", "hall"][..],
        &["map", "snapshot", "hall", "then"],
        &["map", "restore", "hall", "then"],
        &["map", "export", "hall", "--out", &file],
        &["map", "import", "copy", &file],
        &["map", "delete-snapshot", "hall", "then"],
        &["map", "delete", "hall"],
    ] {
        server.run(&admin, args).ok();
    }
    server.run(&admin, &["map", "delete", "hall"]).fails(1, "no map");
    server.run(&reader, &["map", "delete", "copy"]).fails(1, "PERMISSION_DENIED");
    let mut request = ureq::delete(format!("{}/v1/maps/copy", server.url)).header("x-request-id", "r-1");
    request = request.header("authorization", format!("Bearer {admin}"));
    request.call().unwrap();
    let log = desk.log();
    let lines: Vec<&str> = log.lines().filter(|line| line.contains("ubbmap::audit")).collect();
    let expected = [
        ("CreateMap", "map=\"hall\"", "OK"),
        ("CreateSnapshot", "snapshot=\"then\"", "OK"),
        ("RestoreSnapshot", "snapshot=\"then\"", "OK"),
        ("ImportMap", "map=\"copy\"", "OK"),
        ("DeleteSnapshot", "snapshot=\"then\"", "OK"),
        ("DeleteMap", "map=\"hall\"", "OK"),
        ("DeleteMap", "map=\"hall\"", "MAP_NOT_FOUND"),
        ("DeleteMap", "request_id=\"r-1\"", "OK"),
    ];
    assert_eq!(lines.len(), expected.len(), "{log}");
    for (line, (operation, what, outcome)) in lines.iter().zip(expected) {
        let words = ["caller=\"boss\"", "peer=127.0.0.1:", "transport=\"rest\"", what];
        assert!(words.iter().all(|word| line.contains(word)), "{words:?}: {line}");
        assert!(line.contains(&format!("operation=\"{operation}\"")), "{operation}: {line}");
        assert!(line.contains(&format!("outcome=\"{outcome}\"")), "{outcome}: {line}");
    }
    // Who may not is told so, in a line of another kind.
    assert!(log.contains("ubbmap::access") && log.contains("\"reader\" has the role read"), "{log}");
}

#[test]
fn a_signal_has_the_tokens_read_again() {
    let desk = Desk::new();
    let (admin, reader) = (desk.create("admin", "admin", &[]), desk.create("reader", "read", &[]));
    let server = desk.serve(&["--listen", "127.0.0.1:0", "--tokens", &desk.text("tokens.toml")]);
    server.run(&reader, &["map", "list"]).ok();
    desk.token(&["revoke", "reader"]).ok();
    server.signal("-HUP");
    until("the file is read", || desk.log().contains("read anew: 1 entries"));
    server.run(&reader, &["map", "list"]).fails(1, "UNAUTHENTICATED");
    server.run(&admin, &["map", "list"]).ok();
    // Without tokens it is no reason to end.
    let open = desk.serve(&["--listen", "127.0.0.1:0"]);
    open.signal("-HUP");
    open.run("", &["map", "list"]).ok();
}

#[test]
fn of_changes_to_a_file_of_tokens_at_one_time_some_were_lost() {
    let folder = Folder::new();
    let file = folder.text("tokens.toml");
    let create = |name: &str| {
        let mut command = ubbmap();
        command.args(["token", "create", "--file", &file, "--name", name, "--role", "read"]);
        command.stdout(Stdio::null()).stderr(Stdio::null()).spawn().unwrap()
    };
    for round in 0..3 {
        let bad = format!("bad-{round}");
        assert!(create(&bad).wait().unwrap().success());
        let mut children: Vec<Child> = (0..8).map(|place| create(&format!("n-{round}-{place}"))).collect();
        children.push(ubbmap().args(["token", "revoke", "--file", &file, &bad]).stderr(Stdio::null()).spawn().unwrap());
        assert!(children.iter_mut().all(|child| child.wait().unwrap().success()));
        let roll = Roll::parse(&fs::read_to_string(&file).unwrap()).unwrap();
        let names: Vec<&str> = roll.entries().iter().map(|entry| entry.caller.name()).collect();
        assert_eq!(names.len(), 8 * (round + 1), "{names:?}");
        assert!(!names.contains(&bad.as_str()));
    }
    // Nothing is left of the attempts but the lock, which a list does not ask for.
    fs::remove_file(folder.path("tokens.toml.lock")).unwrap();
    run(["token", "list", "--file", &file]).ok();
    run(["token", "revoke", "--file", &folder.text("none.toml"), "a"]).fails(1, "cannot read");
    assert_eq!(fs::read_dir(folder.path("")).unwrap().count(), 1);
}

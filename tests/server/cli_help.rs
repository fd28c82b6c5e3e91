//! The help of every command, and that each of its examples runs as it stands.

#![allow(clippy::unwrap_used, clippy::panic, reason = "tests")]

use super::bag_support::{Bag, Packed, SCAN, Scan, TF, flat, transforms};
use super::cli_support::{Done, Server, gzip, room_json, room_scans, run, ubbmap};
use std::io::{BufRead, BufReader};
use std::path::Path;
use std::process::{Command, Stdio};
use ubbmap::store::{SledOptions, SledStore};

/// Every command, as the words behind the program's name.
fn commands() -> Vec<Vec<String>> {
    let mut found = vec![Vec::new()];
    let mut next = 0;
    while next < found.len() {
        let path: Vec<String> = found[next].clone();
        let help = help(&path);
        let listed = help.lines().skip_while(|line| *line != "Commands:").skip(1).take_while(|line| !line.is_empty());
        // What is wrapped stands farther in.
        let names = listed.filter(|line| line.starts_with("  ") && !line.starts_with("   "));
        let names = names.map(|line| line.split_whitespace().next().unwrap().to_owned()).filter(|name| name != "help");
        found.extend(names.map(|name| [path.clone(), vec![name]].concat()));
        next += 1;
    }
    found
}

fn help(command: &[String]) -> String {
    run(command.iter().map(String::as_str).chain(["--help"])).ok().stdout
}

fn examples(help: &str) -> Vec<String> {
    let lines = help.lines().skip_while(|line| *line != "Example:").skip(1);
    lines.take_while(|line| line.starts_with("  ubbmap ")).map(|line| line.trim().to_owned()).collect()
}

/// Files and maps as every example finds them.
struct Ground {
    folder: tempfile::TempDir,
    server: Server,
}

impl Ground {
    fn new() -> Self {
        let folder = tempfile::tempdir().unwrap();
        let server = Server::start(&folder.path().join("served"), "127.0.0.1:0");
        std::fs::write(folder.path().join("fr079.jsonl.gz"), gzip(room_json(20).as_bytes())).unwrap();
        let mut drive = Bag::default();
        for (i, (x, y, theta, ranges)) in room_scans(5).into_iter().enumerate() {
            let (stamp, ranges) = (i as f64, ranges.iter().map(|range| *range as f32).collect());
            drive.put("/tf", TF, transforms(stamp, &[("map", "laser", flat(x, y, theta))]));
            let step = std::f32::consts::PI / 180.0;
            let scan = Scan {
                stamp,
                frame: "laser",
                angle_min: -90.0 * step,
                angle_increment: step,
                time_increment: 0.0,
                range_max: 30.0,
                ranges,
            };
            drive.put("/scan", SCAN, scan.message(true));
        }
        std::fs::create_dir(folder.path().join("drive")).unwrap();
        std::fs::write(folder.path().join("drive/drive_0.mcap"), drive.mcap(Packed::Zstd)).unwrap();
        drop(SledStore::open(&folder.path().join("maps"), SledOptions::default()).unwrap());
        let ground = Self { folder, server };
        ground.run(&["build", "fr079.jsonl.gz", "--out", "hall.ubbmap"]).ok();
        ground
    }

    fn run(&self, arguments: &[&str]) -> Done {
        let mut command = ubbmap();
        command.env("UBBMAP_SERVER", &self.server.url).current_dir(self.folder.path()).args(arguments);
        Done::of(command.output().unwrap())
    }

    /// A map `hall` with scans and a snapshot, as long as the example does not make them.
    fn prepare(&self, command: &str) {
        for map in ["hall", "hall-2", "fr079"] {
            self.run(&["map", "delete", map]);
        }
        if command != "map create" && command != "map" {
            self.run(&["replay", "fr079.jsonl.gz", "--map", "hall"]).ok();
        }
        if !["map create", "map snapshot", "map"].contains(&command) {
            self.run(&["map", "snapshot", "hall", "before-the-move"]).ok();
        }
    }

    /// Runs an example; one that serves is asked to end once it says that it is ready.
    fn example(&self, command: &str, line: &str) {
        self.prepare(command);
        let line = line.replace("http://127.0.0.1:8080", &self.server.url).replace("127.0.0.1:8080", "127.0.0.1:0");
        let mut words: Vec<&str> = line.split_whitespace().skip(1).collect();
        match command {
            // Neither takes part of a minute here.
            "experiment" => words.extend(["--sample", "3", "--simulated", "10"]),
            "demo" if words.contains(&"--exit") => words.extend(["--listen", "127.0.0.1:0"]),
            _ => {}
        }
        if let Some(at) = words.iter().position(|word| *word == "--duration") {
            words[at + 1] = "1";
        }
        if (words[0] == "serve" && !words.contains(&"--check")) || (words[0] == "demo" && !words.contains(&"--exit")) {
            if !words.contains(&"--listen") {
                words.extend(["--listen", "127.0.0.1:0"]);
            }
            return serve_and_end(self.folder.path(), &words);
        }
        let done = self.run(&words);
        assert_eq!(done.code, 0, "{line}: {done:?}");
    }
}

fn serve_and_end(folder: &Path, words: &[&str]) {
    let mut child = ubbmap().current_dir(folder).args(words).stdout(Stdio::piped()).spawn().unwrap();
    let mut ready = String::new();
    BufReader::new(child.stdout.take().unwrap()).read_line(&mut ready).unwrap();
    assert!(ready.contains("http://127.0.0.1:"), "{words:?}: {ready:?}");
    assert!(Command::new("kill").args(["-TERM", &child.id().to_string()]).status().unwrap().success());
    let ended = child.wait().unwrap();
    assert!(ended.success(), "{words:?}: {ended}");
}

#[test]
fn every_command_has_an_example_that_runs() {
    let ground = Ground::new();
    let commands = commands();
    assert!(commands.len() >= 24, "{commands:?}");
    for command in commands {
        let (help, name) = (help(&command), command.join(" "));
        let examples = examples(&help);
        assert!(!examples.is_empty(), "ubbmap {name} --help has no example:\n{help}");
        for line in examples {
            ground.example(&name, &line);
        }
    }
    assert_eq!(ground.server.terminate(), 0);
}

#[test]
fn every_command_that_prints_has_a_form_for_programs() {
    // A shell's script and a manual page are for programs as they are; these hold other commands.
    let without = ["", "map", "store", "token", "completions", "man"];
    for command in commands().iter().map(|words| words.join(" ")).filter(|name| !without.contains(&name.as_str())) {
        let words: Vec<String> = command.split(' ').map(str::to_owned).collect();
        assert!(help(&words).contains("--json"), "ubbmap {command} has no --json");
    }
}

#[test]
fn shells_and_man_learn_every_command() {
    let folder = tempfile::tempdir().unwrap();
    for (shell, word) in [
        ("bash", "complete -F _ubbmap"),
        ("zsh", "#compdef ubbmap"),
        ("fish", "complete -c ubbmap"),
        ("elvish", "edit:"),
    ] {
        let script = run(["completions", shell]).ok().stdout;
        assert!(script.contains(word) && script.contains("experiment"), "{shell}: {script}");
    }
    // The shell itself takes it.
    let script = folder.path().join("ubbmap.bash");
    std::fs::write(&script, run(["completions", "bash"]).ok().stdout).unwrap();
    let typed = format!(
        "source {}; COMP_WORDS=(ubbmap rep); COMP_CWORD=1; _ubbmap ubbmap rep ubbmap; echo \"${{COMPREPLY[@]}}\"",
        script.display()
    );
    let completed = Command::new("bash").args(["-c", &typed]).output().unwrap();
    assert_eq!(
        String::from_utf8(completed.stdout).unwrap().trim(),
        "replay",
        "{}",
        String::from_utf8_lossy(&completed.stderr)
    );
    run(["completions", "tcsh"]).fails(2, "tcsh");
    assert!(run(["man"]).ok().stdout.contains(".TH ubbmap 1"));
    let out = folder.path().join("man1");
    run(["man", "--out", out.to_str().unwrap()]).ok();
    for page in ["ubbmap.1", "ubbmap-build.1", "ubbmap-map-export.1"] {
        assert!(std::fs::read_to_string(out.join(page)).unwrap().contains("Example"), "{page}");
    }
}

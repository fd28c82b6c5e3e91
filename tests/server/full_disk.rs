//! A disk that is full, and one whose writes or syncs fail: writes stop with a clear error, reads go on, nothing is
//! acknowledged that is not stored, and after a restart on a sound disk writes go on.
//!
//! The full disk is a small tmpfs in a mount namespace of its own, which ends with the test's process. Where that is not
//! permitted, files of the server may not grow beyond a limit. Failures of single calls are injected by `strace`.

use crate::cli_support::{Server, ubbmap};
use crate::crash_client::Client;
use crate::crash_support::{Course, courses, say};
use crate::power_cut_trace::obstacle;
use std::ffi::OsStr;
use std::fs;
use std::io::{BufRead, BufReader};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

const ROBOTS: usize = 3;
const REQUESTS: usize = 150;

/// Starts the server by another program that becomes it; an error is what it says when it ends at once.
fn start(before: &[&OsStr], data: &Path) -> Result<Server, String> {
    let plain = ubbmap();
    let mut command = match before {
        [] => ubbmap(),
        [program, rest @ ..] => {
            let mut command = Command::new(program);
            command.args(rest).arg(plain.get_program());
            for (name, _) in plain.get_envs() {
                command.env_remove(name);
            }
            command
        }
    };
    command.args(["serve", "--log", "off", "--listen", "127.0.0.1:0", "--data"]).arg(data);
    let mut child = command.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
    let mut line = String::new();
    BufReader::new(child.stdout.take().unwrap()).read_line(&mut line).unwrap();
    let url = line.trim().rsplit(' ').next().unwrap_or_default().to_owned();
    if url.starts_with("http://127.0.0.1:") {
        // What it says later is read by nobody, and must not fill the pipe: it logs nothing.
        return Ok(Server { child, url });
    }
    let output = child.wait_with_output().unwrap();
    let text = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(output.status.code().is_some_and(|code| code != 0), "{text}");
    Err(text)
}

/// Robots, each with a map, and how far each was acknowledged.
struct Site {
    courses: Vec<Course>,
    acknowledged: Vec<u64>,
}

fn map(number: usize) -> String {
    format!("hall-{number}")
}

impl Site {
    fn new() -> Self {
        Self { courses: courses(3, ROBOTS, REQUESTS), acknowledged: vec![0; ROBOTS] }
    }

    fn create(&self, client: &Client) {
        for (number, course) in self.courses.iter().enumerate() {
            let (status, answer) = client.create(&map(number), course).unwrap();
            assert!(status < 300, "{answer}");
        }
    }

    /// Sends one request of every robot at the same time; the answers that are none.
    fn send(&mut self, client: &Client) -> Vec<(u16, serde_json::Value)> {
        let (courses, acknowledged) = (&self.courses, &self.acknowledged);
        let answers: Vec<_> = std::thread::scope(|scope| {
            let send = |number: usize| {
                let request = &courses[number].requests[usize::try_from(acknowledged[number]).unwrap()];
                scope.spawn(move || client.insert(&map(number), request).unwrap())
            };
            let sent: Vec<_> = (0..ROBOTS).map(send).collect();
            sent.into_iter().map(|answer| answer.join().unwrap()).collect()
        });
        let mut failed = Vec::new();
        for (number, (status, answer)) in answers.into_iter().enumerate() {
            if status == 200 {
                self.acknowledged[number] += 1;
                assert_eq!(crate::crash_client::number(&answer["revision"]), self.acknowledged[number]);
            } else {
                failed.push((status, answer));
            }
        }
        failed
    }

    /// Sends until the store fails, and holds what the server is then.
    fn send_until_it_fails(&mut self, client: &Client) {
        let failed = loop {
            let left = self.acknowledged.iter().all(|done| *done < REQUESTS as u64 - 20);
            assert!(left, "the store never failed: {:?}", self.acknowledged);
            let failed = self.send(client);
            if !failed.is_empty() {
                break failed;
            }
        };
        failed.iter().for_each(|answer| assert_stopped(answer));
        self.assert_reads_go_on(client);
    }

    /// Every map is served as it was acknowledged; no write is taken.
    fn assert_reads_go_on(&mut self, client: &Client) {
        for (number, course) in self.courses.iter().enumerate() {
            assert_eq!(client.check(&map(number), course), self.acknowledged[number], "what is not stored is served");
        }
        let before = self.acknowledged.clone();
        let failed = self.send(client);
        assert_eq!((failed.len(), &self.acknowledged), (ROBOTS, &before));
        failed.iter().for_each(|answer| assert_stopped(answer));
        assert_stopped(&client.create("another", &self.courses[0]).unwrap());
        assert_stopped(&client.get("/readyz").unwrap());
        assert_eq!(client.get("/healthz").unwrap().0, 200);
    }

    /// After a restart everything acknowledged is there, and the robots go on.
    fn assert_goes_on(&mut self, client: &Client) {
        assert_eq!(client.get("/readyz").unwrap().0, 200);
        for (number, course) in self.courses.iter().enumerate() {
            let (revision, least) = (client.check(&map(number), course), self.acknowledged[number]);
            assert!((least..=least + 1).contains(&revision), "{revision}, {least} was acknowledged");
            self.acknowledged[number] = revision;
        }
        for _ in 0..10 {
            assert_eq!(self.send(client), Vec::new());
        }
        for (number, course) in self.courses.iter().enumerate() {
            assert_eq!(client.check(&map(number), course), self.acknowledged[number]);
        }
    }
}

/// The store takes no writes, and the answer says what is to be done.
#[track_caller]
fn assert_stopped((status, answer): &(u16, serde_json::Value)) {
    assert_eq!((*status, answer["code"].as_str()), (500, Some("STORE_FAILED")), "{answer}");
    let detail = answer["detail"].as_str().unwrap();
    assert!(detail.contains("takes no writes") && detail.contains("restart"), "{detail}");
    assert!(!detail.contains('/'), "a client reads where the data is: {detail}");
}

/// Run by the test below in a process whose disk is small.
#[test]
#[ignore = "run by a_full_disk_stops_writes_and_a_restart_with_room_goes_on"]
fn full_disk_child() {
    let Ok(text) = std::env::var("UBBMAP_TEST_DISK") else { return };
    let (kind, directory) = text.split_once(' ').unwrap();
    let data = Path::new(directory).join("data");
    let ballast = Path::new(directory).join("ballast");
    // Blocks of 512 bytes: 1 MiB; without the trap the signal would end the process.
    let limit = ["sh", "-c", "trap '' XFSZ; ulimit -f 2048; exec \"$0\" \"$@\""].map(OsStr::new);
    let small: &[&OsStr] = if kind == "limit" { &limit } else { &[] };
    let mut site = Site::new();
    let server = start(small, &data).unwrap();
    let client = Client::new(&server.url);
    site.create(&client);
    if kind == "tmpfs" {
        // So much is left that the log of sled can grow by one segment.
        let disk = rustix::fs::statvfs(directory).unwrap();
        let room = usize::try_from(disk.f_bavail * disk.f_frsize).unwrap();
        fs::write(&ballast, vec![1; room - (700 << 10)]).unwrap();
    }
    site.send_until_it_fails(&client);
    assert!(site.acknowledged.iter().all(|done| *done > 0), "{:?}", site.acknowledged);
    drop(server);
    // Started while there is no room it ends with an error, or serves.
    match start(small, &data) {
        Ok(server) => drop(server),
        Err(text) => assert!(text.contains(data.to_str().unwrap()) && !text.contains("panicked"), "{text}"),
    }
    let server = start(small, &data);
    if kind == "tmpfs" {
        fs::remove_file(&ballast).unwrap();
    }
    drop(server);
    let server = start(&[], &data).unwrap();
    site.assert_goes_on(&Client::new(&server.url));
}

/// How a disk can be small here: what comes before the child's command, and what to call it.
fn small_disk(directory: &Path) -> (Vec<String>, &'static str) {
    let script = "mount -t tmpfs -o size=8m ubbmap \"$1\" && shift && exec \"$@\"";
    for own in ["-m", "-rm"] {
        let arguments = ["unshare", own, "sh", "-c", script, "sh", directory.to_str().unwrap()];
        let mut tried = Command::new(arguments[0]);
        let tried = tried.args(&arguments[1..]).arg("true").stdout(Stdio::null()).stderr(Stdio::null()).status();
        if tried.is_ok_and(|status| status.success()) {
            return (arguments.map(str::to_owned).to_vec(), "tmpfs");
        }
    }
    (Vec::new(), "limit")
}

#[test]
#[cfg(target_os = "linux")]
fn a_full_disk_stops_writes_and_a_restart_with_room_goes_on() {
    let directory = tempfile::tempdir().unwrap();
    let (before, kind) = small_disk(directory.path());
    let mut words = before;
    words.push(std::env::current_exe().unwrap().to_str().unwrap().to_owned());
    let mut command = Command::new(&words[0]);
    command.args(&words[1..]).args(["--exact", "full_disk::full_disk_child", "--ignored", "--nocapture"]);
    let output = command.env("UBBMAP_TEST_DISK", format!("{kind} {}", directory.path().display())).output().unwrap();
    let text = |bytes: &[u8]| String::from_utf8_lossy(bytes).into_owned();
    assert!(output.status.success(), "{}\n{}", text(&output.stdout), text(&output.stderr));
    assert!(text(&output.stdout).contains("1 passed"), "{}", text(&output.stdout));
    // Nothing of the small disk is left outside its namespace.
    assert_eq!(kind == "tmpfs", fs::read_dir(directory.path()).unwrap().next().is_none());
    say(&format!("full disk: {kind}"));
}

/// A server whose calls of one kind fail from the n-th on, or only the n-th.
fn failing(call: &str, error: &str, when: &str) -> Vec<String> {
    let inject = format!("inject={call}:error={error}:when={when}");
    ["strace", "-D", "-f", "--seccomp-bpf", "-o", "/dev/null", "-e", &format!("trace={call}"), "-e", &inject]
        .map(str::to_owned)
        .to_vec()
}

#[test]
fn failed_writes_and_syncs_of_the_real_binary_stop_writes_and_lose_nothing() {
    if let Some(why) = obstacle() {
        say(&format!("left out: injected failures of writes and syncs, {why}"));
        return;
    }
    // A sync that fails once may succeed the next time, without the data: it must not be tried again.
    for (call, error, when) in [
        ("fdatasync", "EIO", "30"),
        ("fdatasync", "EIO", "25+"),
        ("pwrite64", "EIO", "20+"),
        ("pwrite64", "ENOSPC", "20+"),
    ] {
        let directory = tempfile::tempdir().unwrap();
        let data: PathBuf = directory.path().join("data");
        let mut site = Site::new();
        let words = failing(call, error, when);
        let words: Vec<&OsStr> = words.iter().map(OsStr::new).collect();
        let server = start(&words, &data).unwrap();
        let client = Client::new(&server.url);
        site.create(&client);
        site.send_until_it_fails(&client);
        drop(server);
        let server = start(&[], &data).unwrap();
        site.assert_goes_on(&Client::new(&server.url));
    }
}

//! The real binary as a child process, and made-up logs for it.

#![allow(clippy::unwrap_used, clippy::panic, clippy::expect_used, reason = "tests")]

use std::fmt::Write as _;
use std::io::{BufRead, BufReader};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Output, Stdio};
use std::time::{Duration, Instant};

/// The binary without the settings of whoever runs the tests.
pub fn ubbmap() -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_ubbmap"));
    for (name, _) in std::env::vars_os() {
        let name = name.to_string_lossy().into_owned();
        if name.starts_with("UBBMAP_") || name == "RUST_LOG" {
            command.env_remove(name);
        }
    }
    command.stdin(Stdio::null());
    command
}

/// A finished run.
#[derive(Debug)]
pub struct Done {
    pub code: i32,
    pub stdout: String,
    pub stderr: String,
}

impl Done {
    pub fn of(output: Output) -> Self {
        Self {
            code: output.status.code().expect("ended by itself"),
            stdout: String::from_utf8(output.stdout).unwrap(),
            stderr: String::from_utf8(output.stderr).unwrap(),
        }
    }

    #[track_caller]
    pub fn json(&self) -> serde_json::Value {
        serde_json::from_str(&self.stdout).unwrap_or_else(|error| panic!("{error}: {self:?}"))
    }

    #[track_caller]
    pub fn ok(self) -> Self {
        assert_eq!(self.code, 0, "{self:?}");
        self
    }

    /// Ended with a code, and said so on stderr.
    #[track_caller]
    pub fn fails(self, code: i32, words: &str) -> Self {
        assert_eq!(self.code, code, "{self:?}");
        assert!(self.stderr.contains(words), "{words:?} is not in {self:?}");
        self
    }
}

/// Runs the binary to its end.
pub fn run<I: AsRef<std::ffi::OsStr>>(args: impl IntoIterator<Item = I>) -> Done {
    Done::of(ubbmap().args(args).output().unwrap())
}

/// A temporary folder; what is within goes with it.
pub struct Folder(tempfile::TempDir);

impl Folder {
    pub fn new() -> Self {
        Self(tempfile::tempdir().unwrap())
    }

    pub fn path(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }

    pub fn text(&self, name: &str) -> String {
        self.path(name).to_str().unwrap().to_owned()
    }
}

/// A running `ubbmap serve`; killed when dropped.
pub struct Server {
    pub child: Child,
    pub url: String,
}

impl Server {
    pub fn start(data: &Path, listen: &str) -> Self {
        Self::start_with(data, listen, &[])
    }

    /// The same with more flags.
    pub fn start_with(data: &Path, listen: &str, flags: &[&str]) -> Self {
        let mut child = ubbmap()
            .args(["serve", "--log", "warn", "--listen", listen, "--data"])
            .arg(data)
            .args(flags)
            .stdout(Stdio::piped())
            .spawn()
            .unwrap();
        let mut line = String::new();
        BufReader::new(child.stdout.take().unwrap()).read_line(&mut line).unwrap();
        let url = line.trim().rsplit(' ').next().unwrap_or_default().to_owned();
        assert!(url.contains("://127.0.0.1:"), "{line:?}");
        Self { child, url }
    }

    pub fn address(&self) -> &str {
        self.url.trim_start_matches("http://")
    }

    /// Runs the binary against this server.
    pub fn run(&self, args: &[&str]) -> Done {
        Done::of(ubbmap().env("UBBMAP_SERVER", &self.url).args(args).output().unwrap())
    }

    pub fn show(&self, map: &str) -> serde_json::Value {
        self.run(&["map", "show", map, "--json"]).ok().json()
    }

    /// The leaves of a whole map, as the interface gives them.
    pub fn leaves(&self, map: &str) -> serde_json::Value {
        let url = format!("{}/v1/maps/{map}/region", self.url);
        let text = ureq::get(&url).call().unwrap().body_mut().read_to_string().unwrap();
        let mut answer: serde_json::Value = serde_json::from_str(&text).unwrap();
        answer["leaves"].take()
    }

    /// Sends SIGTERM and waits for the end.
    pub fn terminate(mut self) -> i32 {
        let pid = self.child.id().to_string();
        assert!(Command::new("kill").args(["-TERM", &pid]).status().unwrap().success());
        let started = Instant::now();
        loop {
            if let Some(status) = self.child.try_wait().unwrap() {
                return status.code().expect("ended by itself");
            }
            assert!(started.elapsed() < Duration::from_secs(30), "the server goes on after SIGTERM");
            std::thread::sleep(Duration::from_millis(20));
        }
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// Waits until something holds.
pub fn until(what: &str, mut holds: impl FnMut() -> bool) {
    let started = Instant::now();
    while !holds() {
        assert!(started.elapsed() < Duration::from_secs(60), "waited in vain until {what}");
        std::thread::sleep(Duration::from_millis(10));
    }
}

/// Beams of the made-up scans: the half circle, as `FLASER` has it.
pub const BEAMS: usize = 180;

/// Scans of a robot that goes round in a room of 8 x 6 m with a pillar in the middle: `(x, y, theta, ranges)`.
pub fn room_scans(count: usize) -> Vec<(f64, f64, f64, Vec<f64>)> {
    let scan = |i: usize| {
        let turn = i as f64 * 0.037;
        let (x, y) = (2.5 * turn.cos(), 1.6 * turn.sin());
        // Written with six digits, so that both formats hold the same numbers.
        let six = |v: f64| (v * 1e6).round() / 1e6;
        // Ahead and a little inwards, so that walls and pillar are seen.
        let (x, y, theta) = (six(x), six(y), six(turn + 2.2));
        let range = |beam: usize| {
            let angle = theta - std::f64::consts::FRAC_PI_2 + std::f64::consts::PI / BEAMS as f64 * beam as f64;
            (distance(x, y, angle) * 100.0).round() / 100.0
        };
        (x, y, theta, (0..BEAMS).map(range).collect())
    };
    (0..count).map(scan).collect()
}

/// How far it is to the walls or to the pillar, a disc of 0.3 m.
fn distance(x: f64, y: f64, angle: f64) -> f64 {
    let (dx, dy) = (angle.cos(), angle.sin());
    let wall = |p: f64, d: f64, half: f64| {
        if d > 0.0 {
            (half - p) / d
        } else if d < 0.0 {
            (-half - p) / d
        } else {
            1e9
        }
    };
    let walls = wall(x, dx, 4.0).min(wall(y, dy, 3.0));
    let along = -(x * dx + y * dy);
    let off = (x * x + y * y - along * along).max(0.0);
    if along > 0.0 && off < 0.09 { walls.min(along - (0.09 - off).sqrt()) } else { walls }
}

/// The scans as JSON lines.
pub fn room_json(count: usize) -> String {
    let increment = std::f64::consts::PI / BEAMS as f64;
    let half = std::f64::consts::FRAC_PI_2;
    let mut log =
        format!("{{\"beams\":{BEAMS},\"angle_min\":-{half},\"angle_increment\":{increment},\"range_max\":30.0}}\n");
    for (i, (x, y, theta, ranges)) in room_scans(count).into_iter().enumerate() {
        writeln!(log, "{{\"t\":{i},\"x\":{x},\"y\":{y},\"theta\":{theta},\"ranges\":{ranges:?}}}").unwrap();
    }
    log
}

/// The scans as a CARMEN log, with other messages between.
pub fn room_carmen(count: usize) -> String {
    let mut log = "# message_name [message contents] ipc_timestamp ipc_hostname logger_timestamp\n".to_owned();
    for (i, (x, y, theta, ranges)) in room_scans(count).into_iter().enumerate() {
        let ranges: Vec<String> = ranges.iter().map(ToString::to_string).collect();
        writeln!(log, "ODOM {x} {y} {theta} 0 0 0 {i} host {i}").unwrap();
        writeln!(log, "FLASER {BEAMS} {} {x} {y} {theta} 0 0 0 {i} host {i}", ranges.join(" ")).unwrap();
    }
    log
}

pub fn gzip(bytes: &[u8]) -> Vec<u8> {
    use std::io::Write;
    let mut encoder = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::fast());
    encoder.write_all(bytes).unwrap();
    encoder.finish().unwrap()
}

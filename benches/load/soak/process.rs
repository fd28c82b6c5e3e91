//! The server of a soak: a process that is ended and started again on the same directory and the same ports.

use std::fs::File;
use std::io::{BufRead, BufReader};
use std::net::TcpListener;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

/// Settings that are smaller than the defaults, so that an hour meets what a large server meets in weeks: the cache holds
/// half of the map, and the database is rewritten.
pub const SETTINGS: [(&str, u64); 7] = [
    ("UBBMAP_CACHE__BLOCK_BYTES", 8 << 20),
    ("UBBMAP_CACHE__PAGE_BYTES", 16 << 20),
    ("UBBMAP_CACHE__SNAPSHOT_BYTES", 16 << 20),
    ("UBBMAP_LIMITS__INSERT_BYTES", 64 << 20),
    ("UBBMAP_LIMITS__INCOMING_BYTES", 32 << 20),
    ("UBBMAP_LIMITS__ANSWER_BYTES", 32 << 20),
    ("UBBMAP_REWRITE__LEAST_BYTES", 16 << 20),
];

/// How an operator ends it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Ending {
    Term,
    Kill,
}

pub struct Process {
    binary: PathBuf,
    directory: PathBuf,
    address: String,
    pub zenoh: String,
    child: Option<Child>,
    /// How often it was started.
    starts: usize,
    /// Whether each start came after a kill.
    after_kill: Vec<bool>,
}

impl Process {
    /// A server that is not started yet, with all it writes under `directory`. `UBBMAP_SOAK_BINARY` names another program than the one that was just built.
    pub fn new(directory: &Path) -> Self {
        let free = || TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap();
        let (http, zenoh) = (free(), free());
        Self {
            binary: std::env::var_os("UBBMAP_SOAK_BINARY")
                .map_or_else(|| env!("CARGO_BIN_EXE_ubbmap").into(), Into::into),
            directory: directory.to_owned(),
            address: http.to_string(),
            zenoh: format!("tcp/{zenoh}"),
            child: None,
            starts: 0,
            after_kill: Vec::new(),
        }
    }

    pub fn url(&self) -> String {
        format!("http://{}", self.address)
    }

    pub fn data(&self) -> PathBuf {
        self.directory.join("store")
    }

    pub fn id(&self) -> Option<u32> {
        self.child.as_ref().map(Child::id)
    }

    fn log(&self, start: usize) -> PathBuf {
        self.directory.join(format!("server-{start}.log"))
    }

    /// Starts it; how long it took until it said that it listens.
    pub fn start(&mut self, after_kill: bool) -> Duration {
        let begun = Instant::now();
        let log = File::create(self.log(self.starts)).unwrap();
        self.starts += 1;
        self.after_kill.push(after_kill);
        let mut child = Command::new(&self.binary)
            .env_remove("UBBMAP_SOAK_BINARY")
            .args(["serve", "--listen", &self.address, "--data"])
            .arg(self.data())
            .env("UBBMAP_ZENOH__MODE", "router")
            .env("UBBMAP_ZENOH__LISTEN", &self.zenoh)
            .env("UBBMAP_LOG", "info,zenoh=warn")
            .env("UBBMAP_LOG_FORMAT", "json")
            .envs(SETTINGS.map(|(name, value)| (name, value.to_string())))
            .stdout(Stdio::piped())
            .stderr(log)
            .spawn()
            .unwrap();
        let mut line = String::new();
        BufReader::new(child.stdout.as_mut().unwrap()).read_line(&mut line).unwrap();
        assert!(
            line.contains(&self.address),
            "the server does not start: {line:?}, {}",
            self.log(self.starts - 1).display()
        );
        self.child = Some(child);
        begun.elapsed()
    }

    /// Ends it and waits until it is gone.
    pub fn end(&mut self, how: Ending) -> Duration {
        let begun = Instant::now();
        let mut child = self.child.take().unwrap();
        if how == Ending::Kill {
            child.kill().unwrap();
        } else {
            Command::new("kill").args(["-TERM", &child.id().to_string()]).status().unwrap();
        }
        let ended = child.wait().unwrap();
        assert!(how == Ending::Kill || ended.success(), "after SIGTERM: {ended}");
        begun.elapsed()
    }

    /// Lines of all its logs that should not be there: errors, panics, and warnings but those of a start after a kill;
    /// and these.
    pub fn complaints(&self) -> (Vec<String>, Vec<String>) {
        let (mut wrong, mut explained) = (Vec::new(), Vec::new());
        for (start, after_kill) in self.after_kill.iter().enumerate() {
            for line in std::fs::read_to_string(self.log(start)).unwrap().lines() {
                let level = serde_json::from_str::<serde_json::Value>(line).ok();
                let level = level.as_ref().and_then(|line| line["level"].as_str()).unwrap_or("no JSON");
                let opening = line.contains("ubbmap::store");
                match level {
                    "INFO" | "DEBUG" | "TRACE" => {}
                    "WARN" if *after_kill && opening => explained.push(format!("start {start}: {line}")),
                    _ => wrong.push(format!("start {start}: {line}")),
                }
            }
        }
        (wrong, explained)
    }
}

impl Drop for Process {
    fn drop(&mut self) {
        if let Some(mut child) = self.child.take() {
            let _ = child.kill();
            let _ = child.wait();
        }
    }
}

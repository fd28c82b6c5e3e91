//! The real binary as a target of clients that mean no good, and whether it is none the worse for them.

use crate::cli_support::ubbmap;
use crate::http_support::{agent, ring};
use crate::limits_support::at_last;
use std::fs::File;
use std::io::{BufRead, BufReader, Read, Write};
use std::net::TcpStream;
use std::process::{Child, Stdio};
use std::time::Duration;

/// What is sent to begin with HTTP/2, and empty settings behind it.
pub const PREFACE: &[u8] = b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n\0\0\0\x04\0\0\0\0\0";

/// A running server with a map `hall` and its log in a file.
pub struct Target {
    child: Child,
    pub url: String,
    folder: tempfile::TempDir,
}

impl Target {
    /// With settings as the environment gives them: `LIMITS__BODY_BYTES` and so on.
    pub fn with(settings: &[(&str, &str)]) -> Self {
        let folder = tempfile::tempdir().unwrap();
        let log = File::create(folder.path().join("log")).unwrap();
        let mut command = ubbmap();
        command.args(["serve", "--log", "warn", "--listen", "127.0.0.1:0", "--data"]).arg(folder.path().join("data"));
        command.envs(settings.iter().map(|(name, value)| (format!("UBBMAP_{name}"), value)));
        let mut child = command.stdout(Stdio::piped()).stderr(log).spawn().unwrap();
        let mut line = String::new();
        BufReader::new(child.stdout.take().unwrap()).read_line(&mut line).unwrap();
        let url = line.trim().rsplit(' ').next().unwrap_or_default().to_owned();
        let target = Self { child, url, folder };
        assert!(target.url.contains("://127.0.0.1:"), "{line:?} {}", target.log());
        let config = r#"{"depth": 10, "sensors": {"default": {"range_max": 10}}}"#;
        let made = agent().put(format!("{}/v1/maps/hall", target.url)).content_type("application/json").send(config);
        assert_eq!(made.unwrap().status(), 201);
        target
    }

    pub fn connect(&self) -> TcpStream {
        let stream = TcpStream::connect(self.url.trim_start_matches("http://")).unwrap();
        stream.set_read_timeout(Some(Duration::from_secs(30))).unwrap();
        stream.set_write_timeout(Some(Duration::from_secs(30))).unwrap();
        stream
    }

    /// A connection with these bytes sent.
    pub fn send(&self, bytes: &[u8]) -> TcpStream {
        let mut stream = self.connect();
        stream.write_all(bytes).unwrap();
        stream
    }

    /// The same, with all connections of the client in one place so that it can be reset (RST) rather than closed.
    pub fn reset(stream: TcpStream) {
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
        let _within = runtime.enter();
        stream.set_nonblocking(true).unwrap();
        tokio::net::TcpStream::from_std(stream).unwrap().set_zero_linger().unwrap();
    }

    /// The status of a scan that a robot inserts, and of what is then free.
    pub fn is_served(&self) -> bool {
        let agent = agent();
        let post = |path: &str, body: &str| {
            let sent =
                agent.post(format!("{}/v1/maps/hall/{path}", self.url)).content_type("application/json").send(body);
            sent.is_ok_and(|answer| answer.status() == 200)
        };
        let free = r#"{"regions": [{"disc": {"center": {"x": 0.0, "y": 0.0}, "radius": 0.1}}]}"#;
        post("scans", &ring("good", None).to_string()) && post("guaranteed-free", free)
    }

    /// A metric, whatever its labels.
    pub fn metric(&self, name: &str) -> f64 {
        let text = agent().get(format!("{}/metrics", self.url)).call().unwrap().body_mut().read_to_string().unwrap();
        let of = |line: &&str| line.strip_prefix(name).is_some_and(|rest| rest.starts_with([' ', '{']));
        text.lines().filter(of).filter_map(|line| line.rsplit_once(' ')?.1.parse::<f64>().ok()).sum()
    }

    pub fn hits(&self, setting: &str) -> f64 {
        self.metric(&format!("ubbmap_limit_hits_total{{limit=\"{setting}\"}}"))
    }

    /// Bytes that the process has in memory.
    pub fn memory(&self) -> f64 {
        let status = std::fs::read_to_string(format!("/proc/{}/status", self.child.id())).unwrap();
        let line = status.lines().find_map(|line| line.strip_prefix("VmRSS:")).unwrap();
        1024.0 * line.trim().trim_end_matches(" kB").parse::<f64>().unwrap()
    }

    fn log(&self) -> String {
        std::fs::read_to_string(self.folder.path().join("log")).unwrap()
    }

    /// The server serves, nothing of those who have gone is left, and its log has nothing to say.
    #[track_caller]
    pub fn is_none_the_worse(&self) {
        assert!(self.is_served(), "it does not serve any more: {}", self.log());
        let gone = |name: &str, left: f64| {
            at_last(|| self.metric(name) <= left);
        };
        // The one that asks.
        gone("ubbmap_connections_open", 1.0);
        gone("ubbmap_requests_in_flight", 0.0);
        gone("ubbmap_streams_open", 0.0);
        gone("ubbmap_incoming_bytes", 0.0);
        gone("ubbmap_answer_bytes", 0.0);
        assert_eq!(self.log(), "");
    }
}

impl Drop for Target {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// What a connection says until it is closed, or nothing more comes.
pub fn rest(mut stream: TcpStream) -> Vec<u8> {
    let mut all = Vec::new();
    let _ = stream.read_to_end(&mut all);
    all
}

/// A frame of HTTP/2.
pub fn frame(kind: u8, flags: u8, stream: u32, payload: &[u8]) -> Vec<u8> {
    let length = u32::try_from(payload.len()).unwrap().to_be_bytes();
    [&length[1..], &[kind, flags], &stream.to_be_bytes(), payload].concat()
}

/// Sends the same bytes over and over; how many were taken until the server closed, or did not read for so long.
pub fn flood(stream: &mut TcpStream, bytes: &[u8], most: usize, patience: Duration) -> usize {
    stream.set_write_timeout(Some(patience)).unwrap();
    let mut taken = 0;
    while taken < most && stream.write_all(bytes).is_ok() {
        taken += bytes.len();
    }
    taken
}

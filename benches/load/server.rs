//! The server as a process, and what it uses.

use std::io::{BufRead, BufReader};
use std::net::TcpListener;
use std::process::{Child, Command, Stdio};
use ubbmap::simulation::Fleet;
use ubbmap::transport::grpc::generated::map_service_client::MapServiceClient;
use ubbmap::wire::v1;

/// Clock ticks of `/proc/PID/stat` a second: fixed on Linux.
const TICKS: f64 = 100.0;

const BINARY: &str = env!("CARGO_BIN_EXE_ubbmap");

pub struct Server {
    process: Child,
    _data: tempfile::TempDir,
    pub url: String,
    pub zenoh: String,
}

/// What a process used so far.
#[derive(Debug, Clone, Copy)]
pub struct Usage {
    pub cpu_seconds: f64,
    pub memory_bytes: f64,
}

/// Of a map with the fleet's sensor.
pub fn map_config() -> v1::MapConfig {
    let spec = Fleet::sensor();
    let sensor = v1::Sensor {
        range_error: Some(v1::RangeError { minus: Some(spec.range_error_minus), plus: Some(spec.range_error_plus) }),
        range_max: Some(spec.range_max),
        no_return_free_to: spec.no_return_free_to,
        mount: Some(v1::Mount { x: spec.mount.x, y: spec.mount.y, theta: spec.mount.theta }),
        ..v1::Sensor::default()
    };
    v1::MapConfig { sensors: [("default".to_owned(), sensor)].into(), ..v1::MapConfig::default() }
}

impl Server {
    /// A server on an empty directory beside the build, with a router of Zenoh.
    pub fn start() -> Self {
        let data = tempfile::tempdir_in(env!("CARGO_TARGET_TMPDIR")).unwrap();
        let free = TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap();
        let zenoh = format!("tcp/{free}");
        let mut process = Command::new(BINARY)
            .args(["serve", "--listen", "127.0.0.1:0", "--data"])
            .arg(data.path().join("store"))
            .env("UBBMAP_ZENOH__MODE", "router")
            .env("UBBMAP_ZENOH__LISTEN", &zenoh)
            .env("UBBMAP_LOG", "warn")
            .stdout(Stdio::piped())
            .spawn()
            .unwrap();
        let mut line = String::new();
        BufReader::new(process.stdout.as_mut().unwrap()).read_line(&mut line).unwrap();
        let url = line.split_whitespace().find(|word| word.starts_with("http://")).unwrap();
        Self { url: url.trim_end_matches(',').to_owned(), process, _data: data, zenoh }
    }

    /// The map `hall` with the fleet's sensor.
    pub async fn create_map(&self) {
        let request = v1::CreateMapRequest { map: "hall".to_owned(), config: Some(map_config()) };
        MapServiceClient::connect(self.url.clone()).await.unwrap().create_map(request).await.unwrap();
    }

    pub fn usage(&self) -> Usage {
        Usage::of(&self.process.id().to_string())
    }

    /// Ends it by a signal, as an operator would.
    pub async fn stop(mut self) {
        let id = self.process.id().to_string();
        Command::new("kill").args(["-TERM", &id]).status().unwrap();
        let ended = tokio::task::spawn_blocking(move || self.process.wait().unwrap()).await.unwrap();
        assert!(ended.success(), "{ended}");
    }
}

impl Usage {
    /// Of this process.
    pub fn own() -> Self {
        Self::of("self")
    }

    fn of(process: &str) -> Self {
        let stat = std::fs::read_to_string(format!("/proc/{process}/stat")).unwrap();
        // The name in parentheses may hold spaces; user and system time are fields 14 and 15.
        let fields: Vec<&str> = stat.rsplit_once(')').unwrap().1.split_whitespace().collect();
        let ticks = |at: usize| fields[at].parse::<f64>().unwrap();
        let status = std::fs::read_to_string(format!("/proc/{process}/status")).unwrap();
        let resident = status.lines().find_map(|line| line.strip_prefix("VmRSS:")).unwrap();
        let kilobytes: f64 = resident.trim().trim_end_matches(" kB").parse().unwrap();
        Self { cpu_seconds: (ticks(11) + ticks(12)) / TICKS, memory_bytes: 1024.0 * kilobytes }
    }
}

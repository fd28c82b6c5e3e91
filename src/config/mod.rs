//! Floor 6: the settings of the server: a file, under the environment, under flags.
//!
//! Everything is read and checked before a port is bound. An unknown key is an error that names the nearest known one.

mod access;
mod error;
mod load;
#[cfg(test)]
mod load_tests;
mod telemetry;
mod tls;
mod words;
mod zenoh;

use crate::mapping::RegionLimits;
use crate::sensor::{PoseLimits, ScanLimits};
use crate::service::ServiceSettings;
use crate::store::{RewriteOptions, SledOptions};
use serde::{Deserialize, Serialize};
use std::net::SocketAddr;
use std::path::PathBuf;
use std::time::Duration;

pub use access::Access;
pub use error::ConfigError;
pub use load::Origins;
pub use telemetry::Telemetry;
pub use tls::{ClientCertificates, Tls};
pub(crate) use words::address;
pub use zenoh::{Zenoh, ZenohMode};

/// Where maps are kept.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase", try_from = "String")]
pub enum StoreKind {
    /// In the data directory, durable.
    Sled,
    /// In memory: nothing outlives the process.
    Memory,
}

/// The form of the log lines.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase", try_from = "String")]
pub enum LogFormat {
    /// For people.
    Text,
    /// One JSON object a line.
    Json,
}

/// The settings of a server; `config/default.toml` explains each with its unit.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Config {
    /// Address to listen on.
    #[serde(deserialize_with = "words::of_setting")]
    pub listen: SocketAddr,
    /// Origins whose pages may use this server from a browser, with commas between.
    pub cors_origins: String,
    /// Address for administration and metrics; empty where `listen` has them too.
    pub admin_listen: String,
    /// Allow an address beyond loopback without tokens.
    pub insecure: bool,
    /// Directory of the store.
    pub data_dir: PathBuf,
    /// Where maps are kept.
    pub store: StoreKind,
    /// Level or filter of the log.
    pub log: String,
    /// Form of the log lines.
    pub log_format: LogFormat,
    /// Who may come in.
    pub access: Access,
    /// Limits on what comes from outside.
    pub limits: Limits,
    /// Memory for maps.
    pub cache: Cache,
    /// When the store is rewritten.
    pub rewrite: Rewrite,
    /// One map's writer.
    pub writer: Writer,
    /// TLS of the listener.
    pub tls: Tls,
    /// The transport over Zenoh.
    pub zenoh: Zenoh,
    /// Traces of requests.
    pub telemetry: Telemetry,
    /// The end of the server.
    pub shutdown: Shutdown,
}

/// Limits on what comes from outside.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Limits {
    /// Largest request body, bytes, also after decompression.
    pub body_bytes: usize,
    /// Largest body of a map configuration, bytes.
    pub config_bytes: usize,
    /// Largest map file that is imported, bytes.
    pub import_bytes: usize,
    /// Bytes of all requests that are being read or worked on.
    pub incoming_bytes: usize,
    /// Bytes of all large answers on their way out.
    pub answer_bytes: usize,
    /// Largest head of a request, bytes.
    pub header_bytes: usize,
    /// Most scans of one request.
    pub scans_per_request: usize,
    /// Most beams of one scan.
    pub beams_per_scan: usize,
    /// Widest pose box along x and y, metres.
    pub pose_width: f64,
    /// Widest pose box in theta, degrees.
    pub pose_heading_degrees: f64,
    /// Most points of a classes query.
    pub points_per_query: usize,
    /// Most regions of a guaranteed-free query.
    pub regions_per_query: usize,
    /// Most points of one polygon or path.
    pub points_per_region: usize,
    /// Most leaves of a region answer.
    pub leaves_per_answer: usize,
    /// Most cells of a grid answer.
    pub cells_per_answer: usize,
    /// Deepest quadtree of a new map.
    pub depth: usize,
    /// Longest name of a new map, sensor, robot or snapshot, bytes.
    pub name_bytes: usize,
    /// Most maps.
    pub maps: usize,
    /// Most robots of one map that send numbered scans.
    pub robots_per_map: usize,
    /// Most snapshots of one map.
    pub snapshots: usize,
    /// Most connections open at once.
    pub connections: usize,
    /// Most connections of one client.
    pub connections_per_client: usize,
    /// Most requests and streams of one connection of HTTP/2 at once.
    pub requests_per_connection: usize,
    /// Most requests worked on at once.
    pub requests: usize,
    /// Of these, most insertions.
    pub insertions: usize,
    /// Most streams of scans and watches open at once.
    pub streams: usize,
    /// Most of these of one client.
    pub streams_per_client: usize,
    /// Most map files on their way to or from clients at once.
    pub transfers: usize,
    /// Most scans of one stream that are not acknowledged yet.
    pub scans_per_stream: usize,
    /// Bytes that all scans under way and their evidence may take together.
    pub insert_bytes: usize,
    /// Heavy queries computed at once.
    pub queries: usize,
    /// Longest time for one request, seconds.
    pub request_seconds: f64,
    /// Longest time for the transfer of one map file, seconds.
    pub transfer_seconds: f64,
    /// Longest time for a request's head to arrive, seconds.
    pub header_seconds: f64,
    /// Longest time for a connection without a request, and for a write to a client to move, seconds.
    pub idle_seconds: f64,
}

/// Memory for maps.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Cache {
    /// Most bytes of blocks in memory, all maps together.
    pub block_bytes: usize,
    /// Most bytes of snapshots in memory for those who ask them.
    pub snapshot_bytes: usize,
    /// Bytes of the store's own cache of pages.
    pub page_bytes: u64,
}

/// When the store is rewritten, so that what it takes on disk stays in proportion to what it holds.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Rewrite {
    /// So many times the bytes of what it holds.
    pub factor: f64,
    /// Never below so many bytes.
    pub least_bytes: u64,
    /// How often its size is looked at, seconds.
    pub check_seconds: f64,
}

/// One map's writer.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Writer {
    /// Insert requests that may wait.
    pub queue: usize,
    /// Most scans of one commit.
    pub scans_per_commit: usize,
    /// Threads that compute evidence; 0 is one a core.
    pub evidence_threads: usize,
    /// Changed blocks that are remembered.
    pub changes: usize,
}

/// The end of the server.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Shutdown {
    /// How long requests under way may take to end, seconds.
    pub grace_seconds: f64,
}

impl Default for Config {
    fn default() -> Self {
        Self {
            listen: SocketAddr::from(([127, 0, 0, 1], 8080)),
            cors_origins: String::new(),
            admin_listen: String::new(),
            insecure: false,
            data_dir: PathBuf::from("ubbmap-data"),
            store: StoreKind::Sled,
            log: "info".to_owned(),
            log_format: LogFormat::Text,
            access: Access::default(),
            limits: Limits::default(),
            cache: Cache::default(),
            rewrite: Rewrite::default(),
            writer: Writer::default(),
            tls: Tls::default(),
            zenoh: Zenoh::default(),
            telemetry: Telemetry::default(),
            shutdown: Shutdown::default(),
        }
    }
}

impl Default for Limits {
    fn default() -> Self {
        Self {
            body_bytes: 16 << 20,
            config_bytes: 1 << 20,
            import_bytes: 256 << 20,
            incoming_bytes: 256 << 20,
            answer_bytes: 256 << 20,
            header_bytes: 16 << 10,
            scans_per_request: 1024,
            beams_per_scan: 20_000,
            pose_width: 2.0,
            pose_heading_degrees: 60.0,
            points_per_query: 100_000,
            regions_per_query: 10_000,
            points_per_region: 4096,
            leaves_per_answer: 1_000_000,
            cells_per_answer: 16_777_216,
            depth: 24,
            name_bytes: 63,
            maps: 10_000,
            robots_per_map: 10_000,
            snapshots: 10_000,
            connections: 1024,
            connections_per_client: 512,
            requests_per_connection: 256,
            requests: 256,
            insertions: 192,
            streams: 1024,
            streams_per_client: 512,
            transfers: 8,
            scans_per_stream: 64,
            insert_bytes: 512 << 20,
            queries: 32,
            request_seconds: 30.0,
            transfer_seconds: 600.0,
            header_seconds: 10.0,
            idle_seconds: 120.0,
        }
    }
}

impl Default for Cache {
    fn default() -> Self {
        Self { block_bytes: 1 << 30, snapshot_bytes: 256 << 20, page_bytes: SledOptions::default().cache_bytes }
    }
}

impl Default for Rewrite {
    fn default() -> Self {
        let RewriteOptions { factor, least_bytes, check } = RewriteOptions::default();
        Self { factor, least_bytes, check_seconds: check.as_secs_f64() }
    }
}

impl Default for Writer {
    fn default() -> Self {
        Self { queue: 256, scans_per_commit: 4096, evidence_threads: 0, changes: 65_536 }
    }
}

impl Default for Shutdown {
    fn default() -> Self {
        Self { grace_seconds: 10.0 }
    }
}

impl Config {
    /// The part that the service takes.
    #[must_use]
    pub fn service_settings(&self) -> ServiceSettings {
        let limits = &self.limits;
        ServiceSettings {
            pose: PoseLimits {
                max_position_width: limits.pose_width,
                max_heading_width: limits.pose_heading_degrees.to_radians(),
            },
            scan: ScanLimits { max_beams: limits.beams_per_scan },
            region: RegionLimits { max_points: limits.points_per_region },
            max_scans_per_request: limits.scans_per_request,
            max_points: limits.points_per_query,
            max_regions: limits.regions_per_query,
            max_leaves: limits.leaves_per_answer,
            max_cells: limits.cells_per_answer,
            max_depth: u8::try_from(limits.depth).unwrap_or(u8::MAX),
            max_name_bytes: limits.name_bytes,
            max_maps: limits.maps,
            max_robots: limits.robots_per_map,
            max_snapshots: limits.snapshots,
            max_import_bytes: limits.import_bytes,
            queue_length: self.writer.queue,
            max_scans_per_commit: self.writer.scans_per_commit,
            max_changes: self.writer.changes,
            max_bytes_in_flight: limits.insert_bytes,
            cache_bytes: self.cache.block_bytes,
            snapshot_cache_bytes: self.cache.snapshot_bytes,
            max_concurrent_queries: limits.queries,
            evidence_threads: self.writer.evidence_threads,
        }
    }

    /// When the store is rewritten.
    #[must_use]
    pub fn rewrite_options(&self) -> RewriteOptions {
        let Rewrite { factor, least_bytes, check_seconds } = self.rewrite;
        RewriteOptions { factor, least_bytes, check: seconds(check_seconds) }
    }

    /// How long requests under way may take to end.
    #[must_use]
    pub fn grace(&self) -> Duration {
        seconds(self.shutdown.grace_seconds)
    }
}

/// A checked number of seconds as a duration; out of range becomes the longest one.
pub(crate) fn seconds(value: f64) -> Duration {
    Duration::try_from_secs_f64(value).unwrap_or(Duration::MAX)
}

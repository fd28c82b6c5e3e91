//! Limits and settings of the service; every one is a setting of the configuration file.

use crate::mapping::RegionLimits;
use crate::sensor::{PoseLimits, ScanLimits};

/// Limits on what comes from outside, and sizes of queues.
#[derive(Debug, Clone, PartialEq)]
pub struct ServiceSettings {
    /// How wide a pose box may be.
    pub pose: PoseLimits,
    /// How large a scan may be.
    pub scan: ScanLimits,
    /// How large a region may be.
    pub region: RegionLimits,
    /// Most scans a request.
    pub max_scans_per_request: usize,
    /// Most points a classes query.
    pub max_points: usize,
    /// Most regions a guaranteed-free query.
    pub max_regions: usize,
    /// Most leaves a region answer.
    pub max_leaves: usize,
    /// Most cells a grid answer.
    pub max_cells: usize,
    /// Most maps.
    pub max_maps: usize,
    /// Most robots of one map that send numbered scans: each keeps a sequence window for good.
    pub max_robots: usize,
    /// Most snapshots of one map.
    pub max_snapshots: usize,
    /// Most bytes of a map file that is imported.
    pub max_import_bytes: usize,
    /// Insert requests of one map that may wait at its writer or have their evidence computed.
    pub queue_length: usize,
    /// Most scans in one commit; a request is never divided, so one that is larger is a commit of its own.
    pub max_scans_per_commit: usize,
    /// Changed blocks of one map that are remembered for those who ask what changed.
    pub max_changes: usize,
    /// Most bytes that scans and their evidence may take, all insertions under way together.
    pub max_bytes_in_flight: usize,
    /// Most bytes of blocks in memory, all maps together; what stands above them, about 100 bytes a block, comes on top.
    pub cache_bytes: usize,
    /// Most bytes of snapshots in memory for those who ask them; one more is there while it is read.
    pub snapshot_cache_bytes: usize,
    /// Heavy queries computed at once; more wait for their turn.
    pub max_concurrent_queries: usize,
    /// Threads that compute evidence; 0 is one a core.
    pub evidence_threads: usize,
}

impl Default for ServiceSettings {
    fn default() -> Self {
        Self {
            pose: PoseLimits::default(),
            scan: ScanLimits::default(),
            region: RegionLimits::default(),
            max_scans_per_request: 1024,
            max_points: 100_000,
            max_regions: 10_000,
            max_leaves: 1_000_000,
            max_cells: 16_777_216,
            max_maps: 10_000,
            max_robots: 10_000,
            max_snapshots: 10_000,
            max_import_bytes: 256 << 20,
            queue_length: 256,
            max_scans_per_commit: 4096,
            max_changes: 65_536,
            max_bytes_in_flight: 512 << 20,
            cache_bytes: 1 << 30,
            snapshot_cache_bytes: 256 << 20,
            max_concurrent_queries: 32,
            evidence_threads: 0,
        }
    }
}

//! What the service counts and times. Without an installed recorder every call here does nothing.

use crate::quadtree::CacheStatistics;
use crate::store::{RobotName, StoreStatistics};
use metrics::{counter, describe_counter, describe_gauge, describe_histogram, gauge, histogram};
use std::collections::BTreeSet;
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

const SCANS: &str = "ubbmap_scans_total";
const ROBOT_SCANS: &str = "ubbmap_robot_scans_total";
const BEAMS_FAILED: &str = "ubbmap_beams_failed_total";
const COMMITS: &str = "ubbmap_commits_total";
const COMMIT_SECONDS: &str = "ubbmap_commit_seconds";
const COMMIT_SCANS: &str = "ubbmap_commit_scans";
const EVIDENCE_SECONDS: &str = "ubbmap_evidence_seconds";
const QUEUE_DEPTH: &str = "ubbmap_queue_depth";
const QUERY_SECONDS: &str = "ubbmap_query_seconds";
const MAPS_OPEN: &str = "ubbmap_maps_open";
const CACHE_BYTES: &str = "ubbmap_cache_bytes";
const SNAPSHOT_CACHE_BYTES: &str = "ubbmap_snapshot_cache_bytes";
const CACHE_HITS: &str = "ubbmap_cache_hits_total";
const CACHE_LOADS: &str = "ubbmap_cache_loads_total";
const CACHE_EVICTIONS: &str = "ubbmap_cache_evictions_total";
const STORE_DISK_BYTES: &str = "ubbmap_store_disk_bytes";
const STORE_LIVE_BYTES: &str = "ubbmap_store_live_bytes";
const STORE_REWRITES: &str = "ubbmap_store_rewrites_total";
const WATCHERS: &str = "ubbmap_watchers";

/// Robots that are counted by name.
const NAMED_ROBOTS: usize = 1000;

/// The name of the others together; no robot has it.
const OTHER_ROBOTS: &str = "(other)";

/// Tells the recorder what each metric means. Call it once, after the recorder is installed.
pub fn describe_metrics() {
    super::limits::describe_metrics();
    describe_counter!(SCANS, "Scans by outcome: applied, duplicate, rejected, failed");
    describe_counter!(ROBOT_SCANS, "Scans by robot and outcome; robots beyond the first thousand as one");
    describe_counter!(BEAMS_FAILED, "Beams of computed scans that were failed measurements");
    describe_counter!(COMMITS, "Commits by outcome: stored, failed");
    describe_histogram!(COMMIT_SECONDS, "Seconds from applying a round of scans to its being durable");
    describe_histogram!(COMMIT_SCANS, "Scans applied in one commit");
    describe_histogram!(EVIDENCE_SECONDS, "Seconds for computing the evidence of one request");
    describe_gauge!(QUEUE_DEPTH, "Insert requests that wait at the writers of all maps or are being committed");
    describe_histogram!(QUERY_SECONDS, "Seconds for computing a query's answer, by kind");
    describe_gauge!(MAPS_OPEN, "Maps that are open: all of each but its blocks is in memory");
    describe_gauge!(WATCHERS, "Watches of maps that are open");
    describe_gauge!(CACHE_BYTES, "Bytes of the blocks in memory, all maps together");
    describe_gauge!(SNAPSHOT_CACHE_BYTES, "Bytes of the snapshots in memory for those who ask them");
    describe_counter!(CACHE_HITS, "Blocks looked into that were in memory");
    describe_counter!(CACHE_LOADS, "Blocks read from the store");
    describe_counter!(CACHE_EVICTIONS, "Blocks let go to keep the limit");
    describe_gauge!(STORE_DISK_BYTES, "Bytes of the files in the data directory, as last measured");
    describe_gauge!(STORE_LIVE_BYTES, "Bytes of the keys and values that the store holds");
    describe_counter!(STORE_REWRITES, "Rewrites of the store's database by outcome: done, failed");
}

/// Takes over what the cache counts by itself.
pub(super) fn cache(statistics: &CacheStatistics) {
    gauge!(CACHE_BYTES).set(statistics.bytes as f64);
    counter!(CACHE_HITS).absolute(statistics.hits);
    counter!(CACHE_LOADS).absolute(statistics.loads);
    counter!(CACHE_EVICTIONS).absolute(statistics.evictions);
}

/// Takes over what snapshots take that are kept for queries.
pub(super) fn snapshot_cache(bytes: usize) {
    gauge!(SNAPSHOT_CACHE_BYTES).set(bytes as f64);
}

/// Takes over what the store counts by itself.
pub(super) fn store(statistics: &StoreStatistics) {
    // Nothing is shown until it was measured.
    if let Some(live) = statistics.live_bytes {
        gauge!(STORE_DISK_BYTES).set(statistics.disk_bytes as f64);
        gauge!(STORE_LIVE_BYTES).set(live as f64);
    }
    counter!(STORE_REWRITES, "outcome" => "done").absolute(statistics.rewrites);
    counter!(STORE_REWRITES, "outcome" => "failed").absolute(statistics.failed_rewrites);
}

/// What became of scans.
#[derive(Debug, Clone, Copy)]
pub(super) enum Outcome {
    Applied,
    Duplicate,
    Rejected,
    /// Good, but the store did not take them.
    Failed,
}

impl Outcome {
    fn label(self) -> &'static str {
        match self {
            Self::Applied => "applied",
            Self::Duplicate => "duplicate",
            Self::Rejected => "rejected",
            Self::Failed => "failed",
        }
    }
}

pub(super) fn scans(outcome: Outcome, count: u64) {
    if count > 0 {
        counter!(SCANS, "outcome" => outcome.label()).increment(count);
    }
}

/// Counts one scan of a robot. Names come from outside, and each is a series of its own for good: there are so many of
/// them, the others share one.
pub(super) fn robot_scan(robot: Option<&RobotName>, outcome: Outcome) {
    static NAMED: Mutex<BTreeSet<RobotName>> = Mutex::new(BTreeSet::new());
    let name = robot.map_or("", |robot| {
        let mut named = NAMED.lock().unwrap_or_else(PoisonError::into_inner);
        if named.contains(robot) || (named.len() < NAMED_ROBOTS && named.insert(robot.clone())) {
            robot.as_str()
        } else {
            OTHER_ROBOTS
        }
    });
    counter!(ROBOT_SCANS, "robot" => name.to_owned(), "outcome" => outcome.label()).increment(1);
}

pub(super) fn beams_failed(count: u64) {
    if count > 0 {
        counter!(BEAMS_FAILED).increment(count);
    }
}

pub(super) fn commit(stored: bool, scans: u64, took: Duration) {
    counter!(COMMITS, "outcome" => if stored { "stored" } else { "failed" }).increment(1);
    histogram!(COMMIT_SECONDS).record(took.as_secs_f64());
    histogram!(COMMIT_SCANS).record(scans as f64);
}

pub(super) fn evidence(took: Duration) {
    histogram!(EVIDENCE_SECONDS).record(took.as_secs_f64());
}

/// Counts one loaded map while it lives.
#[derive(Debug)]
pub(super) struct Loaded(());

impl Loaded {
    pub(super) fn new() -> Self {
        gauge!(MAPS_OPEN).increment(1.0);
        Self(())
    }
}

impl Drop for Loaded {
    fn drop(&mut self) {
        gauge!(MAPS_OPEN).decrement(1.0);
    }
}

/// Counts one watch while it lives.
#[derive(Debug)]
pub(super) struct Watching(());

impl Watching {
    pub(super) fn new() -> Self {
        gauge!(WATCHERS).increment(1.0);
        Self(())
    }
}

impl Drop for Watching {
    fn drop(&mut self) {
        gauge!(WATCHERS).decrement(1.0);
    }
}

/// Counts one request at a writer while it lives.
#[derive(Debug)]
pub(super) struct Queued(());

impl Queued {
    pub(super) fn new() -> Self {
        gauge!(QUEUE_DEPTH).increment(1.0);
        Self(())
    }
}

impl Drop for Queued {
    fn drop(&mut self) {
        gauge!(QUEUE_DEPTH).decrement(1.0);
    }
}

/// Times the computing of a query's answer.
pub(super) fn query<T>(kind: &'static str, compute: impl FnOnce() -> T) -> T {
    let started = Instant::now();
    let answer = compute();
    histogram!(QUERY_SECONDS, "kind" => kind).record(started.elapsed().as_secs_f64());
    answer
}

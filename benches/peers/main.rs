//! `guaranteed` beside OctoMap on the same logs in the same run; `benches/peers/run` builds the driver and starts this.
//!
//! `cargo bench --bench peers -- --octomap DRIVER [LOG ..]`; without logs fr079 and intel of `$UBBMAP_DATA` or
//! `../shared/data`. Scans per processor second, evidence and apply against `insertPointCloud` (clouds made before);
//! medians of alternating rounds, ratios of the same round. Memory and file size after one pass over the log.

#![allow(clippy::print_stdout, clippy::expect_used, reason = "a benchmark prints its figures and may fail loudly")]

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::time::Instant;
use ubbmap::experiment::octomap::{Insertion, OctoMap};
use ubbmap::logs::{LogReader, PoseError};
use ubbmap::mapping::{EvidenceRule, MapConfig, Surveyor};
use ubbmap::quadtree::{ClassScale, Grid, OccupancyTree};
use ubbmap::sensor::{PoseBox, PoseLimits, Scan, ScanLimits, ScanSpec, SensorModel, SensorSpec};
use ubbmap::store::{LoadedMap, write_map_file};

const ROUNDS: usize = 7;

/// Scans that a round takes at least: short logs are looped.
const ROUND_SCANS: usize = 5000;

fn scans_of(path: &Path) -> Vec<Scan> {
    let reader = LogReader::open(path, ScanLimits::default()).expect("the log opens");
    let range_max = reader.sensor().range_max.unwrap_or(SensorSpec::default().range_max);
    let sensor = SensorModel::new(SensorSpec { range_max, ..SensorSpec::default() }).expect("a sensor");
    reader
        .map(|scan| {
            let scan = scan.expect("a scan");
            let (x, y, theta) = scan.pose.bounds(&PoseError { position: 0.0, heading: 0.0 });
            let spec = ScanSpec {
                pose: PoseBox::new(x, y, theta, &PoseLimits::default()).expect("a pose"),
                angles: scan.angles,
                ranges: scan.ranges,
                footprint_radius: 0.0,
                sweep_rotation: 0.0,
                sweep_translation: 0.0,
            };
            Scan::new(spec, sensor, &ScanLimits::default()).expect("a scan")
        })
        .collect()
}

/// Seconds of processor time of this thread where the system tells (Linux), else of the clock since `start`.
fn seconds(start: Instant) -> f64 {
    let schedstat = std::fs::read_to_string("/proc/thread-self/schedstat").ok();
    let on_cpu = schedstat.and_then(|text| text.split(' ').next()?.parse::<u64>().ok());
    on_cpu.map_or_else(|| start.elapsed().as_secs_f64(), |nanoseconds| nanoseconds as f64 * 1e-9)
}

/// The map of `loops` passes over the scans, and its scans per second.
fn build(config: &MapConfig, scans: &[Scan], loops: usize) -> (OccupancyTree, f64) {
    let mut surveyor = Surveyor::new();
    let mut tree = OccupancyTree::new(config.grid().depth(), config.scale());
    let mut changed = Vec::new();
    let clock = Instant::now();
    let start = seconds(clock);
    for scan in (0..loops).flat_map(|_| scans) {
        tree.apply(&surveyor.survey(config, scan), &mut changed);
        changed.clear();
    }
    let rate = (scans.len() * loops) as f64 / (seconds(clock) - start);
    (tree, rate)
}

fn file_bytes(config: &MapConfig, tree: &OccupancyTree) -> usize {
    let mut file = Vec::new();
    let map = LoadedMap { revision: 1, tree: tree.clone(), windows: BTreeMap::new() };
    write_map_file(&mut file, config, &map).expect("memory takes it");
    file.len()
}

fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values[values.len() / 2]
}

fn compare(path: &Path, driver: &Path, resolution: f64) {
    let scans = scans_of(path);
    let peer = OctoMap::new(driver, &std::env::temp_dir(), &scans).expect("the driver is there");
    let loops = ROUND_SCANS.div_ceil(scans.len());
    let grid = Grid::new(resolution, 16, None).expect("a grid");
    let sensors = BTreeMap::from([("default".to_owned(), *scans[0].sensor())]);
    let scale = ClassScale::new(10).expect("a scale");
    let config = MapConfig::new(grid, scale, EvidenceRule::Guaranteed, 0.05, sensors).expect("a configuration");
    let (mut own, mut whole, mut discrete, mut ratios) = (Vec::new(), Vec::new(), Vec::new(), Vec::new());
    for _ in 0..ROUNDS {
        own.push(build(&config, &scans, loops).1);
        whole.push(peer.insert(resolution, loops, Insertion::Whole).expect("OctoMap runs").scans_per_second);
        discrete.push(peer.insert(resolution, loops, Insertion::Discrete).expect("OctoMap runs").scans_per_second);
        let last = |rates: &[f64]| rates[rates.len() - 1];
        ratios.push(last(&own) / last(&whole).max(last(&discrete)));
    }
    let tree = build(&config, &scans, 1).0;
    let size = peer.insert(resolution, 1, Insertion::Whole).expect("OctoMap runs");
    println!(
        "{:<10} {resolution:<5} | guaranteed {:>8.0} | OctoMap {} {:>6.0}, discretised {:>6.0} | ratio to the faster {:>5.1} x | \
         memory kB {:>5.0} against {:>5.0} | file kB {:>5.1} against {:>5.1}",
        path.file_name().unwrap_or_default().to_string_lossy().split('.').next().unwrap_or_default(),
        median(own),
        size.version,
        median(whole),
        median(discrete),
        median(ratios),
        tree.statistics().memory_bytes as f64 / 1e3,
        size.memory_bytes as f64 / 1e3,
        file_bytes(&config, &tree) as f64 / 1e3,
        size.bt_bytes as f64 / 1e3,
    );
}

fn main() {
    let mut args = std::env::args().skip(1);
    let mut driver = None;
    let mut paths: Vec<PathBuf> = Vec::new();
    while let Some(arg) = args.next() {
        match arg.as_str() {
            "--octomap" => driver = args.next().map(PathBuf::from),
            flag if flag.starts_with("--") => {}
            path => paths.push(PathBuf::from(path)),
        }
    }
    let Some(driver) = driver else {
        println!("left out: OctoMap, no driver was named; benches/peers/run builds it and starts this");
        return;
    };
    if paths.is_empty() {
        let data = std::env::var_os("UBBMAP_DATA").map_or_else(|| PathBuf::from("../shared/data"), PathBuf::from);
        paths = ["fr079", "intel"].iter().map(|name| data.join(name).join(format!("{name}.jsonl.gz"))).collect();
    }
    println!("scans per processor second, exact poses, medians of {ROUNDS} alternating rounds");
    for path in paths {
        if !path.exists() {
            println!("left out: {} is not there", path.display());
            continue;
        }
        for resolution in [0.1, 0.05] {
            compare(&path, &driver, resolution);
        }
    }
}

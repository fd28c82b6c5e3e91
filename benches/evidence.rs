//! Scans per CPU second of the evidence rules beside a dense log-odds grid with Bresenham rays, on real logs.
//!
//! `cargo bench --bench evidence -- [--guaranteed] [LOG.jsonl.gz ..]`; without logs those of `$UBBMAP_DATA` or
//! `../shared/data`; with `--guaranteed` the paper's rules are left out.
//! All engines run in turn on the same scans in the same process; medians of the rounds are printed with the ratio to the
//! grid of the same round.

#![allow(clippy::print_stdout, reason = "a benchmark prints its figures")]

use std::collections::BTreeMap;
use std::io::{BufRead, BufReader};
use std::path::PathBuf;
use std::sync::LazyLock;
use std::time::Instant;
use ubbmap::mapping::{EvidenceRule, MapConfig, Surveyor};
use ubbmap::quadtree::{ClassScale, Grid, OccupancyTree};
use ubbmap::sensor::{Angles, PoseBox, PoseLimits, Scan, ScanLimits, ScanSpec, SensorModel, SensorSpec};

const ROUNDS: usize = 7;

static START: LazyLock<Instant> = LazyLock::new(Instant::now);

/// Seconds of processor time of this thread where the system tells (Linux), so that other programs do not count; else of
/// the clock.
fn seconds() -> f64 {
    let schedstat = std::fs::read_to_string("/proc/thread-self/schedstat").ok();
    let on_cpu = schedstat.and_then(|text| text.split(' ').next()?.parse::<u64>().ok());
    on_cpu.map_or_else(|| START.elapsed().as_secs_f64(), |nanoseconds| nanoseconds as f64 * 1e-9)
}

struct RawScan {
    pose: (f64, f64, f64),
    ranges: Vec<f32>,
}

struct Log {
    name: String,
    angle_min: f64,
    increment: f64,
    range_max: f64,
    scans: Vec<RawScan>,
}

fn read(path: &PathBuf) -> Log {
    let file = std::fs::File::open(path).expect("the log opens");
    let mut lines = BufReader::new(flate2::read::GzDecoder::new(file)).lines();
    let header: serde_json::Value =
        serde_json::from_str(&lines.next().expect("a header").expect("readable")).expect("the header is JSON");
    let number = |v: &serde_json::Value, key: &str| v[key].as_f64().expect("a number");
    let scans = lines
        .map(|line| {
            let v: serde_json::Value = serde_json::from_str(&line.expect("readable")).expect("JSON");
            let ranges = v["ranges"].as_array().expect("ranges");
            RawScan {
                pose: (number(&v, "x"), number(&v, "y"), number(&v, "theta")),
                ranges: ranges.iter().map(|r| r.as_f64().unwrap_or(f64::NAN) as f32).collect(),
            }
        })
        .collect();
    Log {
        name: path.file_name().expect("a name").to_string_lossy().replace(".jsonl.gz", ""),
        angle_min: number(&header, "angle_min"),
        increment: number(&header, "angle_increment"),
        range_max: number(&header, "range_max"),
        scans,
    }
}

/// A dense log-odds grid: Bresenham rays, one `f32` a cell, over the log's bounding box.
struct DenseGrid {
    resolution: f64,
    min: (f64, f64),
    width: i64,
    height: i64,
    cells: Vec<f32>,
}

impl DenseGrid {
    fn over(log: &Log, resolution: f64) -> Self {
        let reach = log.scans.iter().flat_map(|s| &s.ranges).copied().filter(|r| f64::from(*r) < log.range_max);
        let reach = f64::from(reach.fold(0.0, f32::max)) + 1.0;
        let (mut min, mut max) = ((f64::INFINITY, f64::INFINITY), (f64::NEG_INFINITY, f64::NEG_INFINITY));
        for scan in &log.scans {
            min = (min.0.min(scan.pose.0 - reach), min.1.min(scan.pose.1 - reach));
            max = (max.0.max(scan.pose.0 + reach), max.1.max(scan.pose.1 + reach));
        }
        let width = ((max.0 - min.0) / resolution) as i64 + 1;
        let height = ((max.1 - min.1) / resolution) as i64 + 1;
        Self { resolution, min, width, height, cells: vec![0.0; (width * height) as usize] }
    }

    fn insert(&mut self, log: &Log, scan: &RawScan) {
        let (x, y, theta) = scan.pose;
        let start = self.cell(x, y);
        for (i, range) in scan.ranges.iter().enumerate() {
            let range = f64::from(*range);
            if range >= log.range_max || range.is_nan() {
                continue;
            }
            let angle = theta + log.angle_min + i as f64 * log.increment;
            let (sin, cos) = angle.sin_cos();
            self.ray(start, self.cell(x + range * cos, y + range * sin));
        }
    }

    fn cell(&self, x: f64, y: f64) -> (i64, i64) {
        (((x - self.min.0) / self.resolution) as i64, ((y - self.min.1) / self.resolution) as i64)
    }

    fn ray(&mut self, from: (i64, i64), to: (i64, i64)) {
        let (dx, dy) = ((to.0 - from.0).abs(), -(to.1 - from.1).abs());
        let (sx, sy) = ((to.0 - from.0).signum(), (to.1 - from.1).signum());
        let (mut x, mut y) = from;
        let mut error = dx + dy;
        while (x, y) != to {
            let cell = &mut self.cells[(y * self.width + x) as usize];
            *cell = (*cell - 0.4).max(-2.0);
            let twice = 2 * error;
            if twice >= dy {
                error += dy;
                x += sx;
            }
            if twice <= dx {
                error += dx;
                y += sy;
            }
        }
        let cell = &mut self.cells[(y * self.width + x) as usize];
        *cell = (*cell + 0.85).min(3.5);
        debug_assert!(y < self.height);
    }
}

fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values[values.len() / 2]
}

fn scans_of(log: &Log, error: (f64, f64)) -> Vec<Scan> {
    let sensor = SensorModel::new(SensorSpec { range_max: log.range_max, ..SensorSpec::default() }).expect("a sensor");
    log.scans
        .iter()
        .map(|raw| {
            let around = |v: f64, e: f64| (v - e, v + e);
            let (x, y, theta) = raw.pose;
            let pose =
                PoseBox::new(around(x, error.0), around(y, error.0), around(theta, error.1), &PoseLimits::default())
                    .expect("a pose");
            let spec = ScanSpec {
                pose,
                angles: Angles::Uniform { min: log.angle_min, increment: log.increment },
                ranges: raw.ranges.clone(),
                footprint_radius: 0.0,
                sweep_rotation: 0.0,
                sweep_translation: 0.0,
            };
            Scan::new(spec, sensor, &ScanLimits::default()).expect("a scan")
        })
        .collect()
}

fn run(log: &Log, rules: &[EvidenceRule], resolution: f64, error: (f64, f64), loops: usize) {
    let scans = scans_of(log, error);
    let sensor = *scans[0].sensor();
    let mut rates: Vec<Vec<f64>> = vec![Vec::new(); rules.len() + 1];
    let count = (scans.len() * loops) as f64;
    for _ in 0..ROUNDS {
        let mut grid = DenseGrid::over(log, resolution);
        let start = seconds();
        for _ in 0..loops {
            for scan in &log.scans {
                grid.insert(log, scan);
            }
        }
        rates[0].push(count / (seconds() - start));
        std::hint::black_box(&grid.cells);
        for (i, rule) in rules.iter().enumerate() {
            let config = MapConfig::new(
                Grid::new(resolution, 16, None).expect("a grid"),
                ClassScale::new(10).expect("a scale"),
                *rule,
                0.05,
                BTreeMap::from([("default".to_owned(), sensor)]),
            )
            .expect("a configuration");
            let mut surveyor = Surveyor::new();
            let mut tree = OccupancyTree::new(16, config.scale());
            let mut changed = Vec::new();
            let start = seconds();
            for _ in 0..loops {
                for scan in &scans {
                    let masks = surveyor.survey(&config, scan);
                    tree.apply(&masks, &mut changed);
                    changed.clear();
                }
            }
            rates[i + 1].push(count / (seconds() - start));
        }
    }
    print!("{:<10} {resolution:<5} +-{} m {:<4} deg", log.name, error.0, error.1.to_degrees());
    print!(" | grid {:>8.0}", median(rates[0].clone()));
    for (rule, rate) in rules.iter().zip(&rates[1..]) {
        let ratio = median(rate.iter().zip(&rates[0]).map(|(a, b)| a / b).collect());
        print!(" | {rule:?} {:>8.0} {ratio:>5.2}x", median(rate.clone()));
    }
    println!();
}

fn main() {
    let mut paths: Vec<PathBuf> =
        std::env::args().skip(1).filter(|a| !a.starts_with("--")).map(PathBuf::from).collect();
    if paths.is_empty() {
        let data = std::env::var_os("UBBMAP_DATA").map_or_else(|| PathBuf::from("../shared/data"), PathBuf::from);
        paths = ["fr079", "intel"].iter().map(|name| data.join(name).join(format!("{name}.jsonl.gz"))).collect();
    }
    let all = [EvidenceRule::Guaranteed, EvidenceRule::Outer, EvidenceRule::Inner];
    let rules = if std::env::args().any(|a| a == "--guaranteed") { &all[..1] } else { &all[..] };
    println!("scans per CPU second, medians of {ROUNDS} alternating rounds; ratio to the grid of the same round");
    for path in paths {
        if !path.exists() {
            println!("left out: {} is not there", path.display());
            continue;
        }
        let log = read(&path);
        let loops = (5000 / log.scans.len()).max(1);
        for resolution in [0.1, 0.05] {
            for error in [(0.0, 0.0), (0.05, 0.5f64.to_radians())] {
                run(&log, rules, resolution, error, loops);
            }
        }
    }
}

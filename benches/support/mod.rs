//! What the benchmarks share: logs, a dense grid as the peer, processor time, medians.

#![allow(dead_code, reason = "no benchmark uses all of it")]

use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::SeedableRng;
use std::io::{BufRead, BufReader};
use std::path::{Path, PathBuf};
use ubbmap::sensor::{Angles, PoseBox, PoseLimits, Scan, ScanLimits, ScanSpec, SensorModel, SensorSpec};
use ubbmap::simulation::{Fleet, Motion, Quirks, pose_box_around, simulate_scan};

/// Seconds of processor time of this thread so far, so that other programs do not count.
pub fn seconds() -> f64 {
    let time = rustix::time::clock_gettime(rustix::time::ClockId::ThreadCPUTime);
    time.tv_sec as f64 + time.tv_nsec as f64 * 1e-9
}

/// A scan with the pose of the laser: metres, radians.
pub struct RawScan {
    pub pose: (f64, f64, f64),
    pub ranges: Vec<f32>,
}

/// Scans of one laser.
pub struct Log {
    pub name: String,
    pub angle_min: f64,
    pub increment: f64,
    pub range_max: f64,
    pub scans: Vec<RawScan>,
}

/// Reads a log of JSON lines.
pub fn read(path: &Path) -> Log {
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
pub struct DenseGrid {
    resolution: f64,
    min: (f64, f64),
    width: i64,
    height: i64,
    pub cells: Vec<f32>,
}

impl DenseGrid {
    pub fn over(log: &Log, resolution: f64) -> Self {
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

    pub fn insert(&mut self, log: &Log, scan: &RawScan) {
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

/// The middle one.
pub fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values[values.len() / 2]
}

/// The scans with every pose in a box of these half widths: metres, radians.
pub fn scans_of(log: &Log, error: (f64, f64)) -> Vec<Scan> {
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

/// The logs named, or fr079 and intel of `$UBBMAP_DATA` or `../shared/data`, as far as they are there.
pub fn logs(named: &[String]) -> Vec<Log> {
    let data = std::env::var_os("UBBMAP_DATA").map_or_else(|| PathBuf::from("../shared/data"), PathBuf::from);
    let mut paths: Vec<PathBuf> = named.iter().map(PathBuf::from).collect();
    if paths.is_empty() {
        paths = ["fr079", "intel"].iter().map(|name| data.join(name).join(format!("{name}.jsonl.gz"))).collect();
    }
    let (there, missing): (Vec<_>, Vec<_>) = paths.into_iter().partition(|path| path.exists());
    missing.iter().for_each(|path| println!("left out: {} is not there", path.display()));
    there.iter().map(|path| read(path)).collect()
}

/// A robot's way through the simulated building with a laser of 1,080 beams over 270 degrees.
pub fn simulated() -> Log {
    const BEAMS: usize = 1080;
    let increment = 0.25_f64.to_radians();
    let angle_min = -135.0_f64.to_radians();
    let sensor = SensorSpec { range_max: 30.0, ..SensorSpec::default() };
    let angles = Angles::Uniform { min: angle_min, increment };
    let (mut fleet, mut random) = (Fleet::new(7, 4), ChaCha8Rng::seed_from_u64(7));
    let mut scans = Vec::new();
    for _ in 0..120 {
        for robot in fleet.step() {
            let pose = pose_box_around(&robot.truth, 0.0, 0.0).expect("a pose");
            let world = &fleet.building().world;
            let motion = Motion::still(robot.truth);
            let scan =
                simulate_scan(world, &sensor, (&angles, BEAMS), (&pose, &motion), &Quirks::default(), &mut random);
            let truth = robot.truth;
            scans.push(RawScan { pose: (truth.x, truth.y, truth.theta), ranges: scan.ranges });
        }
    }
    Log { name: "1080 beams".to_owned(), angle_min, increment, range_max: sensor.range_max, scans }
}

//! Times of queries in the engine: guaranteed-free of discs and paths, tiles, whole maps.
//!
//! `cargo bench --bench queries -- [LOG ..]`; without logs those of `$UBBMAP_DATA` or `../shared/data`. Each log is mapped
//! with the default evidence; fr079 is also repeated into a map of 300 m x 300 m. A round asks every query of a kind once;
//! the mean of each round is taken and the median of the rounds printed, so that a rare dear query counts as what it costs.

#![allow(clippy::print_stdout, reason = "a benchmark prints its figures")]

use std::collections::BTreeMap;
use std::hint::black_box;
use std::path::{Path, PathBuf};
use std::time::Instant;
use ubbmap::logs::{LogPose, LogReader, PoseError};
use ubbmap::mapping::{EvidenceRule, MapConfig, Region, RegionLimits, Surveyor, guaranteed_free};
use ubbmap::quadtree::{BlockAddress, BlockView, ClassScale, Grid, LeafRange, OccupancyTree};
use ubbmap::sensor::{PoseBox, PoseLimits, Scan, ScanLimits, ScanSpec, SensorModel, SensorSpec};

const ROUNDS: usize = 31;

/// Queries of one kind.
const QUERIES: usize = 1000;

/// Radius of the discs and of the paths, metres.
const DISC_RADIUS: f64 = 0.4;
const PATH_RADIUS: f64 = 0.25;

/// Length of the paths, metres, and of one of their pieces.
const PATH_LENGTH: f64 = 10.0;
const PATH_STEP: f64 = 0.5;

/// Side of the large map, metres.
const LARGE_SIDE: f64 = 300.0;

/// Half-widths of the pose boxes: metres and radians.
const POSE_ERROR: PoseError = PoseError { position: 0.02, heading: 0.005 };

/// A map with the way that its robot went.
struct Map {
    name: String,
    tree: OccupancyTree,
    grid: Grid,
    way: Vec<(f64, f64)>,
}

/// A generator of numbers in `[0, 1)` (SplitMix64).
struct Dice(u64);

impl Dice {
    fn next(&mut self) -> f64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let z = (self.0 ^ (self.0 >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        let z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        ((z ^ (z >> 31)) >> 11) as f64 / (1_u64 << 53) as f64
    }
}

fn build(path: &Path, resolution: f64) -> Map {
    let mut log = LogReader::open(path, ScanLimits::default()).expect("the log opens");
    let range_max = log.sensor().range_max.unwrap_or(81.0);
    let sensor = SensorModel::new(SensorSpec { range_max, ..SensorSpec::default() }).expect("a sensor");
    let grid = Grid::new(resolution, 16, None).expect("a grid");
    let sensors = BTreeMap::from([("default".to_owned(), sensor)]);
    let scale = ClassScale::new(10).expect("a scale");
    let config = MapConfig::new(grid, scale, EvidenceRule::Guaranteed, 0.05, sensors).expect("a configuration");
    let (mut tree, mut surveyor) = (OccupancyTree::new(16, scale), Surveyor::new());
    let mut way: Vec<(f64, f64)> = Vec::new();
    for scan in &mut log {
        let scan = scan.expect("the log is whole");
        if let LogPose::Point { x, y, .. } = scan.pose {
            way.push((x, y));
        }
        let (x, y, theta) = scan.pose.bounds(&POSE_ERROR);
        let spec = ScanSpec {
            pose: PoseBox::new(x, y, theta, &PoseLimits::default()).expect("a pose"),
            angles: scan.angles,
            ranges: scan.ranges,
            footprint_radius: 0.0,
            sweep_rotation: 0.0,
            sweep_translation: 0.0,
        };
        let scan = Scan::new(spec, sensor, &ScanLimits::default()).expect("a scan");
        tree.apply(&surveyor.survey(&config, &scan), &mut Vec::new());
    }
    let name = path.file_name().expect("a name").to_string_lossy().split('.').next().unwrap_or_default().to_owned();
    Map { name, tree, grid, way }
}

/// A map repeated side by side until it fills a square.
fn repeated(map: &Map, side: f64) -> Map {
    let mut blocks = Vec::new();
    map.tree.visit_blocks(&mut |address, view| blocks.push((address, view.clone())));
    let columns = blocks.iter().map(|(at, _)| at.x);
    let rows = blocks.iter().map(|(at, _)| at.y);
    let (left, right) = (columns.clone().min().unwrap_or(0), columns.max().unwrap_or(0));
    let (low, high) = (rows.clone().min().unwrap_or(0), rows.max().unwrap_or(0));
    let (width, height) = (right - left + 1, high - low + 1);
    let count = (side / (map.grid.resolution() * 64.0)).ceil() as u32;
    let start = (1 << 9) - count / 2;
    let mut tree = OccupancyTree::new(map.tree.depth(), map.tree.scale());
    let by_address: BTreeMap<(u32, u32), BlockView> = blocks.into_iter().map(|(at, v)| ((at.x, at.y), v)).collect();
    for y in 0..count {
        for x in 0..count {
            if let Some(view) = by_address.get(&(left + x % width, low + y % height)) {
                tree.set_block(BlockAddress { x: start + x, y: start + y }, view.clone());
            }
        }
    }
    let shift = |way: f64, from: u32| way + (f64::from(start) - f64::from(from)) * 64.0 * map.grid.resolution();
    let way = map.way.iter().map(|(x, y)| (shift(*x, left), shift(*y, low))).collect();
    Map { name: format!("{} repeated", map.name), tree, grid: map.grid, way }
}

/// The median over rounds of the mean time of a query, in microseconds.
fn time<T>(queries: &[T], mut ask: impl FnMut(&T)) -> f64 {
    let mut means: Vec<f64> = (0..ROUNDS)
        .map(|_| {
            let start = Instant::now();
            queries.iter().for_each(&mut ask);
            start.elapsed().as_secs_f64() * 1e6 / queries.len().max(1) as f64
        })
        .collect();
    means.sort_by(f64::total_cmp);
    means[means.len() / 2]
}

fn regions(map: &Map, name: &str, asked: &[Region]) {
    let is_free = |region: &&Region| guaranteed_free(&map.tree, &map.grid, region, 0).free;
    let (free, other): (Vec<&Region>, Vec<&Region>) = asked.iter().partition(is_free);
    for (kind, regions) in [("free", free), ("not free", other)] {
        let median = time(&regions, |region| {
            black_box(guaranteed_free(&map.tree, &map.grid, region, 0));
        });
        println!("  {name:<34} {kind:<9} {median:>9.3} us  ({} queries)", regions.len());
    }
}

/// Discs about places that the robot passed and about others near them.
fn discs(map: &Map, dice: &mut Dice) -> Vec<Region> {
    let disc = |_| {
        let (x, y) = map.way[(dice.next() * map.way.len() as f64) as usize];
        let near = |v: f64, dice: &mut Dice| v + 3.0 * (dice.next() - 0.5);
        let center = (near(x, dice), near(y, dice));
        Region::disc(center, DISC_RADIUS).expect("a disc")
    };
    (0..QUERIES).map(disc).collect()
}

/// Paths of [`PATH_LENGTH`] along the robot's way, in pieces of `step`.
fn paths(map: &Map, step: f64, dice: &mut Dice) -> Vec<Region> {
    let mut found = Vec::new();
    for _ in 0..20 * QUERIES {
        if found.len() == QUERIES {
            break;
        }
        let start = (dice.next() * map.way.len() as f64) as usize;
        let mut points = vec![map.way[start]];
        let mut length = 0.0;
        for point in &map.way[start..] {
            let last = points[points.len() - 1];
            let moved = (point.0 - last.0).hypot(point.1 - last.1);
            if moved >= step {
                points.push(*point);
                length += moved;
            }
            if length >= PATH_LENGTH {
                found.push(Region::path(points, PATH_RADIUS, &RegionLimits::default()).expect("a path"));
                break;
            }
        }
    }
    found
}

fn png_of(classes: &[u8], width: u32) -> Vec<u8> {
    let mut bytes = Vec::new();
    let mut encoder = png::Encoder::new(&mut bytes, width, classes.len() as u32 / width);
    encoder.set_color(png::ColorType::Grayscale);
    encoder.set_depth(png::BitDepth::Eight);
    encoder.set_compression(png::Compression::Fast);
    let mut writer = encoder.write_header().expect("written to memory");
    writer.write_image_data(classes).expect("written to memory");
    writer.finish().expect("written to memory");
    bytes
}

fn rasters(map: &Map) {
    let tiles: Vec<LeafRange> = map
        .way
        .iter()
        .step_by((map.way.len() / 50).max(1))
        .filter_map(|(x, y)| map.grid.leaf_at(*x, *y))
        .map(|leaf| {
            let (x, y) = (leaf.x & !255, leaf.y & !255);
            LeafRange { min_x: x, min_y: y, max_x: x + 256, max_y: y + 256 }
        })
        .collect();
    let read = time(&tiles, |tile| {
        black_box(map.tree.raster(tile, 16));
    });
    let drawn = time(&tiles, |tile| {
        black_box(png_of(&map.tree.raster(tile, 16), 256));
    });
    println!("  tile of 256 x 256: read {read:.1} us, with its PNG {drawn:.1} us");
}

fn whole(map: &Map) {
    let half = LARGE_SIDE / 2.0;
    let all = map.grid.leaves_within(-half, -half, half, half);
    let cells = |v: u32| v >> 4;
    let coarse = LeafRange {
        min_x: cells(all.min_x),
        min_y: cells(all.min_y),
        max_x: cells(all.max_x - 1) + 1,
        max_y: cells(all.max_y - 1) + 1,
    };
    let raster = time(&[()], |()| {
        black_box(map.tree.raster(&coarse, 12));
    });
    let mut count = 0;
    let leaves = time(&[()], |()| {
        count = 0;
        map.tree.visit_leaves(&all, 12, &mut |leaf| {
            count += usize::from(black_box(leaf).class > 0);
            true
        });
    });
    println!("  whole at depth - 4: raster {raster:.1} us, {count} leaves {leaves:.1} us");
}

fn main() {
    let mut logs: Vec<PathBuf> = std::env::args().skip(1).filter(|a| !a.starts_with("--")).map(PathBuf::from).collect();
    if logs.is_empty() {
        let data = std::env::var_os("UBBMAP_DATA").map_or_else(|| PathBuf::from("../shared/data"), PathBuf::from);
        logs = ["fr079", "intel"].iter().map(|name| data.join(name).join(format!("{name}.jsonl.gz"))).collect();
    }
    for log in logs.iter().filter(|log| log.exists()) {
        for resolution in [0.1, 0.05] {
            let map = build(log, resolution);
            let large = repeated(&map, LARGE_SIDE);
            for map in [map, large] {
                println!("{} at {resolution} m, {:.2} MB", map.name, map.tree.statistics().memory_bytes as f64 * 1e-6);
                let mut dice = Dice(1);
                regions(&map, "disc of 0.4 m", &discs(&map, &mut dice));
                regions(&map, "path of 10 m in pieces of 0.5 m", &paths(&map, PATH_STEP, &mut dice));
                regions(&map, "path of 10 m in pieces of 2.5 m", &paths(&map, 5.0 * PATH_STEP, &mut dice));
                rasters(&map);
                if map.name.ends_with("repeated") {
                    whole(&map);
                }
            }
        }
    }
}

//! A map of 10 km x 10 km at 0.05 m made by a simulated fleet, mapped and queried under a memory limit; the start of a
//! server with 1,000 maps.
//!
//! `cargo bench --bench large -- [--cache-mib 16] [--page-mib 4] [--sites 49] [--maps 1000]`. Robots scan buildings that stand 204.8 m
//! apart, on a store on disk in a new directory below the system's for temporary files; what is printed as peak is the
//! largest resident set of this process (`VmHWM`), which holds the simulation as well. On Linux.

#![allow(clippy::print_stdout, reason = "a benchmark prints its figures")]

use std::collections::BTreeMap;
use std::path::Path;
use std::sync::Arc;
use std::time::Instant;
use ubbmap::mapping::{EvidenceRule, MapConfig, Region};
use ubbmap::quadtree::{ClassScale, Grid};
use ubbmap::sensor::{ScanSpec, SensorModel};
use ubbmap::service::{BoxQuery, MapService, RawPose, ScanInput, ServiceSettings};
use ubbmap::simulation::Fleet;
use ubbmap::store::{MapName, SledOptions, SledStore};

const RESOLUTION: f64 = 0.05;
const DEPTH: u32 = 18;

/// Between two buildings, metres: 4,096 leaves.
const SPACING: f64 = 204.8;

/// Buildings that differ, and what is seen of each.
const SCENES: u64 = 4;
const ROBOTS: usize = 9;
const STEPS: usize = 4;
/// Simulated steps between two scans that are sent.
const STRIDE: usize = 25;

/// Requests under way at once.
const PARALLEL: usize = 8;

/// Discs asked about, metres.
const DISCS: usize = 20_000;
const RADIUS: f64 = 0.25;

fn argument(name: &str, default: usize) -> usize {
    let mut arguments = std::env::args().skip_while(|argument| argument != name).skip(1);
    arguments.next().and_then(|value| value.parse().ok()).unwrap_or(default)
}

/// A field of `/proc/self/status` in MiB.
fn status_mib(field: &str) -> f64 {
    let text = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let line = text.lines().find(|line| line.starts_with(field)).unwrap_or_default();
    line.split_whitespace().nth(1).and_then(|kib| kib.parse::<f64>().ok()).unwrap_or(f64::NAN) / 1024.0
}

fn config() -> MapConfig {
    let sensor = SensorModel::new(Fleet::sensor()).expect("a sensor");
    let grid = Grid::new(RESOLUTION, DEPTH, None).expect("a grid");
    let sensors = BTreeMap::from([("default".to_owned(), sensor)]);
    MapConfig::new(grid, ClassScale::new(10).expect("a scale"), EvidenceRule::Guaranteed, 0.02, sensors)
        .expect("a configuration")
}

/// What robots see of one building, and where they are.
struct Scene {
    scans: Vec<ScanSpec>,
    places: Vec<(f64, f64)>,
}

fn scene(seed: u64) -> Scene {
    let mut fleet = Fleet::new(seed, ROBOTS);
    let mut scene = Scene { scans: Vec::new(), places: Vec::new() };
    for step in 0..STEPS * STRIDE {
        let scans = fleet.step();
        if step % STRIDE == 0 {
            scene.places.extend(scans.iter().map(|scan| (scan.truth.x, scan.truth.y)));
            scene.scans.extend(scans.into_iter().map(|scan| scan.scan));
        }
    }
    scene
}

/// Where a building's corner is.
fn corner(site: usize, sites: usize) -> (f64, f64) {
    let at = |index: usize| (index as f64 - 0.5 * sites as f64) * SPACING;
    (at(site % sites), at(site / sites))
}

fn inputs(scene: &Scene, (x, y): (f64, f64)) -> Vec<ScanInput> {
    let input = |spec: &ScanSpec| {
        let [px, py, theta] = [spec.pose.x(), spec.pose.y(), spec.pose.theta()].map(|i| (i.lo(), i.hi()));
        ScanInput {
            robot: String::new(),
            sequence: None,
            stamp: 0.0,
            sensor: String::new(),
            pose: Some(RawPose { x: (px.0 + x, px.1 + x), y: (py.0 + y, py.1 + y), theta }),
            angles: spec.angles.clone(),
            ranges: spec.ranges.clone(),
            footprint_radius: spec.footprint_radius,
            sweep_rotation: 0.0,
            sweep_translation: 0.0,
        }
    };
    scene.scans.iter().map(input).collect()
}

/// The fleet comes by every building twice, half of the scans each time.
async fn map(service: &MapService, name: &MapName, scenes: &[Scene], sites: usize) -> u64 {
    let mut running = tokio::task::JoinSet::new();
    let mut applied = 0;
    for visit in 0..2 * sites * sites {
        let (round, site) = (visit / (sites * sites), visit % (sites * sites));
        let all = inputs(&scenes[site % scenes.len()], corner(site, sites));
        let scans: Vec<ScanInput> = all.into_iter().skip(round).step_by(2).collect();
        let (service, name) = (service.clone(), name.clone());
        running.spawn(async move { service.insert(&name, scans).await.expect("the store takes it").applied });
        if running.len() >= PARALLEL {
            applied += running.join_next().await.map_or(0, |done| done.expect("it ends"));
        }
    }
    applied + running.join_all().await.iter().sum::<u64>()
}

/// Times of single questions in microseconds: median and 99th percentile.
fn spread(mut times: Vec<f64>) -> (f64, f64) {
    times.sort_by(f64::total_cmp);
    (times[times.len() / 2], times[times.len() * 99 / 100])
}

async fn query(service: &MapService, name: &MapName, scenes: &[Scene], sites: usize) {
    let (mut discs, mut tiles, mut free) = (Vec::new(), Vec::new(), 0);
    for i in 0..DISCS {
        // All over the map, so that nearly every question meets other blocks.
        let site = i * 7919 % (sites * sites);
        let places = &scenes[site % scenes.len()].places;
        let ((x, y), at) = (corner(site, sites), places[i % places.len()]);
        let region = Region::disc((x + at.0, y + at.1), RADIUS).expect("a disc");
        let start = Instant::now();
        let answer = service.guaranteed_free(name, &[region], 0).await.expect("an answer");
        discs.push(start.elapsed().as_secs_f64() * 1e6);
        free += usize::from(answer.results[0].free);
        if i % 20 == 0 {
            let leaf = config().grid().leaf_at(x + 10.0, y + 5.0).expect("within the root");
            let start = Instant::now();
            service.tile(name, DEPTH - 8, leaf.x >> 8, leaf.y >> 8).await.expect("a tile");
            tiles.push(start.elapsed().as_secs_f64() * 1e6);
        }
    }
    let start = Instant::now();
    let whole = service.grid(name, &BoxQuery { depth: Some(10), ..BoxQuery::default() }).await.expect("a grid");
    let seconds = start.elapsed().as_secs_f64();
    let ((disc, disc_99), (tile, tile_99)) = (spread(discs), spread(tiles));
    println!("queried: {DISCS} discs, {free} free, median {disc:.0} us, p99 {disc_99:.0} us");
    println!("         tiles at full depth, median {tile:.0} us, p99 {tile_99:.0} us");
    println!("         the whole at depth 10: {} cells in {:.1} ms", whole.classes.len(), seconds * 1e3);
}

fn print_memory(service: &MapService, what: &str) {
    let cache = service.cache();
    let mib = cache.bytes as f64 / f64::from(1 << 20);
    println!(
        "{what}: resident {:.0} MiB, peak {:.0} MiB; blocks {mib:.0} MiB, {} hits, {} loads, {} evictions",
        status_mib("VmRSS"),
        status_mib("VmHWM"),
        cache.hits,
        cache.loads,
        cache.evictions
    );
}

/// Everything that is measured shares these.
struct Setting {
    name: MapName,
    scenes: Vec<Scene>,
    sites: usize,
    maps: usize,
    settings: ServiceSettings,
    runtime: tokio::runtime::Runtime,
}

impl Setting {
    fn open(&self, directory: &Path) -> (Arc<SledStore>, MapService) {
        let store = SledStore::open(
            directory,
            SledOptions { cache_bytes: (argument("--page-mib", 4) << 20) as u64, ..SledOptions::default() },
        )
        .expect("the store opens");
        let store = Arc::new(store);
        let service = MapService::open(Arc::clone(&store) as _, self.settings.clone()).expect("a service");
        (store, service)
    }

    /// Maps the large map, asks it, and makes many small ones.
    fn build(&self, directory: &Path) {
        let (store, service) = self.open(directory);
        self.runtime.block_on(service.create_map(&self.name, config())).expect("a map");
        let start = Instant::now();
        let applied = self.runtime.block_on(map(&service, &self.name, &self.scenes, self.sites));
        let seconds = start.elapsed().as_secs_f64();
        let megabytes = store.disk_bytes().unwrap_or(0) as f64 * 1e-6;
        println!("mapped: {applied} scans in {seconds:.1} s, {megabytes:.0} MB on disk");
        print_memory(&service, "after mapping");
        self.runtime.block_on(query(&service, &self.name, &self.scenes, self.sites));
        print_memory(&service, "after queries");
        let scans = inputs(&self.scenes[0], (0.0, 0.0));
        for i in 0..self.maps {
            let other = MapName::new(&format!("map-{i}")).expect("a name");
            self.runtime.block_on(service.create_map(&other, config())).expect("a map");
            self.runtime.block_on(service.insert(&other, scans[..4].to_vec())).expect("it is stored");
        }
        self.runtime.block_on(service.drain());
    }

    /// Starts on what is there, and asks the large map.
    fn reopen(&self, directory: &Path) {
        let start = Instant::now();
        let (_store, service) = self.open(directory);
        let seconds = start.elapsed().as_secs_f64();
        let listed = self.runtime.block_on(service.maps()).expect("the maps").len();
        println!("started with {listed} maps in {seconds:.3} s");
        print_memory(&service, "after the start");
        let start = Instant::now();
        let revision = self.runtime.block_on(service.map(&self.name)).expect("the map").revision;
        println!("opened the large map at revision {revision} in {:.3} s", start.elapsed().as_secs_f64());
        print_memory(&service, "after opening");
        self.runtime.block_on(query(&service, &self.name, &self.scenes, self.sites));
        print_memory(&service, "after queries");
        self.runtime.block_on(service.drain());
    }
}

fn main() {
    let sites = argument("--sites", 49);
    let setting = Setting {
        name: MapName::new("site").expect("a name"),
        scenes: (0..SCENES).map(scene).collect(),
        sites,
        maps: argument("--maps", 1000),
        settings: ServiceSettings { cache_bytes: argument("--cache-mib", 16) << 20, ..ServiceSettings::default() },
        runtime: tokio::runtime::Builder::new_multi_thread().enable_all().build().expect("a runtime"),
    };
    if let Some(directory) = std::env::args().skip_while(|argument| argument != "--reopen").nth(1) {
        return setting.reopen(Path::new(&directory));
    }
    let extent = (sites as f64 - 1.0) * SPACING * 1e-3;
    println!("{sites} x {sites} buildings of 25 m x 15 m over {extent:.1} km, {RESOLUTION} m leaves");
    let directory = std::env::temp_dir().join(format!("ubbmap-large-{}", std::process::id()));
    setting.build(&directory);
    // In a process of its own, whose memory has not seen the mapping.
    let program = std::env::current_exe().expect("this program");
    let again =
        std::process::Command::new(program).args(std::env::args().skip(1)).arg("--reopen").arg(&directory).status();
    assert!(again.is_ok_and(|status| status.success()), "the second process ends well");
    if argument("--keep", 0) == 0 {
        // What cannot be deleted stays in the system's directory for what may go.
        let _ = std::fs::remove_dir_all(directory);
    }
}

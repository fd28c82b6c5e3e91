//! What the tests of power cuts, kills, full disks and damage share: maps whose every revision is known beforehand.
//!
//! One robot sends its scans in order, one request after the other, and every request is one commit. So a revision says
//! which scans were applied, and the map at that revision is computed apart from any store: scan by scan, from an empty
//! tree. A store is right when each of its maps is, leaf for leaf, what its revision says, and no revision that was
//! acknowledged is missing.

use crate::service_support::{applied_to, leaves};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::collections::BTreeMap;
use std::fs;
use std::path::Path;
use std::sync::Arc;
use tempfile::TempDir;
use ubbmap::mapping::{EvidenceRule, MapConfig, Surveyor};
use ubbmap::quadtree::{Block, BlockAddress, BlockCache, BlockView, ClassScale, Grid, OccupancyTree};
use ubbmap::sensor::SensorModel;
use ubbmap::service::{RawPose, ScanInput};
use ubbmap::simulation::{Fleet, SimulatedScan};
use ubbmap::store::{Commit, LoadedMap, MapId, MapName, MapStore, RobotName, SequenceWindow};

/// A map at one revision.
#[derive(Clone)]
pub struct After {
    /// The scans 1..=n of the robot were applied, no others.
    pub sequence: u64,
    pub tree: OccupancyTree,
}

/// What one robot sends to its map, and the map after each of its requests.
#[derive(Clone)]
pub struct Course {
    pub robot: RobotName,
    pub config: MapConfig,
    /// Request `r` leads from revision `r` to `r + 1`. Some repeat an older scan, which must not be applied again.
    pub requests: Vec<Vec<ScanInput>>,
    /// By revision.
    pub after: Vec<After>,
}

/// The configuration of all maps of the robots.
pub fn course_config() -> MapConfig {
    let grid = Grid::new(0.05, 10, None).unwrap();
    let sensors = BTreeMap::from([("default".to_owned(), SensorModel::new(Fleet::sensor()).unwrap())]);
    MapConfig::new(grid, ClassScale::new(10).unwrap(), EvidenceRule::Guaranteed, 0.02, sensors).unwrap()
}

/// The courses of so many robots in one building, each of so many requests of one to three scans.
pub fn courses(seed: u64, robots: usize, requests: usize) -> Vec<Course> {
    let mut fleet = Fleet::new(seed, robots);
    let mut scans = vec![Vec::new(); robots];
    for _ in 0..3 * requests {
        for (of_robot, scan) in scans.iter_mut().zip(fleet.step()) {
            of_robot.push(input(&scan));
        }
    }
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    scans.into_iter().map(|scans| course(&scans, requests, &mut random)).collect()
}

fn course(scans: &[ScanInput], count: usize, random: &mut ChaCha8Rng) -> Course {
    let config = course_config();
    let robot = RobotName::new(&scans[0].robot).unwrap();
    let (mut tree, mut surveyor) = (OccupancyTree::new(config.grid().depth(), config.scale()), Surveyor::new());
    let mut after = vec![After { sequence: 0, tree: tree.clone() }];
    let mut requests = Vec::new();
    let mut next = 0;
    for _ in 0..count {
        let new = random.random_range(1..=3);
        let mut request = scans[next..next + new].to_vec();
        for scan in &request {
            applied_to(&mut tree, &mut surveyor, &config, scan);
        }
        if next > 0 && random.random_range(0..4) == 0 {
            request.insert(0, scans[random.random_range(0..next)].clone());
        }
        next += new;
        requests.push(request);
        after.push(After { sequence: next as u64, tree: tree.clone() });
    }
    Course { robot, config, requests, after }
}

fn input(simulated: &SimulatedScan) -> ScanInput {
    let scan = &simulated.scan;
    let ends = |interval: ubbmap::interval::Interval| (interval.lo(), interval.hi());
    let pose = RawPose { x: ends(scan.pose.x()), y: ends(scan.pose.y()), theta: ends(scan.pose.theta()) };
    ScanInput {
        robot: simulated.robot.clone(),
        sequence: Some(simulated.sequence),
        stamp: simulated.stamp,
        sensor: String::new(),
        pose: Some(pose),
        angles: scan.angles.clone(),
        ranges: scan.ranges.clone(),
        footprint_radius: scan.footprint_radius,
        sweep_rotation: scan.sweep_rotation,
        sweep_translation: scan.sweep_translation,
    }
}

impl Course {
    pub fn last(&self) -> u64 {
        self.requests.len() as u64
    }

    /// What a store must hold of it at a revision; `None` where there is no such revision.
    pub fn at(&self, revision: u64) -> Option<LoadedMap> {
        let After { sequence, tree } = self.after.get(usize::try_from(revision).ok()?)?;
        let mut windows = BTreeMap::new();
        if *sequence > 0 {
            let mut window = SequenceWindow::default();
            for number in 1..=*sequence {
                window.record(number);
            }
            windows.insert(self.robot.clone(), window);
        }
        Some(LoadedMap { revision, tree: tree.clone(), windows })
    }
}

/// A map whose commits are each about a megabyte: more than a segment of sled's log, so that the log comes round to
/// space that an earlier part of the same commit gave up.
pub struct Bulk {
    pub config: MapConfig,
    side: u32,
}

impl Bulk {
    pub fn new() -> Self {
        let sensors = BTreeMap::from([("default".to_owned(), SensorModel::new(Fleet::sensor()).unwrap())]);
        let grid = Grid::new(0.05, 10, None).unwrap();
        let rule = EvidenceRule::Guaranteed;
        Self { config: MapConfig::new(grid, ClassScale::new(255).unwrap(), rule, 0.02, sensors).unwrap(), side: 16 }
    }

    fn block(address: BlockAddress, revision: u64) -> BlockView {
        let mut random = ChaCha8Rng::seed_from_u64(address.morton() << 32 | revision);
        let mut leaves = Box::new([1; 64 * 64]);
        for leaf in leaves.iter_mut() {
            *leaf = random.random_range(1..=255);
        }
        BlockView::Mixed(Arc::new(Block::from_leaves(leaves)))
    }

    /// Every third commit changes all blocks, the others some.
    pub fn commit(&self, revision: u64) -> Commit {
        let all = (0..self.side * self.side).map(|n| BlockAddress { x: n % self.side, y: n / self.side });
        let changed = all.filter(|address| revision % 3 == 1 || (address.morton() + revision).is_multiple_of(9));
        let blocks = changed.map(|address| (address, Self::block(address, revision))).collect();
        Commit { revision, changed: 0.0, blocks, windows: Vec::new() }
    }

    pub fn at(&self, revision: u64) -> LoadedMap {
        let mut tree = OccupancyTree::new(self.config.grid().depth(), self.config.scale());
        // What came before the last commit of all blocks is gone.
        let first = (1..=revision).rev().find(|revision| revision % 3 == 1).unwrap_or(1);
        for revision in first..=revision {
            for (address, view) in self.commit(revision).blocks {
                tree.set_block(address, view);
            }
        }
        LoadedMap { revision, tree, windows: BTreeMap::new() }
    }
}

/// Says how a stored map differs from what it should be: read whole, and opened with its blocks read on demand.
pub fn compare(store: &dyn MapStore, id: MapId, expected: &LoadedMap) -> Result<(), String> {
    let loaded = store.load(id).map_err(|error| format!("loading: {error}"))?;
    same(&loaded, expected)?;
    let open = store.open(id, &Arc::new(BlockCache::new(1 << 16))).map_err(|error| format!("opening: {error}"))?;
    let tree = open.tree.try_whole().map_err(|error| format!("reading a block: {error}"))?;
    same(&LoadedMap { revision: open.revision, tree, windows: open.windows }, expected)
}

/// Says how a map that was read differs from what it should be.
pub fn same(found: &LoadedMap, expected: &LoadedMap) -> Result<(), String> {
    let (revision, sought) = (found.revision, expected.revision);
    if revision != sought {
        return Err(format!("revision {revision} instead of {sought}"));
    }
    if found.windows != expected.windows {
        let (found, expected) = (&found.windows, &expected.windows);
        return Err(format!("revision {revision}: windows {found:?} instead of {expected:?}"));
    }
    let (found, expected) = (leaves(&found.tree), leaves(&expected.tree));
    if found != expected {
        let differing = found.iter().zip(&expected).find(|(found, expected)| found != expected);
        return Err(format!("revision {revision}: other leaves, the first {differing:?}"));
    }
    Ok(())
}

/// The map of a name in a store.
pub fn find(store: &dyn MapStore, name: &str) -> Option<(MapId, u64)> {
    let maps = store.list().unwrap();
    maps.iter().find(|map| map.name.as_str() == name).map(|map| (map.id, map.revision))
}

pub fn named(name: &str) -> MapName {
    MapName::new(name).unwrap()
}

/// A number from the environment: how long a test runs.
pub fn setting(name: &str, default: u64) -> u64 {
    std::env::var(name).map_or(default, |text| text.parse().unwrap_or_else(|_| panic!("{name}={text:?} is no number")))
}

/// A line that is seen although the test passes and its output is kept back.
pub fn say(line: &str) {
    use std::io::Write;
    let _ = std::io::stderr().write_all(format!("{line}\n").as_bytes());
}

/// A directory for many short lives: in memory where that is there, since every opening of a store syncs its files.
pub fn scratch() -> TempDir {
    tempfile::tempdir_in("/dev/shm").or_else(|_| tempfile::tempdir()).unwrap()
}

/// Copies a directory with all that is in it.
pub fn copy_directory(from: &Path, to: &Path) {
    fs::create_dir_all(to).unwrap();
    for entry in fs::read_dir(from).unwrap().map(Result::unwrap) {
        let target = to.join(entry.file_name());
        if entry.file_type().unwrap().is_dir() {
            copy_directory(&entry.path(), &target);
        } else {
            fs::copy(entry.path(), target).unwrap();
        }
    }
}

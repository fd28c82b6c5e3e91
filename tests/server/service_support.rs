//! A store in memory that can be held, made to fail and looked into; scans of a ring of walls; small helpers.

#![allow(clippy::unwrap_used, reason = "a test may end where its ground is not as it should be")]

use std::collections::BTreeMap;
use std::f64::consts::TAU;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Condvar, Mutex};
use std::time::Duration;
use ubbmap::mapping::{EvidenceRule, MapConfig, Surveyor};
use ubbmap::quadtree::{
    BlockAddress, BlockCache, BlockView, ClassScale, Grid, Leaf, LeafRange, OccupancyTree, PagedTree,
};
use ubbmap::sensor::{Angles, PoseBox, PoseLimits, Scan, ScanLimits, ScanSpec, SensorModel, SensorSpec};
use ubbmap::service::{BoxQuery, InsertAnswer, MapService, RawPose, ScanInput, ServiceSettings};
use ubbmap::store::{
    BlockStamp, BlockStamps, Commit, DamagedMap, Difference, LoadedMap, MapId, MapName, MapStore, MemoryStore, OpenMap,
    RobotName, SequenceWindow, SledOptions, SledStore, SnapshotName, StoreError, StoredMap, StoredSnapshot,
};

/// What one commit of the store held.
#[derive(Debug, Clone)]
pub struct Committed {
    pub revision: u64,
    pub blocks: Vec<BlockAddress>,
    pub windows: Vec<RobotName>,
}

/// How the store's writes end.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Writes {
    Work,
    FailOnce,
    FailStop,
    PanicOnce,
}

struct Kept {
    map: StoredMap,
    /// The store cannot read what the map is.
    damaged: bool,
    now: Contents,
    stamps: BlockStamps,
    snapshots: BTreeMap<SnapshotName, (StoredSnapshot, Contents)>,
}

/// A map's content at one revision.
#[derive(Clone, Default)]
struct Contents {
    blocks: BTreeMap<u64, BlockView>,
    windows: BTreeMap<RobotName, SequenceWindow>,
}

impl Kept {
    fn new(map: StoredMap, now: Contents) -> Self {
        let stamps = BlockStamps::new(map.revision);
        Self { map, damaged: false, now, stamps, snapshots: BTreeMap::new() }
    }

    fn loaded(&self, contents: &Contents, revision: u64) -> LoadedMap {
        let mut tree = OccupancyTree::new(self.map.config.grid().depth(), self.map.config.scale());
        for (morton, view) in &contents.blocks {
            tree.set_block(BlockAddress::from_morton(*morton), view.clone());
        }
        LoadedMap { revision, tree, windows: contents.windows.clone() }
    }

    fn snapshot(&self, name: &SnapshotName) -> Result<&(StoredSnapshot, Contents), StoreError> {
        self.snapshots.get(name).ok_or_else(|| StoreError::NoSnapshot(name.clone()))
    }
}

struct Inside {
    maps: BTreeMap<MapId, Kept>,
    next: u32,
    commits: Vec<Committed>,
    writes: Writes,
}

/// The store of these tests.
pub struct TestStore {
    inside: Mutex<Inside>,
    held: Mutex<bool>,
    released: Condvar,
    /// Commits that wait to be released.
    pub waiting: AtomicUsize,
    pub loads: AtomicUsize,
}

impl TestStore {
    pub fn new() -> Arc<Self> {
        let inside = Inside { maps: BTreeMap::new(), next: 1, commits: Vec::new(), writes: Writes::Work };
        Arc::new(Self {
            inside: Mutex::new(inside),
            held: Mutex::new(false),
            released: Condvar::new(),
            waiting: AtomicUsize::new(0),
            loads: AtomicUsize::new(0),
        })
    }

    /// Commits and loads wait from now on.
    pub fn hold(&self) {
        *self.held.lock().unwrap() = true;
    }

    pub fn release(&self) {
        *self.held.lock().unwrap() = false;
        self.released.notify_all();
    }

    pub fn set_writes(&self, writes: Writes) {
        self.inside.lock().unwrap().writes = writes;
    }

    pub fn commits(&self) -> Vec<Committed> {
        self.inside.lock().unwrap().commits.clone()
    }

    /// The revision that a restart would find.
    pub fn revision(&self, name: &MapName) -> Option<u64> {
        let inside = self.inside.lock().unwrap();
        inside.maps.values().find(|kept| kept.map.name == *name).map(|kept| kept.map.revision)
    }

    pub fn damage(&self, name: &MapName) {
        let mut inside = self.inside.lock().unwrap();
        inside.maps.values_mut().filter(|kept| kept.map.name == *name).for_each(|kept| kept.damaged = true);
    }

    fn wait(&self) {
        self.waiting.fetch_add(1, Ordering::SeqCst);
        let held = self.held.lock().unwrap();
        // Not for ever: a test that fails while the store is held must end.
        drop(self.released.wait_timeout_while(held, Duration::from_secs(15), |held| *held).unwrap());
        self.waiting.fetch_sub(1, Ordering::SeqCst);
    }

    fn write<T>(&self, work: impl FnOnce(&mut Inside) -> Result<T, StoreError>) -> Result<T, StoreError> {
        let mut inside = self.inside.lock().unwrap();
        match inside.writes {
            Writes::Work => work(&mut inside),
            Writes::FailOnce => {
                inside.writes = Writes::Work;
                drop(inside);
                Err(StoreError::Io { what: "write".to_owned(), source: std::io::Error::other("no space") })
            }
            Writes::FailStop => Err(StoreError::FailStop("no space".to_owned())),
            Writes::PanicOnce => {
                inside.writes = Writes::Work;
                drop(inside);
                std::panic::resume_unwind(Box::new("planted"));
            }
        }
    }
}

impl MapStore for TestStore {
    fn list(&self) -> Result<Vec<StoredMap>, StoreError> {
        let inside = self.inside.lock().unwrap();
        let mut maps: Vec<StoredMap> =
            inside.maps.values().filter(|kept| !kept.damaged).map(|kept| kept.map.clone()).collect();
        maps.sort_by(|a, b| a.name.cmp(&b.name));
        Ok(maps)
    }

    fn create(&self, name: &MapName, config: &MapConfig, created: f64) -> Result<MapId, StoreError> {
        self.write(|inside| {
            let id = MapId(inside.next);
            inside.next += 1;
            let map = StoredMap { id, name: name.clone(), config: config.clone(), revision: 0, created };
            inside.maps.insert(id, Kept::new(map, Contents::default()));
            Ok(id)
        })
    }

    fn import(
        &self,
        name: &MapName,
        config: &MapConfig,
        created: f64,
        contents: &LoadedMap,
    ) -> Result<MapId, StoreError> {
        self.wait();
        self.write(|inside| {
            if inside.maps.values().any(|kept| kept.map.name == *name) {
                return Err(StoreError::Exists(name.clone()));
            }
            let id = MapId(inside.next);
            inside.next += 1;
            let revision = contents.revision;
            let map = StoredMap { id, name: name.clone(), config: config.clone(), revision, created };
            let mut now = Contents { blocks: BTreeMap::new(), windows: contents.windows.clone() };
            contents.tree.visit_blocks(&mut |address, view| {
                now.blocks.insert(address.morton(), view.clone());
            });
            inside.maps.insert(id, Kept::new(map, now));
            Ok(id)
        })
    }

    fn snapshots(&self, id: MapId) -> Result<Vec<StoredSnapshot>, StoreError> {
        let inside = self.inside.lock().unwrap();
        let kept = inside.maps.get(&id).ok_or(StoreError::NoMap(id))?;
        Ok(kept.snapshots.values().map(|(snapshot, _)| snapshot.clone()).collect())
    }

    fn take_snapshot(&self, id: MapId, name: &SnapshotName, created: f64) -> Result<StoredSnapshot, StoreError> {
        self.wait();
        self.write(|inside| {
            let kept = inside.maps.get_mut(&id).ok_or(StoreError::NoMap(id))?;
            assert!(!kept.snapshots.contains_key(name), "the service looks first");
            let snapshot = StoredSnapshot { name: name.clone(), revision: kept.map.revision, created };
            kept.snapshots.insert(name.clone(), (snapshot.clone(), kept.now.clone()));
            Ok(snapshot)
        })
    }

    fn delete_snapshot(&self, id: MapId, name: &SnapshotName) -> Result<(), StoreError> {
        self.write(|inside| {
            let kept = inside.maps.get_mut(&id).ok_or(StoreError::NoMap(id))?;
            kept.snapshots.remove(name).map(|_| ()).ok_or_else(|| StoreError::NoSnapshot(name.clone()))
        })
    }

    fn load_snapshot(&self, id: MapId, name: &SnapshotName) -> Result<LoadedMap, StoreError> {
        let inside = self.inside.lock().unwrap();
        let kept = inside.maps.get(&id).ok_or(StoreError::NoMap(id))?;
        let (snapshot, contents) = kept.snapshot(name)?;
        Ok(kept.loaded(contents, snapshot.revision))
    }

    fn difference(&self, id: MapId, name: &SnapshotName) -> Result<Difference, StoreError> {
        let inside = self.inside.lock().unwrap();
        let kept = inside.maps.get(&id).ok_or(StoreError::NoMap(id))?;
        let (snapshot, then) = kept.snapshot(name)?;
        let unknown = BlockView::Uniform(kept.map.config.scale().unknown());
        let mut blocks = Vec::new();
        for code in kept.now.blocks.keys() {
            let old = then.blocks.get(code).unwrap_or(&unknown);
            if kept.now.blocks[code] != *old {
                blocks.push((BlockAddress::from_morton(*code), old.clone()));
            }
        }
        let mut windows = Vec::new();
        for (robot, window) in &kept.now.windows {
            let old = then.windows.get(robot).cloned().unwrap_or_default();
            if old != *window {
                windows.push((robot.clone(), old));
            }
        }
        for (robot, old) in then.windows.iter().filter(|(robot, _)| !kept.now.windows.contains_key(*robot)) {
            windows.push((robot.clone(), old.clone()));
        }
        Ok(Difference { revision: snapshot.revision, blocks, windows })
    }

    fn update_config(&self, id: MapId, config: &MapConfig) -> Result<(), StoreError> {
        self.write(|inside| {
            inside.maps.get_mut(&id).ok_or(StoreError::NoMap(id))?.map.config = config.clone();
            Ok(())
        })
    }

    fn delete(&self, id: MapId) -> Result<(), StoreError> {
        self.write(|inside| inside.maps.remove(&id).map(|_| ()).ok_or(StoreError::NoMap(id)))
    }

    fn load(&self, id: MapId) -> Result<LoadedMap, StoreError> {
        self.loads.fetch_add(1, Ordering::SeqCst);
        self.wait();
        let inside = self.inside.lock().unwrap();
        let kept = inside.maps.get(&id).ok_or(StoreError::NoMap(id))?;
        Ok(kept.loaded(&kept.now, kept.map.revision))
    }

    fn open(&self, id: MapId, _: &Arc<BlockCache>) -> Result<OpenMap, StoreError> {
        let LoadedMap { revision, tree, windows } = self.load(id)?;
        let stamps = self.inside.lock().unwrap().maps[&id].stamps.clone();
        Ok(OpenMap { revision, tree: PagedTree::from(&tree), pager: None, windows, stamps })
    }

    fn failure(&self) -> Option<String> {
        (self.inside.lock().unwrap().writes == Writes::FailStop).then(|| "no space".to_owned())
    }

    fn damaged(&self) -> Vec<DamagedMap> {
        let inside = self.inside.lock().unwrap();
        let damaged = inside.maps.values().filter(|kept| kept.damaged);
        damaged
            .map(|kept| DamagedMap {
                id: Some(kept.map.id),
                name: Some(kept.map.name.clone()),
                what: "planted".to_owned(),
            })
            .collect()
    }

    fn commit(&self, id: MapId, commit: &Commit) -> Result<(), StoreError> {
        self.wait();
        self.write(|inside| {
            let kept = inside.maps.get_mut(&id).ok_or(StoreError::NoMap(id))?;
            assert_eq!(commit.revision, kept.map.revision + 1, "one revision a commit");
            kept.map.revision = commit.revision;
            kept.now.blocks.extend(commit.blocks.iter().map(|(address, view)| (address.morton(), view.clone())));
            let stamp = BlockStamp { revision: commit.revision, changed: commit.changed };
            commit.addresses().into_iter().for_each(|address| kept.stamps.set(address, stamp));
            kept.now.windows.extend(commit.windows.iter().cloned());
            kept.now.windows.retain(|_, window| window.highest().is_some());
            inside.commits.push(Committed {
                revision: commit.revision,
                blocks: commit.blocks.iter().map(|(address, _)| *address).collect(),
                windows: commit.windows.iter().map(|(robot, _)| robot.clone()).collect(),
            });
            Ok(())
        })
    }
}

pub fn sensor() -> SensorModel {
    SensorModel::new(SensorSpec { range_max: 10.0, ..SensorSpec::default() }).unwrap()
}

/// A map of 25.6 m about (0, 0) with leaves of 0.1 m.
pub fn config() -> MapConfig {
    config_of(0.1, 8, 10, EvidenceRule::Guaranteed)
}

pub fn config_of(resolution: f64, depth: u32, classes: u32, rule: EvidenceRule) -> MapConfig {
    let grid = Grid::new(resolution, depth, None).unwrap();
    let sensors = BTreeMap::from([("default".to_owned(), sensor())]);
    MapConfig::new(grid, ClassScale::new(classes).unwrap(), rule, 0.02, sensors).unwrap()
}

pub fn map_name(name: &str) -> MapName {
    MapName::new(name).unwrap()
}

/// A scan that sees a round wall 3 m about the robot; `place` moves the robot, so that scans differ.
pub fn ring(robot: &str, sequence: Option<u64>, place: f64) -> ScanInput {
    ScanInput {
        robot: robot.to_owned(),
        sequence,
        stamp: 0.0,
        sensor: String::new(),
        pose: Some(RawPose { x: (place, place), y: (0.0, 0.0), theta: (0.0, 0.0) }),
        angles: Angles::Uniform { min: 0.0, increment: TAU / 360.0 },
        ranges: vec![3.0; 360],
        footprint_radius: 0.0,
        sweep_rotation: 0.0,
        sweep_translation: 0.0,
    }
}

/// A store that keeps snapshots, in memory or on disk; the directory lives as long as it is held.
pub struct Keeping {
    pub what: &'static str,
    pub store: Arc<dyn MapStore>,
    directory: Option<tempfile::TempDir>,
}

impl Keeping {
    pub fn all() -> Vec<Self> {
        let memory = Self { what: "memory", store: Arc::new(MemoryStore::new()), directory: None };
        let directory = tempfile::tempdir().unwrap();
        let store = Arc::new(SledStore::open(directory.path(), SledOptions::default()).unwrap());
        vec![memory, Self { what: "sled", store, directory: Some(directory) }]
    }

    pub fn service(&self, settings: ServiceSettings) -> MapService {
        MapService::open(Arc::clone(&self.store), settings).unwrap()
    }

    /// Whether it is on disk.
    pub fn is_durable(&self) -> bool {
        self.directory.is_some()
    }
}

pub fn snapshot_name(name: &str) -> SnapshotName {
    SnapshotName::new(name).unwrap()
}

pub fn open(store: &Arc<TestStore>, settings: ServiceSettings) -> MapService {
    MapService::open(Arc::clone(store) as Arc<dyn MapStore>, settings).unwrap()
}

/// A service with one map `hall`.
pub async fn hall(store: &Arc<TestStore>, settings: ServiceSettings) -> (MapService, MapName) {
    let service = open(store, settings);
    let name = map_name("hall");
    service.create_map(&name, config()).await.unwrap();
    (service, name)
}

/// The leaves of the whole map as the service serves them.
pub async fn served(service: &MapService, name: &MapName) -> Vec<Leaf> {
    service.region(name, &BoxQuery::default()).await.unwrap().leaves
}

/// The tree that scans lead to when they are applied one by one, without a service.
pub fn applied(config: &MapConfig, scans: &[ScanInput]) -> OccupancyTree {
    let mut tree = OccupancyTree::new(config.grid().depth(), config.scale());
    let mut surveyor = Surveyor::new();
    for scan in scans {
        applied_to(&mut tree, &mut surveyor, config, scan);
    }
    tree
}

/// Applies one more scan, without a service.
pub fn applied_to(tree: &mut OccupancyTree, surveyor: &mut Surveyor, config: &MapConfig, scan: &ScanInput) {
    let pose = scan.pose.unwrap();
    let spec = ScanSpec {
        pose: PoseBox::new(pose.x, pose.y, pose.theta, &PoseLimits::default()).unwrap(),
        angles: scan.angles.clone(),
        ranges: scan.ranges.clone(),
        footprint_radius: scan.footprint_radius,
        sweep_rotation: scan.sweep_rotation,
        sweep_translation: scan.sweep_translation,
    };
    let name = if scan.sensor.is_empty() { "default" } else { &scan.sensor };
    let scan = Scan::new(spec, config.sensors()[name], &ScanLimits::default()).unwrap();
    tree.apply(&surveyor.survey(config, &scan), &mut Vec::new());
}

/// The leaves of a whole tree.
pub fn leaves(tree: &OccupancyTree) -> Vec<Leaf> {
    let side = 1 << tree.depth();
    let mut leaves = Vec::new();
    tree.visit_leaves(&LeafRange { min_x: 0, min_y: 0, max_x: side, max_y: side }, tree.depth(), &mut |leaf| {
        leaves.push(leaf);
        true
    });
    leaves
}

/// `(applied, duplicates, rejected)` of an answer.
pub fn counts(answer: &InsertAnswer) -> (u64, u64, usize) {
    (answer.applied, answer.duplicates, answer.rejected.len())
}

/// Waits until something holds; it must within some seconds.
pub async fn until(what: &str, holds: impl Fn() -> bool) {
    for _ in 0..2000 {
        if holds() {
            return;
        }
        tokio::time::sleep(Duration::from_millis(5)).await;
    }
    assert!(holds(), "never came: {what}");
}

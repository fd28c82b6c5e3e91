//! A service over a store in memory that writes down what it was given, and scans that all say the same: so the number of
//! scans that a root has applied tells its every leaf.

use crate::mapping::{EvidenceRule, MapConfig, Surveyor};
use crate::quadtree::{BlockCache, ClassScale, Grid, OccupancyTree};
use crate::sensor::{Angles, PoseBox, Scan, ScanSpec, SensorModel, SensorSpec};
use crate::service::writer::Published;
use crate::service::{InsertAnswer, MapService, RawPose, ScanInput, ServiceError, ServiceSettings};
use crate::store::{
    Commit, Difference, LoadedMap, MapId, MapName, MapStore, MemoryStore, OpenMap, RobotName, SequenceVerdict,
    SequenceWindow, SnapshotName, StoreError, StoredMap, StoredSnapshot,
};
use crate::sync::point;
use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::f64::consts::TAU;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// The windows of every robot.
pub(super) type Windows = BTreeMap<RobotName, SequenceWindow>;

/// What the store was given, by map and revision. Behind `std`'s lock: looking at it changes no order.
#[derive(Default)]
struct Written {
    windows: BTreeMap<(MapId, u64), Windows>,
    /// The last revision of which the commit has returned.
    durable: BTreeMap<MapId, u64>,
    /// How the next commits end; those to come after them are made.
    fates: VecDeque<bool>,
    failing_deletions: usize,
    /// Maps that are deleted, or being so.
    deleted: BTreeSet<MapId>,
    /// No more commits may come.
    ended: bool,
    snapshots_read: usize,
}

impl Written {
    /// What a map's writer does must not come behind the map's deletion.
    fn is_there(&self, id: MapId) {
        assert!(!self.deleted.contains(&id), "work at a map that is deleted");
    }
}

/// The store.
pub(super) struct Ledger {
    inner: MemoryStore,
    written: Mutex<Written>,
}

impl Ledger {
    fn written(&self) -> MutexGuard<'_, Written> {
        self.written.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// The next commits end like this: `true` is made, `false` fails without a trace.
    pub(super) fn fates(&self, fates: &[bool]) {
        self.written().fates.extend(fates);
    }

    pub(super) fn fail_next_deletion(&self) {
        self.written().failing_deletions += 1;
    }

    /// From now on a commit is a fault.
    pub(super) fn end(&self) {
        self.written().ended = true;
    }

    pub(super) fn durable(&self, id: MapId) -> u64 {
        self.written().durable.get(&id).copied().unwrap_or(0)
    }

    /// The windows that a revision was stored with.
    pub(super) fn windows(&self, id: MapId, revision: u64) -> Windows {
        if revision == 0 {
            return Windows::new();
        }
        self.written().windows.get(&(id, revision)).cloned().expect("a revision that was never stored")
    }

    pub(super) fn snapshots_read(&self) -> usize {
        self.written().snapshots_read
    }

    fn failed() -> StoreError {
        StoreError::Io { what: "writing".to_owned(), source: std::io::Error::other("planted") }
    }
}

impl MapStore for Ledger {
    fn list(&self) -> Result<Vec<StoredMap>, StoreError> {
        self.inner.list()
    }

    fn create(&self, name: &MapName, config: &MapConfig, created: f64) -> Result<MapId, StoreError> {
        self.inner.create(name, config, created)
    }

    fn update_config(&self, id: MapId, config: &MapConfig) -> Result<(), StoreError> {
        self.inner.update_config(id, config)
    }

    fn delete(&self, id: MapId) -> Result<(), StoreError> {
        point();
        let fails = {
            let mut written = self.written();
            let fails = written.failing_deletions > 0;
            written.failing_deletions -= usize::from(fails);
            if !fails {
                written.deleted.insert(id);
            }
            fails
        };
        if fails { Err(Self::failed()) } else { self.inner.delete(id) }
    }

    fn load(&self, id: MapId) -> Result<LoadedMap, StoreError> {
        self.inner.load(id)
    }

    fn open(&self, id: MapId, cache: &Arc<BlockCache>) -> Result<OpenMap, StoreError> {
        self.inner.open(id, cache)
    }

    fn commit(&self, id: MapId, commit: &Commit) -> Result<(), StoreError> {
        point();
        {
            let mut written = self.written();
            assert!(!written.ended, "a commit behind the end");
            written.is_there(id);
            if !written.fates.pop_front().unwrap_or(true) {
                return Err(Self::failed());
            }
        }
        self.inner.commit(id, commit)?;
        let mut written = self.written();
        let before = written.durable.get(&id).copied().unwrap_or(0);
        assert_eq!(commit.revision, before + 1, "revisions follow each other");
        let mut windows = written.windows.get(&(id, before)).cloned().unwrap_or_default();
        windows.extend(commit.windows.iter().cloned());
        windows.retain(|_, window| window.highest().is_some());
        written.windows.insert((id, commit.revision), windows);
        written.durable.insert(id, commit.revision);
        drop(written);
        point();
        Ok(())
    }

    fn snapshots(&self, id: MapId) -> Result<Vec<StoredSnapshot>, StoreError> {
        self.inner.snapshots(id)
    }

    fn take_snapshot(&self, id: MapId, name: &SnapshotName, created: f64) -> Result<StoredSnapshot, StoreError> {
        self.written().is_there(id);
        self.inner.take_snapshot(id, name, created)
    }

    fn delete_snapshot(&self, id: MapId, name: &SnapshotName) -> Result<(), StoreError> {
        self.inner.delete_snapshot(id, name)
    }

    fn load_snapshot(&self, id: MapId, name: &SnapshotName) -> Result<LoadedMap, StoreError> {
        self.written().snapshots_read += 1;
        self.inner.load_snapshot(id, name)
    }

    fn difference(&self, id: MapId, name: &SnapshotName) -> Result<Difference, StoreError> {
        self.written().is_there(id);
        self.inner.difference(id, name)
    }
}

/// The map after so many scans, counted by the evidence of one.
pub(super) struct Expected(Vec<OccupancyTree>);

impl Expected {
    pub(super) fn new(scans: usize) -> Arc<Self> {
        let config = config();
        let sensor = config.sensors()["default"];
        let ScanInput { angles, ranges, footprint_radius, .. } = scan("a", 0);
        let pose = PoseBox::new((0.0, 0.0), (0.0, 0.0), (0.0, 0.0), &Default::default()).expect("a pose");
        let spec = ScanSpec { pose, angles, ranges, footprint_radius, sweep_rotation: 0.0, sweep_translation: 0.0 };
        let scan = Scan::new(spec, sensor, &Default::default()).expect("a scan");
        let masks = Surveyor::default().survey(&config, &scan);
        let mut tree = OccupancyTree::new(config.grid().depth(), config.scale());
        let mut trees = vec![tree.clone()];
        for _ in 0..scans {
            let mut changed = Vec::new();
            tree.apply(&masks, &mut changed);
            assert_eq!(changed.len(), 4, "each scan changes all four blocks");
            trees.push(tree.clone());
        }
        Arc::new(Self(trees))
    }

    pub(super) fn after(&self, scans: u64) -> &OccupancyTree {
        &self.0[usize::try_from(scans).expect("few scans")]
    }
}

fn config() -> MapConfig {
    // Two by two blocks, and the robots stand where the four meet.
    let grid = Grid::new(0.1, 7, None).expect("a grid");
    let spec = SensorSpec { range_max: 5.0, no_return_free_to: Some(4.0), ..SensorSpec::default() };
    let sensors = BTreeMap::from([("default".to_owned(), SensorModel::new(spec).expect("a sensor"))]);
    MapConfig::new(grid, ClassScale::new(40).expect("classes"), EvidenceRule::Guaranteed, 0.0, sensors).expect("a map")
}

/// One scan among walls; all robots see the same.
pub(super) fn scan(robot: &str, sequence: u64) -> ScanInput {
    ScanInput {
        robot: robot.to_owned(),
        sequence: Some(sequence),
        stamp: sequence as f64,
        sensor: String::new(),
        pose: Some(RawPose { x: (0.0, 0.0), y: (0.0, 0.0), theta: (0.0, 0.0) }),
        angles: Angles::Uniform { min: 0.0, increment: TAU / 12.0 },
        ranges: vec![1.0; 12],
        footprint_radius: 0.2,
        sweep_rotation: 0.0,
        sweep_translation: 0.0,
    }
}

/// Has a robot had a number applied?
pub(super) fn has(windows: &Windows, robot: &str, sequence: u64) -> bool {
    let name = RobotName::new(robot).expect("a name");
    windows.get(&name).is_some_and(|window| window.verdict(sequence) == SequenceVerdict::Duplicate)
}

/// A service with one map.
#[derive(Clone)]
pub(super) struct Scene {
    pub(super) store: Arc<Ledger>,
    pub(super) service: MapService,
    pub(super) name: MapName,
    pub(super) id: MapId,
    expected: Arc<Expected>,
}

impl Scene {
    pub(super) async fn new(expected: &Arc<Expected>, settings: ServiceSettings) -> Self {
        let store = Arc::new(Ledger { inner: MemoryStore::new(), written: Mutex::default() });
        let service = MapService::open(Arc::<Ledger>::clone(&store), settings).expect("a service");
        let name = MapName::new("hall").expect("a name");
        service.create_map(&name, config()).await.expect("a map");
        let id = service.registry.find(&name).expect("the map").id;
        Self { store, service, name, id, expected: Arc::clone(expected) }
    }

    /// Blocks come and go: two of the four fit into memory.
    pub(super) fn tight() -> ServiceSettings {
        ServiceSettings { cache_bytes: 2 * 5700, queue_length: 4, ..ServiceSettings::default() }
    }

    pub(super) async fn create_again(&self) {
        self.service.create_map(&self.name, config()).await.expect("a map");
    }

    pub(super) async fn insert(&self, scans: Vec<ScanInput>) -> Result<InsertAnswer, ServiceError> {
        self.service.insert(&self.name, scans).await
    }

    /// Inserts scans of a robot, which are taken.
    pub(super) async fn send(&self, robot: &str, sequences: &[u64]) -> InsertAnswer {
        let scans = sequences.iter().map(|sequence| scan(robot, *sequence)).collect();
        self.insert(scans).await.expect("an answer")
    }

    /// Reads the last root whole; every leaf and every window must be those of its revision, and all of it durable.
    pub(super) async fn read(&self) -> Arc<Published> {
        let root = self.service.root(&self.name).await.expect("a root");
        self.check(&root.published);
        root.published
    }

    /// Looks at a root that may be an old one.
    pub(super) fn check(&self, root: &Published) {
        assert!(root.revision <= self.store.durable(self.id), "revision {} was read and is not stored", root.revision);
        assert_eq!(*root.windows, self.store.windows(self.id, root.revision), "revision {}", root.revision);
        let tree = root.tree.try_whole().expect("every block can be read");
        assert!(tree == *self.expected.after(count(&root.windows)), "wrong leaves at revision {}", root.revision);
    }

    /// What an answer counts is in the map of its revision, and that is published.
    pub(super) async fn check_answer(&self, robot: &str, sequences: &[u64], answer: &InsertAnswer) {
        let windows = self.store.windows(self.id, answer.revision);
        for (index, sequence) in sequences.iter().enumerate() {
            let refused = answer.rejected.iter().any(|rejection| rejection.index == index);
            assert!(refused || has(&windows, robot, *sequence), "{robot} {sequence} is missing: {answer:?}");
        }
        let counted = answer.applied + answer.duplicates + answer.rejected.len() as u64;
        assert_eq!(counted, sequences.len() as u64, "{answer:?}");
        let now = self.service.root(&self.name).await.expect("a root").published.revision;
        assert!(now >= answer.revision, "acknowledged with {}, and {now} is read", answer.revision);
    }

    /// All that insertions held is given back, and the service ends.
    pub(super) async fn all_is_given_back(self) {
        let entry = self.service.registry.find(&self.name);
        self.service.drain().await;
        self.store.end();
        assert_eq!(self.service.registry.pool.budget.used(), 0, "memory for scans is lost");
        if let Ok(entry) = entry
            && let Some(opened) = entry.opened.get()
        {
            let take = |last: usize| opened.places.take(&format!("last-{last}"));
            let all: Vec<_> = (0..self.service.settings().queue_length).map(take).collect();
            assert!(all.iter().all(Result::is_ok), "a place is lost");
        }
    }
}

/// The scans that were applied.
pub(super) fn count(windows: &Windows) -> u64 {
    windows.values().map(SequenceWindow::count).sum()
}

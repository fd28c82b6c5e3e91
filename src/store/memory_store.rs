//! Maps in memory: for tests, and for trials whose maps may vanish with the process.

use super::checks::{check_commit, check_contents};
use super::{
    BlockStamp, BlockStamps, Commit, Difference, LoadedMap, MapId, MapName, MapStore, OpenMap, RobotName,
    SequenceWindow, SnapshotName, StoreError, StoredMap, StoredSnapshot,
};
use crate::mapping::MapConfig;
use crate::quadtree::{
    Block, BlockAddress, BlockCache, BlockPager, BlockSource, BlockTag, BlockView, OccupancyTree, PagedTree,
    SourceError,
};
use crate::sync::{Mutex, lock};
use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;
use std::time::Duration;

/// A store that keeps nothing beyond its own life. Tests can make it fail and wait.
#[derive(Debug, Default)]
pub struct MemoryStore {
    state: Arc<Mutex<State>>,
}

#[derive(Debug, Default)]
struct State {
    maps: BTreeMap<MapId, Kept>,
    last: u32,
    commits: u64,
    failure: Option<String>,
    fail_commit: Option<String>,
    fail_load: Option<String>,
    fail_fetches: Option<String>,
    delay: Duration,
}

/// One map.
#[derive(Debug, Clone)]
struct Kept {
    stored: StoredMap,
    loaded: LoadedMap,
    stamps: BlockStamps,
    snapshots: BTreeMap<SnapshotName, (StoredSnapshot, LoadedMap)>,
}

impl Kept {
    fn snapshot(&self, name: &SnapshotName) -> Result<&LoadedMap, StoreError> {
        self.snapshots.get(name).map(|(_, loaded)| loaded).ok_or_else(|| StoreError::NoSnapshot(name.clone()))
    }
}

/// The blocks of one map.
struct Source {
    state: Arc<Mutex<State>>,
    id: MapId,
}

impl BlockSource for Source {
    fn fetch(&self, tag: &BlockTag) -> Result<Arc<Block>, SourceError> {
        let mut state = lock(&self.state);
        let damaged = |what: &str| {
            let BlockAddress { x, y } = tag.address;
            StoreError::Damaged { what: format!("map {}, block ({x}, {y}): {what}", self.id.0) }
        };
        if let Some(what) = &state.fail_fetches {
            return Err(damaged(what).into());
        }
        let kept = state.map(self.id)?;
        let written = kept.stamps.get(tag.address).map(|stamp| stamp.revision);
        match kept.loaded.tree.block(tag.address) {
            BlockView::Mixed(block) if written == Some(tag.revision) && block.max_at(0, 0, 0) == tag.max => Ok(block),
            _ => Err(damaged(&format!("written by revision {written:?}, expected {tag:?}")).into()),
        }
    }
}

impl State {
    fn writable(&self) -> Result<(), StoreError> {
        self.failure.as_ref().map_or(Ok(()), |reason| Err(StoreError::FailStop(reason.clone())))
    }

    fn map(&mut self, id: MapId) -> Result<&mut Kept, StoreError> {
        self.maps.get_mut(&id).ok_or(StoreError::NoMap(id))
    }
}

impl MemoryStore {
    /// An empty store.
    #[must_use]
    pub fn new() -> Self {
        Self::default()
    }

    /// The next commit fails as a failed flush does: nothing of it is visible, and no write is taken after it.
    pub fn fail_next_commit(&self, reason: &str) {
        lock(&self.state).fail_commit = Some(reason.to_owned());
    }

    /// The next load finds a damaged record.
    pub fn fail_next_load(&self, what: &str) {
        lock(&self.state).fail_load = Some(what.to_owned());
    }

    /// From now on every block that is read is damaged, or none any more.
    pub fn fail_fetches(&self, what: Option<&str>) {
        lock(&self.state).fail_fetches = what.map(str::to_owned);
    }

    /// Every commit from now on takes at least so long.
    pub fn delay_commits(&self, delay: Duration) {
        lock(&self.state).delay = delay;
    }

    /// How many commits were stored.
    #[must_use]
    pub fn commits(&self) -> u64 {
        lock(&self.state).commits
    }
}

impl MapStore for MemoryStore {
    fn list(&self) -> Result<Vec<StoredMap>, StoreError> {
        let mut maps: Vec<StoredMap> = lock(&self.state).maps.values().map(|kept| kept.stored.clone()).collect();
        maps.sort_by(|a, b| a.name.cmp(&b.name));
        Ok(maps)
    }

    fn create(&self, name: &MapName, config: &MapConfig, created: f64) -> Result<MapId, StoreError> {
        let tree = OccupancyTree::new(config.grid().depth(), config.scale());
        let empty = LoadedMap { revision: 0, tree, windows: BTreeMap::new() };
        self.import(name, config, created, &empty)
    }

    fn import(
        &self,
        name: &MapName,
        config: &MapConfig,
        created: f64,
        contents: &LoadedMap,
    ) -> Result<MapId, StoreError> {
        check_contents(config, contents)?;
        let mut state = lock(&self.state);
        state.writable()?;
        if state.maps.values().any(|kept| kept.stored.name == *name) {
            return Err(StoreError::Exists(name.clone()));
        }
        let next = state.last.checked_add(1);
        state.last = next.ok_or_else(|| StoreError::Refused("no map numbers are left".to_owned()))?;
        let id = MapId(state.last);
        let revision = contents.revision;
        let stored = StoredMap { id, name: name.clone(), config: config.clone(), revision, created };
        let mut stamps = BlockStamps::new(revision);
        contents.tree.visit_blocks(&mut |address, _| stamps.set(address, BlockStamp { revision, changed: created }));
        state.maps.insert(id, Kept { stored, loaded: contents.clone(), stamps, snapshots: BTreeMap::new() });
        Ok(id)
    }

    fn update_config(&self, id: MapId, config: &MapConfig) -> Result<(), StoreError> {
        let mut state = lock(&self.state);
        state.writable()?;
        let stored = &mut state.map(id)?.stored;
        match stored.config.with_sensors(config.sensors().clone()) {
            Ok(same) if same == *config => stored.config = same,
            _ => return Err(StoreError::Refused("only the sensors of a map can change".to_owned())),
        }
        Ok(())
    }

    fn delete(&self, id: MapId) -> Result<(), StoreError> {
        let mut state = lock(&self.state);
        state.writable()?;
        state.maps.remove(&id).map(|_| ()).ok_or(StoreError::NoMap(id))
    }

    fn load(&self, id: MapId) -> Result<LoadedMap, StoreError> {
        let mut state = lock(&self.state);
        let loaded = state.map(id)?.loaded.clone();
        state.fail_load.take().map_or(Ok(loaded), |what| Err(StoreError::Damaged { what }))
    }

    fn open(&self, id: MapId, cache: &Arc<BlockCache>) -> Result<OpenMap, StoreError> {
        let LoadedMap { revision, tree: whole, windows } = self.load(id)?;
        let source = Source { state: Arc::clone(&self.state), id };
        let pager = Arc::new(BlockPager::new(Box::new(source), Arc::clone(cache)));
        let mut tree = PagedTree::new(whole.depth(), whole.scale());
        let stamps = lock(&self.state).map(id)?.stamps.clone();
        whole.visit_blocks(&mut |address, view| match view {
            BlockView::Uniform(class) => tree.place_uniform(address, *class),
            BlockView::Mixed(block) => {
                let revision = stamps.get(address).unwrap_or_default().revision;
                tree.place_stored(BlockTag { address, revision, max: block.max_at(0, 0, 0) }, &pager);
            }
        });
        Ok(OpenMap { revision, tree, pager: Some(pager), windows, stamps })
    }

    fn commit(&self, id: MapId, commit: &Commit) -> Result<(), StoreError> {
        let delay = lock(&self.state).delay;
        if !delay.is_zero() {
            std::thread::sleep(delay);
        }
        let mut state = lock(&self.state);
        state.writable()?;
        let kept = state.map(id)?;
        check_commit(&kept.stored, commit)?;
        let mut tree = kept.loaded.tree.clone();
        for (address, view) in &commit.blocks {
            tree.set_block(*address, view.clone());
        }
        if let Some(reason) = state.fail_commit.take() {
            state.failure = Some(reason.clone());
            return Err(StoreError::FailStop(reason));
        }
        let kept = state.map(id)?;
        kept.stored.revision = commit.revision;
        kept.loaded.revision = commit.revision;
        kept.loaded.tree = tree;
        kept.loaded.windows.extend(commit.windows.iter().cloned());
        kept.loaded.windows.retain(|_, window| window.highest().is_some());
        let stamp = BlockStamp { revision: commit.revision, changed: commit.changed };
        commit.blocks.iter().for_each(|(address, _)| kept.stamps.set(*address, stamp));
        state.commits += 1;
        Ok(())
    }

    fn snapshots(&self, id: MapId) -> Result<Vec<StoredSnapshot>, StoreError> {
        let mut state = lock(&self.state);
        Ok(state.map(id)?.snapshots.values().map(|(snapshot, _)| snapshot.clone()).collect())
    }

    fn take_snapshot(&self, id: MapId, name: &SnapshotName, created: f64) -> Result<StoredSnapshot, StoreError> {
        let mut state = lock(&self.state);
        state.writable()?;
        let kept = state.map(id)?;
        if kept.snapshots.contains_key(name) {
            return Err(StoreError::SnapshotExists(name.clone()));
        }
        let snapshot = StoredSnapshot { name: name.clone(), revision: kept.stored.revision, created };
        kept.snapshots.insert(name.clone(), (snapshot.clone(), kept.loaded.clone()));
        Ok(snapshot)
    }

    fn delete_snapshot(&self, id: MapId, name: &SnapshotName) -> Result<(), StoreError> {
        let mut state = lock(&self.state);
        state.writable()?;
        let removed = state.map(id)?.snapshots.remove(name);
        removed.map(|_| ()).ok_or_else(|| StoreError::NoSnapshot(name.clone()))
    }

    fn load_snapshot(&self, id: MapId, name: &SnapshotName) -> Result<LoadedMap, StoreError> {
        lock(&self.state).map(id)?.snapshot(name).cloned()
    }

    fn difference(&self, id: MapId, name: &SnapshotName) -> Result<Difference, StoreError> {
        let mut state = lock(&self.state);
        let kept = state.map(id)?;
        let snapshot = kept.snapshot(name)?;
        let blocks = kept.stamps.since(snapshot.revision).map(|(address, _)| (address, snapshot.tree.block(address)));
        let robots: BTreeSet<_> = kept.loaded.windows.keys().chain(snapshot.windows.keys()).collect();
        let window =
            |windows: &BTreeMap<_, SequenceWindow>, robot: &RobotName| windows.get(robot).cloned().unwrap_or_default();
        let changed = |robot: &&RobotName| window(&kept.loaded.windows, robot) != window(&snapshot.windows, robot);
        let windows = robots.into_iter().filter(changed);
        let windows = windows.map(|robot| (robot.clone(), window(&snapshot.windows, robot))).collect();
        Ok(Difference { revision: snapshot.revision, blocks: blocks.collect(), windows })
    }

    fn failure(&self) -> Option<String> {
        lock(&self.state).failure.clone()
    }
}

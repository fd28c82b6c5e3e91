//! Maps in memory: for tests, and for trials whose maps may vanish with the process.

use super::checks::check_commit;
use super::{Commit, LoadedMap, MapId, MapName, MapStore, StoreError, StoredMap, lock};
use crate::mapping::MapConfig;
use crate::quadtree::OccupancyTree;
use std::collections::BTreeMap;
use std::sync::Mutex;
use std::time::Duration;

/// A store that keeps nothing beyond its own life. Tests can make it fail and wait.
#[derive(Debug, Default)]
pub struct MemoryStore {
    state: Mutex<State>,
}

#[derive(Debug, Default)]
struct State {
    maps: BTreeMap<MapId, (StoredMap, LoadedMap)>,
    last: u32,
    commits: u64,
    failure: Option<String>,
    fail_commit: Option<String>,
    fail_load: Option<String>,
    delay: Duration,
}

impl State {
    fn writable(&self) -> Result<(), StoreError> {
        self.failure.as_ref().map_or(Ok(()), |reason| Err(StoreError::FailStop(reason.clone())))
    }

    fn map(&mut self, id: MapId) -> Result<&mut (StoredMap, LoadedMap), StoreError> {
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
        let mut maps: Vec<StoredMap> = lock(&self.state).maps.values().map(|(stored, _)| stored.clone()).collect();
        maps.sort_by(|a, b| a.name.cmp(&b.name));
        Ok(maps)
    }

    fn create(&self, name: &MapName, config: &MapConfig, created: f64) -> Result<MapId, StoreError> {
        let mut state = lock(&self.state);
        state.writable()?;
        if state.maps.values().any(|(stored, _)| stored.name == *name) {
            return Err(StoreError::Exists(name.clone()));
        }
        let next = state.last.checked_add(1);
        state.last = next.ok_or_else(|| StoreError::Refused("no map numbers are left".to_owned()))?;
        let id = MapId(state.last);
        let stored = StoredMap { id, name: name.clone(), config: config.clone(), revision: 0, created };
        let tree = OccupancyTree::new(config.grid().depth(), config.scale());
        state.maps.insert(id, (stored, LoadedMap { revision: 0, tree, windows: BTreeMap::new() }));
        Ok(id)
    }

    fn update_config(&self, id: MapId, config: &MapConfig) -> Result<(), StoreError> {
        let mut state = lock(&self.state);
        state.writable()?;
        let (stored, _) = state.map(id)?;
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
        let (_, map) = state.map(id)?;
        let map = map.clone();
        state.fail_load.take().map_or(Ok(map), |what| Err(StoreError::Damaged { what }))
    }

    fn commit(&self, id: MapId, commit: &Commit) -> Result<(), StoreError> {
        let delay = lock(&self.state).delay;
        if !delay.is_zero() {
            std::thread::sleep(delay);
        }
        let mut state = lock(&self.state);
        state.writable()?;
        let (stored, map) = state.map(id)?;
        check_commit(stored, commit)?;
        let mut tree = map.tree.clone();
        for (address, view) in &commit.blocks {
            tree.set_block(*address, view.clone());
        }
        if let Some(reason) = state.fail_commit.take() {
            state.failure = Some(reason.clone());
            return Err(StoreError::FailStop(reason));
        }
        let (stored, map) = state.map(id)?;
        stored.revision = commit.revision;
        map.revision = commit.revision;
        map.tree = tree;
        map.windows.extend(commit.windows.iter().cloned());
        state.commits += 1;
        Ok(())
    }

    fn failure(&self) -> Option<String> {
        lock(&self.state).failure.clone()
    }
}

//! Maps on disk, in sled: one tree for all maps, so that a commit is one atomic batch.
//!
//! What is durable: sled's `flush` hands the log to the operating system, and the data file is synced after it; only
//! then is a call answered. After a failed write nothing is written any more, and reads show what was durable before.

use super::checks::check_commit;
use super::config_record::{Counts, FixedConfig, MapRecord, encode_sensor};
use super::copies;
use super::durability::Syncer;
use super::keys::{self, Kind};
use super::record;
use super::sled_catalogue::{Catalogue, Entry, next_map};
use super::sled_generations::{bytes_in, is_in, remove_others};
use super::sled_open::{SledOptions, guarded, io, open_directory};
use super::sled_records::{Blocks, Records};
use super::sled_rewrite::{Rewriter, Rewritten, Watch};
use super::sled_upkeep::Upkeep;
use super::sled_writes::{Change, Sink, Writes};
use super::{
    BlockStamps, Commit, DamagedMap, Difference, LoadedMap, MapId, MapName, MapStore, OpenMap, SnapshotName,
    StoreError, StoreStatistics, StoredMap, StoredSnapshot, lock,
};
use crate::mapping::MapConfig;
use crate::quadtree::{BlockCache, BlockPager, OccupancyTree, PagedTree};
use sled::IVec;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex};

/// Records removed in one batch while a deleted map is cleared away.
const PURGE_BATCH: usize = 1000;

/// A store in a directory. One process may have it open at a time. A thread of its own has the database rewritten when it
/// has grown beyond its limit.
pub struct SledStore {
    /// Ended first.
    _upkeep: Upkeep,
    rewriter: Arc<Rewriter>,
    writes: Arc<Writes>,
    pub(super) catalogue: Mutex<Catalogue>,
    /// The number of the next map; held while maps are created and deleted.
    pub(super) next_map: Mutex<u32>,
    pub(super) directory: PathBuf,
    /// Of which snapshot each map's copy is; held while copies are written.
    pub(super) copied: Mutex<BTreeMap<MapId, StoredSnapshot>>,
    pub(super) records: Arc<Records>,
}

/// What belongs to a map beside the records that its tombstone replaces.
const PURGED: [Kind; 8] = [
    Kind::Block,
    Kind::Group,
    Kind::Window,
    Kind::Sensor,
    Kind::Snapshot,
    Kind::KeptBlock,
    Kind::KeptWindow,
    Kind::Sweep,
];

impl std::fmt::Debug for SledStore {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("SledStore").field("maps", &lock(&self.catalogue).maps.len()).finish_non_exhaustive()
    }
}

impl SledStore {
    /// Opens the store in a directory; makes an empty one where there is none. What is left of maps that were being
    /// deleted is cleared away.
    ///
    /// # Errors
    /// [`StoreError::Locked`], [`StoreError::NoStore`], [`StoreError::NewerFormat`], [`StoreError::Damaged`],
    /// [`StoreError::Io`]; the directory is left as it is. Damage of single maps is no error: see
    /// [`MapStore::damaged`].
    pub fn open(directory: &Path, options: SledOptions) -> Result<Self, StoreError> {
        Self::open_with(directory, options, |syncer| syncer)
    }

    /// True when there is a database in the directory, whether or not it opens.
    ///
    /// # Errors
    /// [`StoreError::Io`] when that cannot be seen.
    pub fn is_in(directory: &Path) -> Result<bool, StoreError> {
        is_in(directory)
    }

    /// As [`SledStore::open`], with the sync of the data file replaced: for tests that count, delay or fail it.
    ///
    /// # Errors
    /// As [`SledStore::open`].
    pub fn open_with(
        directory: &Path,
        options: SledOptions,
        wrap: impl Fn(Box<dyn Syncer>) -> Box<dyn Syncer> + Send + Sync + 'static,
    ) -> Result<Self, StoreError> {
        Self::opened(directory, options, wrap).map_err(|error| copies::offer(directory, error))
    }

    fn opened(
        directory: &Path,
        options: SledOptions,
        wrap: impl Fn(Box<dyn Syncer>) -> Box<dyn Syncer> + Send + Sync + 'static,
    ) -> Result<Self, StoreError> {
        let opened = open_directory(directory, options)?;
        let generation = opened.generation;
        let catalogue = Catalogue::read(&opened.db)?;
        let mut next = next_map(&opened.db)?;
        if let Some((last, _)) = catalogue.maps.last_key_value() {
            next = next.max(last.0.saturating_add(1));
        }
        // It has opened well. Beside a damaged one, what may be its older self is kept.
        remove_others(directory, generation, !catalogue.damaged.is_empty());
        let data = generation.path(directory).join("db").display().to_string();
        let db = Arc::new(opened.db);
        let records = Arc::new(Records::new(Arc::clone(&db), opened.lock));
        let sink = Sink { db, syncer: wrap(opened.syncer), data, mark: opened.mark };
        let writes = Arc::new(Writes::start(Arc::clone(&records), sink, opened.last_write, opened.states)?);
        let rewriter = Rewriter::new(directory, options, Box::new(wrap), generation, Arc::clone(&writes));
        let rewriter = Arc::new(rewriter);
        let upkeep = Upkeep::start(Arc::clone(&rewriter), options.rewrite.check)
            .map_err(|source| StoreError::Io { what: "starting the thread of the upkeep".to_owned(), source })?;
        let store = Self {
            _upkeep: upkeep,
            rewriter,
            writes,
            catalogue: Mutex::new(catalogue),
            next_map: Mutex::new(next),
            directory: directory.to_owned(),
            copied: Mutex::default(),
            records,
        };
        store.finish_deletions()?;
        Ok(store)
    }

    /// Rewrites the database into a new directory, whatever its size; the store goes on meanwhile. `watch` is told how far
    /// it has come.
    ///
    /// # Errors
    /// When something fails, or `watch` does: the database stays as it was. Only when it cannot be known which of the two
    /// would be opened after a crash does the store take no more writes.
    pub fn rewrite(&self, watch: &mut Watch<'_>) -> Result<Rewritten, StoreError> {
        self.rewriter.rewrite(watch)
    }

    /// About how many records the store holds: for showing how far long work is.
    #[must_use]
    pub fn about_records(&self) -> u64 {
        let of_map = |counts: &Counts| counts.blocks + counts.windows + counts.sensors + 3;
        lock(&self.catalogue).maps.values().map(|entry| of_map(&entry.counts)).sum()
    }

    /// Bytes of the store's files.
    ///
    /// # Errors
    /// When the directory cannot be read.
    pub fn disk_bytes(&self) -> Result<u64, StoreError> {
        bytes_in(&self.directory).map_err(|source| io(&self.directory, "measuring", source))
    }

    pub(super) fn writable(&self) -> Result<(), StoreError> {
        self.writes.writable()
    }

    /// The map as it is, and its lock: to be taken, and the entry then read again.
    pub(super) fn busy(&self, id: MapId) -> Result<Arc<Mutex<()>>, StoreError> {
        self.entry(id).map(|entry| entry.busy)
    }

    pub(super) fn entry(&self, id: MapId) -> Result<Entry, StoreError> {
        let catalogue = lock(&self.catalogue);
        if let Some(damage) = catalogue.damaged.iter().find(|damage| damage.id == Some(id)) {
            return Err(StoreError::Damaged { what: damage.what.clone() });
        }
        catalogue.maps.get(&id).cloned().ok_or(StoreError::NoMap(id))
    }

    /// Refuses a name that a map has. Creation must be held.
    pub(super) fn name_is_free(&self, name: &MapName) -> Result<(), StoreError> {
        match lock(&self.catalogue).find(name) {
            None => Ok(()),
            Some(Ok(_)) => Err(StoreError::Exists(name.clone())),
            Some(Err(damage)) => Err(StoreError::Damaged { what: damage.what.clone() }),
        }
    }

    pub(super) fn change(&self, key: Vec<u8>, value: Option<Vec<u8>>) -> Result<Change, StoreError> {
        let db = self.records.db();
        let before = guarded("reading what is to be changed", || db.get(&key))?;
        Ok(Change { key, value, before })
    }

    pub(super) fn put(&self, key: Vec<u8>, revision: u64, content: &[u8]) -> Result<Change, StoreError> {
        let value = record::seal(&key, revision, content);
        self.change(key, Some(value))
    }

    /// Writes all of the changes or none: see [`Writes::write`].
    pub(super) fn write(&self, changes: Vec<Change>) -> Result<(), StoreError> {
        self.writes.write(changes)
    }

    /// The changes from one set of sensors to another.
    pub(super) fn sensor_changes(
        &self,
        id: MapId,
        old: Option<&MapConfig>,
        new: &MapConfig,
    ) -> Result<Vec<Change>, StoreError> {
        let key = |name: &String| keys::named(Kind::Sensor, id, name);
        let mut changes = Vec::new();
        for (name, sensor) in new.sensors() {
            let mut content = Vec::new();
            encode_sensor(sensor, &mut content);
            changes.push(self.put(key(name), 0, &content)?);
        }
        for name in old.iter().flat_map(|old| old.sensors().keys()) {
            if !new.sensors().contains_key(name) {
                changes.push(self.change(key(name), None)?);
            }
        }
        Ok(changes)
    }

    /// Clears away what is left of maps and snapshots whose deletion was decided but not finished.
    fn finish_deletions(&self) -> Result<(), StoreError> {
        let mut left = Vec::new();
        self.records.scan(&[Kind::Tombstone as u8], &mut |key, _| {
            left.extend(keys::map_of(key));
            Ok(())
        })?;
        for id in left {
            // What cannot be read or removed now keeps its tombstone: it is no reason not to serve the others.
            if let Err(error) = self.purge(id) {
                tracing::warn!(map = id.0, "records of a deleted map are left: {error}");
            }
        }
        let mut marked = Vec::new();
        self.records.scan(&[Kind::Sweep as u8], &mut |key, _| {
            marked.extend(keys::map_of(key));
            Ok(())
        })?;
        for id in marked {
            // A map that cannot be read now keeps its mark.
            if let Err(error) = self.sweep(id) {
                tracing::warn!(map = id.0, "what its snapshots no longer need is left: {error}");
            }
        }
        Ok(())
    }

    /// Removes the records of a map that has a tombstone, and the tombstone last.
    pub(super) fn purge(&self, id: MapId) -> Result<(), StoreError> {
        for kind in PURGED {
            let prefix = keys::of_map(kind, id);
            loop {
                let db = self.records.db();
                let found: Vec<(IVec, IVec)> =
                    guarded("reading what is to be removed", || db.scan_prefix(&prefix).take(PURGE_BATCH).collect())?;
                drop(db);
                if found.is_empty() {
                    break;
                }
                // What was there counts for the size alone: the map is deleted already.
                let remove =
                    |(key, value): (IVec, IVec)| Change { key: key.to_vec(), value: None, before: Some(value) };
                self.write(found.into_iter().map(remove).collect())?;
            }
        }
        self.write(vec![self.change(keys::of_map(Kind::Tombstone, id), None)?])
    }
}

/// Takes changes of sensors into a map's state.
pub(super) fn note_sensors(counts: &mut Counts, changes: &[Change]) {
    for change in changes {
        change.before.iter().for_each(|value| counts.sensor_digest.toggle_record(value));
        change.value.iter().for_each(|value| counts.sensor_digest.toggle_record(value));
    }
}

impl MapStore for SledStore {
    fn list(&self) -> Result<Vec<StoredMap>, StoreError> {
        let mut maps: Vec<StoredMap> = lock(&self.catalogue).maps.values().map(|entry| entry.stored.clone()).collect();
        maps.sort_by(|a, b| a.name.cmp(&b.name));
        Ok(maps)
    }

    fn create(&self, name: &MapName, config: &MapConfig, created: f64) -> Result<MapId, StoreError> {
        let mut next = lock(&self.next_map);
        self.writable()?;
        self.name_is_free(name)?;
        let id = MapId(*next);
        let after = next.checked_add(1).ok_or_else(|| StoreError::Refused("no map numbers are left".to_owned()))?;
        let record = MapRecord { name: name.clone(), created, fixed: FixedConfig::of(config) };
        let mut counts = Counts { sensors: config.sensors().len() as u64, ..Counts::default() };
        let mut changes = self.sensor_changes(id, None, config)?;
        note_sensors(&mut counts, &changes);
        changes.push(self.put(keys::NEXT_MAP.to_vec(), 0, &after.to_be_bytes())?);
        changes.push(self.put(keys::name(name.as_str()), 0, &id.0.to_be_bytes())?);
        changes.push(self.put(keys::of_map(Kind::Map, id), 0, &record.encode())?);
        changes.push(self.put(keys::of_map(Kind::State, id), 0, &counts.encode())?);
        self.write(changes)?;
        *next = after;
        let stored = StoredMap { id, name: name.clone(), config: config.clone(), revision: 0, created };
        lock(&self.catalogue).maps.insert(id, Entry::new(stored, counts));
        Ok(id)
    }

    fn update_config(&self, id: MapId, config: &MapConfig) -> Result<(), StoreError> {
        let busy = self.busy(id)?;
        let _held = lock(&busy);
        let entry = self.entry(id)?;
        if FixedConfig::of(config) != FixedConfig::of(&entry.stored.config) {
            return Err(StoreError::Refused("only the sensors of a map can change".to_owned()));
        }
        let mut counts = Counts { sensors: config.sensors().len() as u64, ..entry.counts };
        let mut changes = self.sensor_changes(id, Some(&entry.stored.config), config)?;
        note_sensors(&mut counts, &changes);
        changes.push(self.put(keys::of_map(Kind::State, id), entry.stored.revision, &counts.encode())?);
        self.write(changes)?;
        if let Some(entry) = lock(&self.catalogue).maps.get_mut(&id) {
            entry.counts = counts;
            entry.stored.config = config.clone();
        }
        Ok(())
    }

    fn delete(&self, id: MapId) -> Result<(), StoreError> {
        let creation = lock(&self.next_map);
        let damage = lock(&self.catalogue).damaged.iter().find(|damage| damage.id == Some(id)).cloned();
        let (name, busy) = match damage {
            Some(damage) => (damage.name, Arc::default()),
            None => self.entry(id).map(|entry| (Some(entry.stored.name), entry.busy))?,
        };
        let _held = lock(&busy);
        let mut changes = Vec::new();
        changes.extend(name.as_ref().map(|name| self.change(keys::name(name.as_str()), None)).transpose()?);
        changes.push(self.change(keys::of_map(Kind::Map, id), None)?);
        changes.push(self.change(keys::of_map(Kind::State, id), None)?);
        changes.push(self.put(keys::of_map(Kind::Tombstone, id), 0, &[])?);
        self.write(changes)?;
        let mut catalogue = lock(&self.catalogue);
        catalogue.maps.remove(&id);
        catalogue.damaged.retain(|damage| damage.id != Some(id));
        drop(catalogue);
        // While creation is held: it is not that of a later map of the name.
        if let Some(name) = name {
            copies::remove(&self.directory, &name);
        }
        drop(creation);
        if let Err(error) = self.purge(id) {
            // The map is deleted: the rest goes when the store is opened next.
            tracing::warn!(map = id.0, "records of a deleted map are left: {error}");
        }
        Ok(())
    }

    fn load(&self, id: MapId) -> Result<LoadedMap, StoreError> {
        let busy = self.busy(id)?;
        let _held = lock(&busy);
        let entry = self.entry(id)?;
        let grid = entry.stored.config.grid();
        let mut tree = OccupancyTree::new(grid.depth(), entry.stored.config.scale());
        let blocks = self.records.read_blocks(&entry, &mut |tag, view| tree.set_block(tag.address, view))?;
        entry.check_blocks(&blocks)?;
        let windows = self.records.read_windows(&entry, blocks.len() as u64)?;
        self.records.check_groups(&entry, &blocks)?;
        Ok(LoadedMap { revision: entry.stored.revision, tree, windows })
    }

    fn open(&self, id: MapId, cache: &Arc<BlockCache>) -> Result<OpenMap, StoreError> {
        let busy = self.busy(id)?;
        let _held = lock(&busy);
        let entry = self.entry(id)?;
        let codec = entry.codec();
        let blocks = Blocks { records: Arc::clone(&self.records), id, codec };
        let pager = Arc::new(BlockPager::new(Box::new(blocks), Arc::clone(cache)));
        let mut tree = PagedTree::new(entry.stored.config.grid().depth(), entry.stored.config.scale());
        let known = self.records.known_blocks(&entry)?;
        let windows = self.records.read_windows(&entry, known.len() as u64)?;
        let mut stamps = BlockStamps::new(entry.counts.complete_from);
        for (address, known) in known {
            stamps.set(address, known.stamp);
            if known.mixed {
                tree.place_stored(known.tag(address), &pager);
            } else {
                tree.place_uniform(address, known.max);
            }
        }
        Ok(OpenMap { revision: entry.stored.revision, tree, pager: Some(pager), windows, stamps })
    }

    fn commit(&self, id: MapId, commit: &Commit) -> Result<(), StoreError> {
        let busy = self.busy(id)?;
        let _held = lock(&busy);
        self.writable()?;
        let entry = self.entry(id)?;
        check_commit(&entry.stored, commit)?;
        let (changes, counts) = self.commit_changes(&entry, commit)?;
        self.write(changes)?;
        if let Some(entry) = lock(&self.catalogue).maps.get_mut(&id) {
            entry.stored.revision = commit.revision;
            entry.counts = counts;
        }
        Ok(())
    }

    fn import(
        &self,
        name: &MapName,
        config: &MapConfig,
        created: f64,
        contents: &LoadedMap,
    ) -> Result<MapId, StoreError> {
        self.import_map(name, config, created, contents)
    }

    fn snapshots(&self, id: MapId) -> Result<Vec<StoredSnapshot>, StoreError> {
        Ok(self.entry(id)?.snapshots.values().map(|snapshot| snapshot.stored.clone()).collect())
    }

    fn take_snapshot(&self, id: MapId, name: &SnapshotName, created: f64) -> Result<StoredSnapshot, StoreError> {
        self.store_snapshot(id, name, created)
    }

    fn delete_snapshot(&self, id: MapId, name: &SnapshotName) -> Result<(), StoreError> {
        self.remove_snapshot(id, name)
    }

    fn load_snapshot(&self, id: MapId, name: &SnapshotName) -> Result<LoadedMap, StoreError> {
        self.read_snapshot(id, name)
    }

    fn difference(&self, id: MapId, name: &SnapshotName) -> Result<Difference, StoreError> {
        self.difference_to(id, name)
    }

    fn keep_copy(&self, id: MapId) -> Result<(), StoreError> {
        self.copy_last_snapshot(id)
    }

    fn failure(&self) -> Option<String> {
        self.writes.failure()
    }

    fn statistics(&self) -> Option<StoreStatistics> {
        Some(self.rewriter.statistics())
    }

    fn damaged(&self) -> Vec<DamagedMap> {
        lock(&self.catalogue).damaged.clone()
    }
}

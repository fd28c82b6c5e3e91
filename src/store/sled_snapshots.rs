//! Snapshots of a store on disk: one record each, and the records that commits since have replaced.

use super::checks::holds;
use super::config_record::{SnapshotRecord, decode_block};
use super::groups::Known;
use super::keys::{self, Kind};
use super::record::{self, damaged};
use super::sled_catalogue::{Entry, Snapshot, StoredWindow, open_window, read_window};
use super::sled_open::guarded;
use super::sled_records::Visit;
use super::sled_store::SledStore;
use super::{
    Difference, LoadedMap, MapId, RobotName, SequenceWindow, SnapshotName, StoreError, StoredMap, StoredSnapshot,
    copies, lock,
};
use crate::quadtree::{BlockAddress, BlockView, OccupancyTree};
use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

/// Kept records that are removed in one batch, so that commits come between.
const SWEEP_BATCH: usize = 500;

/// Blocks of a snapshot that are read at once, so that commits come between.
const READ_BATCH: usize = 256;

/// The blocks in which a snapshot differs from its map.
struct SnapshotBlocks {
    /// Those that were replaced, by Morton code.
    kept: BTreeMap<u64, BlockView>,
    /// Those that the map has in another form or did not have then.
    later: Vec<BlockAddress>,
}

/// The windows of a snapshot, and the robots whose windows changed since.
struct SnapshotWindows {
    windows: BTreeMap<RobotName, SequenceWindow>,
    later: BTreeSet<RobotName>,
}

impl SledStore {
    pub(super) fn store_snapshot(
        &self,
        id: MapId,
        name: &SnapshotName,
        created: f64,
    ) -> Result<StoredSnapshot, StoreError> {
        let busy = self.busy(id)?;
        let _held = lock(&busy);
        self.writable()?;
        let entry = self.entry(id)?;
        let key = keys::named(Kind::Snapshot, id, name.as_str());
        let revision = entry.stored.revision;
        let record = SnapshotRecord { created, blocks: entry.counts.blocks, windows: entry.counts.windows };
        let change = self.put(key, revision, &record.encode())?;
        // A record that cannot be read has the name as well.
        if change.before.is_some() {
            return Err(StoreError::SnapshotExists(name.clone()));
        }
        let mut counts = entry.counts;
        counts.snapshots += 1;
        let state = self.put(keys::of_map(Kind::State, id), revision, &counts.encode())?;
        self.write(vec![change, state])?;
        let stored = StoredSnapshot { name: name.clone(), revision, created };
        if let Some(entry) = lock(&self.catalogue).maps.get_mut(&id) {
            entry.counts = counts;
            Arc::make_mut(&mut entry.snapshots).insert(name.clone(), Snapshot { stored: stored.clone(), record });
        }
        Ok(stored)
    }

    pub(super) fn remove_snapshot(&self, id: MapId, name: &SnapshotName) -> Result<(), StoreError> {
        {
            let busy = self.busy(id)?;
            let _held = lock(&busy);
            self.writable()?;
            let entry = self.entry(id)?;
            let change = self.change(keys::named(Kind::Snapshot, id, name.as_str()), None)?;
            if change.before.is_none() {
                return Err(StoreError::NoSnapshot(name.clone()));
            }
            let mut counts = entry.counts;
            counts.snapshots = counts.snapshots.saturating_sub(1);
            let state = self.put(keys::of_map(Kind::State, id), entry.stored.revision, &counts.encode())?;
            let mark = self.put(keys::of_map(Kind::Sweep, id), 0, &[])?;
            self.write(vec![change, state, mark])?;
            if let Some(entry) = lock(&self.catalogue).maps.get_mut(&id) {
                entry.counts = counts;
                Arc::make_mut(&mut entry.snapshots).remove(name);
            }
        }
        if let Err(error) = self.sweep(id) {
            // The snapshot is deleted: the rest goes when the store is opened next.
            tracing::warn!(map = id.0, "what a deleted snapshot kept is left: {error}");
        }
        Ok(())
    }

    /// Removes the kept records that no snapshot needs, and then the mark that there may be some.
    pub(super) fn sweep(&self, id: MapId) -> Result<(), StoreError> {
        let busy = self.busy(id)?;
        let mut unneeded = {
            let _held = lock(&busy);
            self.unneeded(&self.entry(id)?)?
        };
        loop {
            // What no snapshot needs now, none will: they are of the revisions to come.
            let rest = unneeded.split_off(SWEEP_BATCH.min(unneeded.len()));
            let _held = lock(&busy);
            let entry = self.entry(id)?;
            let mut counts = entry.counts;
            let mut changes = Vec::with_capacity(unneeded.len() + 2);
            for key in unneeded {
                let change = self.change(key, None)?;
                counts.kept = counts.kept.saturating_sub(u64::from(change.before.is_some()));
                changes.push(change);
            }
            if rest.is_empty() {
                changes.push(self.change(keys::of_map(Kind::Sweep, id), None)?);
            }
            changes.push(self.put(keys::of_map(Kind::State, id), entry.stored.revision, &counts.encode())?);
            self.write(changes)?;
            if let Some(entry) = lock(&self.catalogue).maps.get_mut(&id) {
                entry.counts = counts;
            }
            if rest.is_empty() {
                return Ok(());
            }
            unneeded = rest;
        }
    }

    /// Keys of the kept records of a map that no snapshot needs. One that is damaged stays: it is reported.
    fn unneeded(&self, entry: &Entry) -> Result<Vec<Vec<u8>>, StoreError> {
        let needed: BTreeSet<u64> = entry.snapshots.values().map(|snapshot| snapshot.stored.revision).collect();
        let mut unneeded = Vec::new();
        for kind in [Kind::KeptBlock, Kind::KeptWindow] {
            self.records.scan(&keys::of_map(kind, entry.stored.id), &mut |key, value| {
                if let (Ok(record), Some(replaced)) = (record::open(key, kind, value), keys::replaced_of(key))
                    && needed.range(record.revision..replaced.max(record.revision)).next().is_none()
                {
                    unneeded.push(key.to_vec());
                }
                Ok(())
            })?;
        }
        Ok(unneeded)
    }

    /// Reads a snapshot while commits go on: what they replace meanwhile is found among what they keep.
    pub(super) fn read_snapshot(&self, id: MapId, name: &SnapshotName) -> Result<LoadedMap, StoreError> {
        let busy = self.busy(id)?;
        let (entry, snapshot, windows, shared) = {
            let _held = lock(&busy);
            let entry = self.entry(id)?;
            let snapshot = snapshot_of(&entry, name)?.clone();
            let windows = self.snapshot_windows(&entry, &snapshot)?.windows;
            let at = snapshot.stored.revision;
            let known = self.records.known_blocks(&entry)?.into_iter();
            let shared: Vec<_> = known.filter(|(_, known)| known.stamp.revision <= at).collect();
            (entry, snapshot, windows, shared)
        };
        let read = || {
            let mut kept = self.kept_blocks_at(&entry, snapshot.stored.revision)?;
            let mut tree = OccupancyTree::new(entry.stored.config.grid().depth(), entry.stored.config.scale());
            let mut found = 0;
            for some in shared.chunks(READ_BATCH) {
                let _held = lock(&busy);
                for (address, known) in some {
                    if !kept.contains_key(&address.morton()) {
                        tree.set_block(*address, self.block_at(&entry, *address, known, snapshot.stored.revision)?);
                        found += 1;
                    }
                }
            }
            found += kept.len() as u64;
            while let Some((code, view)) = kept.pop_first() {
                tree.set_block(BlockAddress::from_morton(code), view);
            }
            complete(&entry, &snapshot, "blocks", found, snapshot.record.blocks)?;
            Ok(tree)
        };
        // One that was deleted meanwhile has lost its blocks.
        let tree = read().or_else(|error| snapshot_of(&self.entry(id)?, name).map(|_| ()).and(Err(error)))?;
        Ok(LoadedMap { revision: snapshot.stored.revision, tree, windows })
    }

    /// Writes the last snapshot of a map as a file, unless the file is of it.
    pub(super) fn copy_last_snapshot(&self, id: MapId) -> Result<(), StoreError> {
        let mut copied = lock(&self.copied);
        let snapshots = self.entry(id)?.snapshots;
        let last = snapshots.values().map(|snapshot| &snapshot.stored).max_by_key(|stored| stored.revision);
        let Some(last) = last.filter(|last| copied.get(&id) != Some(*last)) else { return Ok(()) };
        let map = self.read_snapshot(id, &last.name)?;
        // Its deletion waits until the copy is there, and then removes it.
        let _deletion = lock(&self.next_map);
        let StoredMap { name, config, .. } = self.entry(id)?.stored;
        copies::keep(&self.directory, &name, &config, &map)?;
        copied.insert(id, last.clone());
        Ok(())
    }

    /// A block as a revision had it, of which it was known then. The map must be held.
    fn block_at(&self, entry: &Entry, address: BlockAddress, known: &Known, at: u64) -> Result<BlockView, StoreError> {
        let (id, codec) = (entry.stored.id, entry.codec());
        let own = keys::block(id, address);
        let value = self.records.get(&own)?.ok_or_else(|| damaged(&own, "missing"))?;
        let mut found = (own, Kind::Block, value);
        if record::open(&found.0, found.1, &found.2)?.revision > at {
            // Replaced since it was looked for: the first that was replaced after the revision is what it had.
            let from = keys::kept_block(id, address, at + 1);
            let to = keys::kept_block(id, address, u64::MAX);
            let db = self.records.db();
            let kept = guarded("reading a kept block", || db.range(from.clone()..=to).next().transpose())?;
            let (key, value) = kept.ok_or_else(|| damaged(&from, "missing"))?;
            found = (key.to_vec(), Kind::KeptBlock, value);
        }
        let (key, kind, value) = found;
        let record = record::open(&key, kind, &value)?;
        let (_, view) = decode_block(&codec, &record).map_err(|why| damaged(&key, &why.to_string()))?;
        if record.revision != known.stamp.revision || Known::of(&view, known.stamp) != *known {
            return Err(damaged(&key, "another block than the map's"));
        }
        Ok(view)
    }

    pub(super) fn difference_to(&self, id: MapId, name: &SnapshotName) -> Result<Difference, StoreError> {
        let busy = self.busy(id)?;
        let _held = lock(&busy);
        let entry = self.entry(id)?;
        let snapshot = snapshot_of(&entry, name)?;
        let SnapshotBlocks { mut kept, later, .. } = self.snapshot_blocks(&entry, snapshot)?;
        // A block that the map did not have then was unknown throughout.
        let unknown = BlockView::Uniform(entry.stored.config.scale().unknown());
        let before =
            |address: BlockAddress| (address, kept.remove(&address.morton()).unwrap_or_else(|| unknown.clone()));
        let blocks = later.into_iter().map(before).collect();
        let SnapshotWindows { windows, later } = self.snapshot_windows(&entry, snapshot)?;
        let before = |robot: RobotName| {
            let window = windows.get(&robot).cloned().unwrap_or_default();
            (robot, window)
        };
        let windows = later.into_iter().map(before).collect();
        Ok(Difference { revision: snapshot.stored.revision, blocks, windows })
    }

    /// The kept blocks that a revision had, by Morton code.
    fn kept_blocks_at(&self, entry: &Entry, at: u64) -> Result<BTreeMap<u64, BlockView>, StoreError> {
        let codec = entry.codec();
        let mut kept = BTreeMap::new();
        self.kept_at(entry, Kind::KeptBlock, at, &mut |key, value| {
            let address = keys::kept_block_of(key).filter(|address| holds(entry.stored.config.grid(), *address));
            let address = address.ok_or_else(|| damaged(key, "outside the map"))?;
            let record = record::open(key, Kind::KeptBlock, value)?;
            let (_, view) = decode_block(&codec, &record).map_err(|why| damaged(key, &why.to_string()))?;
            kept.insert(address.morton(), view);
            Ok(())
        })?;
        Ok(kept)
    }

    /// The map must be held.
    fn snapshot_blocks(&self, entry: &Entry, snapshot: &Snapshot) -> Result<SnapshotBlocks, StoreError> {
        let at = snapshot.stored.revision;
        let kept = self.kept_blocks_at(entry, at)?;
        let (shared, later): (Vec<_>, Vec<_>) =
            self.records.known_blocks(entry)?.into_iter().partition(|(_, known)| known.stamp.revision <= at);
        let later: Vec<BlockAddress> = later.into_iter().map(|(address, _)| address).collect();
        let found = (shared.len() + kept.len()) as u64;
        complete(entry, snapshot, "blocks", found, snapshot.record.blocks)?;
        Ok(SnapshotBlocks { kept, later })
    }

    fn snapshot_windows(&self, entry: &Entry, snapshot: &Snapshot) -> Result<SnapshotWindows, StoreError> {
        let (id, at) = (entry.stored.id, snapshot.stored.revision);
        let mut found = SnapshotWindows { windows: BTreeMap::new(), later: BTreeSet::new() };
        self.records.scan(&keys::of_map(Kind::Window, id), &mut |key, value| {
            let (robot, StoredWindow { revision, window }) = read_window(key, value, entry.stored.revision)?;
            if revision <= at {
                found.windows.insert(robot, window);
            } else {
                found.later.insert(robot);
            }
            Ok(())
        })?;
        self.kept_at(entry, Kind::KeptWindow, at, &mut |key, value| {
            let robot = keys::kept_robot_of(key).and_then(|robot| RobotName::new(robot).ok());
            let robot = robot.ok_or_else(|| damaged(key, "not a robot's name"))?;
            let window = open_window(key, Kind::KeptWindow, value)?.window;
            // Its window may have been removed since.
            found.later.insert(robot.clone());
            found.windows.insert(robot, window);
            Ok(())
        })?;
        complete(entry, snapshot, "windows", found.windows.len() as u64, snapshot.record.windows)?;
        Ok(found)
    }

    /// Visits the kept records of a map that a revision had.
    fn kept_at(&self, entry: &Entry, kind: Kind, at: u64, visit: &mut Visit<'_>) -> Result<(), StoreError> {
        self.records.scan(&keys::of_map(kind, entry.stored.id), &mut |key, value| {
            let replaced = keys::replaced_of(key).ok_or_else(|| damaged(key, "no revision in its key"))?;
            if replaced <= at {
                return Ok(());
            }
            if record::open(key, kind, value)?.revision <= at { visit(key, value) } else { Ok(()) }
        })
    }

    /// What is wrong with the snapshots and kept records of a map, beyond single records.
    pub(super) fn check_snapshots(&self, entry: &Entry) -> Result<Vec<String>, StoreError> {
        let id = entry.stored.id;
        let mut problems = Vec::new();
        let known = self.records.known_blocks(entry)?.into_iter().map(|(_, known)| known.stamp.revision).collect();
        let mut windows = Vec::new();
        self.records.scan(&keys::of_map(Kind::Window, id), &mut |key, value| {
            windows.push(read_window(key, value, entry.stored.revision)?.1.revision);
            Ok(())
        })?;
        let blocks = self.lives(entry, Kind::KeptBlock, known)?;
        let windows = self.lives(entry, Kind::KeptWindow, windows)?;
        for snapshot in entry.snapshots.values() {
            let Snapshot { stored, record } = snapshot;
            for (what, lives, expected) in [("blocks", &blocks, record.blocks), ("windows", &windows, record.windows)] {
                let checked = complete(entry, snapshot, what, lives.at(stored.revision), expected);
                problems.extend(checked.err().map(|error| error.to_string()));
            }
        }
        let mut snapshots = 0;
        self.records.scan(&keys::of_map(Kind::Snapshot, id), &mut |_, _| {
            snapshots += 1;
            Ok(())
        })?;
        let kept = (blocks.ends.len() + windows.ends.len()) as u64;
        let counts = &entry.counts;
        for (what, found, expected) in [("snapshots", snapshots, counts.snapshots), ("kept records", kept, counts.kept)]
        {
            if found != expected {
                let why = format!("{found} {what} found of {expected}");
                problems.push(damaged(&keys::of_map(Kind::State, id), &why).to_string());
            }
        }
        Ok(problems)
    }

    /// When the records of one kind came and went: those that the map has came at `begins`.
    fn lives(&self, entry: &Entry, kept: Kind, mut begins: Vec<u64>) -> Result<Lives, StoreError> {
        let mut ends = Vec::new();
        self.records.scan(&keys::of_map(kept, entry.stored.id), &mut |key, value| {
            begins.push(record::open(key, kept, value)?.revision);
            ends.push(keys::replaced_of(key).ok_or_else(|| damaged(key, "no revision in its key"))?);
            Ok(())
        })?;
        begins.sort_unstable();
        ends.sort_unstable();
        Ok(Lives { begins, ends })
    }
}

/// The revisions at which records came and went, each in ascending order.
struct Lives {
    begins: Vec<u64>,
    ends: Vec<u64>,
}

impl Lives {
    /// How many records a revision had.
    fn at(&self, revision: u64) -> u64 {
        let until = |sorted: &[u64]| sorted.partition_point(|at| *at <= revision) as u64;
        until(&self.begins).saturating_sub(until(&self.ends))
    }
}

fn snapshot_of<'e>(entry: &'e Entry, name: &SnapshotName) -> Result<&'e Snapshot, StoreError> {
    entry.snapshots.get(name).ok_or_else(|| StoreError::NoSnapshot(name.clone()))
}

fn complete(entry: &Entry, snapshot: &Snapshot, what: &str, found: u64, expected: u64) -> Result<(), StoreError> {
    if found == expected {
        return Ok(());
    }
    let key = keys::named(Kind::Snapshot, entry.stored.id, snapshot.stored.name.as_str());
    Err(damaged(&key, &format!("{found} {what} found of {expected}")))
}

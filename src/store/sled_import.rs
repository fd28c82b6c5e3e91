//! A map that comes with contents: written under a number that no name leads to, and named in the last batch.
//!
//! Until then it has a tombstone, so what a crash leaves of it is cleared away as what is left of a deleted map is.

use super::checks::check_contents;
use super::config_record::{Counts, FixedConfig, MapRecord, encode_block, encode_window};
use super::groups::{Group, Known, group_of};
use super::keys::{self, Kind};
use super::sled_catalogue::Entry;
use super::sled_store::{SledStore, note_sensors};
use super::sled_writes::Change;
use super::{BlockStamp, LoadedMap, MapId, MapName, StoreError, StoredMap, lock};
use crate::mapping::MapConfig;
use crate::quadtree::{BlockAddress, BlockView};

/// Records that are written in one batch.
const BATCH: usize = 1000;

impl SledStore {
    pub(super) fn import_map(
        &self,
        name: &MapName,
        config: &MapConfig,
        created: f64,
        contents: &LoadedMap,
    ) -> Result<MapId, StoreError> {
        check_contents(config, contents)?;
        let id = self.reserve(name)?;
        let stored = StoredMap { id, name: name.clone(), config: config.clone(), revision: contents.revision, created };
        let written = self.write_contents(&stored, contents).and_then(|counts| self.name_map(stored, counts));
        if let Err(error) = written {
            // After a failed write nothing can be removed; it goes when the store is opened next.
            if let Err(left) = self.writable().and_then(|()| self.purge(id)) {
                tracing::warn!(map = id.0, "records of a map that was not imported are left: {left}");
            }
            return Err(error);
        }
        Ok(id)
    }

    /// A number for a map that is being written.
    fn reserve(&self, name: &MapName) -> Result<MapId, StoreError> {
        let mut next = lock(&self.next_map);
        self.writable()?;
        self.name_is_free(name)?;
        let id = MapId(*next);
        let after = next.checked_add(1).ok_or_else(|| StoreError::Refused("no map numbers are left".to_owned()))?;
        self.write(vec![
            self.put(keys::NEXT_MAP.to_vec(), 0, &after.to_be_bytes())?,
            self.put(keys::of_map(Kind::Tombstone, id), 0, &[])?,
        ])?;
        *next = after;
        Ok(id)
    }

    fn write_contents(&self, map: &StoredMap, contents: &LoadedMap) -> Result<Counts, StoreError> {
        let (id, revision) = (map.id, contents.revision);
        let mut counts = Counts { complete_from: revision, ..Counts::default() };
        let mut changes = self.sensor_changes(id, None, &map.config)?;
        counts.sensors = changes.len() as u64;
        note_sensors(&mut counts, &changes);
        let mut content = Vec::new();
        for (robot, window) in contents.windows.iter().filter(|(_, window)| window.highest().is_some()) {
            content.clear();
            encode_window(window, &mut content);
            let change = self.put(keys::named(Kind::Window, id, robot.as_str()), revision, &content)?;
            change.value.iter().for_each(|value| counts.window_digest.toggle_record(value));
            changes.push(change);
            counts.windows += 1;
            self.write_when_many(&mut changes)?;
        }
        let codec = FixedConfig::of(&map.config).codec();
        let stamp = BlockStamp { revision, changed: map.created };
        let mut group: Option<(u64, Group)> = None;
        let mut failure = Ok(());
        let mut visit = |address: BlockAddress, view: &BlockView| {
            content.clear();
            encode_block(&codec, stamp.changed, view, &mut content)
                .map_err(|why| StoreError::Refused(why.to_string()))?;
            changes.push(self.put(keys::block(id, address), revision, &content)?);
            counts.blocks += 1;
            counts.block_digest.toggle_block(address, revision);
            let number = group_of(address);
            // Blocks come in Z-order, so a group is whole when the next begins.
            if group.as_ref().is_none_or(|(open, _)| *open != number) {
                self.close_group(id, revision, group.replace((number, Group::default())), &mut changes)?;
            }
            if let Some((_, group)) = &mut group {
                group.note(address, Known::of(view, stamp));
            }
            self.write_when_many(&mut changes)
        };
        contents.tree.visit_blocks(&mut |address, view| {
            if failure.is_ok() {
                failure = visit(address, view);
            }
        });
        failure?;
        self.close_group(id, revision, group, &mut changes)?;
        self.write(changes)?;
        Ok(counts)
    }

    fn close_group(
        &self,
        id: MapId,
        revision: u64,
        group: Option<(u64, Group)>,
        changes: &mut Vec<Change>,
    ) -> Result<(), StoreError> {
        let Some((number, group)) = group else { return Ok(()) };
        changes.push(self.put(keys::group(id, number), revision, &group.encode())?);
        Ok(())
    }

    fn write_when_many(&self, changes: &mut Vec<Change>) -> Result<(), StoreError> {
        if changes.len() < BATCH {
            return Ok(());
        }
        self.write(std::mem::take(changes))
    }

    /// Makes a map of what was written.
    fn name_map(&self, map: StoredMap, counts: Counts) -> Result<(), StoreError> {
        let _creation = lock(&self.next_map);
        // Another may have taken the name meanwhile.
        self.name_is_free(&map.name)?;
        let record = MapRecord { name: map.name.clone(), created: map.created, fixed: FixedConfig::of(&map.config) };
        self.write(vec![
            self.put(keys::name(map.name.as_str()), 0, &map.id.0.to_be_bytes())?,
            self.put(keys::of_map(Kind::Map, map.id), 0, &record.encode())?,
            self.put(keys::of_map(Kind::State, map.id), map.revision, &counts.encode())?,
            self.change(keys::of_map(Kind::Tombstone, map.id), None)?,
        ])?;
        lock(&self.catalogue).maps.insert(map.id, Entry::new(map, counts));
        Ok(())
    }
}

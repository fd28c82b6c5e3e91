//! Checking every record of a store on disk, and what belongs together.

use super::block_codec::BlockCodec;
use super::keys;
use super::sled_catalogue::{Verification, check_record};
use super::sled_store::SledStore;
use super::{MapId, MapStore, StoreError, lock};

impl SledStore {
    /// Checks every record of the store.
    ///
    /// # Errors
    /// When the list of maps cannot be read; what is wrong with single records and maps is in the answer.
    pub fn verify(&self) -> Result<Verification, StoreError> {
        self.verify_with(&mut |_| ())
    }

    /// As [`SledStore::verify`]; `told` is given how many records were read so far. Nearly each is read twice.
    ///
    /// # Errors
    /// As [`SledStore::verify`].
    pub fn verify_with(&self, told: &mut dyn FnMut(u64)) -> Result<Verification, StoreError> {
        let maps = self.list()?;
        let codec = |id: Option<MapId>| {
            let map = maps.iter().find(|map| Some(map.id) == id)?;
            Some(BlockCodec::new(map.config.grid().depth(), map.config.scale()))
        };
        let mut found = Verification { maps: maps.len() as u64, ..Verification::default() };
        let mut of_map = (None, None);
        let scanned = self.records.scan(&[], &mut |key, value| {
            let id = keys::map_of(key);
            if of_map.0 != id {
                of_map = (id, codec(id));
            }
            found.records += 1;
            told(found.records);
            found.bytes += (key.len() + value.len()) as u64;
            found.problems.extend(check_record(key, value, of_map.1.as_ref()).err().map(|error| error.to_string()));
            Ok(())
        });
        // Behind a page that sled cannot read the maps are looked at one by one.
        found.problems.extend(scanned.err().map(|error| error.to_string()));
        let known = |problems: &[String], what: &str| problems.iter().any(|problem| what.contains(problem.as_str()));
        let of_maps = self.damaged().into_iter().map(|damaged| damaged.what);
        let mut read = found.records;
        let of_contents = maps.iter().filter_map(|map| {
            let error = self.load(map.id).err().map(|error| format!("map {:?}: {error}", map.name.as_str()));
            read += self.entry(map.id).map_or(0, |entry| entry.counts.blocks);
            told(read);
            error
        });
        let of_snapshots = maps.iter().flat_map(|map| self.snapshot_problems(map.id));
        for what in of_maps.chain(of_contents).chain(of_snapshots) {
            if !known(&found.problems, &what) {
                found.problems.push(what);
            }
        }
        Ok(found)
    }

    fn snapshot_problems(&self, id: MapId) -> Vec<String> {
        let checked = self.busy(id).and_then(|busy| {
            let _held = lock(&busy);
            self.check_snapshots(&self.entry(id)?)
        });
        checked.unwrap_or_else(|error| vec![error.to_string()])
    }
}

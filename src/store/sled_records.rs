//! The records of a store on disk as they were last durable, for all who read them.

use super::block_codec::BlockCodec;
use super::checks::holds;
use super::config_record::decode_block;
use super::digest::Digest;
use super::groups::Known;
use super::keys::{self, Kind};
use super::record::{self, damaged};
use super::sled_catalogue::{Entry, not_later, read_window};
use super::sled_open::{Database, guarded};
use super::{BlockStamp, MapId, RobotName, SequenceWindow, StoreError, lock};
use crate::quadtree::{Block, BlockAddress, BlockSource, BlockTag, BlockView, SourceError};
use arc_swap::ArcSwap;
use sled::IVec;
use std::collections::BTreeMap;
use std::fs::File;
use std::sync::{Arc, Mutex};

/// What records were, by key; `None` where there was none.
pub(super) type Before = BTreeMap<Vec<u8>, Option<IVec>>;

/// Is shown keys and values.
pub(super) type Visit<'a> = dyn FnMut(&[u8], &[u8]) -> Result<(), StoreError> + 'a;

/// The database, shared by the store and the blocks of open maps.
pub(super) struct Records {
    db: ArcSwap<Database>,
    /// After a failure: what the records of the changes that did not become durable were before.
    pub(super) undone: Mutex<Before>,
    /// Held until the database is closed.
    pub(super) _lock: File,
}

impl Records {
    pub(super) fn new(db: Arc<Database>, lock: File) -> Self {
        Self { db: ArcSwap::new(db), undone: Mutex::default(), _lock: lock }
    }

    /// The database, for one access: it may be replaced by a rewritten one between two. What is read through it, an
    /// iterator too, must be dropped before it is: the one before is closed and removed when nobody has it any more.
    pub(super) fn db(&self) -> Arc<Database> {
        self.db.load_full()
    }

    /// Replaces the database by one that holds the same.
    pub(super) fn replace(&self, db: Arc<Database>) {
        self.db.store(db);
    }

    /// A record as it was last durable, for readers of a record that no commit under way replaces.
    pub(super) fn get(&self, key: &[u8]) -> Result<Option<IVec>, StoreError> {
        if let Some(before) = lock(&self.undone).get(key) {
            return Ok(before.clone());
        }
        let db = self.db();
        guarded("reading a record", || db.get(key)).map_err(|error| at(&keys::describe(key), error))
    }

    /// Every record whose key begins so, as it was last durable. Its map must be held, but for checks.
    pub(super) fn scan(&self, prefix: &[u8], visit: &mut Visit<'_>) -> Result<(), StoreError> {
        let undone: Before = {
            let all = lock(&self.undone);
            let from = all.range(prefix.to_vec()..).take_while(|(key, _)| key.starts_with(prefix));
            from.map(|(key, value)| (key.clone(), value.clone())).collect()
        };
        let db = self.db();
        let mut records = db.scan_prefix(prefix);
        let mut last = None;
        let read = |error, last: &Option<IVec>| match (last, keys::map_of(prefix)) {
            (Some(last), _) => at(&format!("after {}", keys::describe(last)), error),
            (None, Some(id)) => at(&format!("map {}, its first records", id.0), error),
            (None, None) => error,
        };
        while let Some((key, value)) =
            guarded("reading records", || records.next().transpose()).map_err(|error| read(error, &last))?
        {
            last = Some(key.clone());
            if !undone.contains_key(key.as_ref()) {
                visit(&key, &value)?;
            }
        }
        undone.iter().try_for_each(|(key, value)| value.as_ref().map_or(Ok(()), |value| visit(key, value)))
    }

    /// Reads every block of a map; what is known of each. The map must be held.
    pub(super) fn read_blocks(
        &self,
        entry: &Entry,
        visit: &mut dyn FnMut(BlockTag, BlockView),
    ) -> Result<Vec<(BlockAddress, Known)>, StoreError> {
        let (stored, codec) = (&entry.stored, entry.codec());
        let mut blocks = Vec::new();
        self.scan(&keys::of_map(Kind::Block, stored.id), &mut |key, value| {
            let address = keys::block_of(key).filter(|address| holds(stored.config.grid(), *address));
            let address = address.ok_or_else(|| damaged(key, "outside the map"))?;
            let record = record::open(key, Kind::Block, value)?;
            not_later(key, &record, stored.revision)?;
            let (changed, view) = decode_block(&codec, &record).map_err(|why| damaged(key, &why.to_string()))?;
            let known = Known::of(&view, BlockStamp { revision: record.revision, changed });
            visit(known.tag(address), view);
            blocks.push((address, known));
            Ok(())
        })?;
        Ok(blocks)
    }

    /// Reads a map's windows, and checks their number and that of the blocks found. The map must be held.
    pub(super) fn read_windows(
        &self,
        entry: &Entry,
        blocks: u64,
    ) -> Result<BTreeMap<RobotName, SequenceWindow>, StoreError> {
        let (stored, counts) = (&entry.stored, &entry.counts);
        let mut windows = BTreeMap::new();
        let mut digest = Digest::default();
        self.scan(&keys::of_map(Kind::Window, stored.id), &mut |key, value| {
            digest.toggle_record(value);
            let (robot, read) = read_window(key, value, stored.revision)?;
            windows.insert(robot, read.window);
            Ok(())
        })?;
        for (what, found, expected) in
            [("blocks", blocks, counts.blocks), ("windows", windows.len() as u64, counts.windows)]
        {
            if found != expected {
                let why = format!("{found} {what} found of {expected}");
                return Err(damaged(&keys::of_map(Kind::State, stored.id), &why));
            }
        }
        if digest != counts.window_digest {
            let why = format!("some of its sequence windows are older than its revision, {}", stored.revision);
            return Err(damaged(&keys::of_map(Kind::State, stored.id), &why));
        }
        Ok(windows)
    }
}

/// What sled says of a file, said of what was looked for in it.
fn at(place: &str, error: StoreError) -> StoreError {
    match error {
        StoreError::Damaged { what } => StoreError::Damaged { what: format!("{place}: {what}") },
        StoreError::Io { what, source } => StoreError::Io { what: format!("{place}: {what}"), source },
        other => other,
    }
}

/// The blocks of one map.
pub(super) struct Blocks {
    pub(super) records: Arc<Records>,
    pub(super) id: MapId,
    pub(super) codec: BlockCodec,
}

impl BlockSource for Blocks {
    fn fetch(&self, tag: &BlockTag) -> Result<Arc<Block>, SourceError> {
        let key = keys::block(self.id, tag.address);
        let Some(value) = self.records.get(&key)? else {
            let map = self.records.get(&keys::of_map(Kind::Map, self.id))?;
            return Err(map.map_or(StoreError::NoMap(self.id), |_| damaged(&key, "missing")).into());
        };
        let record = record::open(&key, Kind::Block, &value)?;
        if record.revision != tag.revision {
            let why = format!("of revision {}, expected that of revision {}", record.revision, tag.revision);
            return Err(damaged(&key, &why).into());
        }
        match decode_block(&self.codec, &record).map_err(|why| damaged(&key, &why.to_string()))?.1 {
            BlockView::Mixed(block) if block.max_at(0, 0, 0) == tag.max => Ok(block),
            _ => Err(damaged(&key, "another block than the map's").into()),
        }
    }
}

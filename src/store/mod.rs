//! Floor 3: durable maps.
//!
//! [`MapStore`] is the port: everything of one commit is stored at once, and what a call acknowledged survives a power
//! cut. Two implementations: [`SledStore`], on disk, and [`MemoryStore`], for tests and trials. A map file
//! ([`write_map_file`], [`read_map_file`]) is one map in one file. `docs/store-format.md` gives every byte of both.

mod block_codec;
mod bytes;
mod checks;
mod config_record;
mod copies;
mod digest;
mod durability;
#[cfg(fuzzing)]
pub mod fuzzing;
mod groups;
mod kept;
mod keys;
mod map_file;
mod mark;
mod memory_store;
mod migrate;
mod migrate_times;
mod names;
mod nudge;
mod peek;
mod record;
mod sled_catalogue;
mod sled_commit;
mod sled_copy;
mod sled_generations;
mod sled_import;
mod sled_open;
mod sled_records;
mod sled_rewrite;
mod sled_snapshots;
mod sled_store;
mod sled_upkeep;
mod sled_verify;
mod sled_writes;
mod stamps;
mod stop;
mod window;

#[cfg(test)]
mod block_codec_tests;
#[cfg(all(test, feature = "shuttle"))]
mod durability_schedules;
#[cfg(all(test, not(feature = "shuttle")))]
mod durability_tests;
#[cfg(test)]
mod migrate_tests;
#[cfg(test)]
mod record_tests;

use crate::mapping::MapConfig;
use crate::quadtree::{BlockAddress, BlockCache, BlockPager, BlockView, OccupancyTree, PageError, PagedTree};
use std::collections::BTreeMap;
use std::sync::Arc;
use thiserror::Error;

pub use durability::Syncer;
pub use map_file::{MAP_FILE_MAGIC, MapFileError, MapFileLimits, read_map_file, read_map_file_within, write_map_file};
pub use memory_store::MemoryStore;
pub use migrate::STORE_FORMAT;
pub use names::{MapName, NameError, RobotName, SnapshotName};
pub use peek::Peek;
pub use sled_catalogue::Verification;
pub use sled_open::{RewriteOptions, SledOptions};
pub use sled_rewrite::{RewriteStep, Rewritten, Watch};
pub use sled_store::SledStore;
pub use stamps::{BlockStamp, BlockStamps};
pub use window::{SequenceVerdict, SequenceWindow, WINDOW_LENGTH};

/// A map's number in a store; never used again after the map is deleted.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct MapId(pub u32);

/// What a store knows of a map without loading it.
#[derive(Debug, Clone, PartialEq)]
pub struct StoredMap {
    /// Its number.
    pub id: MapId,
    /// Its name.
    pub name: MapName,
    /// Its configuration.
    pub config: MapConfig,
    /// Its revision: 0 when created, one more with every commit.
    pub revision: u64,
    /// When it was created, seconds since the Unix epoch.
    pub created: f64,
}

/// A map's contents at its last revision.
#[derive(Debug, Clone)]
pub struct LoadedMap {
    /// Its revision.
    pub revision: u64,
    /// The quadtree.
    pub tree: OccupancyTree,
    /// What every robot has had applied.
    pub windows: BTreeMap<RobotName, SequenceWindow>,
}

/// A map at its last revision, whose blocks are read when they are looked into.
#[derive(Debug, Clone)]
pub struct OpenMap {
    /// Its revision.
    pub revision: u64,
    /// The quadtree.
    pub tree: PagedTree,
    /// Where its blocks are read from; `None` when all are in memory and stay there.
    pub pager: Option<Arc<BlockPager>>,
    /// What every robot has had applied.
    pub windows: BTreeMap<RobotName, SequenceWindow>,
    /// When each block last changed.
    pub stamps: BlockStamps,
}

/// Everything that one commit changes; stored whole or not at all.
#[derive(Debug, Clone)]
pub struct Commit {
    /// The new revision.
    pub revision: u64,
    /// When it is made, seconds since the Unix epoch: the time of the last change of its blocks.
    pub changed: f64,
    /// The changed blocks, each once.
    pub blocks: Vec<(BlockAddress, BlockView)>,
    /// The changed windows; one in which nothing was applied is removed.
    pub windows: Vec<(RobotName, SequenceWindow)>,
}

impl Commit {
    /// The addresses of the changed blocks.
    #[must_use]
    pub fn addresses(&self) -> Vec<BlockAddress> {
        self.blocks.iter().map(|(address, _)| *address).collect()
    }
}

/// A revision of a map that is kept under a name.
#[derive(Debug, Clone, PartialEq)]
pub struct StoredSnapshot {
    /// Its name, unique within its map.
    pub name: SnapshotName,
    /// The revision that it keeps.
    pub revision: u64,
    /// When it was taken, seconds since the Unix epoch.
    pub created: f64,
}

/// What leads from a map's last revision to one of its snapshots.
#[derive(Debug, Clone)]
pub struct Difference {
    /// The snapshot's revision.
    pub revision: u64,
    /// The blocks that were changed since, as they are in the snapshot.
    pub blocks: Vec<(BlockAddress, BlockView)>,
    /// The windows that were changed since, as they are in the snapshot; empty for robots that were not known then.
    pub windows: Vec<(RobotName, SequenceWindow)>,
}

/// Why a store refuses or fails.
#[derive(Debug, Error)]
pub enum StoreError {
    /// The name is taken.
    #[error("map {0} exists")]
    Exists(MapName),
    /// There is no such map.
    #[error("no map {0:?} in the store")]
    NoMap(MapId),
    /// The map has a snapshot of this name.
    #[error("snapshot {0} exists")]
    SnapshotExists(SnapshotName),
    /// The map has no such snapshot.
    #[error("no snapshot {0}")]
    NoSnapshot(SnapshotName),
    /// A record's checksum or form is wrong.
    #[error("damaged record: {what}")]
    Damaged {
        /// The map and block or record.
        what: String,
    },
    /// Written by a newer version.
    #[error("{what} has format version {found}, this program reads up to {supported}")]
    NewerFormat {
        /// What was read.
        what: String,
        /// Its version.
        found: u32,
        /// The newest version known.
        supported: u32,
    },
    /// Another process, or another store of this one, has the directory open.
    #[error("{directory}: another ubbmap has this store open")]
    Locked {
        /// The data directory.
        directory: String,
    },
    /// The directory holds no store that can be opened. It is left as it is.
    #[error("{directory}: {why}")]
    NoStore {
        /// The data directory.
        directory: String,
        /// What is wrong with it.
        why: String,
    },
    /// What was to be written does not fit what is stored; nothing was written.
    #[error("refused: {0}")]
    Refused(String),
    /// The store no longer takes writes after a failed one.
    #[error("the store takes no more writes after a failure: {0}")]
    FailStop(String),
    /// Reading or writing failed.
    #[error("{what}: {source}")]
    Io {
        /// What was being done.
        what: String,
        /// Why it failed.
        source: std::io::Error,
    },
}

/// What a source of this module says when it has no block.
impl From<PageError> for StoreError {
    fn from(error: PageError) -> Self {
        let absent = || Self::Refused("a block was not to be fetched".to_owned());
        match error {
            PageError::Absent => absent(),
            PageError::Source(source) => match source.downcast::<Self>() {
                Ok(own) => *own,
                Err(other) => Self::Io { what: "reading a block".to_owned(), source: std::io::Error::other(other) },
            },
        }
    }
}

/// Where maps are kept. Calls block; every call that changes something is durable when it returns `Ok`.
pub trait MapStore: Send + Sync + 'static {
    /// Every map, by name.
    ///
    /// # Errors
    /// [`StoreError`]
    fn list(&self) -> Result<Vec<StoredMap>, StoreError>;

    /// Creates an empty map at revision 0.
    ///
    /// # Errors
    /// [`StoreError::Exists`] and failures.
    fn create(&self, name: &MapName, config: &MapConfig, created: f64) -> Result<MapId, StoreError>;

    /// Replaces a map's configuration (its sensors).
    ///
    /// # Errors
    /// [`StoreError`]
    fn update_config(&self, id: MapId, config: &MapConfig) -> Result<(), StoreError>;

    /// Deletes a map and all that belongs to it.
    ///
    /// # Errors
    /// [`StoreError`]
    fn delete(&self, id: MapId) -> Result<(), StoreError>;

    /// Loads a map's last revision.
    ///
    /// # Errors
    /// [`StoreError`]
    fn load(&self, id: MapId) -> Result<LoadedMap, StoreError>;

    /// Opens a map's last revision. Its blocks are read when they are looked into, and let go by the cache; before a
    /// commit replaces a block, the caller holds the old one ([`PagedTree::hold_replaced`]).
    ///
    /// A store that cannot read single blocks reads them all here, and they stay in memory.
    ///
    /// # Errors
    /// [`StoreError`]
    fn open(&self, id: MapId, cache: &Arc<BlockCache>) -> Result<OpenMap, StoreError> {
        let _ = cache;
        let LoadedMap { revision, tree, windows } = self.load(id)?;
        let stamps = BlockStamps::new(revision);
        Ok(OpenMap { revision, tree: PagedTree::from(&tree), pager: None, windows, stamps })
    }

    /// Stores a commit.
    ///
    /// # Errors
    /// [`StoreError::Refused`] when the revision is not above the map's or a block does not fit the map, and failures;
    /// nothing of the commit is visible after an error.
    fn commit(&self, id: MapId, commit: &Commit) -> Result<(), StoreError>;

    /// Creates a map with contents. The map is there as a whole or not at all; its blocks count as changed by its
    /// revision.
    ///
    /// # Errors
    /// [`StoreError::Exists`], [`StoreError::Refused`] when the contents do not fit the configuration, and failures.
    fn import(
        &self,
        name: &MapName,
        config: &MapConfig,
        created: f64,
        contents: &LoadedMap,
    ) -> Result<MapId, StoreError> {
        let _ = (name, config, created, contents);
        Err(StoreError::Refused("this store takes no maps with contents".to_owned()))
    }

    /// The snapshots of a map, by name.
    ///
    /// # Errors
    /// [`StoreError`]
    fn snapshots(&self, id: MapId) -> Result<Vec<StoredSnapshot>, StoreError> {
        let _ = id;
        Ok(Vec::new())
    }

    /// Keeps a map's last revision under a name. Costs one record: what is kept is what later commits replace.
    ///
    /// # Errors
    /// [`StoreError::SnapshotExists`] and failures.
    fn take_snapshot(&self, id: MapId, name: &SnapshotName, created: f64) -> Result<StoredSnapshot, StoreError> {
        let _ = (id, name, created);
        Err(StoreError::Refused("this store keeps no snapshots".to_owned()))
    }

    /// Removes a snapshot, and what was kept for it alone.
    ///
    /// # Errors
    /// [`StoreError::NoSnapshot`] and failures.
    fn delete_snapshot(&self, id: MapId, name: &SnapshotName) -> Result<(), StoreError> {
        let _ = id;
        Err(StoreError::NoSnapshot(name.clone()))
    }

    /// Loads what a snapshot keeps. The map itself need not be readable.
    ///
    /// # Errors
    /// [`StoreError::NoSnapshot`] and failures.
    fn load_snapshot(&self, id: MapId, name: &SnapshotName) -> Result<LoadedMap, StoreError> {
        let _ = id;
        Err(StoreError::NoSnapshot(name.clone()))
    }

    /// What leads from a map's last revision to a snapshot: stored as a commit, it restores it.
    ///
    /// # Errors
    /// [`StoreError::NoSnapshot`] and failures.
    fn difference(&self, id: MapId, name: &SnapshotName) -> Result<Difference, StoreError> {
        let _ = id;
        Err(StoreError::NoSnapshot(name.clone()))
    }

    /// Writes a map's last snapshot as a map file beside the store, in place of that of an earlier one: what is left when
    /// the store itself cannot be opened. A store that cannot lose its database alone does nothing.
    ///
    /// # Errors
    /// [`StoreError`]; the file before stays.
    fn keep_copy(&self, id: MapId) -> Result<(), StoreError> {
        let _ = id;
        Ok(())
    }

    /// Why the store takes no more writes; `None` while it does.
    fn failure(&self) -> Option<String> {
        None
    }

    /// What the store takes on disk; `None` for one that is on none.
    fn statistics(&self) -> Option<StoreStatistics> {
        None
    }

    /// Maps that are in the store but cannot be read, and why; [`MapStore::list`] leaves them out.
    fn damaged(&self) -> Vec<DamagedMap> {
        Vec::new()
    }
}

/// What a store takes on disk, as it was last measured.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct StoreStatistics {
    /// Bytes of all files.
    pub disk_bytes: u64,
    /// Bytes of the keys and values that it holds; `None` until they are counted.
    pub live_bytes: Option<u64>,
    /// How often the database was rewritten since the store was opened.
    pub rewrites: u64,
    /// How often a rewrite failed and left the database as it was.
    pub failed_rewrites: u64,
}

/// A map that is in the store but cannot be read. Its name stays taken; [`MapStore::delete`] removes it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct DamagedMap {
    /// Its number, where that can be read.
    pub id: Option<MapId>,
    /// Its name, where that can be read.
    pub name: Option<MapName>,
    /// What is wrong.
    pub what: String,
}

/// The lock of a mutex whether or not a thread panicked with it: no state here is left half changed by a panic.
fn lock<T>(mutex: &std::sync::Mutex<T>) -> std::sync::MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(std::sync::PoisonError::into_inner)
}

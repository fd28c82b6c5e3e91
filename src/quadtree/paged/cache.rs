//! Which stored blocks stay in memory: second chance under a limit in bytes.

use super::cell::{BlockCell, LetGo};
use crate::quadtree::Block;
use crate::sync::{AtomicU64, AtomicUsize, Mutex};
use std::collections::VecDeque;
use std::sync::atomic::Ordering;
use std::sync::{Arc, PoisonError, Weak};

/// Bytes of a block in memory: with the counts before it and what an allocator adds.
const BLOCK_BYTES: usize = size_of::<Block>() + 32;

/// Entries of the ring beyond twice the blocks in memory before those of cells that are gone are cleared away.
const SLACK: usize = 1024;

/// The memory for stored blocks of all maps together.
///
/// Cells stand in a ring. Who is over the limit goes round: a block that was looked into since the last time stays, one
/// that was not is let go. Blocks that a writer has changed and those that are held for readers of older revisions are
/// not let go and count all the same, so that the limit is kept by what remains; it can be passed by one commit's blocks.
#[derive(Debug)]
pub struct BlockCache {
    limit: usize,
    blocks: AtomicUsize,
    ring: Mutex<VecDeque<Weak<BlockCell>>>,
    hits: AtomicU64,
    loads: AtomicU64,
    evictions: AtomicU64,
}

/// What a cache holds and has done.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct CacheStatistics {
    /// Bytes of the stored blocks in memory.
    pub bytes: u64,
    /// Blocks that were looked into and were in memory.
    pub hits: u64,
    /// Blocks that were fetched.
    pub loads: u64,
    /// Blocks that were let go.
    pub evictions: u64,
}

impl BlockCache {
    /// A cache of at most so many bytes.
    #[must_use]
    pub fn new(limit: usize) -> Self {
        Self {
            limit,
            blocks: AtomicUsize::new(0),
            ring: Mutex::default(),
            hits: AtomicU64::new(0),
            loads: AtomicU64::new(0),
            evictions: AtomicU64::new(0),
        }
    }

    /// What it holds and has done so far.
    #[must_use]
    pub fn statistics(&self) -> CacheStatistics {
        CacheStatistics {
            bytes: (self.blocks.load(Ordering::Relaxed) * BLOCK_BYTES) as u64,
            hits: self.hits.load(Ordering::Relaxed),
            loads: self.loads.load(Ordering::Relaxed),
            evictions: self.evictions.load(Ordering::Relaxed),
        }
    }

    pub(super) fn hit(&self) {
        self.hits.fetch_add(1, Ordering::Relaxed);
    }

    pub(super) fn loaded(&self) {
        self.loads.fetch_add(1, Ordering::Relaxed);
    }

    /// A block came into memory.
    pub(super) fn came(&self) {
        self.blocks.fetch_add(1, Ordering::Relaxed);
    }

    /// A block went with its cell.
    pub(super) fn went(&self) {
        self.blocks.fetch_sub(1, Ordering::Relaxed);
    }

    fn is_over(&self) -> bool {
        self.blocks.load(Ordering::Relaxed) * BLOCK_BYTES > self.limit
    }

    /// Takes a cell into the ring, and lets go of others while there are too many. Not called under a cell's lock.
    pub(super) fn admit(&self, cell: &Arc<BlockCell>) {
        let mut ring = self.ring.lock().unwrap_or_else(PoisonError::into_inner);
        if !cell.listed.swap(true, Ordering::Relaxed) {
            ring.push_back(Arc::downgrade(cell));
        }
        if ring.len() > 2 * self.blocks.load(Ordering::Relaxed) + SLACK {
            ring.retain(|cell| cell.strong_count() > 0);
        }
        // Twice round, every block that may go has gone.
        let mut looks = 2 * ring.len();
        while looks > 0 && self.is_over() {
            looks -= 1;
            let Some(first) = ring.pop_front() else { break };
            // A cell that is gone has taken its block with it.
            let Some(cell) = first.upgrade() else { continue };
            if cell.used.swap(false, Ordering::Relaxed) {
                ring.push_back(first);
                continue;
            }
            match cell.let_go() {
                LetGo::Gone => {
                    self.went();
                    self.evictions.fetch_add(1, Ordering::Relaxed);
                    cell.listed.store(false, Ordering::Relaxed);
                }
                LetGo::Busy => ring.push_back(first),
                // It comes back when it is fetched or released.
                LetGo::Absent | LetGo::Held => cell.listed.store(false, Ordering::Relaxed),
            }
        }
    }
}

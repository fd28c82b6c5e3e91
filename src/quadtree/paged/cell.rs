//! One stored block, in memory or not.

use super::cache::BlockCache;
use crate::quadtree::{Block, BlockAddress, BlockMasks, BlockSlot, Class, ClassScale};
use crate::sync::{ArcSwapOption, AtomicBool, Mutex, MutexGuard};
use std::error::Error;
use std::fmt;
use std::sync::atomic::Ordering;
use std::sync::{Arc, PoisonError};
use thiserror::Error;

/// What is known of a stored block without reading it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct BlockTag {
    /// Its address.
    pub address: BlockAddress,
    /// The revision of the map that wrote its record.
    pub revision: u64,
    /// The maximum of its classes.
    pub max: Class,
}

/// Why a source has no block.
pub type SourceError = Box<dyn Error + Send + Sync>;

/// Where the blocks of one map are read from.
pub trait BlockSource: Send + Sync {
    /// Reads a block of mixed classes. Blocks the thread; the answer is the very block of the tag or an error.
    ///
    /// # Errors
    /// When it cannot be read or is another.
    fn fetch(&self, tag: &BlockTag) -> Result<Arc<Block>, SourceError>;
}

/// Why a block is not to be had.
#[derive(Debug, Error)]
pub enum PageError {
    /// It is not in memory, and the tree is one that fetches nothing.
    #[error("a block is not in memory")]
    Absent,
    /// Its source failed.
    #[error(transparent)]
    Source(SourceError),
}

/// How a tree reads its blocks.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Access {
    /// Fetches what is not in memory.
    #[default]
    Fetch,
    /// Takes what is in memory.
    InMemory,
}

/// Where the blocks of one map come from, and who lets go of them.
pub struct BlockPager {
    source: Box<dyn BlockSource>,
    pub(super) cache: Arc<BlockCache>,
}

impl BlockPager {
    /// The blocks of a source, in memory under the limit of a cache.
    #[must_use]
    pub fn new(source: Box<dyn BlockSource>, cache: Arc<BlockCache>) -> Self {
        Self { source, cache }
    }
}

impl fmt::Debug for BlockPager {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("BlockPager").field("cache", &self.cache).finish_non_exhaustive()
    }
}

/// A stored block, in memory or not.
pub struct BlockCell {
    tag: BlockTag,
    block: ArcSwapOption<Block>,
    /// How many hold it in memory. Locked while it is fetched, held and let go.
    holders: Mutex<u32>,
    /// Looked into since the cache came by last.
    pub(super) used: AtomicBool,
    /// In the cache's ring.
    pub(super) listed: AtomicBool,
    pager: Arc<BlockPager>,
}

impl fmt::Debug for BlockCell {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let in_memory = self.block.load().is_some();
        f.debug_struct("BlockCell").field("tag", &self.tag).field("in_memory", &in_memory).finish_non_exhaustive()
    }
}

impl BlockCell {
    /// A cell whose block is not in memory.
    pub(super) fn absent(tag: BlockTag, pager: &Arc<BlockPager>) -> Self {
        Self {
            tag,
            block: ArcSwapOption::empty(),
            holders: Mutex::new(0),
            used: AtomicBool::new(false),
            listed: AtomicBool::new(false),
            pager: Arc::clone(pager),
        }
    }

    /// A cell of a block that was just stored.
    pub(super) fn stored(tag: BlockTag, block: Arc<Block>, pager: &Arc<BlockPager>) -> Arc<Self> {
        let cell = Arc::new(Self::absent(tag, pager));
        cell.keep(block);
        pager.cache.admit(&cell);
        cell
    }

    fn lock(&self) -> MutexGuard<'_, u32> {
        self.holders.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn keep(&self, block: Arc<Block>) {
        self.block.store(Some(block));
        self.pager.cache.came();
    }

    /// The block.
    pub(super) fn get(self: &Arc<Self>, access: Access) -> Result<Arc<Block>, PageError> {
        if let Some(block) = self.block.load_full() {
            // Written only where it changes, so that readers on several cores do not take the line from each other.
            if !self.used.load(Ordering::Relaxed) {
                self.used.store(true, Ordering::Relaxed);
            }
            self.pager.cache.hit();
            return Ok(block);
        }
        match access {
            Access::InMemory => Err(PageError::Absent),
            Access::Fetch => {
                let (block, fetched) = self.fetch(&self.lock())?;
                if fetched {
                    self.pager.cache.admit(self);
                }
                Ok(block)
            }
        }
    }

    /// The block, and whether it was fetched for this; under the lock, so that it is fetched once.
    fn fetch(&self, _locked: &MutexGuard<'_, u32>) -> Result<(Arc<Block>, bool), PageError> {
        if let Some(block) = self.block.load_full() {
            return Ok((block, false));
        }
        let block = self.pager.source.fetch(&self.tag).map_err(PageError::Source)?;
        self.pager.cache.loaded();
        self.keep(Arc::clone(&block));
        Ok((block, true))
    }

    /// Fetches the block where needed and keeps it in memory until it is released.
    fn hold(&self) -> Result<(), PageError> {
        let mut holders = self.lock();
        self.fetch(&holders)?;
        *holders += 1;
        Ok(())
    }

    fn release(self: &Arc<Self>) {
        let mut holders = self.lock();
        *holders = holders.saturating_sub(1);
        drop(holders);
        self.pager.cache.admit(self);
    }

    /// Lets go of the block unless it is held or being fetched; what became of it.
    pub(super) fn let_go(&self) -> LetGo {
        match self.holders.try_lock() {
            Ok(holders) if *holders > 0 => LetGo::Held,
            Ok(_holders) => match self.block.swap(None) {
                Some(_) => LetGo::Gone,
                None => LetGo::Absent,
            },
            Err(_) => LetGo::Busy,
        }
    }
}

impl Drop for BlockCell {
    fn drop(&mut self) {
        if self.block.load().is_some() {
            self.pager.cache.went();
        }
    }
}

/// What became of a block that the cache wanted to let go.
#[derive(Debug, PartialEq, Eq)]
pub(super) enum LetGo {
    Gone,
    /// It was not in memory.
    Absent,
    Held,
    Busy,
}

/// Blocks that are held in memory because a commit replaces their records. Dropped, it releases them: for a commit that
/// failed. After one that did not, [`Held::keep`] leaves them held for as long as a tree has them.
#[derive(Debug, Default)]
pub struct Held(Vec<Arc<BlockCell>>);

impl Held {
    pub(super) fn add(&mut self, cell: &Arc<BlockCell>) -> Result<(), PageError> {
        cell.hold()?;
        self.0.push(Arc::clone(cell));
        Ok(())
    }

    /// The commit is durable: what is held is in no store any more.
    pub fn keep(mut self) {
        self.0.clear();
    }
}

impl Drop for Held {
    fn drop(&mut self) {
        self.0.iter().for_each(BlockCell::release);
    }
}

/// What stands in a [`super::PagedTree`] for a block.
#[derive(Debug, Clone)]
pub enum PagedBlock {
    /// In memory: changed and not stored yet, or of a store that reads maps as a whole.
    Own(Arc<Block>),
    /// Stored.
    Cell(Arc<BlockCell>),
}

impl From<Arc<Block>> for PagedBlock {
    fn from(block: Arc<Block>) -> Self {
        Self::Own(block)
    }
}

impl BlockSlot for PagedBlock {
    type Error = PageError;
    type Access = Access;
    type Guard<'a> = Arc<Block>;

    fn max(&self) -> Class {
        match self {
            Self::Own(block) => block.max_at(0, 0, 0),
            Self::Cell(cell) => cell.tag.max,
        }
    }

    fn read(&self, access: Access) -> Result<Arc<Block>, PageError> {
        self.share(access)
    }

    fn share(&self, access: Access) -> Result<Arc<Block>, PageError> {
        match self {
            Self::Own(block) => Ok(Arc::clone(block)),
            Self::Cell(cell) => cell.get(access),
        }
    }

    fn step(&mut self, masks: &BlockMasks, scale: ClassScale) -> Result<Option<&Block>, PageError> {
        if let Self::Cell(cell) = self {
            // The cell has the block as well, so that a change makes a copy and leaves the cell's as it is.
            let mut block = cell.get(Access::Fetch)?;
            let Ok(changed) = block.step(masks, scale);
            if changed.is_none() {
                return Ok(None);
            }
            *self = Self::Own(block);
        } else if let Self::Own(block) = self {
            let Ok(changed) = block.step(masks, scale);
            if changed.is_none() {
                return Ok(None);
            }
        }
        let Self::Own(block) = self else { return Ok(None) };
        Ok(Some(block))
    }
}

//! When each block of a map last changed, kept with every revision that readers hold.
//!
//! Blocks stand in chunks of 64 x 64 blocks, each sorted by the low bits of the Morton code. A clone shares everything;
//! a commit copies the list of chunks and the chunks that it changes.

use crate::quadtree::BlockAddress;
use std::collections::BTreeMap;
use std::sync::Arc;

/// Bits of a Morton code that tell the blocks of a chunk apart.
const BITS: u32 = 12;

/// The last change of a block.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct BlockStamp {
    /// The revision that changed it.
    pub revision: u64,
    /// When, seconds since the Unix epoch; 0 when that was not kept (by a store before version 3).
    pub changed: f64,
}

/// The last change of every block of a map.
#[derive(Debug, Clone, Default)]
pub struct BlockStamps {
    /// Every change after this revision is known; of those before, the last of each block that had a record.
    complete_from: u64,
    chunks: Arc<BTreeMap<u64, Arc<Chunk>>>,
    newest: BlockStamp,
}

#[derive(Debug, Clone, Default)]
struct Chunk {
    /// The highest revision in it.
    newest: u64,
    /// By the low bits of their Morton codes.
    blocks: Vec<(u16, BlockStamp)>,
}

fn place(address: BlockAddress) -> (u64, u16) {
    let code = address.morton();
    (code >> BITS, (code & ((1 << BITS) - 1)) as u16)
}

impl BlockStamps {
    /// No blocks yet. Changes up to and with `complete_from` may be left out of what is then put in.
    #[must_use]
    pub fn new(complete_from: u64) -> Self {
        Self { complete_from, ..Self::default() }
    }

    /// The revision from which on every change is known.
    #[must_use]
    pub fn complete_from(&self) -> u64 {
        self.complete_from
    }

    /// Notes a block's last change.
    pub fn set(&mut self, address: BlockAddress, stamp: BlockStamp) {
        let (chunk, place) = place(address);
        let chunk = Arc::make_mut(Arc::make_mut(&mut self.chunks).entry(chunk).or_default());
        chunk.newest = chunk.newest.max(stamp.revision);
        match chunk.blocks.last() {
            // What is read from a store comes in order.
            Some((last, _)) if *last >= place => match chunk.blocks.binary_search_by_key(&place, |(place, _)| *place) {
                Ok(found) => chunk.blocks[found].1 = stamp,
                Err(gap) => chunk.blocks.insert(gap, (place, stamp)),
            },
            _ => chunk.blocks.push((place, stamp)),
        }
        if stamp.revision >= self.newest.revision {
            self.newest = stamp;
        }
    }

    /// The last change of one block; `None` for a block that never changed.
    #[must_use]
    pub fn get(&self, address: BlockAddress) -> Option<BlockStamp> {
        let (chunk, place) = place(address);
        let blocks = &self.chunks.get(&chunk)?.blocks;
        blocks.binary_search_by_key(&place, |(place, _)| *place).ok().map(|found| blocks[found].1)
    }

    /// The last change of all; `None` when no block ever changed.
    #[must_use]
    pub fn newest(&self) -> Option<BlockStamp> {
        (!self.chunks.is_empty()).then_some(self.newest)
    }

    /// The blocks changed after a revision, in Z-order.
    pub fn since(&self, revision: u64) -> impl Iterator<Item = (BlockAddress, BlockStamp)> + '_ {
        let chunks = self.chunks.iter().filter(move |(_, chunk)| chunk.newest > revision);
        chunks.flat_map(move |(number, chunk)| {
            let later = chunk.blocks.iter().filter(move |(_, stamp)| stamp.revision > revision);
            later.map(move |(place, stamp)| (BlockAddress::from_morton(number << BITS | u64::from(*place)), *stamp))
        })
    }

    /// The blocks that ever changed, in Z-order.
    pub fn all(&self) -> impl Iterator<Item = (BlockAddress, BlockStamp)> + '_ {
        self.chunks.iter().flat_map(|(number, chunk)| {
            let all = chunk.blocks.iter();
            all.map(move |(place, stamp)| (BlockAddress::from_morton(number << BITS | u64::from(*place)), *stamp))
        })
    }
}

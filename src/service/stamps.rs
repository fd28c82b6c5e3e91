//! When blocks last changed, as answers tell it.

use super::answers::BlockChange;
use crate::quadtree::{BLOCK_LEVELS, BlockAddress, Grid, LeafRange, NodeAddress};
use crate::store::{BlockStamp, BlockStamps};
use std::collections::BTreeMap;

/// Boxes of at most so many blocks are asked block by block, larger ones by going through all that ever changed.
const FEW_BLOCKS: u64 = 1024;

/// The time of a change; `None` where it was not kept.
pub(super) fn time_of(stamp: BlockStamp) -> Option<f64> {
    (stamp.changed > 0.0).then_some(stamp.changed)
}

/// The blocks of a map in a box of its leaves.
#[derive(Debug, Clone, Copy)]
pub(super) struct BlockBox {
    map_depth: u8,
    area: LeafRange,
}

impl BlockBox {
    pub(super) fn new(grid: &Grid, area: &LeafRange) -> Self {
        Self { map_depth: grid.depth(), area: *area }
    }

    /// Levels below a block; a map that is smaller than one is one block.
    fn levels(&self) -> u8 {
        self.map_depth.min(BLOCK_LEVELS)
    }

    /// Depth of the nodes that stand for blocks in answers with cells of `depth`: a coarser one stands for several.
    pub(super) fn node_depth(&self, depth: u8) -> u8 {
        (self.map_depth - self.levels()).min(depth)
    }

    fn meets(&self, block: BlockAddress) -> bool {
        let (area, levels) = (&self.area, self.levels());
        let (left, bottom, side) = (block.x << levels, block.y << levels, 1 << levels);
        !area.is_empty()
            && left < area.max_x
            && bottom < area.max_y
            && left + side > area.min_x
            && bottom + side > area.min_y
    }

    /// The blocks in the box that ever changed.
    pub(super) fn changed(&self, stamps: &BlockStamps) -> Vec<(BlockAddress, BlockStamp)> {
        let (area, levels) = (&self.area, self.levels());
        if area.is_empty() {
            return Vec::new();
        }
        let columns = (area.min_x >> levels)..((area.max_x - 1) >> levels) + 1;
        let rows = (area.min_y >> levels)..((area.max_y - 1) >> levels) + 1;
        if u64::from(columns.end - columns.start) * u64::from(rows.end - rows.start) > FEW_BLOCKS {
            return stamps.all().filter(|(block, _)| self.meets(*block)).collect();
        }
        let addresses = rows.flat_map(|y| columns.clone().map(move |x| BlockAddress { x, y }));
        addresses.filter_map(|block| Some((block, stamps.get(block)?))).collect()
    }

    /// The nodes that stand for those of the blocks that meet the box, in Z-order, each with the last change below it.
    pub(super) fn nodes(
        &self,
        depth: u8,
        blocks: impl IntoIterator<Item = (BlockAddress, BlockStamp)>,
    ) -> Vec<(NodeAddress, BlockStamp)> {
        let node_depth = self.node_depth(depth);
        let shift = 2 * (self.map_depth - self.levels() - node_depth);
        // By Morton code of the node: that of a coarser node is a prefix, so the order stays.
        let mut nodes: BTreeMap<u64, BlockStamp> = BTreeMap::new();
        for (block, stamp) in blocks.into_iter().filter(|(block, _)| self.meets(*block)) {
            let last = nodes.entry(block.morton() >> shift).or_insert(stamp);
            if stamp.revision > last.revision {
                *last = stamp;
            }
        }
        let node = |(code, stamp): (u64, BlockStamp)| {
            let BlockAddress { x, y } = BlockAddress::from_morton(code);
            (NodeAddress { depth: node_depth, x, y }, stamp)
        };
        nodes.into_iter().map(node).collect()
    }
}

/// A changed node without its contents.
pub(super) fn bare((node, stamp): (NodeAddress, BlockStamp)) -> BlockChange {
    BlockChange { node, revision: stamp.revision, changed: time_of(stamp), classes: Vec::new() }
}

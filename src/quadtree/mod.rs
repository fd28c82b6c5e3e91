//! Floor 1: the k-class occupancy quadtree map (k-OQM), model section 3.
//!
//! The lowest six levels of the tree are held as one [`Block`] of 64 x 64 leaf classes with its pyramid of maxima; a
//! block of one class is a single node. Above stands a sparse quadtree. Trees are persistent: a clone is one `Arc`
//! and shares every block that is not changed afterwards, so a reader holds one revision while a writer goes on.

mod address;
mod block;
mod class;
mod exact;
mod grid;
mod masks;
mod paged;
mod paving;
mod reference;
mod search;
mod slot;
mod tree;
mod walk;

pub use address::{BLOCK_LEVELS, BLOCK_SIDE, BlockAddress, LeafRange, NodeAddress};
pub use block::Block;
pub use class::{Class, ClassScale, ClassScaleError};
pub use grid::{Grid, GridError, MAX_CELL_SLACK, MAX_COORDINATE, MAX_DEPTH, MAX_RESOLUTION, MIN_RESOLUTION};
pub use masks::{BlockMasks, LeafMasks, RowMask};
pub use paged::{
    Access, BlockCache, BlockCell, BlockPager, BlockSource, BlockTag, CacheStatistics, Held, PageError, PagedBlock,
    PagedTree, SourceError,
};
pub use paving::OccupancyPaving;
pub use reference::{ReferenceNode, ReferenceTree};
pub use search::Searcher;
pub use slot::BlockSlot;
pub use tree::{BlockView, Leaf, OccupancyTree, Tree};
pub use walk::{Descent, TreeStatistics};

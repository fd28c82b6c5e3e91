//! Sets of leaves as bit masks a block: the evidence of one scan.

use super::BlockAddress;

/// One bit a leaf of a block: word `y`, bit `x`.
pub type RowMask = [u64; 64];

/// Which leaves of one block a scan says something about. `occupied` and `empty` have no leaf in common.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum BlockMasks {
    /// Every leaf of the block is empty.
    AllEmpty,
    /// Some leaves.
    Some {
        /// Leaves of X_OCC.
        occupied: Box<RowMask>,
        /// Leaves of X_EMP less X_OCC.
        empty: Box<RowMask>,
    },
}

/// The leaf sets X_OCC and X_EMP of one scan, held to the map's root; blocks in no particular order, each once.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct LeafMasks {
    /// The blocks about which the scan says something.
    pub blocks: Vec<(BlockAddress, BlockMasks)>,
}

impl LeafMasks {
    /// Number of leaves in X_OCC and in X_EMP.
    #[must_use]
    pub fn counts(&self) -> (u64, u64) {
        let ones = |mask: &RowMask| mask.iter().map(|w| u64::from(w.count_ones())).sum::<u64>();
        self.blocks.iter().fold((0, 0), |(o, e), (_, masks)| match masks {
            BlockMasks::AllEmpty => (o, e + 64 * 64),
            BlockMasks::Some { occupied, empty } => (o + ones(occupied), e + ones(empty)),
        })
    }
}

//! Addresses of nodes, blocks and ranges of leaves.

/// Levels of the tree that one block holds.
pub const BLOCK_LEVELS: u8 = 6;

/// Leaves along one side of a block.
pub const BLOCK_SIDE: u32 = 1 << BLOCK_LEVELS;

/// The address of a node: depth 0 is the root, `x` counts from the root's `min_x`, `y` from its `min_y` upwards.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct NodeAddress {
    /// Depth, 0 for the root.
    pub depth: u8,
    /// Column, `0..2^depth`.
    pub x: u32,
    /// Row, `0..2^depth`.
    pub y: u32,
}

/// The address of a block of 64 x 64 leaves: leaf coordinates divided by 64.
///
/// A map of depth below 6 has the one block `(0, 0)`, of which only the lowest `2^depth` rows and columns exist.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct BlockAddress {
    /// Column.
    pub x: u32,
    /// Row.
    pub y: u32,
}

impl BlockAddress {
    /// The Morton code: bits of `x` at even, of `y` at odd positions, so the order is the Z-order.
    #[must_use]
    pub fn morton(self) -> u64 {
        spread(self.x) | spread(self.y) << 1
    }

    /// The block of a Morton code.
    #[must_use]
    pub fn from_morton(code: u64) -> Self {
        Self { x: gather(code), y: gather(code >> 1) }
    }
}

/// A half-open box of leaves `[min_x, max_x) x [min_y, max_y)`; empty when a side is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct LeafRange {
    /// First column.
    pub min_x: u32,
    /// First row.
    pub min_y: u32,
    /// Column behind the last.
    pub max_x: u32,
    /// Row behind the last.
    pub max_y: u32,
}

impl LeafRange {
    /// True when it holds no leaf.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.min_x >= self.max_x || self.min_y >= self.max_y
    }
}

fn spread(v: u32) -> u64 {
    let mut v = u64::from(v);
    v = (v | v << 16) & 0x0000_ffff_0000_ffff;
    v = (v | v << 8) & 0x00ff_00ff_00ff_00ff;
    v = (v | v << 4) & 0x0f0f_0f0f_0f0f_0f0f;
    v = (v | v << 2) & 0x3333_3333_3333_3333;
    (v | v << 1) & 0x5555_5555_5555_5555
}

fn gather(code: u64) -> u32 {
    let mut v = code & 0x5555_5555_5555_5555;
    v = (v | v >> 1) & 0x3333_3333_3333_3333;
    v = (v | v >> 2) & 0x0f0f_0f0f_0f0f_0f0f;
    v = (v | v >> 4) & 0x00ff_00ff_00ff_00ff;
    v = (v | v >> 8) & 0x0000_ffff_0000_ffff;
    ((v | v >> 16) & 0xffff_ffff) as u32
}

//! A window of any size, in tiles aligned with the map's blocks that come into being when something is drawn on them: for
//! scans that reach beyond a dense window ([`super::window`]).

use super::sheet::{BOUNDARY, FILLED, OCCUPIED, Plane, Sheet, TILE_SHIFT, TOGGLE, fill};
use crate::quadtree::{BLOCK_SIDE, BlockAddress, BlockMasks, LeafMasks, RowMask};

const NO_TILE: u32 = u32::MAX;

/// 64 x 64 leaves, word `y`, bit `x`, of every plane.
#[derive(Debug, Clone)]
struct Tile {
    planes: [RowMask; 4],
}

impl Tile {
    const BLANK: Self = Self { planes: [[0; 64]; 4] };
}

/// A window of tiles. Tiles come into being when something is drawn on them.
#[derive(Debug, Default)]
pub(super) struct Canvas {
    /// Block coordinates of the window's first tile; may lie outside the root.
    base: (i64, i64),
    /// Tiles along x and y.
    size: (i32, i32),
    slots: Vec<u32>,
    tiles: Vec<Tile>,
    used: usize,
}

impl Canvas {
    /// Starts a blank window.
    pub(super) fn begin(&mut self, base: (i64, i64), size: (i32, i32)) {
        self.base = base;
        self.size = size;
        self.used = 0;
        self.slots.clear();
        self.slots.resize((size.0 * size.1) as usize, NO_TILE);
    }

    fn tile(&mut self, tile_x: i32, tile_y: i32) -> &mut Tile {
        let slot = &mut self.slots[(tile_y * self.size.0 + tile_x) as usize];
        if *slot == NO_TILE {
            *slot = self.used as u32;
            if self.used == self.tiles.len() {
                self.tiles.push(Tile::BLANK);
            } else {
                self.tiles[self.used] = Tile::BLANK;
            }
            self.used += 1;
        }
        &mut self.tiles[*slot as usize]
    }

    /// The leaf sets drawn, held to a root of `2^depth` leaves a side.
    pub(super) fn masks(&self, depth: u8) -> LeafMasks {
        let root_side = 1i64 << depth;
        let blocks = (root_side / i64::from(BLOCK_SIDE)).max(1);
        // A root smaller than a block owns only the lowest rows and columns of it.
        let valid = if depth < 6 { (1u64 << root_side) - 1 } else { u64::MAX };
        let mut out = LeafMasks::default();
        for tile_y in 0..self.size.1 {
            let block_y = self.base.1 + i64::from(tile_y);
            if !(0..blocks).contains(&block_y) {
                continue;
            }
            let mut carry = [0u64; 64];
            for tile_x in 0..self.size.0 {
                let slot = self.slots[(tile_y * self.size.0 + tile_x) as usize];
                let planes = (slot != NO_TILE).then(|| &self.tiles[slot as usize].planes);
                let masks = tile_masks(planes, &mut carry, valid);
                let block_x = self.base.0 + i64::from(tile_x);
                if let Some(masks) = masks
                    && (0..blocks).contains(&block_x)
                {
                    out.blocks.push((BlockAddress { x: block_x as u32, y: block_y as u32 }, masks));
                }
            }
        }
        out
    }
}

impl Sheet for Canvas {
    fn span<const PLANE: Plane>(&mut self, row: i32, first: i32, last: i32) {
        let first = first.max(0);
        let last = last.min((self.size.0 << TILE_SHIFT) - 1);
        if row < 0 || row >= self.size.1 << TILE_SHIFT || first > last {
            return;
        }
        let (tile_y, y) = (row >> TILE_SHIFT, (row & 63) as usize);
        for tile_x in first >> TILE_SHIFT..=last >> TILE_SHIFT {
            let left = tile_x << TILE_SHIFT;
            let from = (first - left).max(0);
            let to = (last - left).min(63);
            let mask = (u64::MAX >> (63 - (to - from))) << from;
            self.tile(tile_x, tile_y).planes[PLANE][y] |= mask;
        }
    }

    fn toggle(&mut self, row: i32, column: i32) {
        let width = self.size.0 << TILE_SHIFT;
        if row < 0 || row >= self.size.1 << TILE_SHIFT || column >= width {
            return;
        }
        let column = column.max(0);
        let tile = self.tile(column >> TILE_SHIFT, row >> TILE_SHIFT);
        tile.planes[TOGGLE][(row & 63) as usize] ^= 1 << (column & 63);
    }

    fn keep_star(&mut self) {
        for tile_y in 0..self.size.1 {
            let mut carry = [0u64; 64];
            for tile_x in 0..self.size.0 {
                let slot = self.slots[(tile_y * self.size.0 + tile_x) as usize];
                if slot == NO_TILE && carry.iter().all(|word| *word == 0) {
                    continue;
                }
                let tile = self.tile(tile_x, tile_y);
                let inside = fill(&tile.planes[TOGGLE], &mut carry);
                for (y, word) in inside.iter().enumerate() {
                    tile.planes[FILLED][y] |= word & !tile.planes[BOUNDARY][y];
                }
                tile.planes[BOUNDARY] = [0; 64];
                tile.planes[TOGGLE] = [0; 64];
            }
        }
    }
}

fn tile_masks(planes: Option<&[RowMask; 4]>, carry: &mut RowMask, valid: u64) -> Option<BlockMasks> {
    let Some(planes) = planes else {
        let (all, any) = carry.iter().fold((u64::MAX, 0), |(all, any), word| (all & word, any | word));
        return match (all, any) {
            (_, 0) => None,
            (u64::MAX, _) if valid == u64::MAX => Some(BlockMasks::AllEmpty),
            _ => Some(clipped([0; 64], *carry, valid)).filter(says_something),
        };
    };
    let mut empty = fill(&planes[TOGGLE], carry);
    for (y, word) in empty.iter_mut().enumerate() {
        *word = ((*word & !planes[BOUNDARY][y]) | planes[FILLED][y]) & !planes[OCCUPIED][y];
    }
    Some(clipped(planes[OCCUPIED], empty, valid)).filter(says_something)
}

fn clipped(mut occupied: RowMask, mut empty: RowMask, valid: u64) -> BlockMasks {
    if valid != u64::MAX {
        for y in 0..64 {
            let row = if valid >> y & 1 == 1 { valid } else { 0 };
            occupied[y] &= row;
            empty[y] &= row;
        }
    }
    BlockMasks::Some { occupied: Box::new(occupied), empty: Box::new(empty) }
}

fn says_something(masks: &BlockMasks) -> bool {
    match masks {
        BlockMasks::AllEmpty => true,
        BlockMasks::Some { occupied, empty } => {
            occupied.iter().zip(empty.iter()).any(|(occupied, empty)| occupied | empty != 0)
        }
    }
}

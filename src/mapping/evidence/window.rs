//! A dense window of 64 x 64 tiles about the sensor: what scans of ordinary reach are drawn on.
//!
//! Words stand in columns: word `tile_x * 4096 + row` has the 64 leaves of a row that lie in the tile column `tile_x`, so the
//! rows that a small piece of the boundary touches are words side by side. Tiles are aligned with the map's blocks. Nothing
//! is blanked as a whole: emission blanks the tiles that were touched, so a window is blank between scans.

use super::sheet::{FILLED, Plane, Sheet, TILE_SHIFT, TOGGLE, fill};
use crate::quadtree::{BLOCK_SIDE, BlockAddress, BlockMasks, LeafMasks, RowMask};
use crate::vector::{Path, on_each_path};

/// Tiles along one side.
pub(super) const TILES: usize = 64;

/// Leaves along one side.
pub(super) const SIDE: usize = TILES * BLOCK_SIDE as usize;

/// Words of one plane.
const WORDS: usize = TILES * SIDE;

/// One plane: a bit a leaf.
pub(super) type Bits = [u64; WORDS];

/// Memory of one plane that begins with a cache line. There is none until a drawing begins, so that a window that draws nothing
/// costs nothing.
#[derive(Debug, Default)]
pub(super) struct PlaneMemory {
    memory: Vec<u64>,
    start: usize,
}

impl PlaneMemory {
    /// Sees to it that there is memory. It comes blank from the system, page by page when it is first used.
    fn prepare(&mut self) {
        if self.memory.is_empty() {
            self.memory = vec![0; WORDS + 8];
            // Where the address of an allocation cannot be told, any start will do.
            self.start = Some(self.memory.as_ptr().align_offset(64)).filter(|start| *start < 8).unwrap_or(0);
        }
    }

    /// The plane, after [`Window::begin`].
    pub(super) fn bits(&mut self) -> &mut Bits {
        match self.memory[self.start..].first_chunk_mut() {
            Some(bits) => bits,
            None => unreachable!("a drawing has begun, and eight words more than a plane has were taken"),
        }
    }
}

/// Which tiles hold anything, `tile_y * 64 + tile_x`; 1 or 0.
pub(super) type Touched = [u8; TILES * TILES];

/// Two masks of one block: X_OCC and X_EMP.
type Pair = (Box<RowMask>, Box<RowMask>);

/// The window. A sensor stands in the tile in the middle.
#[derive(Debug)]
pub(super) struct Window {
    /// Block coordinates of the first tile; may lie outside the root.
    base: (i64, i64),
    pub(super) planes: [PlaneMemory; 4],
    pub(super) touched: Box<Touched>,
    /// Tiles about the middle one that can be touched.
    reach: usize,
    /// True when anything is in [`FILLED`].
    filled: bool,
    /// Memory of masks that are no longer wanted.
    spare: Vec<Pair>,
}

impl Default for Window {
    fn default() -> Self {
        Self {
            base: (0, 0),
            planes: Default::default(),
            touched: Box::new([0; TILES * TILES]),
            reach: 0,
            filled: false,
            spare: Vec::new(),
        }
    }
}

/// The words of one tile, `tile_x * 64 + tile_y`.
fn of_tile(plane: &mut Bits, tile: usize) -> &mut RowMask {
    &mut plane.as_chunks_mut::<64>().0[tile]
}

/// Where a word of a plane is: of the tile column of a leaf's column, and its row. Both are in `0..4096`.
#[inline(always)]
pub(super) fn word_at(column: usize, row: usize) -> usize {
    (((column << TILE_SHIFT) & !(SIDE - 1)) | row) & (WORDS - 1)
}

/// Where a tile's byte is.
#[inline(always)]
pub(super) fn tile_at(column: usize, row: usize) -> usize {
    ((row >> TILE_SHIFT) << 6 | column >> TILE_SHIFT) & (TILES * TILES - 1)
}

/// Rows and columns that a small mask can have.
pub(super) const MASK_ROWS: i32 = 8;
pub(super) const MASK_COLUMNS: i32 = 16;

/// Masks of up to 16 columns for 8 rows: 16 bits a row, four rows a word.
pub(super) type SmallMask = [u64; 2];

/// Eight rows of a tile column, from a multiple of eight on: one cache line. Small pieces are drawn by whole lines, since
/// neighbours fall onto the same ones: a processor hands on what it has just stored only where the next load is the same.
type Line = [u64; 8];

/// The line of a leaf's column and row, and the one in the next tile column.
#[inline(always)]
fn lines(bits: &mut Bits, column: usize, row: usize) -> &mut [Line] {
    &mut bits.as_chunks_mut::<8>().0[word_at(column, row) / 8..]
}

const NEXT_TILE: usize = SIDE / 8;

/// A mask whose first row is in row `row` as the rows of two lines: the one of that row, and the one above it.
#[inline(always)]
pub(super) fn aligned(mask: SmallMask, row: i32) -> (SmallMask, SmallMask) {
    let up = 16 * (row & 3) as u32;
    let over = |word: u64| word >> 1 >> (63 - up);
    let (first, second, third) = (mask[0] << up, mask[1] << up | over(mask[0]), over(mask[1]));
    if row & 4 == 0 { ([first, second], [third, 0]) } else { ([0, first], [second, third]) }
}

/// The columns from `floor(first)` to `floor(last)` as bits, both held to a mask's sixteen; `first <= last`.
///
/// As `2^(last + 1) - 2^first`, with the integers brought into the exponents of floats: all processors do that in vectors,
/// while not all can shift by a vector, or compare integers for the larger.
#[inline(always)]
pub(super) fn columns_mask(first: f32, last: f32) -> u32 {
    // Adding 1.5 * 2^23 leaves the rounded integer in the low bits, adding 2^23 an integer below that.
    const SHIFT: f32 = 12_582_912.0;
    const WHOLE: f32 = 8_388_608.0;
    let power = |v: f32, more: u32| {
        let v = v - 0.5;
        let v = if v > -0.5 { v } else { -0.5 };
        let v = if v < 15.25 { v } else { 15.25 };
        f32::from_bits(((v + SHIFT).to_bits() << 23).wrapping_add((127 + more) << 23))
    };
    (power(last, 1) - power(first, 0) + WHOLE).to_bits() & 0x7f_ffff
}

/// The mask of lane `k` from pairs of rows.
#[inline(always)]
pub(super) fn joined<const LANES: usize>(pairs: &[[u32; LANES]; 4], k: usize) -> SmallMask {
    let join = |low: usize| u64::from(pairs[low][k]) | u64::from(pairs[low + 1][k]) << 32;
    [join(0), join(2)]
}

/// Combines one line with a small mask of its rows whose first column is `column`; the last set column is at most `columns`
/// further.
#[inline(always)]
pub(super) fn draw_line(
    bits: &mut Bits,
    (column, row): (usize, usize),
    columns: usize,
    mask: SmallMask,
    with: impl Fn(&mut u64, u64),
) {
    let row_of = |i: usize| mask[i / 4] >> (16 * (i % 4)) & 0xffff;
    draw_rows(bits, (column, row), columns, row_of, with);
}

/// As [`draw_line`], with the same columns in all rows of the set `rows`.
#[inline(always)]
pub(super) fn draw_block(bits: &mut Bits, (column, row): (usize, usize), columns: usize, rows: u64) {
    let mask = (2_u64 << columns) - 1;
    let row_of = |i: usize| if rows & 1 << i == 0 { 0 } else { mask };
    draw_rows(bits, (column, row), columns, row_of, |word, mask| *word |= mask);
}

#[inline(always)]
fn draw_rows(
    bits: &mut Bits,
    (column, row): (usize, usize),
    columns: usize,
    row_of: impl Fn(usize) -> u64,
    with: impl Fn(&mut u64, u64),
) {
    let lines = lines(bits, column, row);
    let shift = column & 63;
    for (i, word) in lines[0].iter_mut().enumerate() {
        with(word, row_of(i) << shift);
    }
    if shift + columns > 63 {
        for (i, word) in lines[NEXT_TILE].iter_mut().enumerate() {
            with(word, row_of(i) >> (64 - shift));
        }
    }
}

/// Byte `i`, 0 or 1, as bit `i`; at most 64 bytes, a multiple of eight.
#[inline(always)]
pub(super) fn pack<const N: usize>(bytes: &[u8; N]) -> u64 {
    let mut word = 0;
    for (i, eight) in bytes.as_chunks::<8>().0.iter().enumerate() {
        // The factor brings bit 8 i to bit 56 + i, and nothing else to a bit from 56 on.
        word |= (u64::from_le_bytes(*eight).wrapping_mul(0x0102_0408_1020_4080) >> 56) << (8 * i);
    }
    word
}

/// Which numbers are not negative, as bits.
#[inline(always)]
pub(super) fn not_negative(numbers: &[i32; 16]) -> u64 {
    let mut bytes = [0; 16];
    for (byte, number) in bytes.iter_mut().zip(numbers) {
        *byte = (!*number as u32 >> 31) as u8;
    }
    pack(&bytes)
}

/// Notes that leaves of a line are touched.
#[inline(always)]
pub(super) fn touch(touched: &mut Touched, (column, row): (usize, usize), columns: usize) {
    touched[tile_at(column, row)] = 1;
    if (column & 63) + columns > 63 {
        touched[tile_at(column + columns, row)] = 1;
    }
}

impl Window {
    /// Bytes of the planes.
    pub(super) fn bytes(&self) -> usize {
        self.planes.iter().map(|plane| size_of_val(plane.memory.as_slice())).sum()
    }

    /// Starts a drawing on the blank window, whose sensor stands in the middle tile; nothing is drawn farther than `reach`
    /// leaves from that tile.
    pub(super) fn begin(&mut self, base: (i64, i64), reach: f64) {
        self.planes.iter_mut().for_each(PlaneMemory::prepare);
        self.base = base;
        self.reach = (reach / f64::from(BLOCK_SIDE)) as usize + 1;
        self.filled = false;
    }

    /// Gives back masks that are no longer wanted, for [`Window::emit`] to write into.
    pub(super) fn recycle(&mut self, masks: &mut LeafMasks) {
        for (_, masks) in masks.blocks.drain(..) {
            if let BlockMasks::Some { occupied, empty } = masks {
                self.spare.push((occupied, empty));
            }
        }
    }

    /// The leaf sets drawn, held to a root of `2^depth` leaves a side; blanks the window.
    pub(super) fn emit(&mut self, path: Path, depth: u8, out: &mut LeafMasks) {
        let root_side = 1_i64 << depth;
        let blocks = (root_side / i64::from(BLOCK_SIDE)).max(1);
        let tiles = (TILES / 2).saturating_sub(self.reach)..(TILES / 2 + self.reach + 1).min(TILES);
        for tile_y in tiles.clone() {
            let y = self.base.1 + tile_y as i64;
            let mut carry = [0; 64];
            for tile_x in tiles.clone() {
                let x = self.base.0 + tile_x as i64;
                let in_root = (0..blocks).contains(&x) && (0..blocks).contains(&y);
                let address = BlockAddress { x: x as u32, y: y as u32 };
                if self.touched[tile_y * TILES + tile_x] == 0 {
                    // No boundary in it: all of it is inside or all is outside.
                    if carry[0] != 0 && in_root {
                        out.blocks.push((address, all_empty(depth)));
                    }
                    continue;
                }
                self.touched[tile_y * TILES + tile_x] = 0;
                let (mut occupied, mut empty) =
                    self.spare.pop().unwrap_or_else(|| (Box::new([0; 64]), Box::new([0; 64])));
                let says = self.take(path, tile_x * TILES + tile_y, &mut carry, (&mut occupied, &mut empty));
                if says && in_root {
                    let mut masks = BlockMasks::Some { occupied, empty };
                    if depth < 6 {
                        clip(&mut masks, depth);
                    }
                    out.blocks.push((address, masks));
                } else {
                    self.spare.push((occupied, empty));
                }
            }
        }
    }

    /// Takes the leaf sets of one touched tile and blanks it; false when they are empty.
    fn take(
        &mut self,
        path: Path,
        tile: usize,
        carry: &mut RowMask,
        (occupied, empty): (&mut RowMask, &mut RowMask),
    ) -> bool {
        let [occupied_bits, boundary, toggle, filled] = &mut self.planes;
        let planes =
            (of_tile(occupied_bits.bits(), tile), of_tile(boundary.bits(), tile), of_tile(toggle.bits(), tile));
        let says = take_tile(path, planes.0, planes.1, planes.2, carry, occupied, empty);
        if !self.filled {
            return says;
        }
        let filled = of_tile(filled.bits(), tile);
        let mut any = 0;
        for y in 0..64 {
            empty[y] |= filled[y] & !occupied[y];
            any |= occupied[y] | empty[y];
            filled[y] = 0;
        }
        any != 0
    }
}

on_each_path! {
    /// Reads and blanks the planes of a tile: `empty = inside & !boundary & !occupied`. False when both sets are empty.
    fn take_tile(
        occupied_bits: &mut RowMask,
        boundary: &mut RowMask,
        toggle: &mut RowMask,
        carry: &mut RowMask,
        occupied: &mut RowMask,
        empty: &mut RowMask,
    ) -> bool {
        *occupied = *occupied_bits;
        *empty = fill(toggle, carry);
        let mut any = 0;
        for y in 0..64 {
            empty[y] &= !(boundary[y] | occupied[y]);
            any |= occupied[y] | empty[y];
        }
        *occupied_bits = [0; 64];
        *boundary = [0; 64];
        *toggle = [0; 64];
        any != 0
    }
}

/// All leaves of a block that exist in a root of `depth`, empty.
fn all_empty(depth: u8) -> BlockMasks {
    if depth >= 6 {
        return BlockMasks::AllEmpty;
    }
    let mut masks = BlockMasks::Some { occupied: Box::new([0; 64]), empty: Box::new([u64::MAX; 64]) };
    clip(&mut masks, depth);
    masks
}

/// Takes away the leaves that do not exist in a root smaller than a block: it owns only the lowest rows and columns.
fn clip(masks: &mut BlockMasks, depth: u8) {
    let BlockMasks::Some { occupied, empty } = masks else { return };
    let side = 1_usize << depth;
    let row = (1_u64 << side) - 1;
    for y in 0..64 {
        let exists = if y < side { row } else { 0 };
        occupied[y] &= exists;
        empty[y] &= exists;
    }
}

impl Sheet for Window {
    fn span<const PLANE: Plane>(&mut self, row: i32, first: i32, last: i32) {
        let (first, last) = (first.max(0), last.min(SIDE as i32 - 1));
        if row < 0 || row >= SIDE as i32 || first > last {
            return;
        }
        self.filled |= PLANE == FILLED;
        let row = row as usize;
        for tile_x in first >> TILE_SHIFT..=last >> TILE_SHIFT {
            let left = tile_x << TILE_SHIFT;
            let (from, to) = ((first - left).max(0), (last - left).min(63));
            let mask = (u64::MAX >> (63 - (to - from))) << from;
            self.planes[PLANE].bits()[word_at(left as usize, row)] |= mask;
            self.touched[tile_at(left as usize, row)] = 1;
        }
    }

    fn toggle(&mut self, row: i32, column: i32) {
        if row < 0 || row >= SIDE as i32 || column >= SIDE as i32 {
            return;
        }
        let (row, column) = (row as usize, column.max(0) as usize);
        self.planes[TOGGLE].bits()[word_at(column, row)] ^= 1 << (column & 63);
        self.touched[tile_at(column, row)] = 1;
    }

    fn keep_star(&mut self) {
        self.filled = true;
        for tile_y in 0..TILES {
            let mut carry = [0; 64];
            for tile_x in 0..TILES {
                let touched = &mut self.touched[tile_y * TILES + tile_x];
                if *touched == 0 && carry[0] == 0 {
                    continue;
                }
                *touched = 1;
                let tile = tile_x * TILES + tile_y;
                let [_, boundary, toggle, filled] = &mut self.planes;
                let boundary = of_tile(boundary.bits(), tile);
                let toggle = of_tile(toggle.bits(), tile);
                let inside = fill(toggle, &mut carry);
                for (y, filled) in of_tile(filled.bits(), tile).iter_mut().enumerate() {
                    *filled |= inside[y] & !boundary[y];
                }
                *boundary = [0; 64];
                *toggle = [0; 64];
            }
        }
    }
}

//! A block as bits: its quadtree in pre-order.
//!
//! A node above the leaves begins with a bit: 1 when it is split, and its four children follow in Z-order (x is the
//! lower bit); 0 when it is of one class, and the class follows. A leaf is its class alone. A class is `class - 1` in 4
//! bits where `k <= 16`, else in 8; bits fill bytes from the highest down, and the last byte is filled with zeros. A
//! split node whose children are all of one class is not allowed, so every block has one form.
//!
//! In a map of depth `d < 6` the one block is the quadtree of its lowest `2^d` rows and columns; decoded, the leaves that
//! do not exist have the lowest class, as in the tree.

use super::bytes::Malformed;
use crate::quadtree::{BLOCK_LEVELS, BLOCK_SIDE, Block, BlockView, Class, ClassScale};
use std::sync::Arc;

/// Leaves along one side.
const SIDE: usize = BLOCK_SIDE as usize;

/// Levels of a block above its leaves.
const LEVELS: usize = BLOCK_LEVELS as usize;

/// The longest form: 1 + 4 + ... + 1,024 split bits and 4,096 classes of 8 bits.
pub(super) const MAX_ENCODED: usize = (1365 + 4096 * 8_usize).div_ceil(8);

type Leaves = [Class; SIDE * SIDE];

/// How blocks of one map are written.
#[derive(Debug, Clone, Copy)]
pub(super) struct BlockCodec {
    scale: ClassScale,
    /// The level of a block's root: 0, or more where the map is shallower than a block.
    root: usize,
    /// Bits of a class.
    width: u32,
}

impl BlockCodec {
    /// The codec of a map with leaves at `depth`.
    pub(super) fn new(depth: u8, scale: ClassScale) -> Self {
        let root = LEVELS.saturating_sub(usize::from(depth.max(1)));
        Self { scale, root, width: if scale.count() <= 16 { 4 } else { 8 } }
    }

    /// The highest class of the scale.
    pub(super) fn highest(&self) -> Class {
        self.scale.count()
    }

    /// Appends a block.
    ///
    /// # Errors
    /// When a class is not of the scale; nothing is appended then.
    pub(super) fn encode(&self, view: &BlockView, out: &mut Vec<u8>) -> Result<(), Malformed> {
        match view {
            BlockView::Uniform(class) => {
                self.check(*class)?;
                let mut bits = BitWriter::new(out);
                bits.push(u64::from(class - 1), self.width + 1);
                bits.finish();
            }
            BlockView::Mixed(block) => {
                let leaves = block.leaves();
                let side = SIDE >> self.root;
                for row in leaves.chunks_exact(SIDE).take(side) {
                    let low = row[..side].iter().fold(u8::MAX, |low, class| low.min(*class));
                    let high = row[..side].iter().fold(0, |high, class| high.max(*class));
                    self.check(low)?;
                    self.check(high)?;
                }
                let split = SplitNodes::of(leaves);
                let mut encoder = Encoder { leaves, split: &split, width: self.width, bits: BitWriter::new(out) };
                encoder.node(self.root, 0, 0);
                encoder.bits.finish();
            }
        }
        Ok(())
    }

    fn check(&self, class: Class) -> Result<(), Malformed> {
        if (1..=self.scale.count()).contains(&class) {
            Ok(())
        } else {
            Err(Malformed(format!("class {class} is not in 1..={}", self.scale.count())))
        }
    }

    /// Reads a block.
    ///
    /// # Errors
    /// Unless the bytes are exactly one block in its one form with classes of the scale.
    pub(super) fn decode(&self, bytes: &[u8]) -> Result<BlockView, Malformed> {
        let mut decoder = Decoder { bits: BitReader::new(bytes)?, width: self.width, count: self.scale.count() };
        if decoder.bits.read(1)? == 0 {
            let class = decoder.class()?;
            decoder.bits.finish()?;
            return Ok(BlockView::Uniform(class));
        }
        let mut leaves: Box<Leaves> = Box::new([self.scale.free(); SIDE * SIDE]);
        decoder.children(&mut leaves, self.root, 0, 0)?;
        decoder.bits.finish()?;
        Ok(BlockView::Mixed(Arc::new(Block::from_leaves(leaves))))
    }
}

/// Which nodes of a block are split: bit `x` of word `y` of each level above the leaves.
struct SplitNodes {
    levels: [[u32; 32]; LEVELS],
}

impl SplitNodes {
    fn of(leaves: &Leaves) -> Self {
        let mut levels = [[0; 32]; LEVELS];
        for (y, word) in levels[LEVELS - 1].iter_mut().enumerate() {
            let (low, high) = leaves[y * 2 * SIDE..(y + 1) * 2 * SIDE].split_at(SIDE);
            *word = differing_pairs(low, high);
        }
        for level in (0..LEVELS - 1).rev() {
            let step = SIDE >> (level + 1);
            let (upper, below) = levels.split_at_mut(level + 1);
            for (y, word) in upper[level].iter_mut().take(1 << level).enumerate() {
                let below = below[0][2 * y] | below[0][2 * y + 1];
                for x in 0..1_usize << level {
                    // The first leaves of the four children tell whether children of one class each are of the same.
                    let corner = 2 * y * step * SIDE + 2 * x * step;
                    let first = leaves[corner];
                    let differ = leaves[corner + step] != first
                        || leaves[corner + step * SIDE] != first
                        || leaves[corner + step * SIDE + step] != first;
                    *word |= u32::from(below >> (2 * x) & 3 != 0 || differ) << x;
                }
            }
        }
        Self { levels }
    }

    fn has(&self, level: usize, x: usize, y: usize) -> bool {
        self.levels[level][y] >> x & 1 == 1
    }
}

/// Bit `x` is set when the four leaves `2x`, `2x + 1` of two rows are not all of one class.
fn differing_pairs(low: &[Class], high: &[Class]) -> u32 {
    let mut word = 0;
    for (x, (low, high)) in low.chunks_exact(8).zip(high.chunks_exact(8)).enumerate() {
        let eight = |row: &[Class]| {
            let mut bytes = [0; 8];
            bytes.copy_from_slice(row);
            u64::from_le_bytes(bytes)
        };
        let (low, high) = (eight(low), eight(high));
        // Per pair of bytes, 0 exactly when the four leaves are equal; folded to the pair's lowest bit.
        let differ = (low ^ high) | ((low ^ low >> 8) & 0x00ff_00ff_00ff_00ff);
        let mut bit = differ | differ >> 8;
        bit |= bit >> 4;
        bit |= bit >> 2;
        bit |= bit >> 1;
        bit &= 0x0001_0001_0001_0001;
        // The four bits 0, 16, 32, 48 side by side.
        let four = (bit | bit >> 15 | bit >> 30 | bit >> 45) & 0xf;
        word |= (four as u32) << (4 * x);
    }
    word
}

struct Encoder<'a> {
    leaves: &'a Leaves,
    split: &'a SplitNodes,
    width: u32,
    bits: BitWriter<'a>,
}

impl Encoder<'_> {
    fn node(&mut self, level: usize, x: usize, y: usize) {
        let shift = LEVELS - level;
        let first = (y << shift) * SIDE + (x << shift);
        let class = |index: usize| u64::from(self.leaves[index] - 1);
        if !self.split.has(level, x, y) {
            self.bits.push(class(first), self.width + 1);
        } else if level == LEVELS - 1 {
            let width = self.width;
            let four = (class(first) << (3 * width))
                | (class(first + 1) << (2 * width))
                | (class(first + SIDE) << width)
                | class(first + SIDE + 1);
            self.bits.push(1 << (4 * width) | four, 4 * width + 1);
        } else {
            self.bits.push(1, 1);
            for child in 0..4 {
                self.node(level + 1, 2 * x + (child & 1), 2 * y + (child >> 1));
            }
        }
    }
}

struct Decoder {
    bits: BitReader,
    width: u32,
    count: u8,
}

impl Decoder {
    fn class(&mut self) -> Result<Class, Malformed> {
        let value = self.bits.read(self.width)?;
        self.checked(value)
    }

    fn checked(&self, value: u64) -> Result<Class, Malformed> {
        if value < u64::from(self.count) {
            Ok(value as Class + 1)
        } else {
            Err(Malformed(format!("class {} is not in 1..={}", value + 1, self.count)))
        }
    }

    /// A node at `level`: its class, or `None` when it is split.
    fn node(&mut self, leaves: &mut Leaves, level: usize, x: usize, y: usize) -> Result<Option<Class>, Malformed> {
        if self.bits.read(1)? == 1 {
            self.children(leaves, level, x, y)?;
            return Ok(None);
        }
        let class = self.class()?;
        let side = SIDE >> level;
        for row in y * side..(y + 1) * side {
            leaves[row * SIDE + x * side..][..side].fill(class);
        }
        Ok(Some(class))
    }

    /// The children of a split node at `level`.
    fn children(&mut self, leaves: &mut Leaves, level: usize, x: usize, y: usize) -> Result<(), Malformed> {
        let merged = if level == LEVELS - 1 {
            let four = self.bits.read(4 * self.width)?;
            let mask = (1 << self.width) - 1;
            let first = 2 * y * SIDE + 2 * x;
            for (child, place) in [first, first + 1, first + SIDE, first + SIDE + 1].into_iter().enumerate() {
                leaves[place] = self.checked(four >> ((3 - child as u32) * self.width) & mask)?;
            }
            let class = leaves[first];
            [first + 1, first + SIDE, first + SIDE + 1].into_iter().all(|place| leaves[place] == class)
        } else {
            let first = self.node(leaves, level + 1, 2 * x, 2 * y)?;
            let mut merged = first.is_some();
            for child in 1..4 {
                merged &= self.node(leaves, level + 1, 2 * x + (child & 1), 2 * y + (child >> 1))? == first;
            }
            merged
        };
        if merged { Err(Malformed::new("a split node of one class")) } else { Ok(()) }
    }
}

/// Appends bits, the highest first.
struct BitWriter<'a> {
    out: &'a mut Vec<u8>,
    /// The low `held` bits are not written yet; fewer than 32 between calls.
    bits: u64,
    held: u32,
}

impl<'a> BitWriter<'a> {
    fn new(out: &'a mut Vec<u8>) -> Self {
        Self { out, bits: 0, held: 0 }
    }

    /// Appends the low `count <= 33` bits of a value that has no higher ones.
    fn push(&mut self, value: u64, count: u32) {
        debug_assert!(count <= 33 && value >> count == 0, "held + count must fit 64 bits");
        self.bits = self.bits << count | value;
        self.held += count;
        while self.held >= 32 {
            self.held -= 32;
            let word = (self.bits >> self.held) as u32;
            self.out.extend_from_slice(&word.to_be_bytes());
        }
    }

    fn finish(self) {
        let Self { out, bits, held } = self;
        if held > 0 {
            let word = (bits << (64 - held)).to_be_bytes();
            out.extend_from_slice(&word[..held.div_ceil(8) as usize]);
        }
    }
}

/// Takes bits, the highest first, from a copy with zeros behind it, so that every load is of eight bytes.
struct BitReader {
    bytes: [u8; MAX_ENCODED + 8],
    length: usize,
    position: usize,
}

impl BitReader {
    fn new(bytes: &[u8]) -> Result<Self, Malformed> {
        if bytes.len() > MAX_ENCODED {
            return Err(Malformed(format!("{} bytes, a block has at most {MAX_ENCODED}", bytes.len())));
        }
        let mut copy = [0; MAX_ENCODED + 8];
        copy[..bytes.len()].copy_from_slice(bytes);
        Ok(Self { bytes: copy, length: bytes.len(), position: 0 })
    }

    /// The next `1..=33` bits.
    fn read(&mut self, count: u32) -> Result<u64, Malformed> {
        let end = self.position + count as usize;
        if end > self.length * 8 {
            return Err(Malformed::new("the block's bits end too soon"));
        }
        let mut eight = [0; 8];
        eight.copy_from_slice(&self.bytes[self.position / 8..][..8]);
        let bits = u64::from_be_bytes(eight) << (self.position % 8) >> (64 - count);
        self.position = end;
        Ok(bits)
    }

    /// Only the zeros that fill the last byte may be left.
    fn finish(mut self) -> Result<(), Malformed> {
        let left = self.length * 8 - self.position;
        if left >= 8 {
            return Err(Malformed(format!("{} bytes too many behind the block", left / 8)));
        }
        if left > 0 && self.read(left as u32)? != 0 {
            return Err(Malformed::new("the bits that fill the last byte are not zero"));
        }
        Ok(())
    }
}

//! A block: the lowest six levels of the tree.

use super::{Class, ClassScale, RowMask};
use crate::vector::{Path, on_each_path, step_rows};
use std::fmt;

/// Leaves of a block.
const LEAVES: usize = 64 * 64;

/// 64 x 64 leaf classes with the maxima of every node above them: 5,461 bytes.
///
/// All classes must be on the scale that [`Block::apply`] is called with.
#[derive(Clone, PartialEq, Eq)]
pub struct Block {
    leaves: [Class; LEAVES],
    maxima: Levels,
}

/// One value for each node of a block above its leaves, by level.
#[derive(Clone, PartialEq, Eq)]
pub(super) struct Levels {
    five: [[Class; 32]; 32],
    four: [[Class; 16]; 16],
    three: [[Class; 8]; 8],
    two: [[Class; 4]; 4],
    one: [[Class; 2]; 2],
    zero: [[Class; 1]; 1],
}

impl Block {
    /// A block all of one class.
    #[must_use]
    pub fn uniform(class: Class) -> Self {
        Self { leaves: [class; LEAVES], maxima: Levels::filled(class) }
    }

    /// A block of the given leaf classes, row `y` at `leaves[y * 64..][..64]`.
    #[must_use]
    #[expect(
        clippy::needless_pass_by_value,
        reason = "callers build the leaves on the heap and have no more use for them"
    )]
    pub fn from_leaves(leaves: Box<[Class; 64 * 64]>) -> Self {
        Self { leaves: *leaves, maxima: Levels::of(&leaves, Class::max) }
    }

    /// The classes of all leaves, row-major from the lowest row.
    #[must_use]
    pub fn leaves(&self) -> &[Class; 64 * 64] {
        &self.leaves
    }

    /// Adds 1 to the leaves in `occupied` and takes 1 from those in `empty`, held to the scale; a leaf in both counts
    /// as occupied. Returns whether a class changed.
    pub fn apply(&mut self, occupied: &RowMask, empty: &RowMask, scale: ClassScale) -> bool {
        let path = Path::best();
        let Some(rows) = self.leaves.as_chunks_mut::<64>().0.first_chunk_mut() else { return false };
        let changed = step_rows(path, rows, occupied, empty, scale.free(), scale.occupied());
        if changed != 0 {
            raise_maxima(path, &mut self.maxima, &self.leaves, changed);
        }
        changed != 0
    }

    /// Takes 1 from every leaf, held to the scale. Returns whether a class changed.
    pub fn apply_all_empty(&mut self, scale: ClassScale) -> bool {
        // The step keeps order, so the maximum of the stepped classes is the stepped maximum.
        let lowest = scale.free();
        let changed = self.maxima.zero[0][0] > lowest;
        let lower = |classes: &mut [Class]| {
            for class in classes {
                *class = class.saturating_sub(1).max(lowest);
            }
        };
        lower(&mut self.leaves);
        self.maxima.slices_mut().into_iter().for_each(lower);
        changed
    }

    /// Whether [`Block::apply`] would change a class.
    #[must_use]
    pub fn would_change(&self, occupied: &RowMask, empty: &RowMask, scale: ClassScale) -> bool {
        let (lowest, highest) = (scale.free(), scale.occupied());
        let some = |row: &[Class; 64], mask: u64, limit: Class| {
            // A byte a leaf: whether its class is not at the limit, and whether its bit is set.
            row.iter().enumerate().any(|(x, class)| *class != limit && mask >> x & 1 == 1)
        };
        self.rows().iter().zip(occupied.iter().zip(empty)).any(|(row, (up, down))| {
            (*up != 0 && some(row, *up, highest)) || (down & !up != 0 && some(row, down & !up, lowest))
        })
    }

    /// The maximum over the node at `level` (0: the block, 6: a leaf), column `x`, row `y` of that level.
    ///
    /// Columns and rows count modulo the level's side, so absolute ones may be given; levels above 6 count as 6.
    #[must_use]
    pub fn max_at(&self, level: u8, x: u32, y: u32) -> Class {
        if level >= 6 {
            return self.leaves[(y as usize % 64) * 64 + x as usize % 64];
        }
        self.maxima.at(level, x, y)
    }

    /// The one class of all leaves, if they have one.
    #[must_use]
    pub fn as_uniform(&self) -> Option<Class> {
        self.node_uniform(0)
    }

    /// The one class of all leaves below the first node of `level` (which has columns and rows `0..2^(6 - level)`).
    ///
    /// The maxima refuse most mixed nodes at once.
    pub(super) fn node_uniform(&self, level: u8) -> Option<Class> {
        let class = self.max_at(level, 0, 0);
        let level = u32::from(level.min(6));
        for below in [2, 3] {
            let side = (1_u32 << below) >> level;
            let same = (0..side).all(|y| (0..side).all(|x| self.max_at(below as u8, x, y) == class));
            if !same {
                return None;
            }
        }
        let side = 64 >> level;
        let expected = [class; 64];
        self.rows()[..side].iter().all(|row| row[..side] == expected[..side]).then_some(class)
    }

    /// The leaves by row.
    pub(super) fn rows(&self) -> &[[Class; 64]] {
        self.leaves.as_chunks::<64>().0
    }

    /// Row `y` of `level`: one maximum a node, all `2^level` of them.
    pub(crate) fn level_row(&self, level: u8, y: u32) -> &[Class] {
        if level >= 6 { &self.rows()[y as usize % 64] } else { self.maxima.row(level, y) }
    }

    /// The minimum of every node above the leaves: where it equals the maximum, the node is a leaf of the quadtree.
    pub(super) fn minima(&self) -> Levels {
        Levels::of(&self.leaves, Class::min)
    }

    /// Number of inner nodes (mixed ones) of the quadtree below the first node of `level`.
    pub(super) fn inner_nodes(&self, level: u8) -> u64 {
        let minima = self.minima();
        // A row has 32 nodes at most, so a byte counts them: that compiles to vector code.
        let mixed = |below: u8| -> u64 {
            let side = 1_u32 << (below - level);
            let row = |y: u32| {
                let pairs = self.maxima.row(below, y).iter().zip(minima.row(below, y));
                u64::from(pairs.take(side as usize).map(|(max, min)| u8::from(max != min)).sum::<u8>())
            };
            (0..side).map(row).sum()
        };
        (level..6).map(mixed).sum()
    }
}

impl fmt::Debug for Block {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Block").field("max", &self.maxima.zero[0][0]).finish_non_exhaustive()
    }
}

impl Levels {
    fn filled(class: Class) -> Self {
        Self {
            five: [[class; 32]; 32],
            four: [[class; 16]; 16],
            three: [[class; 8]; 8],
            two: [[class; 4]; 4],
            one: [[class; 2]; 2],
            zero: [[class; 1]; 1],
        }
    }

    /// The levels above the given leaves; `pick` is the minimum or the maximum.
    fn of(leaves: &[Class; LEAVES], pick: impl Fn(Class, Class) -> Class + Copy) -> Self {
        let mut levels = Self::filled(0);
        levels.update(leaves, u64::MAX, pick);
        levels
    }

    /// Brings the values above the leaf rows of the bit set `rows` up to date.
    #[inline(always)]
    fn update(&mut self, leaves: &[Class; LEAVES], rows: u64, pick: impl Fn(Class, Class) -> Class + Copy) {
        let rows = halve(leaves.as_chunks::<64>().0, &mut self.five, rows, pick);
        let rows = halve(&self.five, &mut self.four, rows, pick);
        let rows = halve(&self.four, &mut self.three, rows, pick);
        let rows = halve(&self.three, &mut self.two, rows, pick);
        let rows = halve(&self.two, &mut self.one, rows, pick);
        halve(&self.one, &mut self.zero, rows, pick);
    }

    fn row(&self, level: u8, y: u32) -> &[Class] {
        let y = y as usize % (1 << level.min(5));
        match level {
            0 => &self.zero[y],
            1 => &self.one[y],
            2 => &self.two[y],
            3 => &self.three[y],
            4 => &self.four[y],
            _ => &self.five[y],
        }
    }

    /// The value of a node above the leaves; levels above 5 count as 5.
    pub(super) fn at(&self, level: u8, x: u32, y: u32) -> Class {
        self.row(level, y)[x as usize % (1 << level.min(5))]
    }

    fn slices_mut(&mut self) -> [&mut [Class]; 6] {
        [
            self.zero.as_flattened_mut(),
            self.one.as_flattened_mut(),
            self.two.as_flattened_mut(),
            self.three.as_flattened_mut(),
            self.four.as_flattened_mut(),
            self.five.as_flattened_mut(),
        ]
    }
}

on_each_path! {
    /// Brings the maxima above the leaf rows of the bit set `rows` up to date.
    fn raise_maxima(maxima: &mut Levels, leaves: &[Class; LEAVES], rows: u64) {
        maxima.update(leaves, rows, |a, b| if a > b { a } else { b });
    }
}

/// One level up: every node of `above` whose row lies over one of `rows` picks from its four children; returns the rows
/// of `above` that were done.
#[inline(always)]
fn halve<const FINE: usize, const COARSE: usize>(
    below: &[[Class; FINE]],
    above: &mut [[Class; COARSE]; COARSE],
    rows: u64,
    pick: impl Fn(Class, Class) -> Class + Copy,
) -> u64 {
    let mut done = 0;
    for (y, (pair, target)) in below.as_chunks::<2>().0.iter().zip(above).enumerate() {
        if rows >> (2 * y) & 3 == 0 {
            continue;
        }
        done |= 1 << y;
        let mut merged = pair[0];
        for (a, b) in merged.iter_mut().zip(pair[1]) {
            *a = pick(*a, b);
        }
        for (value, pair) in target.iter_mut().zip(merged.as_chunks::<2>().0) {
            // As one number of 16 bits, which vectors split faster than two bytes side by side.
            let pair = u16::from_le_bytes(*pair);
            *value = pick(pair as Class, (pair >> 8) as Class);
        }
    }
    done
}

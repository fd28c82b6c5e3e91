//! The boundary of the free star on a dense window, in single precision and vectors.
//!
//! The star is a closed polygon of units. Unit `i` runs from the vertex `rho[i] u[i]` along a chord to its corner `rho[i] u[i + 1]`
//! and along that direction to the first vertex of the next unit. Most units are smaller than a leaf: the box about such a
//! unit, dilated by the box of the sensor's positions, is marked as a whole. The edges of the others are drawn row by row
//! ([`super::edges`]).
//!
//! Parity: a small unit flips "inside" in the rows whose centre line lies between its first and its last vertex, at the first
//! leaf of its own marked span. All its crossings of the row lie in that span, so the parity of an unmarked leaf is exact;
//! which side of a centre line a vertex is on depends on the vertex alone ([`side`]), so units agree about it.
//!
//! Coordinates are leaves relative to the corner of the sensor's leaf; those of the window are whole numbers.

use super::edges::{Polyline, Target, draw_units};
use super::window::{draw_block, pack, touch, word_at};
use crate::vector::{Path, on_each_path};

/// A unit wider or higher than this, without its dilation, is drawn edge by edge, unless it lies in one row or column; leaves.
const SMALL: f32 = 0.5;

/// The keys of units that are not small: those that fit into four rows of a small mask, and all others.
const LOW: u32 = u32::MAX - 1;
const LARGE: u32 = u32::MAX;

/// Where the sensor is and how far everything is dilated.
#[derive(Debug, Clone, Copy)]
pub(super) struct Place {
    /// The sensor within its leaf, `0.0..1.0`.
    pub x: f32,
    pub y: f32,
    /// Its leaf, window coordinates.
    pub column: i32,
    pub row: i32,
    /// Half widths of the box of its positions, with the slack.
    pub dx: f32,
    pub dy: f32,
}

/// Draws polygons; keeps its scratch memory.
#[derive(Debug, Default)]
pub(super) struct Outline {
    line: Polyline,
    /// [`LARGE`], and behind it one key a unit.
    keys: Vec<u32>,
    /// The side of each vertex, window coordinates.
    sides: Vec<i32>,
    sorted: Sorted,
    /// Units that are drawn edge by edge.
    chosen: Vec<u32>,
}

/// Bits of units.
#[derive(Debug, Default)]
struct Sorted {
    /// Small ones that are not marked as the one before.
    marks: Vec<u64>,
    /// Small ones that flip rows.
    flips: Vec<u64>,
    low: Vec<u64>,
    large: Vec<u64>,
}

/// The nearest integer of a number of magnitude below 2^21, without saturation: adding 1.5 * 2^23 leaves it in the low bits.
/// A floor is that of half less: where rounding makes it the neighbour's, the number is so near to an integer that every
/// slack covers it.
#[inline(always)]
fn rounded(v: f32) -> i32 {
    const SHIFT: f32 = 12_582_912.0;
    ((v + SHIFT).to_bits() as i32).wrapping_sub(SHIFT.to_bits() as i32)
}

/// `floor(v - less)`.
#[inline(always)]
pub(super) fn floor_less(v: f32, less: f32) -> i32 {
    rounded(v - (less + 0.5))
}

/// `floor(v + more)`.
#[inline(always)]
pub(super) fn floor_more(v: f32, more: f32) -> i32 {
    rounded(v + (more - 0.5))
}

/// The last row whose centre line is below `y`, relative to the sensor's leaf.
#[inline(always)]
pub(super) fn side(y: f32) -> i32 {
    rounded(y - 1.0)
}

#[inline(always)]
pub(super) fn min(a: f32, b: f32) -> f32 {
    if a < b { a } else { b }
}

#[inline(always)]
pub(super) fn max(a: f32, b: f32) -> f32 {
    if a > b { a } else { b }
}

/// The leaves that the dilated box `left..right`, `bottom..top` touches, in one word: column, row, columns more, rows more;
/// or [`LOW`] or [`LARGE`].
#[inline(always)]
fn key(left: f32, right: f32, bottom: f32, top: f32, place: &Place) -> u32 {
    let (column, row) = (floor_less(left, place.dx), floor_less(bottom, place.dy));
    let (columns, rows) = (floor_more(right, place.dx) - column, floor_more(top, place.dy) - row);
    // Of a single row or column of leaves a unit touches every one.
    let small = ((right - left <= SMALL) & (top - bottom <= SMALL)) | (rows == 0) | (columns == 0);
    let small = small & (columns < 16) & (rows < 8);
    let key = (column + place.column) | (row + place.row) << 12 | columns << 24 | rows << 28;
    let other = if rows < 4 { LOW } else { LARGE };
    if small { key as u32 } else { other }
}

on_each_path! {
    /// Vertices and sides from directions and distances.
    fn vertices(x: &[f32], y: &[f32], rho: &[f32], place: &Place, vertex_x: &mut [f32], vertex_y: &mut [f32], sides: &mut [i32]) {
        let count = rho.len();
        let (x, y, sides) = (&x[..count], &y[..count], &mut sides[..count]);
        let (vertex_x, vertex_y) = (&mut vertex_x[..count], &mut vertex_y[..count]);
        for i in 0..count {
            (vertex_x[i], vertex_y[i]) = (x[i] * rho[i] + place.x, y[i] * rho[i] + place.y);
            sides[i] = side(vertex_y[i]) + place.row;
        }
    }
}

on_each_path! {
    /// Corners and keys of units, from the directions and distances of their ends, and the vertices.
    fn corners(
        x: &[f32],
        y: &[f32],
        rho: &[f32],
        place: &Place,
        vertices: (&[f32], &[f32]),
        corners: (&mut [f32], &mut [f32]),
        keys: &mut [u32],
    ) {
        let count = keys.len();
        let (x, y, rho) = (&x[1..=count], &y[1..=count], &rho[..count]);
        let (from_x, from_y) = (&vertices.0[..count], &vertices.1[..count]);
        let (to_x, to_y) = (&vertices.0[1..=count], &vertices.1[1..=count]);
        let (corner_x, corner_y) = (&mut corners.0[..count], &mut corners.1[..count]);
        for i in 0..count {
            (corner_x[i], corner_y[i]) = (x[i] * rho[i] + place.x, y[i] * rho[i] + place.y);
            let (left, right) = (min(from_x[i], to_x[i]), max(from_x[i], to_x[i]));
            let (bottom, top) = (min(from_y[i], to_y[i]), max(from_y[i], to_y[i]));
            let (left, right) = (min(left, corner_x[i]), max(right, corner_x[i]));
            let (bottom, top) = (min(bottom, corner_y[i]), max(top, corner_y[i]));
            keys[i] = key(left, right, bottom, top, place);
        }
    }
}

on_each_path! {
    /// Sorts units by their keys (behind the key before the first) and the sides of their ends.
    fn sort_out(keys: &[u32], sides: &[i32], out: (&mut [u64], &mut [u64], &mut [u64], &mut [u64])) {
        let count = keys.len() - 1;
        for (word, (((marks, flips), low), large)) in out.0.iter_mut().zip(out.1).zip(out.2).zip(out.3).enumerate() {
            let (start, end) = (64 * word, count.min(64 * word + 64));
            let (before, keys) = (&keys[start..end], &keys[start + 1..=end]);
            let (first, last) = (&sides[start..end], &sides[start + 1..=end]);
            let (mut is_mark, mut is_flip, mut is_low, mut is_large) = ([0; 64], [0; 64], [0; 64], [0; 64]);
            for ((out, key), before) in is_mark.iter_mut().zip(keys).zip(before) {
                *out = u8::from((*key < LOW) & (key != before));
            }
            for (((out, key), first), last) in is_flip.iter_mut().zip(keys).zip(first).zip(last) {
                *out = u8::from((*key < LOW) & (first != last));
            }
            for (out, key) in is_low.iter_mut().zip(keys) {
                *out = u8::from(*key == LOW);
            }
            for (out, key) in is_large.iter_mut().zip(keys) {
                *out = u8::from(*key == LARGE);
            }
            (*marks, *flips, *low, *large) = (pack(&is_mark), pack(&is_flip), pack(&is_low), pack(&is_large));
        }
    }
}

/// A small unit's first column and row, how many columns more it has, and its rows as a set that begins with the line of the
/// first.
#[inline(always)]
fn block(key: u32) -> ((usize, usize), usize, u64) {
    let (column, row, columns, rows) = (key & 4095, key >> 12 & 4095, key >> 24 & 15, key >> 28);
    ((column as usize, row as usize), columns as usize, ((2 << rows) - 1) << (row & 7))
}

on_each_path! {
    /// Marks the small units of the bit set `marks`, and flips rows for those of `flips`.
    fn mark_small(keys: &[u32], sides: &[i32], marks: &[u64], flips: &[u64], target: Target<'_>) {
        for (base, word) in marks.iter().enumerate() {
            let mut crossing = 0;
            let mut left = *word;
            while left != 0 {
                let i = left.trailing_zeros();
                left &= left - 1;
                let (at, columns, rows) = block(keys[64 * base + i as usize]);
                crossing |= u64::from(rows > 0xff) << i;
                draw_block(target.boundary, at, columns, rows);
                touch(target.touched, at, columns);
            }
            while crossing != 0 {
                let ((column, row), columns, rows) = block(keys[64 * base + crossing.trailing_zeros() as usize]);
                crossing &= crossing - 1;
                draw_block(target.boundary, (column, row + 8), columns, rows >> 8);
                touch(target.touched, (column, row + 8), columns);
            }
        }
        for (base, word) in flips.iter().enumerate() {
            let mut left = *word;
            while left != 0 {
                let i = 64 * base + left.trailing_zeros() as usize;
                left &= left - 1;
                let column = keys[i] as usize & 4095;
                let (a, b) = (sides[i], sides[i + 1]);
                for row in a.min(b) + 1..=a.max(b) {
                    target.toggle[word_at(column, row as usize)] ^= 1 << (column & 63);
                }
            }
        }
    }
}

/// Lists the members of a set of bits.
fn list(bits: &[u64], out: &mut Vec<u32>) {
    for (base, word) in (0..).step_by(64).zip(bits) {
        let mut left = *word;
        while left != 0 {
            out.push(base + left.trailing_zeros());
            left &= left - 1;
        }
    }
}

impl Outline {
    /// Draws the polygon of the chords of `rho` between successive directions; the last entry of each is the first again.
    pub(super) fn draw(&mut self, path: Path, x: &[f32], y: &[f32], rho: &[f32], place: &Place, target: Target<'_>) {
        let units = rho.len() - 1;
        self.keys.resize(units + 1, LARGE);
        self.sides.resize(units + 1, 0);
        let line = &mut self.line;
        line.vertex_x.resize(units + 1, 0.0);
        line.vertex_y.resize(units + 1, 0.0);
        line.corner_x.resize(units, 0.0);
        line.corner_y.resize(units, 0.0);
        let Sorted { marks, flips, low, large } = &mut self.sorted;
        for bits in [&mut *marks, &mut *flips, &mut *low, &mut *large] {
            bits.resize(units.div_ceil(64), 0);
        }
        self.keys[0] = LARGE;
        vertices(path, x, y, rho, place, &mut line.vertex_x, &mut line.vertex_y, &mut self.sides);
        let ends = (&line.vertex_x[..], &line.vertex_y[..]);
        corners(path, x, y, rho, place, ends, (&mut line.corner_x, &mut line.corner_y), &mut self.keys[1..]);
        sort_out(path, &self.keys, &self.sides, (marks, flips, low, large));
        let Target { boundary, toggle, touched } = target;
        mark_small(path, &self.keys[1..], &self.sides, marks, flips, Target { boundary, toggle, touched });
        self.chosen.clear();
        list(low, &mut self.chosen);
        let low = self.chosen.len();
        list(large, &mut self.chosen);
        let (low, large) = self.chosen.split_at(low);
        for chosen in [low, large] {
            draw_units(path, line, chosen, place, Target { boundary, toggle, touched });
        }
    }
}

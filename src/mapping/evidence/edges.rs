//! Units of the free star's boundary that are no smaller than a leaf: each of two edges marks the leaves that it may touch when
//! dilated, and flips the rows whose centre line it crosses at the first of them in that row.
//!
//! Sixteen units are computed side by side, each as masks of up to 16 columns for up to 8 rows. The few that are longer are
//! walked edge by edge, sixteen rows at a time.

use super::outline::{Place, floor_less, floor_more, max, min, side};
use super::window::{
    Bits, MASK_COLUMNS, MASK_ROWS, Touched, aligned, columns_mask, draw_line, joined, not_negative, tile_at, touch,
    word_at,
};
use crate::vector::on_each_path;

/// Units computed side by side.
const LANES: usize = 16;

/// Rows walked at once.
const ROWS: usize = 16;

/// An edge that rises less counts as level, leaves: its whole span is marked in each row that it may touch.
const FLAT: f32 = 1.0 / 4096.0;

/// The planes that the boundary is drawn on.
pub(super) struct Target<'a> {
    pub boundary: &'a mut Bits,
    pub toggle: &'a mut Bits,
    pub touched: &'a mut Touched,
}

/// The vertices of all units: unit `i` goes from the vertex `i` to the corner `i` and on to the vertex `i + 1`.
#[derive(Debug, Default)]
pub(super) struct Polyline {
    /// One more than there are units.
    pub vertex_x: Vec<f32>,
    pub vertex_y: Vec<f32>,
    pub corner_x: Vec<f32>,
    pub corner_y: Vec<f32>,
}

/// Sixteen points.
#[derive(Debug, Clone, Copy)]
struct Points {
    x: [f32; LANES],
    y: [f32; LANES],
}

/// Sixteen units: first vertex, corner, last vertex.
type Units = [Points; 3];

/// The dilated boxes of sixteen units: first column and row, relative to the sensor's leaf, and how many more.
struct Boxes {
    column: [i32; LANES],
    row: [i32; LANES],
    columns: [i32; LANES],
    rows: [i32; LANES],
}

#[inline(always)]
fn boxes([a, b, c]: &Units, place: &Place) -> Boxes {
    let zero = [0; LANES];
    let mut out = Boxes { column: zero, row: zero, columns: zero, rows: zero };
    for k in 0..LANES {
        let (left, right) = (min(min(a.x[k], b.x[k]), c.x[k]), max(max(a.x[k], b.x[k]), c.x[k]));
        let (bottom, top) = (min(min(a.y[k], b.y[k]), c.y[k]), max(max(a.y[k], b.y[k]), c.y[k]));
        out.column[k] = floor_less(left, place.dx);
        out.columns[k] = floor_more(right, place.dx) - out.column[k];
        out.row[k] = floor_less(bottom, place.dy);
        out.rows[k] = floor_more(top, place.dy) - out.row[k];
    }
    out
}

/// One edge from its lower to its higher end, and how its x changes with y.
#[derive(Clone, Copy)]
struct Edge {
    low: (f32, f32),
    high_y: f32,
    slope: f32,
    /// The whole way along x of a level edge, which has no slope.
    level: f32,
    /// It flips the rows above `sides.0` up to `sides.1`, relative to the sensor's leaf.
    sides: (i32, i32),
}

#[inline(always)]
fn edge(from: (f32, f32), to: (f32, f32)) -> Edge {
    let upward = from.1 <= to.1;
    let low = (if upward { from.0 } else { to.0 }, min(from.1, to.1));
    let high = (if upward { to.0 } else { from.0 }, max(from.1, to.1));
    let (rise, run) = (high.1 - low.1, high.0 - low.0);
    let flat = rise < FLAT;
    let slope = if flat { 0.0 } else { run / rise };
    let level = if flat { run } else { 0.0 };
    Edge { low, high_y: high.1, slope, level, sides: (side(low.1), side(high.1)) }
}

impl Edge {
    /// The least and the greatest x of the part whose dilation along y reaches a row of leaves.
    #[inline(always)]
    fn span(&self, row: i32, place: &Place) -> (f32, f32) {
        let y = row as f32;
        let bottom = max(y - place.dy, self.low.1);
        let top = min(y + (1.0 + place.dy), self.high_y);
        let a = self.low.0 + (bottom - self.low.1) * self.slope;
        let b = self.low.0 + (top - self.low.1) * self.slope + self.level;
        (min(a, b), max(a, b))
    }

    /// True when the dilated edge reaches a row.
    #[inline(always)]
    fn reaches(&self, row: i32, place: &Place) -> bool {
        let y = row as f32;
        (y - place.dy <= self.high_y) & (y + (1.0 + place.dy) >= self.low.1)
    }

    /// What the edge marks in a row, as bits from a column, and which of them it flips.
    #[inline(always)]
    fn masks(&self, row: i32, column: i32, place: &Place) -> (u32, u32) {
        let (left, right) = self.span(row, place);
        let mask = columns_mask(left - (column as f32 + place.dx), right - (column as f32 - place.dx));
        let mask = if self.reaches(row, place) { mask } else { 0 };
        let flipped = (row > self.sides.0) & (row <= self.sides.1);
        (mask, if flipped { mask & mask.wrapping_neg() } else { 0 })
    }
}

/// Sixteen edges.
struct Edges {
    low_x: [f32; LANES],
    low_y: [f32; LANES],
    high_y: [f32; LANES],
    slope: [f32; LANES],
    level: [f32; LANES],
    low_side: [i32; LANES],
    high_side: [i32; LANES],
}

impl Edges {
    #[inline(always)]
    fn between(from: &Points, to: &Points) -> Self {
        let zero = [0.0; LANES];
        let mut out = Self {
            low_x: zero,
            low_y: zero,
            high_y: zero,
            slope: zero,
            level: zero,
            low_side: [0; LANES],
            high_side: [0; LANES],
        };
        for k in 0..LANES {
            let edge = edge((from.x[k], from.y[k]), (to.x[k], to.y[k]));
            (out.low_x[k], out.low_y[k]) = edge.low;
            (out.high_y[k], out.slope[k], out.level[k]) = (edge.high_y, edge.slope, edge.level);
            (out.low_side[k], out.high_side[k]) = edge.sides;
        }
        out
    }

    #[inline(always)]
    fn at(&self, k: usize) -> Edge {
        Edge {
            low: (self.low_x[k], self.low_y[k]),
            high_y: self.high_y[k],
            slope: self.slope[k],
            level: self.level[k],
            sides: (self.low_side[k], self.high_side[k]),
        }
    }
}

/// What sixteen units mark and flip in one line each.
#[derive(Clone, Copy)]
struct Stamps {
    marks: [[u64; LANES]; 2],
    flips: [[u64; LANES]; 2],
}

const NO_STAMPS: Stamps = Stamps { marks: [[0; LANES]; 2], flips: [[0; LANES]; 2] };

/// The stamps of the first `rows + 1` rows of the boxes, in the lines of the boxes' first rows and in those above them.
#[inline(always)]
fn stamps([a, b, c]: &Units, boxes: &Boxes, rows: i32, place: &Place) -> [Stamps; 2] {
    let (chords, radials) = (Edges::between(a, b), Edges::between(b, c));
    let (mut marks, mut flips) = ([[0_u32; LANES]; 4], [[0_u32; LANES]; 4]);
    for row in 0..=rows {
        let (pair, up) = ((row >> 1 & 3) as usize, 16 * (row & 1));
        let (marks, flips) = (&mut marks[pair], &mut flips[pair]);
        for k in 0..LANES {
            let chord = chords.at(k).masks(boxes.row[k] + row, boxes.column[k], place);
            let radial = radials.at(k).masks(boxes.row[k] + row, boxes.column[k], place);
            marks[k] |= (chord.0 | radial.0) << up;
            flips[k] |= (chord.1 ^ radial.1) << up;
        }
    }
    let (mut first, mut second) = (NO_STAMPS, NO_STAMPS);
    for k in 0..LANES {
        let row = boxes.row[k] + place.row;
        let marks = aligned(joined(&marks, k), row);
        let flips = aligned(joined(&flips, k), row);
        ([first.marks[0][k], first.marks[1][k]], [second.marks[0][k], second.marks[1][k]]) = marks;
        ([first.flips[0][k], first.flips[1][k]], [second.flips[0][k], second.flips[1][k]]) = flips;
    }
    [first, second]
}

/// Bits of the boxes that fit into small masks and of those that reach into the line above that of their first row; and the
/// most rows above the first of any that fits.
#[inline(always)]
fn fitting(boxes: &Boxes, place: &Place) -> (u64, u64, i32) {
    // By arithmetic, not by conditions: compilers make branches of those.
    let (mut exceeds, mut below, mut rows) = ([0; LANES], [0; LANES], [0; LANES]);
    for k in 0..LANES {
        let fits = (boxes.rows[k] - MASK_ROWS) & (boxes.columns[k] - MASK_COLUMNS);
        exceeds[k] = !fits;
        below[k] = ((boxes.row[k] + place.row) & 7) + boxes.rows[k] - 8;
        rows[k] = boxes.rows[k] & fits >> 31;
    }
    let most = rows.iter().fold(0, |most, rows| most.max(*rows));
    (not_negative(&exceeds), not_negative(&below), most)
}

/// Draws the first `count` of sixteen units.
#[inline(always)]
fn draw_sixteen(units: &Units, count: usize, place: &Place, target: &mut Target<'_>) {
    let boxes = boxes(units, place);
    let (fits, crossing, rows) = fitting(&boxes, place);
    let there = (1 << count) - 1;
    let stamps = stamps(units, &boxes, rows, place);
    for (above, mut left) in [(0, fits & there), (1, fits & crossing & there)] {
        while left != 0 {
            let k = left.trailing_zeros() as usize & (LANES - 1);
            left &= left - 1;
            stamps[above].draw(&boxes, k, 8 * above as i32, place, target);
        }
    }
    let mut left = !fits & there;
    while left != 0 {
        let k = left.trailing_zeros() as usize & (LANES - 1);
        left &= left - 1;
        for ends in units.windows(2) {
            let edge = edge((ends[0].x[k], ends[0].y[k]), (ends[1].x[k], ends[1].y[k]));
            walk(&edge, place, target);
        }
    }
}

impl Stamps {
    /// Draws the line of one unit that lies `above` the one of its first row.
    #[inline(always)]
    fn draw(&self, boxes: &Boxes, k: usize, above: i32, place: &Place, target: &mut Target<'_>) {
        let at = ((boxes.column[k] + place.column) as usize, (boxes.row[k] + place.row + above) as usize);
        let columns = boxes.columns[k] as usize;
        let flips = [self.flips[0][k], self.flips[1][k]];
        draw_line(target.boundary, at, columns, [self.marks[0][k], self.marks[1][k]], |word, mark| *word |= mark);
        if flips != [0, 0] {
            draw_line(target.toggle, at, columns, flips, |word, flip| *word ^= flip);
        }
        touch(target.touched, at, columns);
    }
}

/// Up to sixteen units of a polyline side by side.
#[inline(always)]
fn gathered(line: &Polyline, chosen: &[u32]) -> Units {
    let none = Points { x: [0.0; LANES], y: [0.0; LANES] };
    let [mut a, mut b, mut c] = [none; 3];
    for (k, i) in chosen.iter().enumerate().take(LANES) {
        let i = *i as usize;
        (a.x[k], a.y[k]) = (line.vertex_x[i], line.vertex_y[i]);
        (b.x[k], b.y[k]) = (line.corner_x[i], line.corner_y[i]);
        (c.x[k], c.y[k]) = (line.vertex_x[i + 1], line.vertex_y[i + 1]);
    }
    [a, b, c]
}

on_each_path! {
    /// Draws the chosen units of a polyline.
    pub(super) fn draw_units(line: &Polyline, chosen: &[u32], place: &Place, target: Target<'_>) {
        let mut target = target;
        for chosen in chosen.chunks(LANES) {
            draw_sixteen(&gathered(line, chosen), chosen.len(), place, &mut target);
        }
    }
}

/// Draws one edge of any length.
#[inline(always)]
fn walk(edge: &Edge, place: &Place, target: &mut Target<'_>) {
    let (mut row, last_row) = (floor_less(edge.low.1, place.dy), floor_more(edge.high_y, place.dy));
    let flips = (edge.sides.0 + 1 + place.row, edge.sides.1 + place.row);
    while row <= last_row {
        let (mut first, mut last) = ([0; ROWS], [0; ROWS]);
        for i in 0..ROWS {
            let (left, right) = edge.span(row + i as i32, place);
            first[i] = floor_less(left, place.dx) + place.column;
            last[i] = floor_more(right, place.dx) + place.column;
        }
        let more = (last_row - row).min(ROWS as i32 - 1);
        mark_rows(row + place.row, more, &first, &last, flips, target);
        row += ROWS as i32;
    }
}

/// Ones below bit `n`, for `n` in `0..=64`.
#[inline(always)]
fn ones(n: i32) -> u64 {
    if n >= 64 { u64::MAX } else { (1_u64 << (n & 63)) - 1 }
}

/// Marks the spans `first..=last` of a row and the `more` rows above it, and flips those from `flips.0` to `flips.1` at their
/// first leaf. Window coordinates.
#[inline(always)]
fn mark_rows(row: i32, more: i32, first: &[i32; ROWS], last: &[i32; ROWS], flips: (i32, i32), target: &mut Target<'_>) {
    let there = ..=more as usize;
    let leftmost = first[there].iter().fold(i32::MAX, |least, column| least.min(*column));
    let rightmost = last[there].iter().fold(0, |most, column| most.max(*column));
    for tile in leftmost >> 6..=rightmost >> 6 {
        let left = tile << 6;
        let (mut mask, mut flip) = ([0_u64; ROWS], [0_u64; ROWS]);
        for k in 0..ROWS {
            let (from, to) = ((first[k] - left).clamp(0, 64), (last[k] + 1 - left).clamp(0, 64));
            let (here, there) = (row + k as i32, k as i32 <= more);
            mask[k] = if there & (from < to) { ones(to) & !ones(from) } else { 0 };
            let flipped = (here >= flips.0) & (here <= flips.1) & (first[k] >> 6 == tile) & there;
            flip[k] = u64::from(flipped) << (first[k] & 63);
        }
        let at = word_at(left as usize, row as usize);
        for (word, mask) in target.boundary[at..][..ROWS].iter_mut().zip(mask) {
            *word |= mask;
        }
        for (word, flip) in target.toggle[at..][..ROWS].iter_mut().zip(flip) {
            *word ^= flip;
        }
        target.touched[tile_at(left as usize, row as usize)] = 1;
        target.touched[tile_at(left as usize, (row + more) as usize)] = 1;
    }
}

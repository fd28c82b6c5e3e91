//! X_OCC on a dense window: the measurement sets of a scan's returns, in single precision and vectors.
//!
//! The same sets as [`super::cones`] draws one by one in double precision: the rectangle about the part of the cone, widened by
//! the turn of the heading and held to the axis-parallel hull of the turned rectangle, then dilated. Sixteen beams are
//! computed side by side; each comes out as a mask of up to 16 columns for up to 8 rows. A set that is larger is left to
//! the caller; so is one that is wider than it is long, or begins behind the sensor, and turns: its corners pass other axes than
//! those that the beam is near.
//!
//! A side's x at a given y may have a slope of any size: an error of the y acts as if the shape lay that much higher or lower,
//! which the slack of the dilation along y covers.

#![allow(clippy::needless_range_loop, reason = "lanes side by side in many arrays read best by their number")]

use super::cones::Cones;
use super::outline::{Place, floor_less, floor_more, max, min};
use super::window::{
    Bits, MASK_COLUMNS, MASK_ROWS, Touched, aligned, columns_mask, draw_line, joined, not_negative, touch,
};
use crate::vector::on_each_path;

/// Beams computed side by side.
const LANES: usize = 16;

/// More rows than a small mask has, in a bit that no number of rows has.
const TOO_MANY_ROWS: i32 = 1 << 20;

/// Keeps a slope finite; a side so level has no height.
const TINY: f32 = 1e-20;

/// What all returns of a scan have in common, leaves.
#[derive(Debug, Clone, Copy)]
pub(super) struct Shape {
    sin: f32,
    cos: f32,
    /// Half width at the emitter, and how far the rim lies behind.
    rim: (f32, f32),
    sin_turn: f32,
    cos_turn: f32,
    /// By this the hull of a set may be rounded.
    slack: f32,
}

impl Shape {
    /// The shape of the returns that `cones` draws; `None` where it is none for these formulas: a wide opening or turn.
    pub(super) fn of(cones: &Cones, slack: f32) -> Option<Self> {
        let (sin, cos) = cones.opening();
        let (sin_turn, cos_turn) = cones.turn();
        let narrow = !cones.is_wide() && cos_turn > 0.1;
        let rim = cones.rim();
        narrow.then_some(Self {
            sin: sin as f32,
            cos: cos as f32,
            rim: (rim.0 as f32, rim.1 as f32),
            sin_turn: sin_turn as f32,
            cos_turn: cos_turn as f32,
            slack,
        })
    }
}

/// Sixteen numbers side by side.
type Lanes = [f32; LANES];

/// The dilated sets of sixteen beams: where they are, and the sides of their rectangles.
struct Sets {
    /// Leftmost and rightmost corner.
    left: (Lanes, Lanes),
    right: (Lanes, Lanes),
    /// dx/dy of the sides that rise and fall to the right.
    rising: Lanes,
    falling: Lanes,
    /// What the set is held to.
    bottom: Lanes,
    top: Lanes,
    clip: (Lanes, Lanes),
    /// The first leaf of the bounding box and how many more there are.
    column: [i32; LANES],
    row: [i32; LANES],
    columns: [i32; LANES],
    rows: [i32; LANES],
}

/// An axis-parallel box about the sensor.
struct Hull {
    min: (f32, f32),
    max: (f32, f32),
}

impl Hull {
    /// The hull of a trapezoid (half widths `narrow` at `low`, `width` at `far`) turned to both sides about the sensor.
    #[inline(always)]
    fn about<const TURNED: bool>(
        x: f32,
        y: f32,
        (low, narrow): (f32, f32),
        (far, width): (f32, f32),
        shape: &Shape,
    ) -> Self {
        let mut hull = Self { min: (f32::MAX, f32::MAX), max: (f32::MIN, f32::MIN) };
        hull.add((x, y), shape.cos_turn, -shape.sin_turn, (low, narrow), (far, width));
        if !TURNED {
            return hull;
        }
        hull.add((x, y), shape.cos_turn, shape.sin_turn, (low, narrow), (far, width));
        // A corner that passes an axis on the way is farthest out there.
        let radius = (far * far + width * width).sqrt();
        let near_axis = (shape.sin_turn * radius + width) * 1.000_01;
        let (along_x, along_y) = (y.abs() * radius <= near_axis, x.abs() * radius <= near_axis);
        hull.max.0 = if along_x & (x > 0.0) { max(hull.max.0, radius) } else { hull.max.0 };
        hull.min.0 = if along_x & (x < 0.0) { min(hull.min.0, -radius) } else { hull.min.0 };
        hull.max.1 = if along_y & (y > 0.0) { max(hull.max.1, radius) } else { hull.max.1 };
        hull.min.1 = if along_y & (y < 0.0) { min(hull.min.1, -radius) } else { hull.min.1 };
        hull
    }

    #[inline(always)]
    fn add(&mut self, (x, y): (f32, f32), cos: f32, sin: f32, near: (f32, f32), far: (f32, f32)) {
        let (x, y) = (x * cos - y * sin, y * cos + x * sin);
        for (along, aside) in [near, far] {
            let (aside_x, aside_y) = (y.abs() * aside, x.abs() * aside);
            self.min = (min(self.min.0, x * along - aside_x), min(self.min.1, y * along - aside_y));
            self.max = (max(self.max.0, x * along + aside_x), max(self.max.1, y * along + aside_y));
        }
    }
}

/// The sets of sixteen beams in the directions `(x, y)`.
#[inline(always)]
fn sets<const TURNED: bool>(x: &Lanes, y: &Lanes, near: &Lanes, far: &Lanes, shape: &Shape, place: &Place) -> Sets {
    let zero = [0.0; LANES];
    let mut out = Sets {
        left: (zero, zero),
        right: (zero, zero),
        rising: zero,
        falling: zero,
        bottom: zero,
        top: zero,
        clip: (zero, zero),
        column: [0; LANES],
        row: [0; LANES],
        columns: [0; LANES],
        rows: [0; LANES],
    };
    for k in 0..LANES {
        let (x, y, near, far) = (x[k], y[k], near[k], far[k]);
        let width = far * shape.sin + shape.rim.0;
        let low = near * shape.cos - shape.rim.1;
        let rim = far * shape.cos - shape.rim.1;
        let first = min(low, low * shape.cos_turn) - width * shape.sin_turn;
        let last = if TURNED {
            // No point of the cone is farther from the sensor than its rim.
            min(far + width * shape.sin_turn, max((rim * rim + width * width).sqrt(), far) + shape.slack)
        } else {
            far
        };
        let aside = width + far * shape.sin_turn;
        let (along, middle) = (0.5 * (last - first), 0.5 * (last + first));
        let hull = Hull::about::<TURNED>(x, y, (low, near * shape.sin + shape.rim.0), (far, width), shape);
        let clip = (place.x + hull.min.0 - shape.slack, place.x + hull.max.0 + shape.slack);
        let (center_x, center_y) = (x * middle + place.x, y * middle + place.y);
        // By symmetry the direction may point up and its normal to the left; else the normal, seen as the direction, does.
        let upright = x * y >= 0.0;
        let (c, s) = if upright { (x.abs(), y.abs()) } else { (y.abs(), x.abs()) };
        let (along, aside) = if upright { (along, aside) } else { (aside, along) };
        let (corner_x, corner_y) = (c * along + s * aside, s * along - c * aside);
        let height = s * along + c * aside;
        out.left.0[k] = center_x - corner_x;
        out.left.1[k] = center_y - corner_y;
        out.right.0[k] = center_x + corner_x;
        out.right.1[k] = center_y + corner_y;
        out.rising[k] = c / (s + TINY);
        out.falling[k] = -s / (c + TINY);
        let bottom = max(center_y - height, place.y + hull.min.1 - shape.slack);
        let top = min(center_y + height, place.y + hull.max.1 + shape.slack);
        (out.bottom[k], out.top[k]) = (bottom, top);
        (out.clip.0[k], out.clip.1[k]) = clip;
        out.column[k] = floor_less(max(center_x - corner_x, clip.0), place.dx);
        out.columns[k] = floor_more(min(center_x + corner_x, clip.1), place.dx) - out.column[k];
        out.row[k] = floor_less(bottom, place.dy);
        out.rows[k] = floor_more(top, place.dy) - out.row[k];
        if TURNED {
            // Where no corner turns more than a quarter away from the beam, this is not negative.
            let ahead = min(low, far * shape.cos_turn - width * shape.sin_turn);
            out.rows[k] |= (ahead.to_bits() as i32 >> 31) & TOO_MANY_ROWS;
        }
    }
    out
}

impl Sets {
    /// The columns that row `row` of each bounding box has of the set, as bits from the box's first column.
    #[inline(always)]
    fn mask(&self, row: i32, place: &Place) -> [u32; LANES] {
        let mut masks = [0; LANES];
        for k in 0..LANES {
            let y = (self.row[k] + row) as f32;
            let top = min(y + (1.0 + place.dy), self.top[k]);
            let bottom = min(max(y - place.dy, self.bottom[k]), top);
            let reach = |corner: (f32, f32), below: f32, above: f32| {
                let step = min(max(corner.1, bottom), top) - corner.1;
                corner.0 + step * if step > 0.0 { above } else { below }
            };
            let (rising, falling) = (self.rising[k], self.falling[k]);
            // The edges of a set without width are one line, and rounding may put either to the left.
            let a = reach((self.left.0[k], self.left.1[k]), falling, rising);
            let b = reach((self.right.0[k], self.right.1[k]), rising, falling);
            let (left, right) = (max(min(a, b), self.clip.0[k]), min(max(a, b), self.clip.1[k]));
            let column = self.column[k] as f32;
            let mask = columns_mask(left - (column + place.dx), right - (column - place.dx));
            let some = (row <= self.rows[k]) & (left <= right);
            masks[k] = if some { mask } else { 0 };
        }
        masks
    }
}

impl Sets {
    /// The masks of the sets in the lines of their first rows, and in those above them.
    #[inline(always)]
    fn lines(&self, rows: i32, place: &Place) -> [[[u64; LANES]; 2]; 2] {
        let mut pairs = [[0_u32; LANES]; 4];
        for row in 0..=rows {
            let mask = self.mask(row, place);
            for (pair, mask) in pairs[(row >> 1 & 3) as usize].iter_mut().zip(mask) {
                *pair |= mask << (16 * (row & 1));
            }
        }
        let [mut first, mut second] = [[[0; LANES]; 2]; 2];
        for k in 0..LANES {
            let lines = aligned(joined(&pairs, k), self.row[k] + place.row);
            ([first[0][k], first[1][k]], [second[0][k], second[1][k]]) = lines;
        }
        [first, second]
    }
}

on_each_path! {
    /// Marks the sets of all beams whose `far` is not negative. The bits of beams whose sets are too large are put into
    /// `large`. All slices but that have a whole number of sixteens.
    pub(super) fn mark_returns(
        x: &[f32],
        y: &[f32],
        near: &[f32],
        far: &[f32],
        shape: &Shape,
        place: &Place,
        occupied: &mut Bits,
        touched: &mut Touched,
        large: &mut [u64],
    ) {
        let sixteens = |values| <[f32]>::as_chunks::<LANES>(values).0;
        let chunks = sixteens(x).iter().zip(sixteens(y)).zip(sixteens(near).iter().zip(sixteens(far)));
        large.fill(0);
        for (chunk, ((x, y), (near, far))) in chunks.enumerate() {
            let sets = if shape.sin_turn > 0.0 {
                sets::<true>(x, y, near, far, shape, place)
            } else {
                sets::<false>(x, y, near, far, shape, place)
            };
            let fit = fitting(&sets, far, place);
            large[chunk / 4] |= fit.exceeds << (16 * (chunk % 4));
            let lines = sets.lines(fit.rows, place);
            let chunks = [(fit.fits, 0), (fit.fits & fit.crosses, 8)];
            for ((mut left, above), line) in chunks.into_iter().zip(lines) {
                while left != 0 {
                    let k = left.trailing_zeros() as usize & (LANES - 1);
                    left &= left - 1;
                    let row = (sets.row[k] + place.row + above) as usize;
                    let at = ((sets.column[k] + place.column) as usize, row);
                    let columns = sets.columns[k] as usize;
                    draw_line(occupied, at, columns, [line[0][k], line[1][k]], |word, mask| *word |= mask);
                    touch(touched, at, columns);
                }
            }
        }
    }
}

/// Which sets fit into small masks, which are larger, which reach into the line above that of their first row; and the most
/// rows above the first of any that fits.
struct Fit {
    fits: u64,
    exceeds: u64,
    crosses: u64,
    rows: i32,
}

#[inline(always)]
fn fitting(sets: &Sets, far: &Lanes, place: &Place) -> Fit {
    // By arithmetic, not by conditions: compilers make branches of those. The bits of a float are a negative number where it
    // is one.
    let (mut returned, mut exceeds, mut below, mut rows) = ([0; LANES], [0; LANES], [0; LANES], [0; LANES]);
    for k in 0..LANES {
        returned[k] = far[k].to_bits() as i32;
        let fits = (sets.rows[k] - MASK_ROWS) & (sets.columns[k] - MASK_COLUMNS) & !returned[k];
        exceeds[k] = !fits;
        below[k] = ((sets.row[k] + place.row) & 7) + sets.rows[k] - 8;
        rows[k] = sets.rows[k] & fits >> 31;
    }
    let rows = rows.iter().fold(0, |most, rows| most.max(*rows));
    let fits = not_negative(&exceeds);
    Fit { fits, exceeds: not_negative(&returned) & !fits, crosses: not_negative(&below), rows }
}

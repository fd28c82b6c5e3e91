//! Drawing on the canvas: dilated edges of the free star and dilated convex shapes, row by row.
//!
//! Coordinates are window coordinates in leaves: leaf `(column, row)` is the closed square `[column, column + 1] x
//! [row, row + 1]`. "Dilated by `(x, y)`" is the Minkowski sum with the box `[-x, x] x [-y, y]`: the set of all positions
//! that the sensor's origin may have, plus the slack of the floating-point arithmetic (see [`super::frame`]).

use super::sheet::{BOUNDARY, Plane, Sheet};

/// A point or vector in window coordinates, leaves.
pub(super) type Point = (f64, f64);

/// An edge that rises less counts as level. Window coordinates are below 2^18, so a y is off by at most 2^-34 when the x
/// of an edge at that y is found; both are far below the slack by which every shape is dilated along y.
const FLAT: f64 = 1e-9;

/// An edge shorter than this along both axes has its bounding box marked.
const SHORT: f64 = 0.5;

/// `floor` for window coordinates (magnitude below 2^30), without a call on machines that have no instruction for it:
/// adding 1.5 * 2^52 leaves the rounded integer in the low bits. For a `v` within 2^-20 of an integer the answer may be the
/// one for a neighbour of `v`: the slack of every boundary is at least as large.
pub(super) fn floor(v: f64) -> i32 {
    const SHIFT: f64 = 6_755_399_441_055_744.0;
    ((v - 0.5) + SHIFT).to_bits() as i32
}

/// Marks the leaves that the dilated edge `from`-`to` touches, and flips the parity of the rows whose centre line it
/// crosses at the first marked leaf of that row. An unmarked leaf of the row lies wholly to one side of the marked span,
/// so the parity counts the crossings on its left exactly.
pub(super) fn edge(sheet: &mut impl Sheet, from: Point, to: Point, dilation: Point) {
    let (low, high) = if from.1 <= to.1 { (from, to) } else { (to, from) };
    let (rise, run) = (high.1 - low.1, high.0 - low.0);
    let first_row = floor(low.1 - dilation.1);
    let last_row = floor(high.1 + dilation.1);
    let left = low.0.min(high.0);
    let right = low.0.max(high.0);
    if rise < FLAT || (rise < SHORT && run.abs() < SHORT) {
        let (first, last) = (floor(left - dilation.0), floor(right + dilation.0));
        for row in first_row..=last_row {
            sheet.span::<BOUNDARY>(row, first, last);
            flip(sheet, low.1, high.1, row, first);
        }
        return;
    }
    let per_rise = rise.recip();
    let at = |y: f64| low.0 + ((y - low.1) * per_rise).min(1.0) * run;
    for row in first_row..=last_row {
        // The part of the edge whose dilation reaches the row's closed leaves.
        let bottom = (f64::from(row) - dilation.1).max(low.1);
        let top = (f64::from(row) + 1.0 + dilation.1).min(high.1);
        let (a, b) = (at(bottom), at(top));
        let first = floor(a.min(b) - dilation.0);
        let last = floor(a.max(b) + dilation.0);
        sheet.span::<BOUNDARY>(row, first, last);
        flip(sheet, low.1, high.1, row, first);
    }
}

fn flip(sheet: &mut impl Sheet, low: f64, high: f64, row: i32, column: i32) {
    let center = f64::from(row) + 0.5;
    if (low < center) != (high < center) {
        sheet.toggle(row, column);
    }
}

/// A convex shape that can tell its extent along x over a band of y.
pub(super) trait Convex {
    /// Lowest and highest y.
    fn extent_y(&self) -> (f64, f64);

    /// Lowest and highest x of the part with `bottom <= y <= top`, a little more at most; `bottom` and `top` are held to
    /// [`Convex::extent_y`] by the caller, `None` when the part is empty.
    fn extent_x(&self, bottom: f64, top: f64) -> Option<(f64, f64)>;
}

/// Sets the leaves that the dilated shape touches.
pub(super) fn cover<const PLANE: Plane>(sheet: &mut impl Sheet, shape: &impl Convex, dilation: Point) {
    let (low, high) = shape.extent_y();
    for row in floor(low - dilation.1)..=floor(high + dilation.1) {
        let bottom = (f64::from(row) - dilation.1).max(low);
        let top = (f64::from(row) + 1.0 + dilation.1).min(high);
        if let Some((left, right)) = shape.extent_x(bottom.min(top), top) {
            sheet.span::<PLANE>(row, floor(left - dilation.0), floor(right + dilation.0));
        }
    }
}

/// Sets the leaves all of whose corners lie in the dilated shape, less `slack` leaves on every side.
pub(super) fn inscribe<const PLANE: Plane>(sheet: &mut impl Sheet, shape: &impl Convex, dilation: Point, slack: f64) {
    let (low, high) = shape.extent_y();
    // Along a line y the dilated shape reaches from the smallest to the largest x over the band y +- dilation.
    let line = |row: i32| -> Option<(f64, f64)> {
        let y = f64::from(row);
        let (bottom, top) = (y - dilation.1 + slack, y + dilation.1 - slack);
        let (left, right) = if bottom <= top {
            let (bottom, top) = (bottom.max(low), top.min(high));
            if bottom > top {
                return None;
            }
            shape.extent_x(bottom, top)?
        } else {
            // Less slack than dilation: the line give or take the rest. The shape is convex, so what lies in it at both
            // ends lies in it between.
            let at = |y: f64| if low <= y && y <= high { shape.extent_x(y, y) } else { None };
            let (a, b) = (at(bottom)?, at(top)?);
            (a.0.max(b.0), a.1.min(b.1))
        };
        Some((left - dilation.0 + slack, right + dilation.0 - slack))
    };
    let mut below: Option<(f64, f64)> = None;
    for row in floor(low - dilation.1)..=floor(high + dilation.1) + 1 {
        let here = line(row);
        if let (Some((left_below, right_below)), Some((left, right))) = (below, here) {
            let first = left_below.max(left).ceil() as i32;
            let last = floor(right_below.min(right)) - 1;
            sheet.span::<PLANE>(row - 1, first, last);
        }
        below = here;
    }
}

/// A convex polygon of four corners in either order.
#[derive(Debug, Clone, Copy)]
pub(super) struct Quad {
    /// The corners, round the boundary.
    pub corners: [Point; 4],
}

impl Convex for Quad {
    fn extent_y(&self) -> (f64, f64) {
        let ys = self.corners.map(|corner| corner.1);
        (ys.iter().copied().fold(f64::INFINITY, f64::min), ys.iter().copied().fold(f64::NEG_INFINITY, f64::max))
    }

    fn extent_x(&self, bottom: f64, top: f64) -> Option<(f64, f64)> {
        let mut out = (f64::INFINITY, f64::NEG_INFINITY);
        let mut take = |x: f64| out = (out.0.min(x), out.1.max(x));
        for i in 0..4 {
            let (mut low, mut high) = (self.corners[i], self.corners[(i + 1) % 4]);
            if low.1 > high.1 {
                (low, high) = (high, low);
            }
            if high.1 < bottom || low.1 > top {
                continue;
            }
            let rise = high.1 - low.1;
            if rise < FLAT {
                take(low.0);
                take(high.0);
                continue;
            }
            let at = |y: f64| low.0 + ((y - low.1) / rise).clamp(0.0, 1.0) * (high.0 - low.0);
            take(if low.1 < bottom { at(bottom) } else { low.0 });
            take(if high.1 > top { at(top) } else { high.0 });
        }
        (out.0 <= out.1).then_some(out)
    }
}

/// A disc.
#[derive(Debug, Clone, Copy)]
pub(super) struct Disc {
    /// Centre.
    pub center: Point,
    /// Radius, leaves.
    pub radius: f64,
}

impl Convex for Disc {
    fn extent_y(&self) -> (f64, f64) {
        (self.center.1 - self.radius, self.center.1 + self.radius)
    }

    fn extent_x(&self, bottom: f64, top: f64) -> Option<(f64, f64)> {
        let nearest = self.center.1.clamp(bottom, top) - self.center.1;
        let half = (self.radius * self.radius - nearest * nearest).max(0.0).sqrt();
        Some((self.center.0 - half, self.center.0 + half))
    }
}

/// The leaves that touch each of two shapes, taken one by one: a row of leaves keeps what both reach.
#[derive(Debug, Clone, Copy)]
pub(super) struct Both<A, B>(pub A, pub B);

impl<A: Convex, B: Convex> Convex for Both<A, B> {
    fn extent_y(&self) -> (f64, f64) {
        let (a, b) = (self.0.extent_y(), self.1.extent_y());
        (a.0.max(b.0), a.1.min(b.1))
    }

    fn extent_x(&self, bottom: f64, top: f64) -> Option<(f64, f64)> {
        let (a, b) = (self.0.extent_x(bottom, top)?, self.1.extent_x(bottom, top)?);
        let both = (a.0.max(b.0), a.1.min(b.1));
        (both.0 <= both.1).then_some(both)
    }
}

/// A rectangle at any angle, held to an axis-parallel box: rows of leaves keep what both reach.
#[derive(Debug, Clone, Copy)]
pub(super) struct TurnedRectangle {
    low: f64,
    high: f64,
    /// Leftmost and rightmost corner.
    left: Point,
    right: Point,
    /// Along each side: how x changes with y below and above the outermost corner.
    left_slopes: Point,
    right_slopes: Point,
    clip: Point,
}

impl TurnedRectangle {
    /// The rectangle about `center` that reaches `along` to both sides in the direction `unit` and `aside` across it, held to
    /// the box `clip_min..clip_max`.
    pub(super) fn new(center: Point, unit: Point, (along, aside): Point, clip_min: Point, clip_max: Point) -> Self {
        // By symmetry the direction may point up and its normal to the left, or the other way round.
        let (c, s, along, aside) = if unit.0 * unit.1 >= 0.0 {
            (unit.0.abs(), unit.1.abs(), along, aside)
        } else {
            // The normal (-s, c), seen as the direction, points into the first quadrant.
            (unit.1.abs(), unit.0.abs(), aside, along)
        };
        // Corners: right at +along - aside, top at +along + aside, and their mirror images.
        let right = (c * along + s * aside, s * along - c * aside);
        let top = s * along + c * aside;
        // dx/dy of the sides; a level side has no height, and within the slack its slope does not matter.
        let rising = if s > 1e-9 { c / s } else { 0.0 };
        let falling = if c > 1e-9 { -s / c } else { 0.0 };
        Self {
            low: (center.1 - top).max(clip_min.1),
            high: (center.1 + top).min(clip_max.1),
            left: (center.0 - right.0, center.1 - right.1),
            right: (center.0 + right.0, center.1 + right.1),
            left_slopes: (falling, rising),
            right_slopes: (rising, falling),
            clip: (clip_min.0, clip_max.0),
        }
    }
}

impl Convex for TurnedRectangle {
    fn extent_y(&self) -> (f64, f64) {
        (self.low, self.high)
    }

    fn extent_x(&self, bottom: f64, top: f64) -> Option<(f64, f64)> {
        let reach = |corner: Point, (below, above): Point| {
            let step = corner.1.clamp(bottom, top) - corner.1;
            corner.0 + step * if step > 0.0 { above } else { below }
        };
        // The edges of a rectangle without width are one line, and rounding may put either to the left.
        let (a, b) = (reach(self.left, self.left_slopes), reach(self.right, self.right_slopes));
        let (left, right) = (a.min(b).max(self.clip.0), a.max(b).min(self.clip.1));
        (left <= right).then_some((left, right))
    }
}

//! The leaves of a capsule, row by row: what a small region needs of a block is a few short pieces of rows.
//!
//! A row's piece holds every leaf that the capsule of radius `r + slack` meets there, and may hold others: leaves whose
//! class counts are tested one by one. A leaf meets a convex set exactly when its column lies in what the set's part in
//! the row's strip covers along x. The right edge of a capsule is concave as a function of y, so its largest x in a strip
//! is at the strip's point nearest to where it is largest of all; the left edge likewise.
//!
//! Rounding: with `slack` of four and three needed (`lens.rs`), a quarter of the slack, at least `2^-20` leaves, is left for
//! what is computed here. Roots are of numbers that err as if the radius did by a few units in its last place. On a
//! tangent x errs by the error of y, a few `2^-29` within the root, times the slope; so steeper ones than
//! [`MAX_SLOPE`] are left to the box about the capsule.

use super::lens::POINT;

/// Largest `|dx / dy|` of a piece whose tangents are followed.
const MAX_SLOPE: f64 = 32.0;

/// One capsule, or a disc.
pub struct Rows {
    /// The end of smaller y, and the other.
    low: (f64, f64),
    high: (f64, f64),
    radius: f64,
    /// `dx / dy` of the tangents; `None` for the box.
    slope: Option<f64>,
    /// From an end to where the tangent leaves its circle, to the right: `(x, y)`; to the left both change sign.
    tangent: (f64, f64),
}

impl Rows {
    /// A capsule by its ends and radius, in leaves; the radius with its slack.
    pub fn new(start: (f64, f64), end: (f64, f64), radius: f64) -> Self {
        let (low, high) = if start.1 <= end.1 { (start, end) } else { (end, start) };
        let (dx, dy) = (high.0 - low.0, high.1 - low.1);
        let squared = dx * dx + dy * dy;
        // Divided by its length, a piece that has next to none would leave no numbers.
        if squared <= POINT {
            return Self { low, high: low, radius, slope: Some(0.0), tangent: (0.0, 0.0) };
        }
        let scale = radius / squared.sqrt();
        let slope = (dx.abs() <= MAX_SLOPE * dy).then(|| dx / dy);
        Self { low, high, radius, slope, tangent: (scale * dy, -scale * dx) }
    }

    /// The box about it: `(min, max)`.
    pub fn bounds(&self) -> ((f64, f64), (f64, f64)) {
        let (left, right) = (self.low.0.min(self.high.0), self.low.0.max(self.high.0));
        let r = self.radius;
        ((left - r, self.low.1 - r), (right + r, self.high.1 + r))
    }

    /// What it covers along x at heights from `bottom` to `bottom + height`, which it meets.
    pub fn span(&self, bottom: f64, height: f64) -> (f64, f64) {
        let Some(slope) = self.slope else {
            let (min, max) = self.bounds();
            return (min.0, max.0);
        };
        let at = |y: f64| y.clamp(bottom, bottom + height);
        let (left, right) = if slope > 0.0 { (self.low.1, self.high.1) } else { (self.high.1, self.low.1) };
        let (left, right) = (self.edge(at(left), -1.0, slope), self.edge(at(right), 1.0, slope));
        // Rounding may put the edges of a thin capsule on one another.
        (left.min(right), left.max(right))
    }

    /// The edge at a height, to the right (`side` 1) or to the left (-1).
    fn edge(&self, y: f64, side: f64, slope: f64) -> f64 {
        let (tx, ty) = (side * self.tangent.0, side * self.tangent.1);
        let circle = |(cx, cy): (f64, f64)| {
            let dy = y - cy;
            cx + side * (self.radius * self.radius - dy * dy).max(0.0).sqrt()
        };
        let from = self.low.1 + ty;
        if y <= from {
            circle(self.low)
        } else if y >= self.high.1 + ty {
            circle(self.high)
        } else {
            self.low.0 + tx + (y - from) * slope
        }
    }
}

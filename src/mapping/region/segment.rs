//! Straight pieces: the edges of polygons and the axes of capsules, against boxes.

use crate::interval::Box2;

/// Rounding slack of the tests for a leaf, relative to the extent of the numbers involved: `32 u` with `u = 2^-53`.
///
/// Relative to the piece's start every coordinate is one rounded difference (`u`), a cross product adds two products and
/// a difference (together below `6 u` of each product), and dividing by the length leaves an error below `12 u` of the
/// extent in a distance. Squares and square roots of distances add less than `8 u`.
pub const LEAF_SLACK: f64 = 32.0 * (f64::EPSILON / 2.0);

/// The slack for a node with children: so much above [`LEAF_SLACK`] that a node with a leaf that meets the piece always
/// meets it as well (the extent of a node's numbers is at least that of its leaves', and both errors fit between).
pub const NODE_SLACK: f64 = 2.0 * LEAF_SLACK;

/// A piece that is shorter is a point, metres: the squares of its length would be lost to underflow. What that leaves out is far
/// below the slack, which is relative to the side of a leaf at least.
const SHORTEST: f64 = 1e-100;

/// The straight piece from `start` to `end`, metres; they may be the same point.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Segment {
    pub start: (f64, f64),
    pub end: (f64, f64),
    /// `end - start`
    step: (f64, f64),
    length: f64,
}

/// A box relative to a piece's start.
struct Offset {
    x: (f64, f64),
    y: (f64, f64),
}

impl Offset {
    /// Squared distance to a point relative to the same start.
    fn distance_squared(&self, (px, py): (f64, f64)) -> f64 {
        let dx = (self.x.0 - px).max(px - self.x.1).max(0.0);
        let dy = (self.y.0 - py).max(py - self.y.1).max(0.0);
        dx * dx + dy * dy
    }

    fn corners(&self) -> [(f64, f64); 4] {
        [(self.x.0, self.y.0), (self.x.1, self.y.0), (self.x.0, self.y.1), (self.x.1, self.y.1)]
    }
}

impl Segment {
    pub fn new(start: (f64, f64), end: (f64, f64)) -> Self {
        let step = (end.0 - start.0, end.1 - start.1);
        let length = step.0.hypot(step.1);
        if length < SHORTEST {
            return Self { start, end, step: (0.0, 0.0), length: 0.0 };
        }
        Self { start, end, step, length }
    }

    /// Length, metres.
    pub fn length(&self) -> f64 {
        self.length
    }

    /// The point so far along, metres.
    pub fn at(&self, distance: f64) -> (f64, f64) {
        if self.length == 0.0 {
            return self.start;
        }
        let t = (distance / self.length).clamp(0.0, 1.0);
        (self.start.0 + t * self.step.0, self.start.1 + t * self.step.1)
    }

    /// How far along the piece, or the line that it is on, the foot of a point is; metres.
    pub fn along(&self, (x, y): (f64, f64)) -> f64 {
        if self.length == 0.0 {
            return 0.0;
        }
        ((x - self.start.0) * self.step.0 + (y - self.start.1) * self.step.1) / self.length
    }

    fn offset(&self, square: &Box2) -> Offset {
        let (x, y) = self.start;
        Offset { x: (square.x.lo() - x, square.x.hi() - x), y: (square.y.lo() - y, square.y.hi() - y) }
    }

    fn extent(&self, offset: &Offset, radius: f64) -> f64 {
        let far = |(lo, hi): (f64, f64)| lo.abs().max(hi.abs());
        far(offset.x).max(far(offset.y)) + self.step.0.abs() + self.step.1.abs() + radius
    }

    /// True when a closed box comes within `radius` of the piece, or within `slack` of the extent of that.
    pub fn comes_within(&self, square: &Box2, radius: f64, slack: f64) -> bool {
        let offset = self.offset(square);
        let (dx, dy) = self.step;
        let allowance = slack * self.extent(&offset, radius);
        let reach = radius + allowance;
        let apart = |(lo, hi): (f64, f64), d: f64| lo > d.max(0.0) + reach || hi < d.min(0.0) - reach;
        if apart(offset.x, dx) || apart(offset.y, dy) {
            return false;
        }
        let reach_squared = reach * reach;
        if offset.distance_squared((0.0, 0.0)) <= reach_squared || offset.distance_squared((dx, dy)) <= reach_squared {
            return true;
        }
        if self.length == 0.0 {
            return false;
        }
        // Signed distances of the corners from the piece's line, times the length.
        let corners = offset.corners();
        let sides = corners.map(|(px, py)| dx * py - dy * px);
        let (lo, hi) = sides.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(lo, hi), v| (lo.min(*v), hi.max(*v)));
        let band = reach * self.length;
        if lo > band || hi < -band {
            return false;
        }
        // The box crosses the line between the ends' perpendiculars, or a corner is beside the piece and near enough;
        // the two sets' nearest points are otherwise an end of the piece, which was asked above.
        let thin = allowance * self.length;
        let crosses = lo <= thin && hi >= -thin && {
            let overlaps = |(lo, hi): (f64, f64), d: f64| lo <= d.max(0.0) + allowance && hi >= d.min(0.0) - allowance;
            overlaps(offset.x, dx) && overlaps(offset.y, dy)
        };
        let along = 0.0..=self.length * self.length;
        crosses
            || corners
                .iter()
                .zip(sides)
                .any(|((px, py), side)| side.abs() <= band && along.contains(&(dx * px + dy * py)))
    }

    /// True when a closed box certainly is within `radius` of the piece, all of it. May miss some.
    pub fn covers(&self, square: &Box2, radius: f64) -> bool {
        let offset = self.offset(square);
        let allowance = LEAF_SLACK * self.extent(&offset, radius);
        // Distances to a segment are convex, so the largest over a box is at a corner.
        offset.corners().iter().all(|corner| self.distance_from_start(*corner) <= radius - allowance)
    }

    /// Distance of the point `start + offset` from the piece.
    fn distance_from_start(&self, (px, py): (f64, f64)) -> f64 {
        let (dx, dy) = self.step;
        let along = dx * px + dy * py;
        if along <= 0.0 || self.length == 0.0 {
            (px * px + py * py).sqrt()
        } else if along >= self.length * self.length {
            let (qx, qy) = (px - dx, py - dy);
            (qx * qx + qy * qy).sqrt()
        } else {
            (dx * py - dy * px).abs() / self.length
        }
    }

    /// How far along the piece a disc of this radius that moves along it first touches a closed box, metres. For a box
    /// that the disc misses (by rounding, or altogether): where it comes nearest.
    pub fn first_touch(&self, square: &Box2, radius: f64) -> f64 {
        let offset = self.offset(square);
        if self.length == 0.0 || offset.distance_squared((0.0, 0.0)) <= radius * radius {
            return 0.0;
        }
        // The box dilated by the disc is two boxes and four discs.
        let widen = |(lo, hi): (f64, f64)| (lo - radius, hi + radius);
        let mut first = self.enters(widen(offset.x), offset.y).min(self.enters(offset.x, widen(offset.y)));
        for corner in offset.corners() {
            first = first.min(self.enters_disc(corner, radius));
        }
        if first.is_finite() { first * self.length } else { self.nearest_approach(&offset) }
    }

    /// The share of the piece at which it enters a box given relative to its start; infinite when it does not.
    fn enters(&self, x: (f64, f64), y: (f64, f64)) -> f64 {
        let (mut from, mut to) = (0.0_f64, 1.0_f64);
        for ((lo, hi), d) in [(x, self.step.0), (y, self.step.1)] {
            if d == 0.0 {
                if lo > 0.0 || hi < 0.0 {
                    return f64::INFINITY;
                }
            } else {
                let (a, b) = (lo / d, hi / d);
                from = from.max(a.min(b));
                to = to.min(a.max(b));
            }
        }
        if from <= to { from } else { f64::INFINITY }
    }

    /// The share of the piece at which it enters a disc given relative to its start; infinite when it does not.
    fn enters_disc(&self, (cx, cy): (f64, f64), radius: f64) -> f64 {
        let (ux, uy) = (self.step.0 / self.length, self.step.1 / self.length);
        let beside = ux * cy - uy * cx;
        if beside.abs() > radius {
            return f64::INFINITY;
        }
        let half_chord = ((radius - beside) * (radius + beside)).max(0.0).sqrt();
        let share = (ux * cx + uy * cy - half_chord) / self.length;
        if (0.0..=1.0).contains(&share) { share } else { f64::INFINITY }
    }

    /// How far along the piece it comes nearest to a box that it does not meet, metres.
    fn nearest_approach(&self, offset: &Offset) -> f64 {
        let ends = [0.0, self.length];
        let beside = offset
            .corners()
            .map(|(px, py)| ((self.step.0 * px + self.step.1 * py) / self.length).clamp(0.0, self.length));
        let gap = |distance: f64| {
            let share = distance / self.length;
            offset.distance_squared((share * self.step.0, share * self.step.1))
        };
        ends.into_iter().chain(beside).min_by(|a, b| gap(*a).total_cmp(&gap(*b))).unwrap_or(0.0)
    }
}

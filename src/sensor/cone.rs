//! The beam as a cone in its own frame: origin at the emitter, x along the beam's axis, y to the left; metres.
//!
//! With `h = phi_b / 2` and the virtual apex `delta_d = cot(h) w_b / 2` behind the emitter (4), the point of (6) at
//! distance `d` and angle `tau` off the axis, `|tau| <= h`, is
//!
//! ```text
//! axial   = (d + delta_d) cos(tau) - delta_d
//! lateral = (d + delta_d) sin(tau)
//! ```
//!
//! At the side, `tau = h`, `delta_d` goes out of both. With `delta_d sin(h) = cos(h) w_b / 2` the lateral part is
//!
//! ```text
//! d sin(h) + cos(h) w_b / 2
//! ```
//!
//! and with `1 - cos(h) = 2 sin^2(h/2)` and `sin(h) = 2 sin(h/2) cos(h/2)`, so that
//! `cot(h) (1 - cos(h)) = cos(h) tan(h/2)`, the axial part is
//!
//! ```text
//! d cos(h) - cos(h) tan(h/2) w_b / 2
//! ```
//!
//! Neither divides nor cancels, and for `phi_b = 0` both are those of the strip of width `w_b`.

use super::{SensorModel, SensorSpec};
use crate::interval::{Box2, Interval, Verdict};

/// The rectangle `[near, far] x [-half_width, half_width]` about the part of a beam's cone with `[d]`, in the frame of
/// the beam, rounded outward; metres.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BeamRectangle {
    /// Axial lower bound: slightly below `d-`, since the sides of the cone recede.
    pub near: f64,
    /// Axial upper bound, `d+`.
    pub far: f64,
    /// Lateral bound: half the width of the cone at `d+`.
    pub half_width: f64,
}

/// The part `0 <= d <= d-` of a beam's cone in the frame of the beam: what lies before the obstacle.
///
/// It lies within the convex hexagon of [`EmptyCone::corners`], rounded outward, which leaves out nothing of it and adds
/// the two slivers between the far arc and its box; metres.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct EmptyCone {
    /// Axial lower bound: 0 for a pencil or a strip, slightly below where the sides recede.
    pub start: f64,
    /// Half the width at [`EmptyCone::start`].
    pub half_width_at_origin: f64,
    /// Where the sides end, axially: slightly below [`EmptyCone::near_end`].
    pub shoulder: f64,
    /// Half the width at the shoulder, the largest.
    pub half_width_at_near: f64,
    /// Axial upper bound, `d-`.
    pub near_end: f64,
}

impl EmptyCone {
    /// The corners of the enclosing convex hexagon, counter-clockwise from the right one at the emitter.
    #[must_use]
    pub fn corners(&self) -> [(f64, f64); 6] {
        [
            (self.start, -self.half_width_at_origin),
            (self.shoulder, -self.half_width_at_near),
            (self.near_end, -self.half_width_at_near),
            (self.near_end, self.half_width_at_near),
            (self.shoulder, self.half_width_at_near),
            (self.start, self.half_width_at_origin),
        ]
    }
}

/// The cone of a sensor's beams, its trigonometry done once.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BeamCone {
    half_opening: f64,
    sin: Interval,
    cos: Interval,
    radius: Interval,
    /// `cos(h) w_b / 2`, lateral, at `d = 0`.
    side: Interval,
    /// `cos(h) tan(h/2) w_b / 2`: how far the sides recede at `d = 0`.
    recession: Interval,
}

impl BeamCone {
    /// The cone of the beams of a sensor.
    #[must_use]
    pub fn new(sensor: &SensorModel) -> Self {
        Self::of(sensor.spec())
    }

    pub(super) fn of(spec: &SensorSpec) -> Self {
        let half_opening = 0.5 * spec.beam_opening;
        let half = Interval::point(half_opening);
        let quarter = half.scale(0.5);
        let (sin, cos) = (half.sin(), half.cos());
        let radius = Interval::point(0.5 * spec.beam_diameter);
        let side = cos * radius;
        // h < pi / 2, so neither cosine's enclosure reaches zero.
        let recession = side * (quarter.sin() / quarter.cos());
        Self { half_opening, sin, cos, radius, side, recession }
    }

    /// `h = phi_b / 2`, radians.
    #[must_use]
    pub fn half_opening(&self) -> f64 {
        self.half_opening
    }

    /// An enclosure of `delta_d` (4), metres; unbounded for a strip, 0 where the beam begins as a point.
    #[must_use]
    pub fn apex_offset(&self) -> Interval {
        if self.radius == Interval::point(0.0) { self.radius } else { self.side / self.sin }
    }

    /// An enclosure of the axial part of the point at distance `d` on the cone's side, metres; never above `d`.
    #[must_use]
    pub fn side_axial(&self, d: f64) -> Interval {
        Interval::point(d) * self.cos - self.recession
    }

    /// An enclosure of the lateral part of the point at distance `d` on the cone's side: half its width there, metres.
    #[must_use]
    pub fn side_lateral(&self, d: f64) -> Interval {
        Interval::point(d) * self.sin + self.side
    }

    /// The rectangle about the part of the cone with `[d] = [near, far]`, metres, `0 <= near <= far`.
    #[must_use]
    pub fn rectangle(&self, near: f64, far: f64) -> BeamRectangle {
        BeamRectangle { near: self.side_axial(near).lo(), far, half_width: self.side_lateral(far).hi() }
    }

    /// The part with `0 <= d <= near`, metres.
    #[must_use]
    pub fn empty(&self, near: f64) -> EmptyCone {
        EmptyCone {
            start: self.side_axial(0.0).lo(),
            half_width_at_origin: self.side_lateral(0.0).hi(),
            shoulder: self.side_axial(near).lo(),
            half_width_at_near: self.side_lateral(near).hi(),
            near_end: near,
        }
    }

    /// Do the points of a box in the frame of the beam lie in the part of the cone with `0 <= d <= near` (metres)?
    ///
    /// The inclusion test behind (8) to (11), in a form without `delta_d`: a point lies between the sides when
    /// `|y| cos(h) <= x sin(h) + cos(h) w_b / 2`, and its distance from the apex is `d + delta_d`; squared and times
    /// `tan(h)`, `d <= near` reads `(x^2 + y^2 - near^2) tan(h) <= w_b (near - x)` and `d >= 0` reads
    /// `(x^2 + y^2) tan(h) + w_b x >= 0`. For `phi_b = 0` they are `x <= near` and `x >= 0`.
    #[must_use]
    pub fn holds(&self, point: Box2, near: f64) -> Verdict {
        let (x, y) = (point.x, point.y);
        let between = at_most(y.abs() * self.cos, x * self.sin + self.side);
        let limit = Interval::point(near);
        let zero = Interval::point(0.0);
        if self.half_opening == 0.0 {
            return between.and(at_most(zero, x)).and(at_most(x, limit));
        }
        let tan = self.sin / self.cos;
        let diameter = self.radius.scale(2.0);
        let square = x.square() + y.square();
        let ahead = at_most(zero, square * tan + diameter * x);
        let before = at_most((square - limit.square()) * tan, diameter * (limit - x));
        between.and(ahead).and(before)
    }
}

/// Is `a <= b` for all, for no, or for some choices of members?
fn at_most(a: Interval, b: Interval) -> Verdict {
    if a.hi() <= b.lo() {
        Verdict::Yes
    } else if a.lo() > b.hi() {
        Verdict::No
    } else {
        Verdict::Unknown
    }
}

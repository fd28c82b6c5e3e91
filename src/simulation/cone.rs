//! Beams as cones: what of a world a beam touches, and how far away it is.

use super::part::to_frame;
use super::{GUARD, Point};
use crate::sensor::SensorSpec;

/// A beam: all points in front of its emitter within half the opening angle of its axis as seen from the virtual apex,
/// which lies `delta_d` behind the emitter (4); for an opening of 0 the strip of the beam's diameter.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Cone {
    emitter: Point,
    axis: Point,
    half_diameter: f64,
    /// Sine, cosine and tangent of half the opening angle.
    sin: f64,
    cos: f64,
    tan: f64,
}

impl Cone {
    /// A beam from `emitter` (map frame, metres) towards `heading` (radians) with the opening angle and diameter
    /// of a sensor; the opening is below pi.
    #[must_use]
    pub fn new(emitter: Point, heading: f64, sensor: &SensorSpec) -> Self {
        Self::with_opening(emitter, heading, sensor.beam_opening, sensor.beam_diameter)
    }

    /// A beam of the given full opening angle (radians, below pi) and diameter (metres).
    #[must_use]
    pub fn with_opening(emitter: Point, heading: f64, opening: f64, diameter: f64) -> Self {
        let (sin, cos) = (0.5 * opening).sin_cos();
        let axis = Point::new(heading.cos(), heading.sin());
        Self { emitter, axis, half_diameter: 0.5 * diameter, sin, cos, tan: sin / cos }
    }

    /// A ray: a beam without any width.
    #[must_use]
    pub fn ray(emitter: Point, heading: f64) -> Self {
        Self::with_opening(emitter, heading, 0.0, 0.0)
    }

    /// The unit vector along the beam, map frame.
    #[must_use]
    pub fn axis(&self) -> Point {
        self.axis
    }

    /// Where the beam starts, map frame.
    #[must_use]
    pub fn emitter(&self) -> Point {
        self.emitter
    }

    /// The beam's diameter at its emitter, metres.
    #[must_use]
    pub fn diameter(&self) -> f64 {
        2.0 * self.half_diameter
    }

    /// A point of the map in the beam's frame: emitter at the origin, x along the axis.
    #[must_use]
    pub fn to_beam(&self, point: Point) -> Point {
        to_frame(point - self.emitter, self.axis)
    }

    /// `delta_d` (4), metres; infinite for a strip that has a width.
    fn offset(&self) -> f64 {
        if self.half_diameter == 0.0 { 0.0 } else { self.half_diameter / self.tan }
    }

    /// The virtual apex in the beam's frame; `None` for a strip.
    #[must_use]
    pub(super) fn apex(&self) -> Option<Point> {
        (self.tan > 0.0).then(|| Point::new(-self.offset(), 0.0))
    }

    /// The two sides in the beam's frame: start and unit direction.
    pub(super) fn sides(&self) -> [(Point, Point); 2] {
        [1.0, -1.0].map(|s| (Point::new(0.0, s * self.half_diameter), Point::new(self.cos, s * self.sin)))
    }

    /// True when a point of the beam's frame is in the cone, with the guard added all round.
    pub(super) fn holds(&self, p: Point) -> bool {
        p.x >= -GUARD && p.y.abs() <= self.half_diameter + p.x * self.tan + GUARD * (1.0 + self.tan)
    }

    /// The distance of (6) to a point of the beam's frame: from the virtual apex, less `delta_d`; never negative.
    #[must_use]
    pub fn measure(&self, p: Point) -> f64 {
        if self.tan == 0.0 {
            return p.x.max(0.0);
        }
        // |p - apex| - delta_d without the cancellation of two large numbers.
        let offset = self.offset();
        let sum = (p.x + offset).hypot(p.y) + offset;
        if sum == 0.0 { 0.0 } else { ((p.norm_squared() + 2.0 * p.x * offset) / sum).max(0.0) }
    }

    /// True when a disc (map frame) certainly does not touch the cone: a cheap test before the exact one.
    #[must_use]
    pub fn misses(&self, center: Point, radius: f64) -> bool {
        let p = self.to_beam(center);
        let reach = radius + 2.0 * GUARD;
        p.x < -reach || (p.y.abs() - self.half_diameter) * self.cos - p.x * self.sin > reach
    }
}

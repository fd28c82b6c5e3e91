//! Axis-parallel 2-D boxes.

use super::Interval;

/// A closed axis-parallel box `x × y`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Box2 {
    /// Extent along x.
    pub x: Interval,
    /// Extent along y.
    pub y: Interval,
}

impl Box2 {
    /// The box of two extents.
    #[must_use]
    pub fn new(x: Interval, y: Interval) -> Self {
        Self { x, y }
    }

    /// The box that holds one point.
    #[must_use]
    pub fn point(x: f64, y: f64) -> Self {
        Self { x: Interval::point(x), y: Interval::point(y) }
    }

    /// True when the point is a member.
    #[must_use]
    pub fn contains(self, x: f64, y: f64) -> bool {
        self.x.contains(x) && self.y.contains(y)
    }

    /// True when every member of `other` is a member.
    #[must_use]
    pub fn encloses(self, other: Self) -> bool {
        self.x.encloses(other.x) && self.y.encloses(other.y)
    }

    /// True when the two have a point in common.
    #[must_use]
    pub fn meets(self, other: Self) -> bool {
        self.x.meets(other.x) && self.y.meets(other.y)
    }

    /// The smallest box that encloses both.
    #[must_use]
    pub fn hull(self, other: Self) -> Self {
        Self { x: self.x.hull(other.x), y: self.y.hull(other.y) }
    }
}

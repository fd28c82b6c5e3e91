//! Obstacles with exact geometry, and worlds of them.

use super::part::from_frame;
use super::{Cone, Part, Point};

/// An obstacle: a closed set that satisfies assumption A4 with [`Shape::width`] as the least obstacle width.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Shape {
    /// A disc, such as a table leg or a pillar.
    Disc {
        /// The middle.
        center: Point,
        /// The radius, metres.
        radius: f64,
    },
    /// All points within `radius` of a segment, such as a door leaf with round edges.
    Capsule {
        /// One end of the segment.
        from: Point,
        /// The other end.
        to: Point,
        /// The radius, metres.
        radius: f64,
    },
    /// A rectangle at any angle.
    Rectangle {
        /// The middle.
        center: Point,
        /// Heading of its first axis, radians.
        heading: f64,
        /// Half extents along and across the heading, metres.
        half: (f64, f64),
    },
    /// A disc with a right-angled nose: the hull of the disc and a point `sqrt(2)` radii from its centre. Of all shapes
    /// that satisfy A4 the one whose nose is farthest from its disc: the limit `lambda` itself.
    Drop {
        /// The middle of the disc.
        center: Point,
        /// The disc's radius, metres.
        radius: f64,
        /// Where the nose points, radians.
        heading: f64,
    },
}

impl Shape {
    /// The axis-parallel rectangle between two corners.
    #[must_use]
    pub fn rectangle_between(a: (f64, f64), b: (f64, f64)) -> Self {
        let center = Point::new(0.5 * (a.0 + b.0), 0.5 * (a.1 + b.1));
        Self::Rectangle { center, heading: 0.0, half: (0.5 * (b.0 - a.0).abs(), 0.5 * (b.1 - a.1).abs()) }
    }

    /// The largest `s` with which the shape satisfies A4, metres.
    #[must_use]
    pub fn width(&self) -> f64 {
        match *self {
            Self::Disc { radius, .. } | Self::Capsule { radius, .. } | Self::Drop { radius, .. } => 2.0 * radius,
            Self::Rectangle { half, .. } => 2.0 * half.0.min(half.1),
        }
    }

    /// The convex pieces whose union the shape is.
    pub fn parts(&self, found: &mut dyn FnMut(Part)) {
        match *self {
            Self::Disc { center, radius } => found(Part::Disc { center, radius }),
            Self::Capsule { from, to, radius } => {
                found(Part::Disc { center: from, radius });
                found(Part::Disc { center: to, radius });
                let length = (to - from).norm();
                if length > 0.0 {
                    let axis = (to - from) / length;
                    let half = Point::new(0.5 * length, radius);
                    found(Part::Rectangle { center: (from + to) * 0.5, axis, half });
                }
            }
            Self::Rectangle { center, heading, half } => {
                let axis = Point::new(heading.cos(), heading.sin());
                found(Part::Rectangle { center, axis, half: Point::new(half.0, half.1) });
            }
            Self::Drop { center, radius, heading } => {
                found(Part::Disc { center, radius });
                // The two tangents from the nose touch the disc at right angles to each other: with the centre and the
                // nose the points of contact make a square of side `radius`, turned by 45 degrees.
                let turn = heading + std::f64::consts::FRAC_PI_4;
                let axis = Point::new(turn.cos(), turn.sin());
                let middle = from_frame(Point::new(0.5 * radius, -0.5 * radius), axis);
                let half = Point::new(0.5 * radius, 0.5 * radius);
                found(Part::Rectangle { center: center + middle, axis, half });
            }
        }
    }

    /// The distance from a point to the shape, 0 inside; metres.
    #[must_use]
    pub fn distance(&self, point: Point) -> f64 {
        let mut best = f64::INFINITY;
        self.parts(&mut |part| best = best.min(part.distance(point)));
        best
    }
}

/// A union of shapes.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct World {
    shapes: Vec<Shape>,
    parts: Vec<(Part, Point, f64)>,
}

impl World {
    /// A world of the given shapes.
    #[must_use]
    pub fn new(shapes: Vec<Shape>) -> Self {
        let mut parts = Vec::with_capacity(shapes.len());
        for shape in &shapes {
            shape.parts(&mut |part| {
                let (center, radius) = part.bounds();
                parts.push((part, center, radius));
            });
        }
        Self { shapes, parts }
    }

    /// The shapes.
    #[must_use]
    pub fn shapes(&self) -> &[Shape] {
        &self.shapes
    }

    /// The convex pieces of all shapes.
    pub fn parts(&self) -> impl Iterator<Item = &Part> {
        self.parts.iter().map(|(part, _, _)| part)
    }

    /// The distance from a point to the nearest obstacle, 0 inside one, infinite in an empty world; metres.
    #[must_use]
    pub fn distance(&self, point: Point) -> f64 {
        self.parts.iter().fold(f64::INFINITY, |best, (part, center, radius)| {
            if (point - center).norm() - radius >= best { best } else { best.min(part.distance(point)) }
        })
    }

    /// The distance by (6) to the nearest obstacle point anywhere in a beam's cone (A2), however little of the beam it
    /// fills; `None` when no obstacle touches the cone. At most [`super::GUARD`]-sized errors, never above the truth.
    #[must_use]
    pub fn nearest_in(&self, cone: &Cone) -> Option<f64> {
        self.parts
            .iter()
            .filter(|(_, center, radius)| !cone.misses(*center, *radius))
            .filter_map(|(part, _, _)| part.nearest_in(cone))
            .reduce(f64::min)
    }

    /// True when nothing stands on the segment between two points.
    #[must_use]
    pub fn sees(&self, from: Point, to: Point) -> bool {
        let way = to - from;
        let ray = Cone::ray(from, way.y.atan2(way.x));
        self.nearest_in(&ray).is_none_or(|d| d > way.norm())
    }
}

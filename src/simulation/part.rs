//! The two convex shapes that everything is made of: discs and rectangles at any angle.

use super::{Cone, GUARD, Point};

/// A closed convex piece of an obstacle; lengths in metres, map frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Part {
    /// All points within `radius` of `center`; a radius of 0 is a point.
    Disc {
        /// The middle.
        center: Point,
        /// The radius.
        radius: f64,
    },
    /// A rectangle; a half extent of 0 makes it a segment.
    Rectangle {
        /// The middle.
        center: Point,
        /// Unit vector of its first axis.
        axis: Point,
        /// Half extents along `axis` and across it.
        half: Point,
    },
}

impl Part {
    /// A disc that holds the part: centre and radius.
    #[must_use]
    pub fn bounds(&self) -> (Point, f64) {
        match *self {
            Self::Disc { center, radius } => (center, radius),
            Self::Rectangle { center, half, .. } => (center, half.norm()),
        }
    }

    /// The distance from a point to the nearest point of the part, 0 inside.
    #[must_use]
    pub fn distance(&self, point: Point) -> f64 {
        match *self {
            Self::Disc { center, radius } => ((point - center).norm() - radius).max(0.0),
            Self::Rectangle { center, axis, half } => {
                let local = to_frame(point - center, axis);
                Point::new((local.x.abs() - half.x).max(0.0), (local.y.abs() - half.y).max(0.0)).norm()
            }
        }
    }

    /// The smallest and largest `x` of the part's points with `y` in `[y_min, y_max]`; `None` when there are none.
    ///
    /// The part is convex, so its points in the strip have every `x` between: a square of the strip meets the part
    /// exactly when its `x` extent meets this one.
    #[must_use]
    pub fn extent_in_strip(&self, y_min: f64, y_max: f64) -> Option<(f64, f64)> {
        match *self {
            Self::Disc { center, radius } => {
                let off = (center.y.clamp(y_min, y_max) - center.y).abs();
                (off <= radius).then(|| {
                    let chord = ((radius - off) * (radius + off)).sqrt();
                    (center.x - chord, center.x + chord)
                })
            }
            Self::Rectangle { center, axis, half } => {
                let corners = corners(center, axis, half);
                let mut extent: Option<(f64, f64)> = None;
                let mut add = |x: f64| {
                    extent = Some(extent.map_or((x, x), |(lo, hi)| (lo.min(x), hi.max(x))));
                };
                for (a, b) in edges(&corners) {
                    if (y_min..=y_max).contains(&a.y) {
                        add(a.x);
                    }
                    for y in [y_min, y_max] {
                        if (a.y < y) != (b.y < y) {
                            add(a.x + (b.x - a.x) * ((y - a.y) / (b.y - a.y)).clamp(0.0, 1.0));
                        }
                    }
                }
                extent
            }
        }
    }

    /// The distance, as equation (6) measures it, to the part's nearest point in a beam's cone; `None` when the cone
    /// does not touch the part. The part is taken [`GUARD`] larger, so the answer is never above the true one.
    ///
    /// The nearest point of a convex shape within a convex cone is the shape's nearest point to the apex, where that
    /// lies in the cone, and otherwise on the cone's border: on one of its two sides or its front.
    #[must_use]
    pub fn nearest_in(&self, cone: &Cone) -> Option<f64> {
        let shape = self.in_frame_of(cone);
        let mut best: Option<f64> = None;
        let mut offer = |p: Point| {
            let d = cone.measure(p);
            best = Some(best.map_or(d, |b| b.min(d)));
        };
        shape.extreme_points(cone, &mut |p| {
            if cone.holds(p) {
                offer(p);
            }
        });
        for (start, direction) in cone.sides() {
            if let Some((first, last)) = shape.on_line(start, direction)
                && last >= 0.0
            {
                offer(start + direction * first.max(0.0));
            }
        }
        let front = 0.5 * cone.diameter();
        if let Some((first, last)) = shape.on_line(Point::zeros(), Point::new(0.0, 1.0))
            && first <= front
            && last >= -front
        {
            offer(Point::new(0.0, 0.0_f64.clamp(first.max(-front), last.min(front))));
        }
        best
    }

    /// The part, widened by the guard, in the beam's frame: emitter at the origin, x along the axis.
    fn in_frame_of(&self, cone: &Cone) -> Self {
        match *self {
            Self::Disc { center, radius } => Self::Disc { center: cone.to_beam(center), radius: radius + GUARD },
            Self::Rectangle { center, axis, half } => Self::Rectangle {
                center: cone.to_beam(center),
                axis: to_frame(axis, cone.axis()),
                half: half.add_scalar(GUARD),
            },
        }
    }

    /// In the beam's frame: the points at which the distance of (6) can be least over the whole part.
    fn extreme_points(&self, cone: &Cone, found: &mut dyn FnMut(Point)) {
        let apex = cone.apex();
        match (*self, apex) {
            (Self::Disc { center, radius }, None) => found(Point::new(center.x - radius, center.y)),
            (Self::Disc { center, radius }, Some(apex)) => {
                let away = center - apex;
                let length = away.norm();
                // The apex inside the disc: then the least distance within the cone is on the cone's border.
                if length > radius {
                    found(center - away * (radius / length));
                }
            }
            (Self::Rectangle { center, axis, half }, apex) => {
                // A strip's distance is linear along its axis, least at a corner.
                for corner in corners(center, axis, half) {
                    found(corner);
                }
                if let Some(apex) = apex {
                    let local = to_frame(apex - center, axis);
                    let nearest = Point::new(local.x.clamp(-half.x, half.x), local.y.clamp(-half.y, half.y));
                    found(center + from_frame(nearest, axis));
                }
            }
        }
    }

    /// Where the line `start + t * direction` (a unit vector) runs through the part: first and last `t`.
    fn on_line(&self, start: Point, direction: Point) -> Option<(f64, f64)> {
        match *self {
            Self::Disc { center, radius } => {
                let to = center - start;
                let along = to.dot(&direction);
                let off = direction.perp(&to).abs();
                (off <= radius).then(|| {
                    let chord = ((radius - off) * (radius + off)).sqrt();
                    (along - chord, along + chord)
                })
            }
            Self::Rectangle { center, axis, half } => {
                let (origin, direction) = (to_frame(start - center, axis), to_frame(direction, axis));
                let (mut first, mut last) = (f64::NEG_INFINITY, f64::INFINITY);
                for k in 0..2 {
                    if direction[k] == 0.0 {
                        if origin[k].abs() > half[k] {
                            return None;
                        }
                        continue;
                    }
                    let (a, b) = ((-half[k] - origin[k]) / direction[k], (half[k] - origin[k]) / direction[k]);
                    first = first.max(a.min(b));
                    last = last.min(a.max(b));
                }
                (first <= last).then_some((first, last))
            }
        }
    }
}

/// The coordinates of a vector in the frame whose first axis is the unit vector `axis`.
pub(super) fn to_frame(v: Point, axis: Point) -> Point {
    Point::new(axis.dot(&v), axis.perp(&v))
}

/// The inverse of [`to_frame`].
pub(super) fn from_frame(v: Point, axis: Point) -> Point {
    Point::new(axis.x * v.x - axis.y * v.y, axis.y * v.x + axis.x * v.y)
}

fn corners(center: Point, axis: Point, half: Point) -> [Point; 4] {
    [(1.0, 1.0), (-1.0, 1.0), (-1.0, -1.0), (1.0, -1.0)]
        .map(|(a, b)| center + from_frame(Point::new(a * half.x, b * half.y), axis))
}

fn edges(corners: &[Point; 4]) -> [(Point, Point); 4] {
    std::array::from_fn(|i| (corners[i], corners[(i + 1) % 4]))
}

//! Regions of the plane: closed sets that a query asks about.

mod lens;
mod polygon;
mod probe;
mod rows;
mod scan;
mod segment;

pub(super) use lens::{Lens, smallest_node};
pub(super) use probe::{Cover, Probe};
pub(super) use segment::Segment;

use crate::interval::{Box2, Interval};
use thiserror::Error;

/// Largest absolute coordinate and radius of a region, metres.
pub const MAX_REGION_COORDINATE: f64 = 1e9;

/// Limits on regions that come from outside.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RegionLimits {
    /// Most points of a polygon or path.
    pub max_points: usize,
}

impl Default for RegionLimits {
    fn default() -> Self {
        Self { max_points: 4096 }
    }
}

/// Why a region is refused; each names the field at fault.
#[derive(Debug, Clone, PartialEq, Error)]
pub enum RegionError {
    /// A coordinate or radius is NaN, infinite or beyond 10^9 m.
    #[error("{field} is not a usable number: {value}")]
    NotFinite {
        /// The field.
        field: String,
        /// Its value.
        value: f64,
    },
    /// `min > max`.
    #[error("{field} is inverted: min {min} is above max {max}")]
    Inverted {
        /// The axis.
        field: String,
        /// Lower bound.
        min: f64,
        /// Upper bound.
        max: f64,
    },
    /// A negative radius.
    #[error("{field} must not be negative, got {value}")]
    Negative {
        /// The field.
        field: String,
        /// Its value.
        value: f64,
    },
    /// Too few or too many points.
    #[error("{field} has {count} points: it must have {min} to {max}")]
    Points {
        /// The field.
        field: String,
        /// How many there are.
        count: usize,
        /// Fewest allowed.
        min: usize,
        /// Most allowed.
        max: usize,
    },
}

/// What a region is made of; every number is finite.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum Shape {
    /// The closed box, which is [`Region::bounds`].
    Rectangle,
    /// The closed disc.
    Disc {
        /// Its centre, metres.
        center: (f64, f64),
        /// Its radius, metres; 0 is the point.
        radius: f64,
    },
    /// A closed polygon by the even-odd rule, with its boundary.
    Polygon {
        /// The edges, the closing one last.
        edges: Vec<Segment>,
    },
    /// A union of capsules.
    Path {
        /// The pieces of the polyline in order; one of length 0 for a path of one point.
        pieces: Vec<Segment>,
        /// The radius, metres.
        radius: f64,
    },
}

/// A closed region of the map frame, metres. Built by the checked constructors.
///
/// Its tests against squares round outward: a square that meets the region is never said to be apart from it, and one
/// that is said to meet it comes within `2^-46` of the extent of the numbers involved (the distance between the square
/// and the piece of the region, their sizes and the radius), far below one part in 10^12 of the coordinates, or within
/// `2^-511` m, where numbers have no square.
#[derive(Debug, Clone, PartialEq)]
pub struct Region {
    shape: Shape,
    bounds: Box2,
}

impl Region {
    /// The closed box `[min_x, max_x] x [min_y, max_y]`.
    ///
    /// # Errors
    /// [`RegionError`] for bounds that are not finite or inverted.
    pub fn rectangle(min: (f64, f64), max: (f64, f64)) -> Result<Self, RegionError> {
        for (field, value) in [("box.min_x", min.0), ("box.min_y", min.1), ("box.max_x", max.0), ("box.max_y", max.1)] {
            usable(|| field.to_owned(), value)?;
        }
        let axis = |field: &str, min: f64, max: f64| {
            Interval::new(min, max).ok_or(RegionError::Inverted { field: field.to_owned(), min, max })
        };
        let bounds = Box2::new(axis("box.x", min.0, max.0)?, axis("box.y", min.1, max.1)?);
        Ok(Self { shape: Shape::Rectangle, bounds })
    }

    /// The closed disc; a radius of 0 is the point.
    ///
    /// # Errors
    /// [`RegionError`] for values that are not finite or a negative radius.
    pub fn disc(center: (f64, f64), radius: f64) -> Result<Self, RegionError> {
        usable(|| "disc.center.x".to_owned(), center.0)?;
        usable(|| "disc.center.y".to_owned(), center.1)?;
        usable_radius("disc.radius", radius)?;
        Ok(Self { shape: Shape::Disc { center, radius }, bounds: dilated_hull(&[center], radius) })
    }

    /// The closed simple polygon of at least 3 corners in either order, concave or not, its boundary included. A
    /// boundary that crosses itself encloses what an odd number of its turns encloses, and all of its boundary.
    ///
    /// # Errors
    /// [`RegionError`] for corners that are not finite, too few or too many.
    #[expect(clippy::needless_pass_by_value, reason = "what a request holds goes into the region")]
    pub fn polygon(points: Vec<(f64, f64)>, limits: &RegionLimits) -> Result<Self, RegionError> {
        usable_points("polygon.points", &points, 3, limits)?;
        let next = points.iter().skip(1).chain(points.first());
        let edges = points.iter().zip(next).map(|(a, b)| Segment::new(*a, *b)).collect();
        Ok(Self { shape: Shape::Polygon { edges }, bounds: dilated_hull(&points, 0.0) })
    }

    /// All points within `radius` of a polyline of at least 1 point.
    ///
    /// # Errors
    /// [`RegionError`] for values that are not finite, a negative radius, too few or too many points.
    #[expect(clippy::needless_pass_by_value, reason = "what a request holds goes into the region")]
    pub fn path(points: Vec<(f64, f64)>, radius: f64, limits: &RegionLimits) -> Result<Self, RegionError> {
        usable_points("path.points", &points, 1, limits)?;
        usable_radius("path.radius", radius)?;
        let bounds = dilated_hull(&points, radius);
        let pieces = match points.as_slice() {
            [only] => vec![Segment::new(*only, *only)],
            _ => points.windows(2).map(|pair| Segment::new(pair[0], pair[1])).collect(),
        };
        Ok(Self { shape: Shape::Path { pieces, radius }, bounds })
    }

    /// The smallest box that encloses the region, rounded outward; metres.
    #[must_use]
    pub fn bounds(&self) -> Box2 {
        self.bounds
    }

    /// True when the region and a closed box have a point in common, rounded outward as the type says.
    #[must_use]
    pub fn meets(&self, square: &Box2) -> bool {
        self.bounds.meets(*square) && Probe::new(self).classify(0, square, true) == Cover::All
    }

    pub(super) fn shape(&self) -> &Shape {
        &self.shape
    }
}

/// The box about points and everything within `radius` of them, rounded outward.
fn dilated_hull(points: &[(f64, f64)], radius: f64) -> Box2 {
    let hull = |pick: fn(&(f64, f64)) -> f64| {
        let (lo, hi) =
            points.iter().map(pick).fold((f64::INFINITY, f64::NEG_INFINITY), |(lo, hi), v| (lo.min(v), hi.max(v)));
        // A sum of radius 0 is exact; any other is rounded to nearest, and one float outward is a bound of it.
        if radius == 0.0 {
            Interval::spanning(lo, hi)
        } else {
            Interval::spanning((lo - radius).next_down(), (hi + radius).next_up())
        }
    };
    Box2::new(hull(|p| p.0), hull(|p| p.1))
}

fn usable(field: impl Fn() -> String, value: f64) -> Result<(), RegionError> {
    if value.abs() <= MAX_REGION_COORDINATE { Ok(()) } else { Err(RegionError::NotFinite { field: field(), value }) }
}

fn usable_radius(field: &str, value: f64) -> Result<(), RegionError> {
    usable(|| field.to_owned(), value)?;
    if value < 0.0 { Err(RegionError::Negative { field: field.to_owned(), value }) } else { Ok(()) }
}

fn usable_points(field: &str, points: &[(f64, f64)], min: usize, limits: &RegionLimits) -> Result<(), RegionError> {
    if points.len() < min || points.len() > limits.max_points {
        return Err(RegionError::Points { field: field.to_owned(), count: points.len(), min, max: limits.max_points });
    }
    for (i, (x, y)) in points.iter().enumerate() {
        usable(|| format!("{field}[{i}].x"), *x)?;
        usable(|| format!("{field}[{i}].y"), *y)?;
    }
    Ok(())
}

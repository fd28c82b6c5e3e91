//! Windows: stretches of wall at which a scanner fails as it does at glass.
//!
//! A beam that meets a pane often has no reading, and the scanner says so. It never reads through the pane: that would
//! break the bounds that a scan claims, and with them what its map guarantees.

use super::Point;
use rand::{Rng, RngExt};

/// Share of the beams on a pane that fail.
const FAILED: f64 = 0.7;

/// How far a measured point may lie off the pane's line, metres: the range error and the width of a beam.
const NEAR: f64 = 0.15;

/// A pane along a wall that is parallel to the x axis.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Pane {
    /// The wall's face, metres.
    pub y: f64,
    /// From where to where, metres.
    pub x: (f64, f64),
}

impl Pane {
    fn holds(&self, point: Point) -> bool {
        (point.y - self.y).abs() < NEAR && (self.x.0..=self.x.1).contains(&point.x)
    }
}

/// Makes beams fail that ended on a pane: `origin` and `heading` are the sensor's, `angle` gives the mirror angle of each
/// of the `ranges`, radians.
pub fn fail_at_glass(
    panes: &[Pane],
    (origin, heading): (Point, f64),
    angle: impl Fn(usize) -> f64,
    ranges: &mut [f32],
    random: &mut impl Rng,
) {
    for (beam, range) in ranges.iter_mut().enumerate().filter(|(_, range)| range.is_finite() && **range > 0.0) {
        let direction = heading + angle(beam);
        let end = origin + Point::new(direction.cos(), direction.sin()) * f64::from(*range);
        if panes.iter().any(|pane| pane.holds(end)) && random.random::<f64>() < FAILED {
            *range = f32::NAN;
        }
    }
}

//! The beams of a scan in ascending angle with their unit vectors; kept from scan to scan while the angles stay.

use crate::sensor::{Angles, Scan};
use std::f64::consts::TAU;

/// An angle's sine and cosine, kept while the angle stays: a correctly rounded function takes as long as some beams do.
#[derive(Debug, Clone, Copy)]
pub(super) struct Turn {
    angle: f64,
    /// `(sin, cos)`
    of: (f64, f64),
}

impl Default for Turn {
    fn default() -> Self {
        Self { angle: 0.0, of: (0.0, 1.0) }
    }
}

impl Turn {
    /// `(sin, cos)` of an angle, radians.
    pub(super) fn sin_cos(&mut self, angle: f64) -> (f64, f64) {
        if angle != self.angle {
            *self = Self { angle, of: (core_math::sin(angle), core_math::cos(angle)) };
        }
        self.of
    }
}

/// A ring of even steps closes when the step over its seam differs by no more than this, radians.
const SEAM: f64 = 1e-6;

/// Beams at even steps, no two of them at one angle.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Even {
    /// Radians between neighbours.
    pub step: f64,
    /// True when the last and the first beam are neighbours like any other two.
    pub ring: bool,
    /// How much the step over the seam of a ring differs from the others, radians.
    pub seam_error: f64,
}

/// Order, angles and unit vectors of a scan's beams.
#[derive(Debug, Default)]
pub(super) struct Directions {
    of: Option<(Angles, usize)>,
    /// Beam index by position in ascending angle.
    order: Vec<u32>,
    /// Angle by position, radians in the sensor frame.
    angles: Vec<f64>,
    /// `(cos, sin)` of the angle by position, each correctly rounded.
    units: Vec<(f64, f64)>,
    /// The same in single precision, and behind the last position the first again.
    pub(super) cos: Vec<f32>,
    pub(super) sin: Vec<f32>,
    even: Option<Even>,
}

impl Directions {
    /// Brings the table up to date for a scan.
    pub(super) fn prepare(&mut self, scan: &Scan) {
        let beams = scan.beams();
        if self.of.as_ref().is_some_and(|(angles, count)| *count == beams && *angles == scan.spec().angles) {
            return;
        }
        let lowest = (0..beams).map(|beam| scan.angle(beam)).fold(f64::INFINITY, f64::min);
        // A beam that closes the circle stands beside the first one: the ring spans less than a full turn.
        let on_ring = |beam: u32| {
            let angle = scan.angle(beam as usize);
            if angle - lowest >= TAU { (angle - TAU).max(lowest) } else { angle }
        };
        self.order.clear();
        self.order.extend(0..beams as u32);
        self.order.sort_by(|a, b| on_ring(*a).total_cmp(&on_ring(*b)));
        self.angles.clear();
        self.angles.extend(self.order.iter().map(|beam| on_ring(*beam)));
        self.units.clear();
        self.units.extend(self.angles.iter().map(|angle| (core_math::cos(*angle), core_math::sin(*angle))));
        let round = self.units.iter().chain(self.units.first());
        (self.cos, self.sin) = round.map(|(cos, sin)| (*cos as f32, *sin as f32)).unzip();
        self.even = even(&scan.spec().angles, beams);
        self.of = Some((scan.spec().angles.clone(), beams));
    }

    /// The beam at a position in ascending angle.
    pub(super) fn beam(&self, position: usize) -> usize {
        self.order[position] as usize
    }

    /// The angle at a position, radians.
    pub(super) fn angle(&self, position: usize) -> f64 {
        self.angles[position]
    }

    /// The unit vector at a position.
    pub(super) fn unit(&self, position: usize) -> (f64, f64) {
        self.units[position]
    }

    /// The even steps of the beams; `None` where they are uneven or two beams share an angle.
    pub(super) fn even(&self) -> Option<Even> {
        self.even
    }

    /// Brings ranges given in firing order into ascending angle.
    pub(super) fn sort(&self, ranges: &[f32], sorted: &mut Vec<f32>) {
        sorted.clear();
        match self.order.first() {
            Some(0) if self.even.is_some() => sorted.extend_from_slice(ranges),
            _ => sorted.extend(self.order.iter().map(|beam| ranges[*beam as usize])),
        }
    }
}

fn even(angles: &Angles, beams: usize) -> Option<Even> {
    let Angles::Uniform { increment, .. } = angles else { return None };
    let step = increment.abs();
    let seam = TAU - (beams - 1) as f64 * step;
    // Of steps smaller than what a seam may differ by, the last beam could lie behind the first: then the beams are not in
    // ascending angle as they come.
    if beams < 2 || seam <= 0.0 || seam < step - SEAM {
        return None;
    }
    let seam_error = (seam - step).abs();
    let ring = seam_error <= SEAM;
    Some(Even { step, ring, seam_error: if ring { seam_error } else { 0.0 } })
}

#[cfg(test)]
mod tests {
    use super::{Angles, TAU, even};

    /// A table of as many beams is never made: the limit on beams is far below.
    #[test]
    fn a_last_beam_behind_the_first_was_a_ring_of_tiny_steps() {
        let ring = |increment: f64, beams: usize| even(&Angles::Uniform { min: 0.0, increment }, beams);
        for step in [9e-7, 5e-7, 1e-8] {
            let beams = (TAU / step) as usize;
            assert!(ring(step, beams).is_some_and(|even| even.ring));
            assert!(ring(step, beams + 2).is_none() && ring(-step, beams + 2).is_none());
        }
        assert!(ring(TAU / 360.0, 360).is_some_and(|even| even.ring));
        assert!(ring(TAU / 360.0, 361).is_none());
    }
}

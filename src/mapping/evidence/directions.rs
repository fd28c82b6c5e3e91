//! The beams of a scan in ascending angle with their unit vectors; kept from scan to scan while the angles stay.

use crate::sensor::{Angles, Scan};
use std::f64::consts::TAU;

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
}

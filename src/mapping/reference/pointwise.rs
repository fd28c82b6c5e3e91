//! The rule `guaranteed` point by point: what the rule for whole boxes says of one point at one pose.

use super::paper::corners;
use super::{LAMBDA, Pose, Ray, Reference};
use crate::interval::Box2;
use std::f64::consts::{FRAC_PI_2, PI, TAU};

/// Points this near to the side of a bracket's window, radians, are left to the neighbour: computed directions are off by
/// less.
const SIDE: f64 = 1e-10;

/// How near to the sensor a point of a bracket's wedge must be to be free at a pose, metres: the largest `r` that meets
/// conditions 2 and 3 of the rule.
///
/// `h` is half the bracket's angle, `near` the smaller of the `d-` of its two beams, `opening` and `diameter` are `phi_b`
/// and `w_b`, `width` is `s`. With `kappa = sin h - cos h tan(phi_b / 2)`: up to `w_b / (2 kappa)` the cones leave no gap,
/// and the point must be nearer than `near` alone. Beyond, `r + lambda s'(r) < near` gives `r < near (1 - 2 lambda kappa) +
/// lambda w_b`, and `s'(r) <= s` gives `r <= (s (1 - 2 lambda kappa) + w_b) / (2 kappa)`.
#[must_use]
pub fn pointwise_rho(h: f64, near: f64, opening: f64, diameter: f64, width: f64) -> f64 {
    if h > FRAC_PI_2 {
        return 0.0;
    }
    let kappa = h.sin() - h.cos() * (0.5 * opening).tan();
    if 2.0 * near * kappa <= diameter {
        return near;
    }
    let shrunk = 1.0 - 2.0 * LAMBDA * kappa;
    if shrunk <= 0.0 {
        return diameter / (2.0 * kappa);
    }
    (near * shrunk + LAMBDA * diameter).min((width * shrunk + diameter) / (2.0 * kappa))
}

/// A point as the sensor sees it.
#[derive(Debug, Clone, Copy)]
struct Seen {
    /// Radians in the sensor frame.
    direction: f64,
    /// Metres.
    distance: f64,
}

impl Reference<'_> {
    /// Is a point free if the scan was taken at this pose?
    ///
    /// With beams whose angles are known exactly and no motion during the sweep, the direction of a point lies in one
    /// bracket of neighbouring usable beams. Otherwise it may lie in any bracket whose window, widened by the angle error
    /// and the motion, holds it, and each of them must show the point to be free. A bracket within a run of beams without
    /// a return may be replaced by the one that skips the run.
    ///
    /// One bracket, the one with the largest motion, need not be widened by its motion: where the directions of a point stay
    /// outside of it during the whole sweep, its two axes lie on either side of the point all the way round the other
    /// brackets, and two beams of one of these straddle it. Where a direction at some moment lies inside, the point must be
    /// nearer at that moment by as much as the sensor moves, so that it is near enough at the moments of both beams. Where
    /// several have the largest motion, any of them may be the one.
    #[must_use]
    pub fn is_point_free(&self, pose: Pose, (px, py): (f64, f64)) -> bool {
        let (x, y) = self.origin(pose);
        let seen = Seen {
            direction: (py - y).atan2(px - x) - pose.theta - self.scan.sensor().spec().mount.theta,
            distance: (px - x).hypot(py - y),
        };
        let count = self.rays.len();
        if count < 2 {
            return false;
        }
        self.most_moved.iter().any(|exempt| {
            (0..count).all(|j| {
                let k = (j + 1) % count;
                self.shows(j, k, seen, j == *exempt).unwrap_or(true)
                    || self.run_about(j, k).is_some_and(|(from, to)| self.shows(from, to, seen, false) == Some(true))
            })
        })
    }

    /// The returns on both sides of a run without returns that holds one of two neighbouring beams.
    fn run_about(&self, j: usize, k: usize) -> Option<(usize, usize)> {
        let count = self.rays.len();
        let is_return = |i: &usize| self.rays[*i].is_return;
        let from = (0..count).map(|back| (j + count - back) % count).find(is_return)?;
        let to = (0..count).map(|on| (k + on) % count).find(is_return)?;
        ((from, to) != (j, k)).then_some((from, to))
    }

    /// Does the bracket of beams `j` and `k` show that a point is free? `None` when its window does not hold the direction.
    fn shows(&self, j: usize, k: usize, seen: Seen, is_exempt: bool) -> Option<bool> {
        let spec = self.scan.sensor().spec();
        let (from, to): (&Ray, &Ray) = (&self.rays[j], &self.rays[k]);
        let seam = k <= j;
        let step = (to.angle - from.angle + if seam { TAU } else { 0.0 }).max(0.0);
        let motion = self.motion(from, to, seen.distance).unwrap_or(PI);
        let widened = spec.beam_angle_error + if is_exempt { 0.0 } else { motion };
        let moved = if is_exempt { self.scan.spec().sweep_translation } else { 0.0 };
        let ahead = (seen.direction - (from.angle - widened)).rem_euclid(TAU);
        if ahead < SIDE || ahead > step + 2.0 * widened - SIDE {
            return None;
        }
        let h = 0.5 * (step + 2.0 * spec.beam_angle_error + motion);
        let near = from.near.min(to.near);
        let rho = pointwise_rho(h, near, spec.beam_opening, spec.beam_diameter, self.min_obstacle_width);
        Some(seen.distance + moved < rho)
    }

    /// Is every drawn point of a box free at every drawn pose: its corners, and `count` points more, each at `count` poses
    /// of the pose box? What a near-ideal prover of single scans would prove, and a little more (it is a sample).
    pub fn is_proven_by_points(&self, leaf: &Box2, count: usize, unit: &mut dyn FnMut() -> f64) -> bool {
        if self.is_in_footprint(leaf) {
            return true;
        }
        let drawn = |unit: &mut dyn FnMut() -> f64| {
            let (x, y) = (super::draw(unit, leaf.x.lo(), leaf.x.hi()), super::draw(unit, leaf.y.lo(), leaf.y.hi()));
            (x, y)
        };
        let mut points = corners(leaf).to_vec();
        points.extend((0..count).map(|_| drawn(unit)));
        points.into_iter().all(|point| {
            (0..count).all(|_| {
                let pose = self.draw_pose(unit);
                self.is_point_free(pose, point)
            })
        })
    }
}

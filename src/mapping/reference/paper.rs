//! The paper's sets: points drawn from them, and the natural interval tests.

use super::{Pose, Reference, draw};
use crate::interval::{Box2, Interval, Verdict};
use crate::sensor::{Reading, natural_measurement_box};
use std::f64::consts::TAU;

impl Reference<'_> {
    /// A point of the measurement set (6) of a beam; `None` for a beam without a return. Its leaf belongs to X_OCC (7).
    pub fn draw_occupied(&self, beam: usize, unit: &mut dyn FnMut() -> f64) -> Option<(f64, f64)> {
        match self.scan.reading(beam) {
            Reading::Return { near, far } => Some(self.draw_between(beam, near, far, unit)),
            _ => None,
        }
    }

    /// A point of the empty part `0 <= d <= d-` of a beam for some pose; `None` for one that says nothing. Its leaf belongs
    /// to X_EMP `outer` (9), (12), unless it belongs to X_OCC.
    pub fn draw_empty(&self, beam: usize, unit: &mut dyn FnMut() -> f64) -> Option<(f64, f64)> {
        let near = self.empty_to(beam)?;
        Some(self.draw_between(beam, 0.0, near, unit))
    }

    fn draw_between(&self, beam: usize, near: f64, far: f64, unit: &mut dyn FnMut() -> f64) -> (f64, f64) {
        let pose = self.draw_pose(unit);
        self.draw_at(beam, pose, draw(unit, near, far), unit)
    }

    /// A point of (6) at a pose and a distance.
    ///
    /// In the frame of the beam's axis, with `tau = phi - phi_i`, (6) is `(d + delta_d) cos(tau) - delta_d` along it and
    /// `(d + delta_d) sin(tau)` across; written so that a large `delta_d` cancels before it is rounded.
    fn draw_at(&self, beam: usize, pose: Pose, d: f64, unit: &mut dyn FnMut() -> f64) -> (f64, f64) {
        let spec = self.scan.sensor().spec();
        let half = 0.5 * spec.beam_opening;
        let (along, across) = if half == 0.0 {
            (d, draw(unit, -0.5 * spec.beam_diameter, 0.5 * spec.beam_diameter))
        } else {
            let tau = draw(unit, -half, half);
            let offset = 0.5 * spec.beam_diameter / half.tan();
            (d * tau.cos() - 2.0 * offset * (0.5 * tau).sin().powi(2), (d + offset) * tau.sin())
        };
        let error = draw(unit, -spec.beam_angle_error, spec.beam_angle_error);
        let axis = pose.theta + spec.mount.theta + self.scan.angle(beam) + error;
        let (sin, cos) = axis.sin_cos();
        let (x, y) = self.origin(pose);
        (x + along * cos - across * sin, y + along * sin + across * cos)
    }

    /// The paper's test for X_OCC (7): does a box meet the measurement box, the natural interval extension of (6)? Nothing
    /// that does not may be in X_OCC.
    #[must_use]
    pub fn meets_measurement_box(&self, beam: usize, leaf: &Box2) -> bool {
        let Reading::Return { near, far } = self.scan.reading(beam) else { return false };
        natural_measurement_box(self.scan.pose(), self.scan.sensor(), self.scan.angle(beam), near, far).meets(*leaf)
    }

    /// The paper's inclusion test (8), (9): do the points of a box lie in the empty part of a beam, for every pose?
    ///
    /// (8) is read as the inverse of (6), every operation replaced by its natural interval extension: with
    /// `[a] = [theta] + phi_s` and `p` the box,
    ///
    /// ```text
    /// q_x   = p_x - x - (x_s cos(theta) - y_s sin(theta)) + delta_d cos(a + phi_i)
    /// q_y   = p_y - y - (x_s sin(theta) + y_s cos(theta)) + delta_d sin(a + phi_i)
    /// d     = sqrt(q_x^2 + q_y^2) - delta_d
    /// phi   = atan2(q_y, q_x) - a
    /// ```
    ///
    /// and (9) as `[d]` within (or meeting) `[0, d_i-]` and `[phi]` within (or meeting) `[phi_i]`. For `phi_b = 0` the beam is
    /// a strip, and `q` from the sensor turned by `-(a + phi_i)` is held against `[0, d_i-] x [-w_b/2, w_b/2]`. An angle error
    /// widens `phi_i` and `[phi_i]`.
    #[must_use]
    pub fn inclusion(&self, beam: usize, leaf: &Box2) -> Verdict {
        let Some(near) = self.empty_to(beam) else { return Verdict::No };
        let spec = self.scan.sensor().spec();
        let pose = self.scan.pose();
        let (sin, cos) = (pose.theta().sin(), pose.theta().cos());
        let (mount_x, mount_y) = (Interval::point(spec.mount.x), Interval::point(spec.mount.y));
        let qx = leaf.x - pose.x() - (mount_x * cos - mount_y * sin);
        let qy = leaf.y - pose.y() - (mount_x * sin + mount_y * cos);
        let heading = self.headings();
        let angle = Interval::around(self.scan.angle(beam), spec.beam_angle_error);
        let axis = heading + angle;
        let free = Interval::spanning(0.0, near);
        if spec.beam_opening == 0.0 {
            let half = 0.5 * spec.beam_diameter;
            let (along, across) = (qx * axis.cos() + qy * axis.sin(), qy * axis.cos() - qx * axis.sin());
            return is_within(along, free).and(is_within(across, Interval::spanning(-half, half)));
        }
        let half = Interval::point(0.5 * spec.beam_opening);
        let offset = if spec.beam_diameter == 0.0 {
            Interval::point(0.0)
        } else {
            half.cos() / half.sin() * Interval::point(spec.beam_diameter) * Interval::point(0.5)
        };
        let (qx, qy) = (qx + offset * axis.cos(), qy + offset * axis.sin());
        let directions = angle + Interval::spanning(-half.hi(), half.hi());
        let direction = if qx.contains(0.0) && qy.contains(0.0) {
            // The box holds the apex: any direction.
            Verdict::Unknown
        } else {
            is_within_as_angle(qy.atan2(qx) - heading, directions)
        };
        is_within(qx.hypot(qy) - offset, free).and(direction)
    }

    /// Can a point of the box lie in the empty part of a beam, by (8) and (9)? X_EMP `outer` (12) holds nothing else.
    #[must_use]
    pub fn may_be_empty(&self, beam: usize, leaf: &Box2) -> bool {
        self.inclusion(beam, leaf).is_possibly()
    }

    /// The test of X_EMP `inner` (10), (11): a box and its four corners, each give or take `margin` metres, pass the test
    /// of one and the same beam.
    #[must_use]
    pub fn may_be_inner(&self, beam: usize, leaf: &Box2, margin: f64) -> bool {
        let about = |x: f64, y: f64| Box2::new(Interval::around(x, margin), Interval::around(y, margin));
        self.may_be_empty(beam, leaf) && corners(leaf).iter().all(|(x, y)| self.may_be_empty(beam, &about(*x, *y)))
    }

    /// Is a point certainly in the empty part of a beam at a pose? In plain floating point, less `margin` (metres) on
    /// every side.
    #[must_use]
    pub fn is_empty_at(&self, beam: usize, pose: Pose, (px, py): (f64, f64), margin: f64) -> bool {
        let Some(near) = self.empty_to(beam) else { return false };
        let spec = self.scan.sensor().spec();
        let (x, y) = self.origin(pose);
        let (sin, cos) = (pose.theta + spec.mount.theta + self.scan.angle(beam)).sin_cos();
        let (along, across) = ((px - x) * cos + (py - y) * sin, (py - y) * cos - (px - x) * sin);
        let tan = (0.5 * spec.beam_opening).tan();
        // d = |q| - delta_d with q from the apex, times tan^2, so that no delta_d appears: see (4).
        let half_width = 0.5 * spec.beam_diameter;
        let distance = if tan == 0.0 { along } else { (along + half_width / tan).hypot(across) - half_width / tan };
        distance >= margin && distance <= near - margin && across.abs() <= half_width + along * tan - margin
    }
}

/// The corners of a box.
pub(super) fn corners(square: &Box2) -> [(f64, f64); 4] {
    let (x, y) = (square.x, square.y);
    [(x.lo(), y.lo()), (x.hi(), y.lo()), (x.hi(), y.hi()), (x.lo(), y.hi())]
}

/// Are the members of an interval in another one: all, none, or some?
fn is_within(a: Interval, b: Interval) -> Verdict {
    match (b.encloses(a), b.meets(a)) {
        (true, _) => Verdict::Yes,
        (false, true) => Verdict::Unknown,
        (false, false) => Verdict::No,
    }
}

/// The same for intervals of directions.
fn is_within_as_angle(a: Interval, b: Interval) -> Verdict {
    if a.width() >= TAU || b.width() >= TAU {
        return Verdict::Unknown;
    }
    let turns = ((b.mid() - a.mid()) / TAU).round();
    (-1..=1).fold(Verdict::No, |found, extra| {
        let turn = Interval::point(turns + f64::from(extra)) * Interval::spanning(TAU.next_down(), TAU.next_up());
        found.or(is_within(a + turn, b))
    })
}

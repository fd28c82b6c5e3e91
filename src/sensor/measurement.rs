//! Measurement sets: where a beam can have been reflected, equations (4) to (6).

use super::{BeamCone, PoseBox, SensorModel};
use crate::interval::{Box2, Interval};

/// Tangent pieces about the far arc of a wide cone. A piece of the angle `2 s` reaches `1 / cos(s) - 1` of the radius
/// beyond the arc; eight of them keep that below one part in 128 of `h^2`, where the cone's own extent is some `h^2`.
const FAR_PIECES: u32 = 8;

/// A box's end about the far arc will do where its corners reach no farther beyond the arc than this part of
/// `far - near`: in every direction the set is wider by one than the box by the other.
const BOX_END: f64 = 0.01;

/// Nor is anything gained by tangents that save less than this, metres.
const NEGLIGIBLE: f64 = 1e-9;

/// The largest angle of a piece of the arc that a single beam's angle error sweeps, radians.
const ERROR_PIECE: f64 = 0.04;

/// `delta_d = cot(phi_b / 2) * w_b / 2` (4): how far behind the emitter the virtual apex of the beam's cone lies,
/// metres; infinite for `phi_b = 0` with `w_b > 0` (a strip), 0 for `w_b = 0`. Rounded to nearest but for two roundings;
/// [`BeamCone::apex_offset`] encloses it.
///
/// ```
/// let paper = ubbmap::sensor::apex_offset(0.25_f64.to_radians(), 0.012);
/// assert!((paper - 2.75).abs() < 0.001);
/// ```
#[must_use]
pub fn apex_offset(beam_opening: f64, beam_diameter: f64) -> f64 {
    if beam_diameter == 0.0 { 0.0 } else { 0.5 * beam_diameter / core_math::tan(0.5 * beam_opening) }
}

/// Where one beam can have been reflected, over a pose box: an enclosure of (6).
///
/// In the frame of the beam (origin at the emitter, x along the beam's axis) it lies in the rectangle
/// `[near, far] x [-half_width, half_width]`; the map frame has it turned by `[theta] + phi_s + phi_i`, give or take
/// `beam_angle_error`, about the emitter, which itself turns about the robot, and moved by the position box.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MeasurementSet {
    /// Axial lower bound in the beam frame, metres: slightly below `d-`, since the sides of the cone recede.
    pub near: f64,
    /// Axial upper bound in the beam frame, metres.
    pub far: f64,
    /// Lateral bound in the beam frame, metres.
    pub half_width: f64,
    /// Tight axis-parallel enclosure in the map frame; within the natural extension ([`natural_measurement_box`]).
    pub hull: Box2,
}

impl MeasurementSet {
    /// The measurement set of a beam at mirror angle `angle` (radians) with `[d] = [near, far]` (metres).
    ///
    /// The cone's part is enclosed by a convex polygon. For each heading the hull of the polygon is the hull of its
    /// corners, so the hull over all headings is that of the arcs on which the corners turn about the robot.
    #[must_use]
    pub fn new(pose: &PoseBox, sensor: &SensorModel, angle: f64, near: f64, far: f64) -> Self {
        let cone = BeamCone::new(sensor);
        let rectangle = cone.rectangle(near, far);
        let spec = sensor.spec();
        let turn = Interval::point(spec.mount.theta) + Interval::point(angle);
        let turn = (turn.sin(), turn.cos());
        let mut hull: Option<Box2> = None;
        for corner in outline(&cone, near, far) {
            for swung in swung(corner, spec.beam_angle_error) {
                let on_robot = turned(turn, swung);
                let on_robot =
                    Box2::new(on_robot.x + Interval::point(spec.mount.x), on_robot.y + Interval::point(spec.mount.y));
                let arc = swept(pose.theta(), on_robot);
                hull = Some(hull.map_or(arc, |h| h.hull(arc)));
            }
        }
        let natural = natural_measurement_box(pose, sensor, angle, near, far);
        let hull = hull.map_or(natural, |h| {
            // Both enclose the set, so what they share does.
            let (x, y) = (pose.x() + h.x, pose.y() + h.y);
            Box2::new(x.intersection(natural.x).unwrap_or(x), y.intersection(natural.y).unwrap_or(y))
        });
        Self { near: rectangle.near, far: rectangle.far, half_width: rectangle.half_width, hull }
    }
}

/// The paper's measurement box: the natural interval extension of (6), in which `theta` stands four times and
/// `delta_d` twice; metres. For `phi_b = 0` it is the one of the strip, `d cos(b) - v sin(b)` with `|v| <= w_b / 2`.
///
/// An angle error widens `[phi]` and the direction of the axis. Wide, and kept as the bound that a tighter enclosure
/// must not pass.
#[must_use]
pub fn natural_measurement_box(pose: &PoseBox, sensor: &SensorModel, angle: f64, near: f64, far: f64) -> Box2 {
    let spec = sensor.spec();
    let cone = BeamCone::new(sensor);
    let error = spec.beam_angle_error;
    let axis = pose.theta() + Interval::point(spec.mount.theta) + Interval::around(angle, error);
    let distance = Interval::spanning(near, far);
    let (x, y) = if cone.half_opening() == 0.0 {
        let radius = 0.5 * spec.beam_diameter;
        let lateral = Interval::spanning(-radius, radius);
        (distance * axis.cos() - lateral * axis.sin(), distance * axis.sin() + lateral * axis.cos())
    } else {
        let offset = cone.apex_offset();
        let opening = Interval::spanning(-cone.half_opening(), cone.half_opening());
        let direction = axis + opening;
        let reach = distance + offset;
        (reach * direction.cos() - offset * axis.cos(), reach * direction.sin() - offset * axis.sin())
    };
    let (sin, cos) = (pose.theta().sin(), pose.theta().cos());
    let (mount_x, mount_y) = (Interval::point(spec.mount.x), Interval::point(spec.mount.y));
    Box2::new(pose.x() + x + mount_x * cos - mount_y * sin, pose.y() + y + mount_x * sin + mount_y * cos)
}

/// Corners of a convex polygon about the part of the cone with `[d] = [near, far]`, in the beam frame.
///
/// The near arc is concave seen from within, so the chord between its ends bounds the hull. About the far arc goes a
/// box's end, where that is as good, or a polygon of tangents.
fn outline(cone: &BeamCone, near: f64, far: f64) -> Vec<Box2> {
    let mirrored = |axial: Interval, lateral: Interval| [Box2::new(axial, -lateral), Box2::new(axial, lateral)];
    let mut corners = Vec::with_capacity(4 + FAR_PIECES as usize);
    corners.extend(mirrored(cone.side_axial(near), cone.side_lateral(near)));
    corners.extend(mirrored(cone.side_axial(far), cone.side_lateral(far)));
    let beyond_arc = far - cone.side_axial(far).lo();
    if beyond_arc <= (BOX_END * (far - near)).max(NEGLIGIBLE) {
        corners.extend(mirrored(Interval::point(far), cone.side_lateral(far)));
        return corners;
    }
    // So much lies beyond the arc only where the opening is far from zero and the apex near.
    // Tangents that touch at two angles 2 s apart meet on the bisector, at 1 / cos(s) of the radius.
    let s = Interval::point(cone.half_opening()) / Interval::point(f64::from(FAR_PIECES));
    let offset = cone.apex_offset();
    let reach = (Interval::point(far) + offset) / s.cos();
    for piece in 0..FAR_PIECES / 2 {
        let bisector = s.scale(f64::from(2 * piece + 1));
        corners.extend(mirrored(reach * bisector.cos() - offset, reach * bisector.sin()));
    }
    corners
}

/// Corners of a polygon about the arc on which a point turns about the emitter by `+-error` radians: the arc's ends and
/// where its tangents meet between them.
fn swung(point: Box2, error: f64) -> Vec<Box2> {
    if error == 0.0 {
        return vec![point];
    }
    let pieces = (2.0 * error / ERROR_PIECE).ceil().max(1.0);
    let s = Interval::point(error) / Interval::point(pieces);
    let stretch = Interval::point(1.0) / s.cos();
    let stretched = Box2::new(point.x * stretch, point.y * stretch);
    let mut corners = vec![rotated(Interval::point(-error), point), rotated(Interval::point(error), point)];
    let mut piece = 0.5;
    while piece < pieces {
        let bisector = s.scale(2.0 * piece) - Interval::point(error);
        corners.push(rotated(bisector, stretched));
        piece += 1.0;
    }
    corners
}

/// A point turned about the origin by an angle (radians); the natural extension, tight for a point angle.
fn rotated(angle: Interval, point: Box2) -> Box2 {
    turned((angle.sin(), angle.cos()), point)
}

/// A point turned about the origin by the angle of a sine and a cosine.
fn turned((sin, cos): (Interval, Interval), point: Box2) -> Box2 {
    Box2::new(point.x * cos - point.y * sin, point.x * sin + point.y * cos)
}

/// The hull of the arc on which a point turns about the origin by the angles of an interval, in polar form: the angle
/// stands in it once an axis, so it is exact up to rounding.
pub(super) fn swept(theta: Interval, point: Box2) -> Box2 {
    if theta.lo() == theta.hi() {
        return rotated(theta, point);
    }
    let radius = point.x.hypot(point.y);
    let direction = theta + point.y.atan2(point.x);
    Box2::new(radius * direction.cos(), radius * direction.sin())
}

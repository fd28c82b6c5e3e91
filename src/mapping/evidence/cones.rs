//! Single beams on the canvas: the measurement sets of X_OCC (7) and the empty cones of the paper's rules (9) to (12).
//!
//! In the frame of a beam (origin at the sensor, first axis along the beam at the heading's middle), with `x = phi_b / 2`,
//! the cone of (4) to (6) is `{((d + delta_d) cos t - delta_d, (d + delta_d) sin t) : |t| <= x}`. The products with
//! `delta_d = cot x * w_b / 2` are written without it, so that `phi_b = 0` is no special case:
//!
//! ```text
//! delta_d sin x       = cos x * w_b / 2                 half width at the emitter
//! delta_d (1 - cos x) = cos x tan(x / 2) * w_b / 2      how far the rim lies behind the axis
//! ```
//!
//! A heading within `+-delta` turns the cone about the sensor by as much.

use super::directions;
use super::frame::Frame;
use super::raster::{Both, Disc, Point, Quad, TurnedRectangle, cover, inscribe};
use super::sheet::{FILLED, OCCUPIED, Sheet};
use crate::sensor::SensorModel;

/// Openings above have their measurement set held to the paper's natural extension as well: the rectangle about a wide
/// annulus has corners that even (6) evaluated naturally leaves out.
const WIDE_OPENING: f64 = 0.05;

/// A cone is drawn without its round end where that adds less than this, leaves.
const NEGLIGIBLE: f64 = 1.0 / 4096.0;

/// Sines and cosines that stay from scan to scan.
#[derive(Debug, Default)]
pub(super) struct ConeTrig {
    opening: directions::Turn,
    turn: directions::Turn,
}

/// What all beams of a scan have in common.
#[derive(Debug, Clone, Copy)]
pub(super) struct Cones {
    sin: f64,
    cos: f64,
    half_opening: f64,
    /// Half width at the emitter and how far the rim lies behind, leaves.
    rim: (f64, f64),
    /// delta_d, leaves; `None` for a strip.
    apex: Option<f64>,
    /// Half width of the beam's direction, radians, and its sine and cosine.
    turn: f64,
    sin_turn: f64,
    cos_turn: f64,
    origin: Point,
    dilation: Point,
    slack: f64,
    scale: f64,
}

impl Cones {
    pub(super) fn new(frame: &Frame, sensor: &SensorModel, trig: &mut ConeTrig) -> Self {
        let spec = sensor.spec();
        let half_opening = 0.5 * spec.beam_opening;
        let (sin, cos) = trig.opening.sin_cos(half_opening);
        let radius = 0.5 * spec.beam_diameter * frame.scale;
        let turn = (frame.heading.1 + spec.beam_angle_error).min(std::f64::consts::PI);
        let (sin_turn, cos_turn) = trig.turn.sin_cos(turn);
        Self {
            sin,
            cos,
            half_opening,
            // tan(x / 2) = sin x / (1 + cos x)
            rim: (radius * cos, radius * cos * sin / (1.0 + cos)),
            apex: (sin > 0.0).then(|| radius * cos / sin),
            turn,
            sin_turn: if turn < std::f64::consts::FRAC_PI_2 { sin_turn } else { 1.0 },
            cos_turn,
            origin: frame.origin,
            dilation: frame.dilation(),
            slack: frame.slack,
            scale: frame.scale,
        }
    }

    /// Sine and cosine of half the opening.
    pub(super) fn opening(&self) -> (f64, f64) {
        (self.sin, self.cos)
    }

    /// Sine and cosine of the half width of a beam's direction.
    pub(super) fn turn(&self) -> (f64, f64) {
        (self.sin_turn, self.cos_turn)
    }

    /// Half width at the emitter and how far the rim lies behind, leaves.
    pub(super) fn rim(&self) -> (f64, f64) {
        self.rim
    }

    /// True when measurement sets are held to the natural extension of (6) too.
    pub(super) fn is_wide(&self) -> bool {
        2.0 * self.half_opening > WIDE_OPENING
    }

    /// Half width of the unturned cone at distance `d`, leaves.
    fn half_width(&self, d: f64) -> f64 {
        d * self.sin + self.rim.0
    }

    fn at(&self, unit: Point, along: f64, aside: f64) -> Point {
        (self.origin.0 + unit.0 * along - unit.1 * aside, self.origin.1 + unit.1 * along + unit.0 * aside)
    }

    /// Draws the measurement set of a return within `[near, far]` metres along `unit` into X_OCC: the rectangle about the
    /// cone's part, widened by the turn, held to the axis-parallel hull of the turned rectangle.
    pub(super) fn measurement(&self, sheet: &mut impl Sheet, unit: Point, near: f64, far: f64) {
        let (near, far) = (near * self.scale, far * self.scale);
        let width = self.half_width(far);
        let low = near * self.cos - self.rim.1;
        // Of a set that begins behind the sensor, or turns by more than a quarter, either end may be the one that reaches farther.
        let first = low.min(low * self.cos_turn).min(far * self.cos_turn) - width * self.sin_turn;
        let end = far.max(low * self.cos_turn) + width * self.sin_turn;
        // No point of the cone is farther from the sensor than its rim.
        let rim = (far * self.cos - self.rim.1, width);
        let last = end.min((rim.0 * rim.0 + rim.1 * rim.1).sqrt().max(far) + self.slack);
        let aside = width + far.max(-low) * self.sin_turn;
        let (along, middle) = (0.5 * (last - first), 0.5 * (last + first));
        let (min, max) = self.hull(unit, low, (near, far), width);
        let center = (self.origin.0 + unit.0 * middle, self.origin.1 + unit.1 * middle);
        let shape = TurnedRectangle::new(center, unit, (along, aside), min, max);
        cover::<OCCUPIED>(sheet, &shape, self.dilation);
    }

    /// An axis-parallel box about the measurement set over all headings: min and max corner.
    fn hull(&self, unit: Point, low: f64, (near, far): Point, width: f64) -> (Point, Point) {
        let mut hull = Hull::default();
        if let (true, Some(apex)) = (self.is_wide(), self.apex) {
            // (6) with every angle for itself: (d + delta_d) u(a + phi) - delta_d u(a + phi_i).
            let wide = Turn::new(self.turn + self.half_opening);
            let mut cone = Hull::default();
            cone.add_arc(unit, near + apex, wide);
            cone.add_arc(unit, far + apex, wide);
            let mut behind = Hull::default();
            behind.add_arc(unit, apex, Turn::new(self.turn));
            hull.min = (cone.min.0 - behind.max.0, cone.min.1 - behind.max.1);
            hull.max = (cone.max.0 - behind.min.0, cone.max.1 - behind.min.1);
        } else {
            // The near end is narrower: with the far end's width the box would pass the natural extension of (6).
            let narrow = self.half_width(near);
            hull.add_turned_rectangle(unit, (self.cos_turn, self.sin_turn), (low, narrow), (far, width));
        }
        (
            (self.origin.0 + hull.min.0 - self.slack, self.origin.1 + hull.min.1 - self.slack),
            (self.origin.0 + hull.max.0 + self.slack, self.origin.1 + hull.max.1 + self.slack),
        )
    }

    /// Draws the leaves that the empty cone up to `near` metres may touch: (9) and (12).
    pub(super) fn outer(&self, sheet: &mut impl Sheet, unit: Point, near: f64) {
        let near = near * self.scale;
        let wedge = self.wedge(unit, near, -self.rim.1 - self.rim.0 * self.sin_turn);
        match self.round_end(unit, near) {
            Some(end) => cover::<FILLED>(sheet, &Both(wedge, end), self.dilation),
            None => cover::<FILLED>(sheet, &wedge, self.dilation),
        }
    }

    /// Draws the leaves all of whose corners pass the test of the empty cone up to `near` metres: (10) and (11).
    pub(super) fn inner(&self, sheet: &mut impl Sheet, unit: Point, near: f64) {
        let near = near * self.scale;
        let wedge = self.wedge(unit, near, 0.0);
        match self.round_end(unit, near) {
            Some(end) => inscribe::<FILLED>(sheet, &Both(wedge, end), self.dilation, 2.0 * self.slack),
            None => inscribe::<FILLED>(sheet, &wedge, self.dilation, 2.0 * self.slack),
        }
    }

    /// The trapezoid between the cone's sides, turned by the heading's half width: a side through `(0, w_0)` at angle `x`
    /// becomes one at angle `x + delta` through that point turned by `delta`. It begins `first` leaves along the axis: 0, or
    /// as far behind as the turned rim.
    fn wedge(&self, unit: Point, near: f64, first: f64) -> Quad {
        let angle = self.half_opening + self.turn;
        let last = near + self.half_width(near) * self.sin_turn;
        // Nearly a half plane: the round end alone bounds it.
        let (aside_first, aside_last) = if angle >= 1.5 {
            let reach = 2.0 * (near + self.rim.0);
            (reach, reach)
        } else {
            let slope = core_math::tan(angle);
            let side = |along: f64| self.rim.0 * self.cos_turn + (along + self.rim.0 * self.sin_turn) * slope;
            (side(first).max(self.rim.0), side(last))
        };
        let first = if angle >= 1.5 && first < 0.0 { -near - self.rim.0 } else { first };
        Quad {
            corners: [
                self.at(unit, first, -aside_first),
                self.at(unit, last, -aside_last),
                self.at(unit, last, aside_last),
                self.at(unit, first, aside_first),
            ],
        }
    }

    /// The discs that bound the cone's far end, where they cut off more than a negligible corner: no point is farther from
    /// the sensor than the cone's rim, nor from the apex than `d + delta_d` and the apex's own way.
    fn round_end(&self, unit: Point, near: f64) -> Option<Both<Disc, Disc>> {
        let angle = (self.half_opening + self.turn).min(1.5);
        if near * angle * angle < NEGLIGIBLE {
            return None;
        }
        let rim = (near * self.cos - self.rim.1, self.half_width(near));
        let about_sensor = Disc { center: self.origin, radius: rim.0.hypot(rim.1).max(near) };
        let about_apex = match self.apex {
            Some(apex) if about_sensor.radius - near > NEGLIGIBLE => Disc {
                center: self.at(unit, -apex, 0.0),
                radius: near + apex + 2.0 * apex * core_math::sin(0.5 * self.turn),
            },
            _ => about_sensor,
        };
        Some(Both(about_sensor, about_apex))
    }
}

/// A growing axis-parallel box about the sensor, leaves.
#[derive(Debug, Clone, Copy)]
struct Hull {
    min: Point,
    max: Point,
}

impl Default for Hull {
    fn default() -> Self {
        Self { min: (f64::INFINITY, f64::INFINITY), max: (f64::NEG_INFINITY, f64::NEG_INFINITY) }
    }
}

impl Hull {
    fn add(&mut self, point: Point) {
        self.min = (self.min.0.min(point.0), self.min.1.min(point.1));
        self.max = (self.max.0.max(point.0), self.max.1.max(point.1));
    }

    /// Adds the arc of `radius` about the origin within a turn of `unit`.
    fn add_arc(&mut self, unit: Point, radius: f64, turn: Turn) {
        if turn.angle >= std::f64::consts::PI {
            self.add((-radius, -radius));
            self.add((radius, radius));
            return;
        }
        let Turn { sin, cos, .. } = turn;
        self.add((radius * (unit.0 * cos - unit.1 * sin), radius * (unit.1 * cos + unit.0 * sin)));
        self.add((radius * (unit.0 * cos + unit.1 * sin), radius * (unit.1 * cos - unit.0 * sin)));
        // An axis direction within the arc is its extreme: the cosine of the angle to it is at least cos(turn).
        for (along, x, y) in [(unit.0, 1.0, 0.0), (-unit.0, -1.0, 0.0), (unit.1, 0.0, 1.0), (-unit.1, 0.0, -1.0)] {
            if along >= cos {
                self.add((x * radius, y * radius));
            }
        }
    }

    /// Adds the trapezoid with the half widths `narrow` at `low` and `width` at `far` in the frame of `unit`, turned about
    /// the origin to both sides by `(cos, sin)`.
    fn add_turned_rectangle(&mut self, unit: Point, (cos, sin): Point, (low, narrow): Point, (far, width): Point) {
        for sin in [-sin, sin] {
            let (x, y) = (unit.0 * cos - unit.1 * sin, unit.1 * cos + unit.0 * sin);
            for (along, aside) in [(low, narrow), (far, width)] {
                let (aside_x, aside_y) = (y.abs() * aside, x.abs() * aside);
                self.add((x * along - aside_x, y * along - aside_y));
                self.add((x * along + aside_x, y * along + aside_y));
            }
        }
        self.add_passing(unit, cos, (far, width));
        // Before the sensor, the near corners are never farther out than the far ones.
        if low < 0.0 || cos <= 0.0 {
            self.add_passing(unit, cos, (low, narrow));
        }
    }

    /// Adds the axes that the corners `(along, +-aside)` in the frame of `unit` pass as they turn by up to the angle of cosine
    /// `cos`: there they are farthest out.
    fn add_passing(&mut self, unit: Point, cos: f64, (along, aside): Point) {
        let radius = (along * along + aside * aside).sqrt();
        for (towards, across, x, y) in [
            (unit.0, unit.1, 1.0, 0.0),
            (-unit.0, unit.1, -1.0, 0.0),
            (unit.1, unit.0, 0.0, 1.0),
            (-unit.1, unit.0, 0.0, -1.0),
        ] {
            // The radius times the cosine of the angle between the axis and the nearer of the corners.
            if cos <= 0.0 || towards * along + across.abs() * aside >= radius * cos {
                self.add((x * radius, y * radius));
            }
        }
    }
}

/// An angle with its sine and cosine.
#[derive(Debug, Clone, Copy)]
struct Turn {
    angle: f64,
    sin: f64,
    cos: f64,
}

impl Turn {
    fn new(angle: f64) -> Self {
        Self { angle, sin: core_math::sin(angle), cos: core_math::cos(angle) }
    }
}

/// The disc about the robot within which nothing but the robot is, for every position of a box (A5).
#[derive(Debug, Clone, Copy)]
pub(super) struct Footprint {
    /// Middle of the positions, window coordinates.
    pub center: Point,
    /// Half widths of the positions, leaves.
    pub half: Point,
    /// Radius, leaves.
    pub radius: f64,
}

impl Footprint {
    /// Draws the leaves whose farthest point from every position is nearer than the radius.
    pub(super) fn draw(&self, sheet: &mut impl Sheet, slack: f64) {
        let radius = self.radius - slack;
        let top = self.center.1 + radius;
        for row in super::raster::floor(self.center.1 - radius)..=super::raster::floor(top) {
            let below = (f64::from(row) - self.center.1).abs();
            let above = (f64::from(row) + 1.0 - self.center.1).abs();
            let far_y = below.max(above) + self.half.1;
            if far_y >= radius {
                continue;
            }
            let far_x = (radius * radius - far_y * far_y).sqrt() - self.half.0 - slack;
            let first = (self.center.0 - far_x).ceil() as i32;
            let last = super::raster::floor(self.center.0 + far_x) - 1;
            sheet.span::<FILLED>(row, first, last);
        }
    }
}

//! What a laser can have moved by during a sweep, from looks at where it was.
//!
//! A look at a time is a place and a bound of how far the truth may be from it. Of two looks that are `h` apart, and off by
//! `e0` and `e1`, the mean speed between is at most `(|p1 - p0| + e0 + e1) / h`. A motion whose acceleration is at most `a`
//! leaves the line between its own ends at `t` by at most `a (t - t0)(t1 - t) / 2`, and its speed leaves the line's by at most
//! `a ((t - t0)^2 + (t1 - t)^2) / (2 h)`. So each pair of looks bounds the speed between them: near ones where the poses are
//! good, far ones where their errors are larger than what a short time can move.
//!
//! The laser is on an arm of the robot. As that turns at the rate `w`, the laser accelerates by `arm * (turn + w^2)` more.
//!
//! What a scan declares (assumption A1 of the guarantee): between two beams the laser moves by no more than twice their even
//! share of the sweep, and by no more than the whole. So with `T` the sweep's time the motion declared is at least what lies
//! between any two moments, and at least `T / 2` times the highest speed.

use super::track::Between;

/// Where the laser was at a time.
#[derive(Debug, Clone, Copy)]
pub(super) struct Look {
    /// Seconds since the sweep began.
    pub(super) time: f64,
    pub(super) x: f64,
    pub(super) y: f64,
    /// Of the same turn as that of the looks beside it.
    pub(super) theta: f64,
    /// How far the truth may be off, metres and radians.
    pub(super) off: f64,
    pub(super) turn_off: f64,
    /// How far the laser is from the middle of what carries it, metres.
    pub(super) arm: f64,
}

/// A bound of a sweep's motion.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Motion {
    /// How far the truth may leave the line between two looks beside each other, metres and radians.
    pub(super) curve: f64,
    pub(super) turn_curve: f64,
    /// What a scan declares, radians and metres.
    pub(super) rotation: f64,
    pub(super) translation: f64,
}

/// Bounds of rates, metres and radians a second.
#[derive(Debug, Clone, Copy)]
struct Rates {
    speed: f64,
    spin: f64,
}

impl Rates {
    const NONE: Self = Self { speed: f64::INFINITY, spin: f64::INFINITY };

    /// Those that two looks bound, at all times from `since` to `until` between them.
    fn of(a: &Look, b: &Look, (since, until): (f64, f64), between: &Between) -> Self {
        let h = b.time - a.time;
        if h <= 0.0 {
            return Self::NONE;
        }
        let mean = ((b.x - a.x).hypot(b.y - a.y) + a.off + b.off) / h;
        let mean_spin = ((b.theta - a.theta).abs() + a.turn_off + b.turn_off) / h;
        // Highest at one of the ends.
        let bulge = |time: f64| ((time - a.time).powi(2) + (b.time - time).powi(2)) / (2.0 * h);
        let bulge = bulge(since).max(bulge(until));
        let anywhere = mean_spin + 0.5 * between.turn * h;
        let acceleration = swung(a.arm.max(b.arm), anywhere, between);
        Self { speed: mean + acceleration * bulge, spin: mean_spin + between.turn * bulge }
    }

    fn least(self, other: Self) -> Self {
        Self { speed: self.speed.min(other.speed), spin: self.spin.min(other.spin) }
    }

    fn most(self, other: Self) -> Self {
        Self { speed: self.speed.max(other.speed), spin: self.spin.max(other.spin) }
    }
}

/// The acceleration of a laser on an arm.
fn swung(arm: f64, spin: f64, between: &Between) -> f64 {
    between.acceleration + arm * (between.turn + spin * spin)
}

/// The motion of a sweep: `looks` at even times from its begin to its end, a power of two and one more, and pairs of looks
/// with the sweep between them.
pub(super) fn motion(looks: &[Look], about: &[(Look, Look)], between: &Between) -> Option<Motion> {
    let (first, last) = (looks.first()?, looks.last()?);
    let lasting = last.time - first.time;
    let pieces = looks.len() - 1;
    let mut rates = Rates::NONE;
    let mut width = pieces;
    while width >= 1 {
        let ends = looks.iter().step_by(width).zip(looks.iter().skip(width).step_by(width));
        let none = Rates { speed: 0.0, spin: 0.0 };
        let of_width = ends.map(|(a, b)| Rates::of(a, b, (a.time, b.time), between)).fold(none, Rates::most);
        rates = rates.least(of_width);
        width /= 2;
    }
    for (a, b) in about {
        rates = rates.least(Rates::of(a, b, (first.time, last.time), between));
    }
    let most = |of: fn(&Look) -> f64| looks.iter().map(of).fold(0.0, f64::max);
    let spread = |of: fn(&Look) -> f64| {
        looks.iter().map(of).fold(f64::NEG_INFINITY, f64::max) - looks.iter().map(of).fold(f64::INFINITY, f64::min)
    };
    let along = |of: fn(&Look, &Look) -> f64| looks.windows(2).map(|ends| of(&ends[0], &ends[1])).sum::<f64>();
    let piece = lasting / pieces as f64;
    let curve = 0.125 * piece * piece * swung(most(|look| look.arm), rates.spin, between);
    let turn_curve = 0.125 * piece * piece * between.turn;
    // Two moments are on the lines between looks, but for the curve and the errors of both.
    let way = along(|a, b| (b.x - a.x).hypot(b.y - a.y)).min(spread(|look| look.x).hypot(spread(|look| look.y)));
    let way = way + 2.0 * (most(|look| look.off) + curve);
    let turned = along(|a, b| (b.theta - a.theta).abs()).min(spread(|look| look.theta));
    let turned = turned + 2.0 * (most(|look| look.turn_off) + turn_curve);
    let declared = |way: f64, rate: f64| way.min(lasting * rate).max(0.5 * lasting * rate) * (1.0 + 1e-9);
    Some(Motion {
        curve: curve * (1.0 + 1e-9),
        turn_curve: turn_curve * (1.0 + 1e-9),
        rotation: declared(turned, rates.spin),
        translation: declared(way, rates.speed),
    })
}

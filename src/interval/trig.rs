//! Rigorous elementary functions on intervals, on correctly rounded scalar functions (CORE-MATH).
//!
//! CORE-MATH returns the double nearest to the real value, so the next double outward bounds it. Square roots are the
//! standard library's, which IEEE 754 defines as correctly rounded too.

use super::Interval;
use super::arithmetic::{down, up};

/// Pieces no wider than this hold at most one extremum of sine or cosine: it is below pi.
const MONOTONE_WIDTH: f64 = 3.0;

/// An upper bound of the full circle, below which the extrema are looked for.
const FULL_CIRCLE: f64 = 6.283_185_307_179_587;

/// A lower bound and an upper bound of the real value that was rounded to `v`, unless `v` is known to be exact.
fn outward(v: f64, exact: bool) -> (f64, f64) {
    if exact { (v, v) } else { (down(v), up(v)) }
}

/// The hull of `f` over `[lo, hi]`, no wider than [`MONOTONE_WIDTH`], from its values and slopes at the ends.
///
/// The slope of sine and cosine has its zeros pi apart, so such a piece holds at most one, and it holds one exactly when
/// the slopes at the ends have opposite signs. The signs are right, because correct rounding keeps them and neither
/// function is zero at a double, but for the sine at zero: there the end itself is the extremum, or its value is exact.
fn piece(lo: f64, hi: f64, value: fn(f64) -> f64, slope: fn(f64) -> f64) -> (f64, f64) {
    // sin(0) = 0 and cos(0) = 1 are exact.
    let (mut min, mut max) = outward(value(lo), lo == 0.0);
    if lo == hi {
        return (min.max(-1.0), max.min(1.0));
    }
    let (hi_min, hi_max) = outward(value(hi), hi == 0.0);
    min = min.min(hi_min);
    max = max.max(hi_max);
    let (rise_lo, rise_hi) = (slope(lo), slope(hi));
    if rise_lo > 0.0 && rise_hi < 0.0 {
        max = 1.0;
    }
    if rise_lo < 0.0 && rise_hi > 0.0 {
        min = -1.0;
    }
    (min.max(-1.0), max.min(1.0))
}

/// The hull of a sine-like function over an interval.
fn wave(x: Interval, value: fn(f64) -> f64, slope: fn(f64) -> f64) -> Interval {
    let width = x.width();
    if !x.is_bounded() || width >= FULL_CIRCLE {
        return Interval::spanning(-1.0, 1.0);
    }
    if width <= MONOTONE_WIDTH {
        let (min, max) = piece(x.lo(), x.hi(), value, slope);
        return Interval::spanning(min, max);
    }
    let thirds = [x.lo(), x.lo() + width / 3.0, x.hi() - width / 3.0, x.hi()];
    let (mut min, mut max) = (1.0_f64, -1.0_f64);
    for ends in thirds.windows(2) {
        // Where doubles lie so far apart that thirds are not distinct, nothing is known.
        if ends[0] > ends[1] || up(ends[1] - ends[0]) > MONOTONE_WIDTH {
            return Interval::spanning(-1.0, 1.0);
        }
        let (low, high) = piece(ends[0], ends[1], value, slope);
        min = min.min(low);
        max = max.max(high);
    }
    Interval::spanning(min, max)
}

/// The slope of the cosine.
fn minus_sin(x: f64) -> f64 {
    -core_math::sin(x)
}

/// `atan2` rounded outward; exact on the positive x axis. Zeros carry no sign here: -0 is the point 0.
fn direction(y: f64, x: f64) -> (f64, f64) {
    outward(core_math::atan2(y + 0.0, x + 0.0), y == 0.0 && x > 0.0)
}

impl Interval {
    /// An enclosure of the sines of all members (radians), within `[-1, 1]`; `[-1, 1]` when unbounded.
    ///
    /// ```
    /// use ubbmap::interval::Interval;
    /// let s = Interval::spanning(1.0, 2.0).sin();
    /// assert!(s.hi() == 1.0 && s.contains(1.0_f64.sin()) && s.lo() > 0.84);
    /// assert_eq!(Interval::point(0.0).sin(), Interval::point(0.0));
    /// ```
    #[must_use]
    pub fn sin(self) -> Self {
        wave(self, core_math::sin, core_math::cos)
    }

    /// An enclosure of the cosines of all members (radians), within `[-1, 1]`; `[-1, 1]` when unbounded.
    ///
    /// ```
    /// use ubbmap::interval::Interval;
    /// let c = Interval::spanning(3.0, 3.5).cos();
    /// assert!(c.lo() == -1.0 && c.contains(3.5_f64.cos()) && c.hi() < -0.93);
    /// ```
    #[must_use]
    pub fn cos(self) -> Self {
        wave(self, core_math::cos, minus_sin)
    }

    /// An enclosure of the squares of all members; never below 0.
    ///
    /// ```
    /// use ubbmap::interval::Interval;
    /// let q = Interval::spanning(-2.0, 1.0).square();
    /// assert!(q.lo() == 0.0 && q.contains(4.0) && q.hi() < 4.000_001);
    /// ```
    #[must_use]
    pub fn square(self) -> Self {
        let (m, n) = (self.mignitude(), self.magnitude());
        Self::spanning(outward(m * m, m == 0.0).0.max(0.0), outward(n * n, n == 0.0).1)
    }

    /// An enclosure of the square roots of all non-negative members; negative members are taken as 0.
    ///
    /// ```
    /// use ubbmap::interval::Interval;
    /// let r = Interval::spanning(-1.0, 2.0).sqrt();
    /// assert!(r.lo() == 0.0 && r.contains(std::f64::consts::SQRT_2) && r.hi() < 1.414_213_6);
    /// ```
    #[must_use]
    pub fn sqrt(self) -> Self {
        let (m, n) = (self.lo().max(0.0), self.hi().max(0.0));
        Self::spanning(outward(m.sqrt(), m == 0.0).0.max(0.0), outward(n.sqrt(), n == 0.0).1)
    }

    /// An enclosure of `sqrt(x^2 + y^2)` over all members of `self` and `y`; never below 0. Overflows only where the
    /// result does.
    ///
    /// ```
    /// use ubbmap::interval::Interval;
    /// let h = Interval::point(3e200).hypot(Interval::point(-4e200));
    /// assert!(h.contains(5e200) && h.width() < 1e186);
    /// ```
    #[must_use]
    pub fn hypot(self, y: Self) -> Self {
        let (a, b) = (self.mignitude(), y.mignitude());
        let (c, d) = (self.magnitude(), y.magnitude());
        // The length of a vector along an axis is exact.
        let low = outward(core_math::hypot(a, b), a == 0.0 || b == 0.0).0;
        let high = outward(core_math::hypot(c, d), c == 0.0 || d == 0.0).1;
        Self::spanning(low.max(0.0), high)
    }

    /// An enclosure of the directions of the points `(x, y)` of a box, `self` being `y`: a connected interval of
    /// angles of width at most 2 pi, within `[-pi, 2 pi]` (it may run past pi where the box meets the negative x axis
    /// from below); `[-pi, pi]` when the box holds the origin, its boundary included. All up to outward rounding.
    ///
    /// ```
    /// use ubbmap::interval::Interval;
    /// let west = Interval::spanning(-1.0, 1.0).atan2(Interval::spanning(-3.0, -1.0));
    /// assert!(west.contains(0.75 * std::f64::consts::PI) && west.contains(1.25 * std::f64::consts::PI));
    /// assert!(west.width() < 1.571);
    /// ```
    #[must_use]
    pub fn atan2(self, x: Self) -> Self {
        let y = self;
        if y.contains(0.0) && x.contains(0.0) {
            return Self::spanning(-Self::PI.hi(), Self::PI.hi());
        }
        if y.lo() > 0.0 {
            return upper_directions(y, x);
        }
        if y.hi() < 0.0 {
            return -upper_directions(-y, x);
        }
        if x.lo() > 0.0 {
            return Self::spanning(direction(y.lo(), x.lo()).0, direction(y.hi(), x.lo()).1);
        }
        // The box meets the negative x axis: from its upper right corner counter-clockwise to its lower right one.
        let end = if y.lo() < 0.0 {
            (Self::TAU + Self::spanning(direction(y.lo(), x.hi()).0, direction(y.lo(), x.hi()).1)).hi()
        } else {
            Self::PI.hi()
        };
        Self::spanning(direction(y.hi(), x.hi()).0, end)
    }
}

/// Directions of a box strictly above the x axis. Its extreme directions are those of corners: seen from the origin a
/// convex set lies between its extreme points.
fn upper_directions(y: Interval, x: Interval) -> Interval {
    let rightmost = direction(if x.hi() >= 0.0 { y.lo() } else { y.hi() }, x.hi());
    let leftmost = direction(if x.lo() >= 0.0 { y.hi() } else { y.lo() }, x.lo());
    Interval::spanning(rightmost.0.max(0.0), leftmost.1.min(Interval::PI.hi()))
}

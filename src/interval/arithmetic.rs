//! The closed interval and its rounded arithmetic.

use std::ops::{Add, Div, Mul, Neg, Sub};

/// A non-empty closed interval `[lo, hi]` of real numbers, `lo <= hi`, never NaN; bounds may be infinite.
///
/// ```
/// use ubbmap::interval::Interval;
/// let tenth = Interval::point(0.1);
/// let sum = tenth + tenth + tenth;
/// assert!(sum.contains(0.3) && sum.width() < 1e-15);
/// ```
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Interval {
    lo: f64,
    hi: f64,
}

/// The next float below: a lower bound of every real that rounds to `v`; the largest float for what overflowed.
pub(crate) fn down(v: f64) -> f64 {
    if v.is_nan() { f64::NEG_INFINITY } else { v.next_down() }
}

/// The next float above: an upper bound of every real that rounds to `v`; the smallest float for what overflowed.
pub(crate) fn up(v: f64) -> f64 {
    if v.is_nan() { f64::INFINITY } else { v.next_up() }
}

/// `a + b` rounded to nearest and the sign of what the rounding lost (Knuth's error-free sum): 0 when it is exact.
///
/// Sums do not underflow, so the lost part is a float and its sign is right wherever the sum is finite.
fn sum_and_loss(a: f64, b: f64) -> (f64, f64) {
    let sum = a + b;
    let b_part = sum - a;
    let a_part = sum - b_part;
    (sum, (a - a_part) + (b - b_part))
}

/// The largest float at or below the real `a + b`.
fn sum_down(a: f64, b: f64) -> f64 {
    // A loss that is infinite or NaN comes from an overflow on the way: something was lost.
    let (sum, loss) = sum_and_loss(a, b);
    if (0.0..f64::INFINITY).contains(&loss) { sum } else { down(sum) }
}

/// The smallest float at or above the real `a + b`.
fn sum_up(a: f64, b: f64) -> f64 {
    let (sum, loss) = sum_and_loss(a, b);
    if loss <= 0.0 && loss > f64::NEG_INFINITY { sum } else { up(sum) }
}

impl Interval {
    /// All real numbers.
    pub const ENTIRE: Self = Self { lo: f64::NEG_INFINITY, hi: f64::INFINITY };

    /// The two doubles around pi.
    pub const PI: Self = Self { lo: std::f64::consts::PI, hi: std::f64::consts::PI.next_up() };

    /// The two doubles around 2 pi.
    pub const TAU: Self = Self { lo: std::f64::consts::TAU, hi: std::f64::consts::TAU.next_up() };

    /// `[lo, hi]`, or `None` when a bound is NaN, the bounds are inverted, or both are the same infinity.
    #[must_use]
    pub fn new(lo: f64, hi: f64) -> Option<Self> {
        (lo <= hi && lo < f64::INFINITY && hi > f64::NEG_INFINITY).then_some(Self { lo, hi })
    }

    /// The interval spanned by two values in either order.
    ///
    /// NaN in either gives [`Interval::ENTIRE`].
    #[must_use]
    pub fn spanning(a: f64, b: f64) -> Self {
        Self::new(a.min(b), a.max(b)).filter(|_| !a.is_nan() && !b.is_nan()).unwrap_or(Self::ENTIRE)
    }

    /// The interval `[v, v]`; NaN gives [`Interval::ENTIRE`].
    #[must_use]
    pub fn point(v: f64) -> Self {
        Self::spanning(v, v)
    }

    /// `center + [-radius, radius]`, rounded outward; `radius` in the unit of `center`.
    #[must_use]
    pub fn around(center: f64, radius: f64) -> Self {
        Self::spanning(sum_down(center, -radius.abs()), sum_up(center, radius.abs()))
    }

    /// Lower bound.
    #[must_use]
    pub fn lo(self) -> f64 {
        self.lo
    }

    /// Upper bound.
    #[must_use]
    pub fn hi(self) -> f64 {
        self.hi
    }

    /// The least float at or above `hi - lo`; 0 for a point.
    #[must_use]
    pub fn width(self) -> f64 {
        sum_up(self.hi, -self.lo)
    }

    /// A finite member: near the middle when both bounds are finite, 0 for [`Interval::ENTIRE`], else the largest float
    /// on the unbounded side.
    #[must_use]
    pub fn mid(self) -> f64 {
        match (self.lo.is_finite(), self.hi.is_finite()) {
            (true, true) => (0.5 * self.lo + 0.5 * self.hi).clamp(self.lo, self.hi),
            (true, false) => f64::MAX,
            (false, true) => f64::MIN,
            (false, false) => 0.0,
        }
    }

    /// An upper bound of the distance from [`Interval::mid`] to either end.
    #[must_use]
    pub fn radius(self) -> f64 {
        let mid = self.mid();
        sum_up(self.hi, -mid).max(sum_up(mid, -self.lo))
    }

    /// The largest absolute value of a member.
    #[must_use]
    pub fn magnitude(self) -> f64 {
        self.lo.abs().max(self.hi.abs())
    }

    /// The smallest absolute value of a member.
    #[must_use]
    pub fn mignitude(self) -> f64 {
        if self.contains(0.0) { 0.0 } else { self.lo.abs().min(self.hi.abs()) }
    }

    /// True when `v` is a member.
    #[must_use]
    pub fn contains(self, v: f64) -> bool {
        self.lo <= v && v <= self.hi
    }

    /// True when every member of `other` is a member.
    #[must_use]
    pub fn encloses(self, other: Self) -> bool {
        self.lo <= other.lo && other.hi <= self.hi
    }

    /// True when the two have a member in common.
    #[must_use]
    pub fn meets(self, other: Self) -> bool {
        self.lo <= other.hi && other.lo <= self.hi
    }

    /// True when both bounds are finite.
    #[must_use]
    pub fn is_bounded(self) -> bool {
        self.lo.is_finite() && self.hi.is_finite()
    }

    /// The smallest interval that encloses both.
    #[must_use]
    pub fn hull(self, other: Self) -> Self {
        Self { lo: self.lo.min(other.lo), hi: self.hi.max(other.hi) }
    }

    /// The members of both, `None` when there are none.
    #[must_use]
    pub fn intersection(self, other: Self) -> Option<Self> {
        Self::new(self.lo.max(other.lo), self.hi.min(other.hi))
    }

    /// The interval times a scalar, rounded outward; a scalar that is NaN or infinite gives [`Interval::ENTIRE`].
    ///
    /// ```
    /// use ubbmap::interval::Interval;
    /// assert!(Interval::spanning(1.0, 2.0).scale(-3.0).contains(-6.0));
    /// ```
    #[must_use]
    pub fn scale(self, factor: f64) -> Self {
        if factor.is_finite() { self * Self::point(factor) } else { Self::ENTIRE }
    }

    /// The absolute values of all members.
    ///
    /// ```
    /// use ubbmap::interval::Interval;
    /// assert_eq!(Interval::spanning(-3.0, 2.0).abs(), Interval::spanning(0.0, 3.0));
    /// ```
    #[must_use]
    pub fn abs(self) -> Self {
        Self { lo: self.mignitude(), hi: self.magnitude() }
    }

    /// The smaller of a member of each, over all pairs.
    ///
    /// ```
    /// use ubbmap::interval::Interval;
    /// let m = Interval::spanning(0.0, 3.0).min(Interval::spanning(1.0, 2.0));
    /// assert_eq!(m, Interval::spanning(0.0, 2.0));
    /// ```
    #[must_use]
    pub fn min(self, other: Self) -> Self {
        Self { lo: self.lo.min(other.lo), hi: self.hi.min(other.hi) }
    }

    /// The larger of a member of each, over all pairs.
    ///
    /// ```
    /// use ubbmap::interval::Interval;
    /// let m = Interval::spanning(0.0, 3.0).max(Interval::spanning(1.0, 2.0));
    /// assert_eq!(m, Interval::spanning(1.0, 3.0));
    /// ```
    #[must_use]
    pub fn max(self, other: Self) -> Self {
        Self { lo: self.lo.max(other.lo), hi: self.hi.max(other.hi) }
    }
}

impl Neg for Interval {
    type Output = Self;
    fn neg(self) -> Self {
        Self { lo: -self.hi, hi: -self.lo }
    }
}

impl Add for Interval {
    type Output = Self;
    /// The sums, each bound the nearest float outward. A lower bound is never +inf and an upper one never -inf, so no
    /// sum of bounds is NaN.
    fn add(self, rhs: Self) -> Self {
        Self { lo: sum_down(self.lo, rhs.lo), hi: sum_up(self.hi, rhs.hi) }
    }
}

impl Sub for Interval {
    type Output = Self;
    fn sub(self, rhs: Self) -> Self {
        self + -rhs
    }
}

/// A product of bounds with a lower and an upper bound of it. Zero times anything is exactly zero, infinity included:
/// an unbounded interval's members are all finite.
fn bound_product(a: f64, b: f64) -> (f64, f64) {
    if a == 0.0 || b == 0.0 {
        return (0.0, 0.0);
    }
    keeping_sign(a * b, a, b)
}

/// The floats around what was rounded to `v`, cut off at the zero that the factors' signs forbid to pass: what underflows
/// keeps its sign.
fn keeping_sign(v: f64, a: f64, b: f64) -> (f64, f64) {
    if (a > 0.0) == (b > 0.0) { (down(v).max(0.0), up(v)) } else { (down(v), up(v).min(0.0)) }
}

/// A quotient of bounds, likewise; `b` is not zero. Infinity by infinity can be anything of its sign, and the other
/// quotients of the same operands do not bound it: (0, inf) has the sign alone.
fn bound_quotient(a: f64, b: f64) -> (f64, f64) {
    if a == 0.0 {
        return (0.0, 0.0);
    }
    if a.is_infinite() && b.is_infinite() {
        return if (a > 0.0) == (b > 0.0) { (0.0, f64::INFINITY) } else { (f64::NEG_INFINITY, 0.0) };
    }
    keeping_sign(a / b, a, b)
}

/// The hull of four enclosures.
fn hull_of(bounds: [(f64, f64); 4]) -> Interval {
    let lo = bounds.iter().fold(f64::INFINITY, |m, b| m.min(b.0));
    let hi = bounds.iter().fold(f64::NEG_INFINITY, |m, b| m.max(b.1));
    Interval { lo, hi }
}

impl Mul for Interval {
    type Output = Self;
    fn mul(self, rhs: Self) -> Self {
        hull_of([
            bound_product(self.lo, rhs.lo),
            bound_product(self.lo, rhs.hi),
            bound_product(self.hi, rhs.lo),
            bound_product(self.hi, rhs.hi),
        ])
    }
}

impl Div for Interval {
    type Output = Self;
    /// The quotients; [`Interval::ENTIRE`] when the divisor contains zero.
    fn div(self, rhs: Self) -> Self {
        if rhs.contains(0.0) {
            return Self::ENTIRE;
        }
        hull_of([
            bound_quotient(self.lo, rhs.lo),
            bound_quotient(self.lo, rhs.hi),
            bound_quotient(self.hi, rhs.lo),
            bound_quotient(self.hi, rhs.hi),
        ])
    }
}

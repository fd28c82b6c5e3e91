//! Interval arithmetic against exact integers: no bound is on the wrong side of the real result.

#![allow(clippy::unwrap_used, clippy::panic, clippy::print_stdout, reason = "a test fails by panicking")]

use rand::{Rng, RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::cmp::Ordering;
use ubbmap::interval::Interval;

/// The exact real `mantissa * 2^exponent`.
#[derive(Debug, Clone, Copy)]
struct Exact {
    mantissa: i128,
    exponent: i32,
}

impl Exact {
    fn of(v: f64) -> Self {
        let bits = v.to_bits();
        let biased = ((bits >> 52) & 0x7ff) as i32;
        let fraction = i128::from(bits & ((1 << 52) - 1));
        let mantissa = if biased == 0 { fraction } else { fraction | (1 << 52) };
        if mantissa == 0 {
            return Self { mantissa, exponent: 0 };
        }
        // As few bits as will do leave room for sums.
        let zeros = mantissa.trailing_zeros();
        let odd = mantissa >> zeros;
        Self { mantissa: if v < 0.0 { -odd } else { odd }, exponent: biased.max(1) - 1075 + zeros as i32 }
    }

    fn times(self, other: Self) -> Self {
        Self { mantissa: self.mantissa * other.mantissa, exponent: self.exponent + other.exponent }
    }

    /// The sum of two whose exponents are near.
    fn plus(self, other: Self) -> Self {
        if self.mantissa == 0 || other.mantissa == 0 {
            return if self.mantissa == 0 { other } else { self };
        }
        let exponent = self.exponent.min(other.exponent);
        let shifted = |e: Self| e.mantissa.checked_mul(1 << (e.exponent - exponent)).unwrap();
        Self { mantissa: shifted(self).checked_add(shifted(other)).unwrap(), exponent }
    }

    fn cmp(self, other: Self) -> Ordering {
        let sign = |e: Self| e.mantissa.signum();
        if sign(self) != sign(other) || self.mantissa == 0 {
            return sign(self).cmp(&sign(other));
        }
        let top = |e: Self| 128 - e.mantissa.unsigned_abs().leading_zeros() as i32 + e.exponent;
        let by_size = top(self).cmp(&top(other)).then_with(|| {
            // Leading bits in the same place: at the smaller exponent both have as many bits.
            let exponent = self.exponent.min(other.exponent);
            let shifted = |e: Self| e.mantissa.unsigned_abs() << (e.exponent - exponent);
            shifted(self).cmp(&shifted(other))
        });
        if self.mantissa > 0 { by_size } else { by_size.reverse() }
    }
}

/// Is `bound <= real`? An infinite bound is on the right side of any real if its sign says so.
fn below(bound: f64, real: Exact) -> bool {
    if bound.is_infinite() { bound < 0.0 } else { Exact::of(bound).cmp(real) != Ordering::Greater }
}

fn above(bound: f64, real: Exact) -> bool {
    if bound.is_infinite() { bound > 0.0 } else { Exact::of(bound).cmp(real) != Ordering::Less }
}

/// Any finite double; half of the time of everyday size, with few bits so that results are often exact.
fn double(rng: &mut ChaCha8Rng) -> f64 {
    match rng.random_range(0..4) {
        0 => loop {
            let v = f64::from_bits(rng.next_u64());
            if v.is_finite() {
                return v;
            }
        },
        1 => f64::from(rng.random_range(-1000..1000)) * 0.125,
        2 => f64::from_bits(rng.next_u64() & 0x800f_ffff_ffff_ffff), // subnormal
        _ => rng.random_range(-100.0..100.0),
    }
}

#[test]
fn the_oracle_orders_as_the_doubles_do() {
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    for _ in 0..100_000 {
        let (a, b) = (double(&mut rng), double(&mut rng));
        assert_eq!(Exact::of(a).cmp(Exact::of(b)), a.partial_cmp(&b).unwrap(), "{a:e} {b:e}");
        assert_eq!(Exact::of(a).cmp(Exact::of(a.next_up())), Ordering::Less);
    }
}

#[test]
fn products_and_quotients_of_all_sizes_are_bounded_on_the_right_side() {
    let mut rng = ChaCha8Rng::seed_from_u64(2);
    for _ in 0..300_000 {
        let (a, b) = (double(&mut rng), double(&mut rng));
        let product = Interval::point(a) * Interval::point(b);
        let exact = Exact::of(a).times(Exact::of(b));
        assert!(below(product.lo(), exact) && above(product.hi(), exact), "{a:e} * {b:e}: {product:?}");
        let rounded = a * b;
        assert!(product.lo() >= rounded.next_down() && product.hi() <= rounded.next_up(), "{a:e} * {b:e} is wide");
        if b == 0.0 {
            continue;
        }
        let quotient = Interval::point(a) / Interval::point(b);
        // q <= a / b for b > 0 says q b <= a; for b < 0 both change sides.
        let (a, b) = if b < 0.0 { (-a, -b) } else { (a, b) };
        let bounds = |v: f64| Exact::of(v).times(Exact::of(b)).cmp(Exact::of(a));
        assert!(
            quotient.lo().is_infinite() || bounds(quotient.lo()) != Ordering::Greater,
            "{a:e} / {b:e}: {quotient:?}"
        );
        assert!(quotient.hi().is_infinite() || bounds(quotient.hi()) != Ordering::Less, "{a:e} / {b:e}: {quotient:?}");
    }
}

#[test]
fn sums_are_the_nearest_doubles_outward() {
    let mut rng = ChaCha8Rng::seed_from_u64(3);
    let mut exact_sums = 0;
    for _ in 0..300_000 {
        // Exponents within 60 of each other, so that the exact sum fits.
        let shift = rng.random_range(-30..30);
        let near = |rng: &mut ChaCha8Rng| {
            let bits = rng.random_range(1..53);
            let mantissa = (rng.next_u64() >> (64 - bits)) as f64;
            let scale = (2.0_f64).powi(rng.random_range(-4..4) + shift);
            if rng.random() { mantissa * scale } else { -mantissa * scale }
        };
        let (a, b) = (near(&mut rng), near(&mut rng));
        let exact = Exact::of(a).plus(Exact::of(b));
        for (sum, exact) in
            [(Interval::point(a) + Interval::point(b), exact), (Interval::point(a) - Interval::point(-b), exact)]
        {
            assert!(below(sum.lo(), exact) && above(sum.hi(), exact), "{a:e} + {b:e}: {sum:?}");
            // No double lies between a bound and the sum.
            assert!(!below(sum.lo().next_up(), exact) && !above(sum.hi().next_down(), exact), "{a:e} + {b:e} is wide");
            exact_sums += usize::from(sum.lo() == sum.hi());
        }
    }
    assert!(exact_sums > 1000, "some sums are exact: {exact_sums}");
}

#[test]
fn sums_of_unlike_sizes_keep_to_the_right_side() {
    let mut rng = ChaCha8Rng::seed_from_u64(4);
    for _ in 0..100_000 {
        let (a, b) = (double(&mut rng), double(&mut rng));
        let (big, small) = if a.abs() >= b.abs() { (a, b) } else { (b, a) };
        if small == 0.0 || big.abs() < small.abs() * 2.0_f64.powi(60) || small.abs() < f64::MIN_POSITIVE {
            continue;
        }
        // The small one is less than half an ulp of the big one: the sum lies strictly on its side.
        let sum = Interval::point(a) + Interval::point(b);
        let expected = if small > 0.0 { (big, big.next_up()) } else { (big.next_down(), big) };
        assert_eq!((sum.lo(), sum.hi()), expected, "{a:e} + {b:e}");
    }
}

#[test]
fn squares_roots_and_lengths_are_bounded_on_the_right_side() {
    let mut rng = ChaCha8Rng::seed_from_u64(5);
    for _ in 0..300_000 {
        let v = double(&mut rng);
        let square = Interval::point(v).square();
        let exact = Exact::of(v).times(Exact::of(v));
        assert!(below(square.lo(), exact) && above(square.hi(), exact), "{v:e}^2: {square:?}");
        let root = Interval::point(v.abs()).sqrt();
        let squared = |b: f64| Exact::of(b).times(Exact::of(b)).cmp(Exact::of(v.abs()));
        assert!(
            squared(root.lo()) != Ordering::Greater && squared(root.hi()) != Ordering::Less,
            "sqrt {v:e}: {root:?}"
        );
        assert!(root.hi() <= v.abs().sqrt().next_up() && root.lo() >= v.abs().sqrt().next_down());
        // Coordinates of 30 bits: the sum of the squares is exact.
        let whole = |rng: &mut ChaCha8Rng| f64::from(rng.random_range(-(1 << 30)..(1 << 30)));
        let (x, y) = (whole(&mut rng), whole(&mut rng));
        let length = Interval::point(x).hypot(Interval::point(y));
        let exact = Exact::of(x).times(Exact::of(x)).plus(Exact::of(y).times(Exact::of(y)));
        let squared = |b: f64| Exact::of(b).times(Exact::of(b)).cmp(exact);
        assert!(
            squared(length.lo()) != Ordering::Greater && squared(length.hi()) != Ordering::Less,
            "{x} {y}: {length:?}"
        );
        assert!(length.width() <= 3.0 * (length.hi() - length.hi().next_down()));
    }
}

fn interval(rng: &mut ChaCha8Rng) -> Interval {
    Interval::spanning(double(rng), double(rng))
}

#[test]
fn results_of_intervals_enclose_those_of_members() {
    let mut rng = ChaCha8Rng::seed_from_u64(6);
    for _ in 0..100_000 {
        let (x, y) = (interval(&mut rng), interval(&mut rng));
        for _ in 0..4 {
            let pick = |rng: &mut ChaCha8Rng, i: Interval| match rng.random_range(0..4) {
                0 => i.lo(),
                1 => i.hi(),
                2 => i.mid(),
                _ => (i.lo() + rng.random::<f64>() * (0.5 * i.hi() - 0.5 * i.lo())).clamp(i.lo(), i.hi()),
            };
            let (a, b) = (pick(&mut rng, x), pick(&mut rng, y));
            let (pa, pb) = (Interval::point(a), Interval::point(b));
            // The results at points are held to exact numbers above.
            assert!((x + y).encloses(pa + pb) && (x - y).encloses(pa - pb), "{x:?} {y:?} at {a:e} {b:e}");
            assert!((x * y).encloses(pa * pb), "{x:?} * {y:?} at {a:e} {b:e}");
            if b != 0.0 {
                assert!((x / y).encloses(pa / pb), "{x:?} / {y:?} at {a:e} {b:e}");
            }
            let longest = Interval::spanning(a.abs().max(b.abs()), f64::INFINITY);
            let length = pa.hypot(pb).intersection(longest).unwrap();
            assert!(x.square().encloses(pa.square()) && x.hypot(y).encloses(length), "{x:?} {y:?} at {a:e} {b:e}");
            assert!(x.abs().contains(a.abs()) && (-x).contains(-a) && x.scale(b).encloses(pa.scale(b)));
            assert!(x.min(y).contains(a.min(b)) && x.max(y).contains(a.max(b)) && x.hull(y).contains(a));
            assert!(x.sqrt().encloses(Interval::point(a.max(0.0)).sqrt()));
            assert!(x.mid() - x.radius() <= a && a <= x.mid() + x.radius() && x.width() >= a - x.lo());
            assert!(x.mignitude() <= a.abs() && a.abs() <= x.magnitude());
            let shared = x.intersection(y);
            assert_eq!(shared.is_some(), x.meets(y));
            assert_eq!(shared.is_some_and(|s| s.contains(a)), y.contains(a));
        }
    }
}

#[test]
fn infinite_bounds_stay_on_their_side() {
    let up = Interval::new(1.0, f64::INFINITY).unwrap();
    let down = Interval::new(f64::NEG_INFINITY, -1.0).unwrap();
    let zero = Interval::point(0.0);
    assert_eq!(up + down, Interval::ENTIRE);
    assert_eq!(up - up, Interval::ENTIRE);
    assert_eq!((up + up).lo(), 2.0);
    assert_eq!(up - down, up + up);
    assert_eq!(Interval::ENTIRE * zero, zero);
    assert_eq!(zero / up, zero);
    assert_eq!(up / zero, Interval::ENTIRE);
    assert_eq!(up / Interval::point(-0.0), Interval::ENTIRE);
    assert!((up / up).encloses(Interval::spanning(1e-300, 1e300)) && (up / up).lo() == 0.0);
    assert!((up / down).hi() == 0.0 && (up / down).lo() == f64::NEG_INFINITY);
    // Overflow: the sum of the largest doubles is finite, and not below the largest.
    let largest = Interval::point(f64::MAX);
    assert_eq!((largest + largest, largest * largest), (largest.max(up + largest), largest.max(up + largest)));
    assert_eq!((largest + largest).lo(), f64::MAX);
    assert_eq!((-largest - largest).hi(), f64::MIN);
    assert_eq!((up.mid(), down.mid(), Interval::ENTIRE.mid()), (f64::MAX, f64::MIN, 0.0));
    assert_eq!(
        (up.radius(), up.width(), up.magnitude(), up.mignitude()),
        (f64::INFINITY, f64::INFINITY, f64::INFINITY, 1.0)
    );
    // What is no interval of reals is refused or says nothing.
    assert_eq!(Interval::new(f64::INFINITY, f64::INFINITY), None);
    assert_eq!(Interval::new(f64::NAN, 1.0), None);
    assert_eq!(Interval::new(1.0, 0.0), None);
    assert_eq!(Interval::point(f64::NAN), Interval::ENTIRE);
    assert_eq!(Interval::point(f64::INFINITY), Interval::ENTIRE);
    assert_eq!(Interval::around(1.0, f64::NAN), Interval::ENTIRE);
    assert_eq!(up.scale(f64::INFINITY), Interval::ENTIRE);
}

#[test]
fn around_encloses_its_radius() {
    let mut rng = ChaCha8Rng::seed_from_u64(7);
    for _ in 0..100_000 {
        let (c, r) = (rng.random_range(-100.0..100.0), rng.random_range(0.0..10.0));
        let around = Interval::around(c, r);
        assert!(
            below(around.lo(), Exact::of(c).plus(Exact::of(-r))) && above(around.hi(), Exact::of(c).plus(Exact::of(r)))
        );
        assert_eq!(around, Interval::around(c, -r));
    }
}

//! Elementary functions on intervals: members' values are inside, and the hull is reached.
//!
//! The scalar functions are held to exact vectors in `interval_vectors`. Here the scalars' next doubles outward serve as
//! bounds of the truth at sampled members, which the result must enclose.

#![allow(clippy::unwrap_used, clippy::panic, clippy::print_stdout, reason = "a test fails by panicking")]

use proptest::prelude::*;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::f64::consts::{PI, TAU};
use ubbmap::interval::Interval;

/// An enclosure of the real value that a correctly rounded function returned as `v`.
fn truth(v: f64) -> Interval {
    Interval::spanning(v.next_down(), v.next_up())
}

fn random_angles(rng: &mut ChaCha8Rng) -> Interval {
    let scale = [1.0, 10.0, 1e3, 1e6, 1e9, 1e14, 1e18][rng.random_range(0..7)];
    let lo = rng.random_range(-scale..scale);
    let width = match rng.random_range(0..5) {
        0 => 0.0,
        1 => 10.0_f64.powf(rng.random_range(-12.0..0.0)),
        2 => rng.random_range(0.0..PI),
        3 => rng.random_range(2.9..3.3),
        _ => rng.random_range(0.0..7.0),
    };
    Interval::spanning(lo, lo + width)
}

fn members(rng: &mut ChaCha8Rng, x: Interval, count: usize) -> Vec<f64> {
    let mut all = vec![x.lo(), x.hi(), x.mid()];
    all.extend((0..count).map(|_| (x.lo() + rng.random::<f64>() * x.width()).clamp(x.lo(), x.hi())));
    all
}

#[test]
fn sines_and_cosines_of_200_000_intervals_enclose_their_members() {
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    let unit = Interval::spanning(-1.0, 1.0);
    for _ in 0..200_000 {
        let x = random_angles(&mut rng);
        let (sin, cos) = (x.sin(), x.cos());
        assert!(unit.encloses(sin) && unit.encloses(cos));
        for member in members(&mut rng, x, 6) {
            for (got, value) in [(sin, core_math::sin(member)), (cos, core_math::cos(member))] {
                let inside = truth(value).intersection(unit).unwrap();
                assert!(got.encloses(inside), "{x:?} at {member:e}: {got:?} leaves out {value:e}");
            }
        }
    }
}

#[test]
fn sines_and_cosines_are_the_exact_hull_for_arguments_that_leave_no_doubt() {
    let mut rng = ChaCha8Rng::seed_from_u64(2);
    for _ in 0..100_000 {
        let lo = rng.random_range(-50.0..50.0);
        let x = Interval::spanning(lo, lo + rng.random_range(0.0..7.0));
        // Brute force: the extrema of the hull are at the ends or at a turning point, k pi / 2.
        let hull = |value: fn(f64) -> f64, phase: f64| {
            let mut ends = [value(x.lo()), value(x.hi())];
            ends.sort_by(f64::total_cmp);
            let (mut min, mut max) = (ends[0], ends[1]);
            let first = ((x.lo() - phase) / PI).ceil() as i64;
            let last = ((x.hi() - phase) / PI).floor() as i64;
            for k in first..=last {
                if k % 2 == 0 { max = 1.0 } else { min = -1.0 }
            }
            (min, max)
        };
        for (got, (min, max)) in [(x.sin(), hull(f64::sin, PI / 2.0)), (x.cos(), hull(f64::cos, 0.0))] {
            // The width bound: beyond the brute-force hull by no more than rounding.
            assert!(got.lo() >= min - 1e-14 && got.hi() <= max + 1e-14, "{x:?}: {got:?} is wider than {min}, {max}");
        }
    }
}

#[test]
fn angles_without_bounds_or_of_a_full_circle_say_nothing() {
    let unit = Interval::spanning(-1.0, 1.0);
    let half_line = Interval::new(0.0, f64::INFINITY).unwrap();
    let circle = Interval::spanning(1.0, 1.0 + TAU.next_up());
    // Doubles that far out are more than pi apart.
    let sparse = Interval::spanning(1e300, 1e300_f64.next_up());
    let gap = Interval::spanning(2.0_f64.powi(54), 2.0_f64.powi(54).next_up());
    for x in [Interval::ENTIRE, half_line, circle, sparse, gap, Interval::spanning(-f64::MAX, f64::MAX)] {
        assert_eq!((x.sin(), x.cos()), (unit, unit), "{x:?}");
    }
    let zero = Interval::point(-0.0);
    assert_eq!((zero.sin(), zero.cos()), (Interval::point(0.0), Interval::point(1.0)));
    let tiny = Interval::spanning(0.0, 5e-324);
    assert!(tiny.sin().contains(5e-324) && tiny.sin().lo() == 0.0 && tiny.cos().hi() == 1.0);
}

/// A bound of a box: sometimes zero of either sign, sometimes tiny or huge.
fn coordinate(rng: &mut ChaCha8Rng) -> f64 {
    match rng.random_range(0..10) {
        0 => 0.0,
        1 => -0.0,
        2 => rng.random_range(-1.0..1.0) * 1e-310,
        3 => rng.random_range(-1.0..1.0) * 1e300,
        _ => rng.random_range(-10.0..10.0),
    }
}

#[test]
fn directions_of_200_000_boxes_enclose_their_members() {
    let mut rng = ChaCha8Rng::seed_from_u64(3);
    for _ in 0..200_000 {
        let x = Interval::spanning(coordinate(&mut rng), coordinate(&mut rng));
        let y = Interval::spanning(coordinate(&mut rng), coordinate(&mut rng));
        let got = y.atan2(x);
        assert!(got.lo() >= -PI.next_up() && got.hi() <= TAU, "{got:?}");
        if x.contains(0.0) && y.contains(0.0) {
            assert_eq!(got, Interval::spanning(-PI.next_up(), PI.next_up()));
        }
        let mut points = Vec::new();
        for px in members(&mut rng, x, 2) {
            points.extend(members(&mut rng, y, 2).into_iter().map(|py| (px, py)));
        }
        for (px, py) in points {
            if px == 0.0 && py == 0.0 {
                continue;
            }
            // Exact directions have no neighbours to enclose.
            let exact = py == 0.0 && px > 0.0;
            let value = core_math::atan2(py + 0.0, px + 0.0);
            // A point off the x axis has a direction on its own side of it, however small.
            let half =
                if py > 0.0 { Interval::spanning(0.0, PI.next_up()) } else { Interval::spanning(-PI.next_up(), 0.0) };
            let half = if py == 0.0 { limits() } else { half };
            let value = if exact { Interval::point(0.0) } else { truth(value).intersection(half).unwrap() };
            let turned = value + Interval::TAU;
            let inside = got.encloses(value) || got.lo() <= turned.lo() && turned.hi() <= got.hi();
            assert!(inside, "{x:?} {y:?} at ({px:e}, {py:e}): {got:?} leaves out {value:?}");
        }
    }
}

/// All directions.
fn limits() -> Interval {
    Interval::spanning(-PI.next_up(), PI.next_up())
}

#[test]
fn directions_of_a_box_are_no_wider_than_those_of_its_corners() {
    let mut rng = ChaCha8Rng::seed_from_u64(4);
    for _ in 0..100_000 {
        let x = Interval::spanning(rng.random_range(-5.0..5.0), rng.random_range(-5.0..5.0));
        let y = Interval::spanning(rng.random_range(-5.0..5.0), rng.random_range(-5.0..5.0));
        if x.contains(0.0) && y.contains(0.0) {
            continue;
        }
        // Seen from outside, a box spans less than half a circle: turn its centre to the east and take the hull there.
        let centre = y.mid().atan2(x.mid());
        let relative = |px: f64, py: f64| {
            let d = py.atan2(px) - centre;
            if d > PI {
                d - TAU
            } else if d < -PI {
                d + TAU
            } else {
                d
            }
        };
        let corners = [(x.lo(), y.lo()), (x.lo(), y.hi()), (x.hi(), y.lo()), (x.hi(), y.hi())];
        let (mut min, mut max) = (0.0_f64, 0.0_f64);
        for (px, py) in corners {
            min = min.min(relative(px, py));
            max = max.max(relative(px, py));
        }
        let width = y.atan2(x).width();
        assert!(width <= max - min + 1e-14, "{x:?} {y:?}: {width} for {}", max - min);
    }
}

#[test]
fn directions_at_the_axes_are_exact() {
    let zero = Interval::point(0.0);
    let minus_zero = Interval::point(-0.0);
    let (one, minus_one) = (Interval::point(1.0), Interval::point(-1.0));
    assert_eq!(zero.atan2(one), zero);
    assert_eq!(minus_zero.atan2(one), zero);
    // The sign of a zero means nothing: the point lies on the negative x axis, whose direction is pi.
    assert_eq!(zero.atan2(minus_one), minus_zero.atan2(minus_one));
    assert!(zero.atan2(minus_one).encloses(Interval::PI) && zero.atan2(minus_one).width() < 1e-15);
    // Touching that axis from below runs on past pi, from above it ends there.
    let below = Interval::spanning(-1.0, 0.0).atan2(minus_one);
    assert!(below.encloses(Interval::spanning(PI, 1.25 * PI)) && below.width() < 0.25 * PI + 1e-14);
    let above = Interval::spanning(0.0, 1.0).atan2(minus_one);
    assert!(above.encloses(Interval::spanning(0.75 * PI, PI)) && above.hi() <= PI.next_up());
    // Unbounded boxes.
    let far = Interval::new(1.0, f64::INFINITY).unwrap();
    assert!(far.atan2(far).encloses(Interval::spanning(1e-300, 1.57)) && far.atan2(far).width() < 1.571);
    assert!(far.atan2(-far).encloses(Interval::spanning(1.58, 3.1)) && far.atan2(-far).lo() > 1.57);
    assert_eq!(Interval::ENTIRE.atan2(one).width(), PI.next_up());
}

proptest! {
    #[test]
    fn no_bits_make_a_function_panic_or_invert(bits in prop::array::uniform4(any::<u64>())) {
        let [a, b, c, d] = bits.map(f64::from_bits);
        let (x, y) = (Interval::spanning(a, b), Interval::spanning(c, d));
        let results = [x.sin(), x.cos(), x.square(), x.sqrt(), x.hypot(y), x.atan2(y), x + y, x - y, x * y, x / y,
            x.abs(), x.min(y), x.max(y), x.scale(c), x.hull(y), -x, Interval::around(a, b), Interval::point(a)];
        for r in results {
            prop_assert!(r.lo() <= r.hi() && r.lo() < f64::INFINITY && r.hi() > f64::NEG_INFINITY, "{:?}", r);
        }
        prop_assert!(x.mid().is_finite() && x.contains(x.mid()));
        prop_assert!(x.radius() >= 0.0 && x.width() >= 0.0);
        prop_assert!(x.square().lo() >= 0.0 && x.sqrt().lo() >= 0.0 && x.hypot(y).lo() >= 0.0);
    }
}

//! The empty part of a beam in the frame of the beam: its enclosing hexagon and its inclusion test.

#![allow(clippy::unwrap_used, clippy::panic, clippy::print_stdout, reason = "a test fails by panicking")]

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use ubbmap::interval::{Box2, Interval, Verdict};
use ubbmap::sensor::{BeamCone, SensorModel, SensorSpec};

struct Cone {
    opening: f64,
    diameter: f64,
    cone: BeamCone,
}

fn random_cone(rng: &mut ChaCha8Rng) -> Cone {
    let opening = match rng.random_range(0..4) {
        0 => 0.0,
        1 => 0.25_f64.to_radians(),
        2 => rng.random_range(0.0..0.1),
        _ => rng.random_range(0.0..3.1),
    };
    let diameter = [0.0, 0.012, 0.3][rng.random_range(0..3)];
    let spec = SensorSpec { beam_opening: opening, beam_diameter: diameter, ..SensorSpec::default() };
    Cone { opening, diameter, cone: BeamCone::new(&SensorModel::new(spec).unwrap()) }
}

impl Cone {
    /// The point at distance `d`, `side` in -1..=1 across the beam, by (6); outside the cone for other sides.
    fn at(&self, d: f64, side: f64) -> (f64, f64) {
        let half = 0.5 * self.opening;
        if half == 0.0 {
            return (d, side * 0.5 * self.diameter);
        }
        let offset = 0.5 * self.diameter / half.tan();
        ((d + offset) * (side * half).cos() - offset, (d + offset) * (side * half).sin())
    }

    /// Far above the rounding of `at`, far below the distances that the tests tell apart.
    fn slack(&self) -> f64 {
        let half = 0.5 * self.opening;
        1e-14 * (30.0 + if half == 0.0 { 0.0 } else { 0.5 * self.diameter / half.tan() })
    }
}

#[test]
fn the_hexagon_holds_the_empty_part() {
    let mut rng = ChaCha8Rng::seed_from_u64(21);
    for _ in 0..20_000 {
        let cone = random_cone(&mut rng);
        let near: f64 = if rng.random_range(0..5) == 0 { 0.0 } else { rng.random_range(0.0..20.0) };
        let empty = cone.cone.empty(near);
        let corners = empty.corners();
        for _ in 0..50 {
            let (d, side) = (near * rng.random::<f64>(), rng.random_range(-1.0..=1.0));
            let (d, side) = [(d, side), (near, side), (0.0, side), (d, 1.0), (d, -1.0)][rng.random_range(0..5)];
            let (x, y) = cone.at(d, side);
            for i in 0..6 {
                let (a, b) = (corners[i], corners[(i + 1) % 6]);
                let length = (b.0 - a.0).hypot(b.1 - a.1);
                let left = (b.0 - a.0) * (y - a.1) - (b.1 - a.1) * (x - a.0);
                let slack = cone.slack() * (length + 1.0);
                assert!(left >= -slack, "({x}, {y}) at d {d}, side {side} is outside {empty:?}");
            }
        }
    }
}

#[test]
fn the_hexagon_is_as_tight_as_its_ends() {
    let mut rng = ChaCha8Rng::seed_from_u64(22);
    for _ in 0..20_000 {
        let cone = random_cone(&mut rng);
        let near: f64 = rng.random_range(0.0..20.0);
        let empty = cone.cone.empty(near);
        let slack = cone.slack();
        let (origin, shoulder) = (cone.at(0.0, 1.0), cone.at(near, 1.0));
        // Every corner but those of the far box is a point of the cone.
        assert!((empty.start - origin.0).abs() <= slack && (empty.half_width_at_origin - origin.1).abs() <= slack);
        assert!((empty.shoulder - shoulder.0).abs() <= slack && (empty.half_width_at_near - shoulder.1).abs() <= slack);
        assert_eq!(empty.near_end, near);
        assert!(empty.start <= 0.0 && empty.shoulder <= near && empty.half_width_at_origin >= 0.0);
    }
}

#[test]
fn the_inclusion_test_tells_inside_from_outside() {
    let mut rng = ChaCha8Rng::seed_from_u64(23);
    let (mut inside, mut outside) = (0, 0);
    for _ in 0..200_000 {
        let cone = random_cone(&mut rng);
        if cone.opening == 0.0 && cone.diameter == 0.0 {
            continue;
        }
        let near = rng.random_range(0.1..20.0);
        let half = 0.5 * cone.opening;
        // Sides within the half plane ahead of the apex.
        let reach = if half == 0.0 { 3.0 } else { (1.5 / half).min(3.0) };
        let (d, side) = (rng.random_range(-0.5..1.5 * near), rng.random_range(-reach..reach));
        let offset = if half == 0.0 { 0.0 } else { 0.5 * cone.diameter / half.tan() };
        if d + offset <= 1e-6 {
            continue; // behind the apex
        }
        let (x, y) = cone.at(d, side);
        let clear = 1e-6;
        let verdict = cone.cone.holds(Box2::point(x, y), near);
        let lateral = if half == 0.0 { 0.5 * cone.diameter } else { half * (d + offset) };
        let margin = clear / lateral.max(1e-9);
        if d > clear && d < near - clear && side.abs() < 1.0 - margin {
            assert_eq!(verdict, Verdict::Yes, "d {d}, side {side}, near {near}: {cone:?}", cone = cone.cone);
            inside += 1;
        } else if d < -clear || d > near + clear || side.abs() > 1.0 + margin {
            assert_eq!(verdict, Verdict::No, "d {d}, side {side}, near {near}: {cone:?}", cone = cone.cone);
            outside += 1;
        }
    }
    assert!(inside > 20_000 && outside > 20_000, "{inside} {outside}");
}

#[test]
fn the_inclusion_test_of_a_box_speaks_for_all_its_points() {
    let mut rng = ChaCha8Rng::seed_from_u64(24);
    let mut decided = 0;
    for _ in 0..100_000 {
        let cone = random_cone(&mut rng);
        let near = rng.random_range(0.1..5.0);
        let (x, y) = (rng.random_range(-1.0..6.0), rng.random_range(-2.0..2.0));
        let size = 10.0_f64.powf(rng.random_range(-4.0..0.0));
        let area = Box2::new(Interval::spanning(x, x + size), Interval::spanning(y, y + size));
        let whole = cone.cone.holds(area, near);
        for _ in 0..8 {
            let point = Box2::point(x + size * rng.random::<f64>(), y + size * rng.random::<f64>());
            if !area.encloses(point) {
                continue;
            }
            let one = cone.cone.holds(point, near);
            match whole {
                Verdict::Yes => assert_ne!(one, Verdict::No),
                Verdict::No => assert_ne!(one, Verdict::Yes),
                Verdict::Unknown => {}
            }
        }
        decided += usize::from(whole != Verdict::Unknown);
    }
    assert!(decided > 50_000, "{decided}");
}

#[test]
fn a_pencil_has_no_inside_but_its_axis() {
    let spec = SensorSpec { beam_opening: 0.0, beam_diameter: 0.0, ..SensorSpec::default() };
    let cone = BeamCone::new(&SensorModel::new(spec).unwrap());
    assert_eq!(cone.holds(Box2::point(1.0, 0.0), 2.0), Verdict::Yes);
    assert_eq!(cone.holds(Box2::point(3.0, 0.0), 2.0), Verdict::No);
    assert_eq!(cone.holds(Box2::point(-1e-9, 0.0), 2.0), Verdict::No);
    assert_eq!(cone.holds(Box2::point(1.0, 1e-12), 2.0), Verdict::No);
    assert_eq!(cone.apex_offset(), Interval::point(0.0));
    assert_eq!((cone.empty(2.0).start, cone.empty(2.0).half_width_at_origin), (0.0, 0.0));
}

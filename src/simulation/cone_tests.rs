//! The closed forms against dense sampling, and the scanner against its own claims.
#![allow(clippy::unwrap_used, clippy::panic, reason = "a test may fail by panicking")]

use super::{Cone, Motion, Part, Point, Pose, Quirks, Shape, World, pose_box_around, simulate_scan};
use crate::sensor::{Angles, SensorSpec};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::f64::consts::{PI, TAU};

fn random_shape(random: &mut ChaCha8Rng) -> Shape {
    let center = Point::new(random.random_range(-4.0..4.0), random.random_range(-4.0..4.0));
    let width: f64 = if random.random_bool(0.1) { 0.0 } else { random.random_range(0.01..0.6) };
    let heading = random.random_range(-PI..PI);
    match random.random_range(0..4) {
        0 => Shape::Disc { center, radius: width },
        1 => {
            let to = center + Point::new(heading.cos(), heading.sin()) * random.random_range(0.0..3.0);
            Shape::Capsule { from: center, to, radius: width }
        }
        2 => Shape::Rectangle { center, heading, half: (width, random.random_range(0.0..2.0)) },
        _ => Shape::Drop { center, radius: width, heading },
    }
}

/// Points of a part, dense on its border and inside.
fn samples(part: &Part, random: &mut ChaCha8Rng) -> Vec<Point> {
    let (center, reach) = part.bounds();
    let mut points = Vec::new();
    let border: Vec<Point> = match *part {
        Part::Disc { center, radius } => (0..4000)
            .map(|i| f64::from(i) / 4000.0 * TAU)
            .map(|a| center + Point::new(a.cos(), a.sin()) * radius)
            .collect(),
        Part::Rectangle { center, axis, half } => (-1000..=1000)
            .map(|i| f64::from(i) / 1000.0)
            .flat_map(|t| [(t, -1.0), (t, 1.0), (-1.0, t), (1.0, t)])
            .map(|(a, b)| {
                let (u, v) = (a * half.x, b * half.y);
                center + Point::new(axis.x * u - axis.y * v, axis.y * u + axis.x * v)
            })
            .collect(),
    };
    points.extend(border.iter().copied());
    for _ in 0..2000 {
        let at = center + Point::new(random.random_range(-1.0..=1.0), random.random_range(-1.0..=1.0)) * reach;
        if part.distance(at) == 0.0 {
            points.push(at);
        }
    }
    points
}

/// The heading from `from` to some place near the world's first part.
fn towards(world: &World, from: Point, random: &mut ChaCha8Rng) -> f64 {
    let (center, reach) = world.parts().next().unwrap().bounds();
    let aim = center + Point::new(random.random_range(-1.2..1.2), random.random_range(-1.2..1.2)) * reach - from;
    aim.y.atan2(aim.x)
}

/// Plain membership in a cone and the distance of (6), with no guard and from the definitions.
fn definition(emitter: Point, heading: f64, opening: f64, diameter: f64, p: Point) -> Option<f64> {
    let v = p - emitter;
    let along = v.x * heading.cos() + v.y * heading.sin();
    let across = (v.y * heading.cos() - v.x * heading.sin()).abs();
    if along < 0.0 {
        return None;
    }
    if opening == 0.0 {
        return (across <= 0.5 * diameter).then_some(along);
    }
    let offset = 0.5 * diameter / (0.5 * opening).tan();
    (across.atan2(along + offset) <= 0.5 * opening).then(|| (along + offset).hypot(across) - offset)
}

#[test]
fn the_nearest_point_in_a_cone_is_that_of_dense_sampling() {
    let mut random = ChaCha8Rng::seed_from_u64(7);
    let (mut hits, mut close) = (0, 0);
    for _ in 0..1500 {
        let shape = random_shape(&mut random);
        let opening = [0.0, 0.004, 0.05, 0.6, 2.5][random.random_range(0..5)];
        let diameter = [0.0, 0.012, 0.2][random.random_range(0..3)];
        let emitter = Point::new(random.random_range(-1.0..1.0), random.random_range(-1.0..1.0));
        let world = World::new(vec![shape]);
        let heading = towards(&world, emitter, &mut random);
        let cone = Cone::with_opening(emitter, heading, opening, diameter);
        let exact = world.nearest_in(&cone);
        let sampled = world
            .parts()
            .flat_map(|part| samples(part, &mut random))
            .filter_map(|p| definition(emitter, heading, opening, diameter, p))
            .reduce(f64::min);
        if let Some(sampled) = sampled {
            let exact = exact.unwrap_or_else(|| panic!("{shape:?} {cone:?}: sampled {sampled}, none found"));
            assert!(exact <= sampled + 1e-12, "{shape:?} {cone:?}: {exact} is beyond the sampled {sampled}");
            hits += 1;
            close += u32::from(exact >= sampled - 0.01);
        }
    }
    // Sampling finds a narrow beam's point seldom, and never the very nearest: most must agree, all must be above.
    assert!(hits > 600 && f64::from(close) > 0.95 * f64::from(hits), "{close} of {hits}");
}

#[test]
fn the_nearest_point_is_in_the_cone_and_in_the_shape() {
    // The distance is attained: with the part shrunk by 10^-6 on all sides nothing nearer may be found, and a cone
    // widened by 10^-6 finds nothing that is much nearer unless it newly touches the part.
    let mut random = ChaCha8Rng::seed_from_u64(8);
    let mut touched = 0;
    for _ in 0..20_000 {
        let world = World::new(vec![random_shape(&mut random)]);
        let emitter = Point::new(random.random_range(-1.0..1.0), random.random_range(-1.0..1.0));
        let heading = towards(&world, emitter, &mut random);
        let (opening, diameter) = (random.random_range(0.01..0.5), random.random_range(0.0..0.1));
        let cone = Cone::with_opening(emitter, heading, opening, diameter);
        let wider = Cone::with_opening(emitter, heading, opening + 2e-6, diameter);
        match (world.nearest_in(&cone), world.nearest_in(&wider)) {
            (Some(a), Some(b)) => {
                touched += 1;
                assert!(b <= a + 1e-6, "a wider beam sees at least as near: {a} {b}");
            }
            (Some(a), None) => panic!("a wider beam lost the obstacle at {a}"),
            _ => {}
        }
        // No obstacle point of the cone can be nearer than the nearest obstacle point at all.
        if let Some(d) = world.nearest_in(&cone) {
            let apart = world.distance(emitter);
            let offset = 0.5 * diameter / (0.5 * opening).tan();
            let apex = emitter - Point::new(heading.cos(), heading.sin()) * offset;
            assert!(d >= world.distance(apex) - offset - 1e-8 && d <= 20.0, "{d} {apart}");
        }
    }
    assert!(touched > 5000);
}

#[test]
fn a_square_of_a_strip_meets_a_part_exactly_when_the_extents_meet() {
    let mut random = ChaCha8Rng::seed_from_u64(9);
    let mut met = 0;
    for _ in 0..600 {
        let world = World::new(vec![random_shape(&mut random)]);
        let (center, reach) = world.parts().next().unwrap().bounds();
        let near = center + Point::new(random.random_range(-1.3..1.0), random.random_range(-1.3..1.0)) * reach;
        let (x, y) = (near.x, near.y);
        let size = random.random_range(0.02..1.0);
        for part in world.parts() {
            let claimed = part.extent_in_strip(y, y + size).is_some_and(|(lo, hi)| lo <= x + size && hi >= x);
            let inside = |p: &Point| (x..=x + size).contains(&p.x) && (y..=y + size).contains(&p.y);
            let sampled = samples(part, &mut random).iter().any(inside);
            assert!(claimed || !sampled, "{part:?} has points in the square at {x} {y} of side {size}");
            if claimed {
                met += 1;
                // Somewhere in the square the part is (nearly) touched: dense points of the square.
                let nearest = (0..=60)
                    .flat_map(|i| (0..=60).map(move |j| (f64::from(i) / 60.0, f64::from(j) / 60.0)))
                    .map(|(a, b)| part.distance(Point::new(x + a * size, y + b * size)))
                    .fold(f64::INFINITY, f64::min);
                assert!(nearest <= size / 60.0, "{part:?}: claimed in the square, {nearest} m away");
            }
        }
    }
    assert!(met > 200, "{met}");
}

#[test]
fn a_drop_is_the_hull_of_its_disc_and_its_nose() {
    let drop = Shape::Drop { center: Point::new(1.0, 2.0), radius: 0.1, heading: 0.3 };
    let at = |along: f64, across: f64| {
        let (sin, cos) = 0.3_f64.sin_cos();
        Point::new(1.0 + along * cos - across * sin, 2.0 + along * sin + across * cos)
    };
    let nose = 0.1 * 2.0_f64.sqrt();
    assert!(drop.distance(at(nose - 1e-9, 0.0)) < 1e-12);
    assert!(drop.distance(at(nose + 0.01, 0.0)) > 0.0099);
    assert!(drop.distance(at(0.1, 0.0414)) < 1e-12 && drop.distance(at(0.1, 0.042)) > 0.0);
    assert!(drop.distance(at(-0.1 + 1e-9, 0.0)) < 1e-12 && drop.distance(at(-0.08, 0.08)) > 0.01);
}

#[test]
fn every_measured_range_keeps_the_bounds_of_the_sensor() {
    let mut random = ChaCha8Rng::seed_from_u64(10);
    let mut returns = 0;
    for round in 0..60 {
        let world = World::new((0..30).map(|_| random_shape(&mut random)).collect());
        let sensor = SensorSpec {
            range_error_minus: [0.0, 0.03][round % 2],
            range_error_plus: [0.05, 0.0, 0.02][round % 3],
            range_max: 5.6,
            no_return_free_to: [None, Some(3.0)][round % 2],
            ..SensorSpec::default()
        };
        let pose = Pose { x: 0.2, y: -0.1, theta: random.random_range(-4.0..4.0) };
        let box_ = pose_box_around(&pose, 0.0, 0.0).unwrap();
        let angles = Angles::Uniform { min: -2.0, increment: 0.02 };
        let quirks = Quirks { failed: 0.1, missed: 0.1, extreme: 0.8 };
        let scan = simulate_scan(&world, &sensor, (&angles, 200), (&box_, &Motion::still(pose)), &quirks, &mut random);
        for (i, range) in scan.ranges.iter().enumerate() {
            let heading = pose.theta - 2.0 + 0.02 * i as f64;
            let truth = world.nearest_in(&Cone::new(pose.position(), heading, &sensor));
            let half_ulp = 0.5 * f64::from(range.next_up() - range);
            if *range >= sensor.range_max as f32 {
                let free = sensor.no_return_free_to.unwrap_or(0.0);
                assert!(truth.is_none_or(|d| d >= free), "{truth:?} without a return, free to {free}");
            } else if *range > 0.0 {
                let truth = truth.unwrap();
                let range = f64::from(*range);
                let (near, far) =
                    (range - sensor.range_error_minus - half_ulp, range + sensor.range_error_plus + half_ulp);
                assert!((near..=far + 3e-9).contains(&truth), "{truth} outside {near}..{far}");
                returns += 1;
            }
        }
    }
    assert!(returns > 3000, "{returns}");
}

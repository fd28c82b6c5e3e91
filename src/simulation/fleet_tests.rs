//! The building can be driven through, and the robots' claims hold.
#![allow(clippy::unwrap_used, clippy::panic, reason = "a test may fail by panicking")]

use super::fleet::ROBOT_RADIUS;
use super::{Building, Cone, Fleet};
use crate::sensor::Angles;

#[test]
fn every_route_keeps_a_robot_clear_of_everything() {
    for seed in 0..40 {
        let building = Building::new(seed);
        assert!(building.rooms.len() >= 8);
        assert!(building.world.shapes().iter().all(|s| s.width() >= 0.02), "nothing is thinner than 2 cm");
        for room in &building.rooms {
            for leg in room.route.windows(2) {
                for i in 0..=50 {
                    let at = leg[0] + (leg[1] - leg[0]) * (f64::from(i) / 50.0);
                    let clear = building.world.distance(at);
                    assert!(clear > ROBOT_RADIUS + 0.01, "{} {seed}: {clear} m at {at:?}", room.name);
                }
            }
        }
    }
}

#[test]
fn the_fleet_tells_the_truth_and_goes_everywhere() {
    let mut fleet = Fleet::new(3, 3);
    let mut visited = vec![false; fleet.building().rooms.len()];
    let mut scans = 0;
    for _ in 0..1200 {
        for scan in fleet.step() {
            scans += 1;
            let building = fleet.building();
            let at = scan.truth.position();
            assert!(building.world.distance(at) > ROBOT_RADIUS, "{scan:?} touches something");
            let pose = &scan.scan.pose;
            let held = pose.x().contains(at.x) && pose.y().contains(at.y) && pose.theta().contains(scan.truth.theta);
            assert!(held, "{:?} outside {pose:?}", scan.truth);
            for (room, seen) in building.rooms.iter().zip(&mut visited) {
                *seen |= room.route[2..room.route.len() - 2].iter().any(|p| (p - at).norm() < 0.5);
            }
            if scan.sequence % 50 == 1 {
                let Angles::Uniform { min, increment } = scan.scan.angles else { panic!("uneven") };
                let sensor = Fleet::sensor();
                let (origin, heading) = scan.truth.sensor(&sensor);
                for (i, range) in scan.scan.ranges.iter().enumerate().filter(|(_, r)| r.is_finite() && **r > 0.0) {
                    let cone = Cone::new(origin, heading + min + i as f64 * increment, &sensor);
                    let truth = building.world.nearest_in(&cone).unwrap();
                    assert!((f64::from(*range) - truth).abs() <= 0.030_01, "{range} for {truth}");
                }
            }
        }
    }
    assert_eq!(scans, 3600);
    assert!(visited.iter().all(|seen| *seen), "{visited:?}");
}

#[test]
fn the_same_seed_gives_the_same_scans() {
    let (mut a, mut b) = (Fleet::new(5, 2), Fleet::new(5, 2));
    for _ in 0..20 {
        let bits = |scans: Vec<super::SimulatedScan>| -> Vec<Vec<u32>> {
            scans.iter().map(|s| s.scan.ranges.iter().map(|r| r.to_bits()).collect()).collect()
        };
        assert_eq!(bits(a.step()), bits(b.step()));
    }
}

#[test]
fn at_glass_beams_fail_and_all_other_readings_stay() {
    let (mut plain, mut glazed) = (Fleet::new(5, 4), Fleet::new(5, 4).with_glass());
    let panes = Building::panes();
    assert_eq!(panes.len(), plain.building().rooms.len());
    let (mut failed, mut stayed) = (0, 0);
    for _ in 0..400 {
        for (a, b) in plain.step().iter().zip(&glazed.step()) {
            assert_eq!((a.truth, &a.scan.pose), (b.truth, &b.scan.pose));
            let (origin, heading) = a.truth.sensor(&Fleet::sensor());
            let Angles::Uniform { min, increment } = a.scan.angles else { panic!("uneven") };
            for (i, (range, glass)) in a.scan.ranges.iter().zip(&b.scan.ranges).enumerate() {
                let direction = heading + min + i as f64 * increment;
                let y = origin.y + f64::from(*range) * direction.sin();
                let at_outer_wall = y.abs() < 0.2 || (y - 15.0).abs() < 0.2;
                match glass.to_bits() == range.to_bits() {
                    true => stayed += usize::from(at_outer_wall),
                    // Only ever no reading, and only at the outer walls: never another distance.
                    false => {
                        assert!(glass.is_nan() && at_outer_wall, "{range} became {glass} at y {y}");
                        failed += 1;
                    }
                }
            }
        }
    }
    assert!(failed > 2000 && stayed > 2000, "{failed} {stayed}");
}

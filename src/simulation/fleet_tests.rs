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

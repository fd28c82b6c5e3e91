//! X_OCC of beams without width or opening that point nearly along an axis: the two edges of their sets are one line, which
//! rounding may put in either order.
#![allow(clippy::unwrap_used, clippy::panic, reason = "a test that cannot be set up has failed")]

use crate::regions_exact::Dice;
use crate::rules_support::{Leaves, survey, survey_wide};
use std::f64::consts::FRAC_PI_2;
use ubbmap::mapping::EvidenceRule;
use ubbmap::quadtree::{Grid, NodeAddress};
use ubbmap::sensor::{Angles, PoseBox, PoseLimits, Reading, Scan, ScanLimits, ScanSpec, SensorModel, SensorSpec};

fn pencil(error: f64) -> SensorModel {
    let spec = SensorSpec { range_error_minus: error, range_error_plus: error, ..SensorSpec::default() };
    SensorModel::new(SensorSpec { beam_opening: 0.0, beam_diameter: 0.0, ..spec }).unwrap()
}

fn scan(sensor: SensorModel, place: (f64, f64), heading: f64, angles: Vec<f64>, ranges: Vec<f32>) -> Scan {
    let at = |v: f64| (v, v);
    let pose = PoseBox::new(at(place.0), at(place.1), at(heading), &PoseLimits::default()).unwrap();
    let spec = ScanSpec {
        pose,
        angles: Angles::Listed(angles),
        ranges,
        footprint_radius: 0.0,
        sweep_rotation: 0.0,
        sweep_translation: 0.0,
    };
    Scan::new(spec, sensor, &ScanLimits::default()).unwrap()
}

/// The sets of the dense window, the same on every path, and those of windows drawn row by row.
fn both(grid: Grid, scan: &Scan) -> [(&'static str, Leaves); 2] {
    let rule = EvidenceRule::Guaranteed;
    [("dense", survey(grid, rule, 0.02, scan)), ("row by row", survey_wide(grid, rule, 0.02, scan))]
}

#[test]
fn a_beam_nearly_along_y_lost_rows_of_its_measurement() {
    let grid = Grid::new(0.1, 12, None).unwrap();
    let scan = scan(pencil(0.1), (0.75, 1.25), 2.679e-8 - FRAC_PI_2, vec![0.0], vec![20.07]);
    for (way, leaves) in both(grid, &scan) {
        // From 1.25 - 20.17 to 1.25 - 19.97 at x = 0.75.
        for y in 1858..=1860 {
            assert!(leaves.occupied(NodeAddress { depth: 12, x: 2055, y }), "{way}: row {y}");
        }
    }
}

#[test]
fn x_occ_holds_every_point_of_beams_that_point_nearly_along_an_axis() {
    let mut dice = Dice(17);
    let mut points = 0;
    for round in 0..400 {
        let resolution = dice.pick(&[0.1, 0.1, 0.05, 0.25]);
        let grid = Grid::new(resolution, 12, dice.pick(&[None, Some((-2040.3 * resolution, -2050.7 * resolution))]));
        let grid = grid.unwrap();
        let place = (dice.real(-5.0, 5.0), dice.real(-5.0, 5.0));
        let heading = dice.pick(&[0.0, 0.0, 0.0, FRAC_PI_2, 0.7]);
        // 37 beams: not a whole number of lanes.
        let angles: Vec<f64> = (0..37)
            .map(|_| {
                // In single precision the edges cross where they are 1e-4 rad off the axis, in double precision 1e-13.
                let decade = dice.pick(&[(-9.0, -3.0), (-14.5, -11.5)]);
                let off = 10_f64.powf(dice.real(decade.0, decade.1)) * dice.pick(&[-1.0, 1.0]);
                f64::from(dice.whole(-1, 2) as i32) * FRAC_PI_2 - heading + dice.pick(&[off, off, off, 0.0])
            })
            .collect();
        let far = 900.0 * resolution;
        let ranges = angles.iter().map(|_| dice.real(0.5, far.min(80.0)) as f32).collect();
        let scan = scan(pencil(dice.pick(&[0.0, 0.035, 0.1, 0.3])), place, heading, angles, ranges);
        let ways = both(grid, &scan);
        for beam in 0..scan.beams() {
            let Reading::Return { near, far } = scan.reading(beam) else { panic!("beam {beam} returned") };
            let axis = heading + scan.angle(beam);
            for i in 0..=16 {
                let d = near + (far - near) * f64::from(i) / 16.0;
                let point = (place.0 + d * axis.cos(), place.1 + d * axis.sin());
                let leaf = grid.leaf_at(point.0, point.1).unwrap();
                points += 1;
                for (way, leaves) in &ways {
                    assert!(leaves.occupied(leaf), "{way}, round {round}: {point:?} at {d} of beam {beam}, {scan:?}");
                }
            }
        }
    }
    assert!(points > 200_000);
}

//! X_OCC of beams that are wider than the obstacle is far: parts of their sets lie behind the sensor, and turn with it.
#![allow(clippy::unwrap_used, clippy::panic, reason = "a test that cannot be set up has failed")]

use crate::regions_exact::Dice;
use crate::rules_support::{Case, survey, survey_wide};
use std::f64::consts::PI;
use ubbmap::mapping::EvidenceRule;
use ubbmap::quadtree::Grid;
use ubbmap::sensor::{Angles, PoseBox, PoseLimits, Scan, ScanLimits, ScanSpec, SensorModel, SensorSpec};

/// Any heading: up to a full turn may be configured.
const LIMITS: PoseLimits = PoseLimits { max_position_width: 2.0, max_heading_width: 2.0 * PI };

fn scan(sensor: SensorSpec, theta: (f64, f64), angles: Vec<f64>, ranges: Vec<f32>) -> Scan {
    let pose = PoseBox::new((0.0, 0.0), (0.0, 0.0), theta, &LIMITS).unwrap();
    let spec = ScanSpec {
        pose,
        angles: Angles::Listed(angles),
        ranges,
        footprint_radius: 0.0,
        sweep_rotation: 0.0,
        sweep_translation: 0.0,
    };
    Scan::new(spec, SensorModel::new(sensor).unwrap(), &ScanLimits::default()).unwrap()
}

fn sensor(beam_opening: f64, beam_diameter: f64, error: f64) -> SensorSpec {
    SensorSpec {
        range_error_minus: error,
        range_error_plus: error,
        beam_opening,
        beam_diameter,
        range_max: 0.2,
        ..SensorSpec::default()
    }
}

/// Draws points of every measurement set and asks for their leaves, of the dense window on every path and row by row.
fn check(grid: Grid, scan: &Scan, draws: usize, name: String, dice: &mut Dice) -> usize {
    let case = Case::new(grid, scan, 0.02, name);
    let dense = survey(grid, EvidenceRule::Guaranteed, 0.02, scan);
    let wide = survey_wide(grid, EvidenceRule::Guaranteed, 0.02, scan);
    case.check_drawn(&dense, draws, dice) + case.check_drawn(&wide, draws, dice)
}

#[test]
fn a_wide_cone_at_millimetres_lost_what_turns_behind_the_sensor() {
    let grid = Grid::new(1e-4, 12, None).unwrap();
    let scan = scan(sensor(2.16, 0.05, 0.0), (2.71 - 0.38, 2.71 + 0.38), vec![0.0], vec![0.002_54]);
    check(grid, &scan, 4_000, "opening 2.16".to_owned(), &mut Dice(5));
}

#[test]
fn a_narrow_beam_wider_than_its_range_lost_the_corner_that_passes_an_axis() {
    let grid = Grid::new(1e-4, 12, None).unwrap();
    let scan = scan(sensor(0.01, 0.05, 0.0), (1.4 - 0.35, 1.4 + 0.35), vec![0.0], vec![0.001]);
    check(grid, &scan, 4_000, "opening 0.01".to_owned(), &mut Dice(6));
}

#[test]
fn a_heading_of_more_than_half_a_turn_lost_the_far_side_of_the_measurement() {
    let grid = Grid::new(1e-3, 10, None).unwrap();
    let scan = scan(sensor(0.0, 0.001, 0.05), (0.4, 0.4 + 2.0 * PI), vec![0.0], vec![0.1]);
    check(grid, &scan, 4_000, "a full turn".to_owned(), &mut Dice(7));
}

#[test]
fn x_occ_holds_every_point_of_beams_wider_than_they_are_long() {
    let mut dice = Dice(23);
    let mut points = 0;
    for round in 0..300 {
        let opening = match dice.whole(0, 3) {
            0 => dice.pick(&[0.0, 1e-9, 0.004, 0.05]),
            1 => dice.real(0.0, 0.05),
            _ => dice.real(0.05, 3.1),
        };
        let error = dice.pick(&[0.0, 0.0005, 0.005]);
        let mut spec = sensor(opening, dice.pick(&[0.0, 0.003, 0.012, 0.05, 0.08]), error);
        spec.beam_angle_error = dice.pick(&[0.0, 0.0, 0.01, 0.5]);
        let half = dice.pick(&[0.0, 0.01, 0.2, 0.5, 1.0, 1.5, 2.5, 3.14]);
        let theta = dice.real(-4.0, 4.0);
        let angles: Vec<f64> = (0..19).map(|_| dice.real(-3.0, 3.0)).collect();
        let ranges = angles.iter().map(|_| 10_f64.powf(dice.real(-4.0, -1.5)) as f32).collect();
        let scan = scan(spec, (theta - half, theta + half), angles, ranges);
        let resolution = dice.pick(&[1e-4, 5e-4, 0.002]);
        let grid = Grid::new(resolution, 12, Some((-0.2, -0.2))).unwrap();
        points += check(grid, &scan, 40, format!("round {round}: {spec:?}, heading {theta} +- {half}"), &mut dice);
    }
    assert!(points > 300_000, "{points} points");
}

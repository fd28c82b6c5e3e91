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

/// At next to no range the near corners lie farther behind the sensor than the far ones before it, and alone reach the farthest point
/// of the set where they pass an axis by less than half a degree: by a part of a leaf, of a set of thousands. An edge of leaves
/// lies where that shows.
#[test]
fn x_occ_holds_the_near_corners_of_a_beam_as_they_pass_an_axis() {
    let mut dice = Dice(29);
    for round in 0..16 {
        let (opening, diameter, range, resolution) = (0.049_f64, 0.5, dice.real(2e-6, 2e-5), 1e-4);
        // From 0 to twice the range.
        let spec = sensor(opening, diameter, range);
        let radius = 0.5 * diameter * (0.5 * opening).cos();
        let (low, narrow) = (-radius * (0.25 * opening).tan(), radius);
        let (half, past) = (dice.real(0.1, 1.4), dice.real(0.004, 0.008));
        let quarter = f64::from(round % 4);
        let theta = quarter * 0.5 * PI - narrow.atan2(low) - half + past;
        let scan = scan(spec, (theta - half, theta + half), vec![0.0], vec![range as f32]);
        let farthest = low.hypot(narrow) - 0.005 * resolution;
        let on_edge = |sign: f64| sign * farthest - ((sign * farthest + 0.8) / resolution).round() * resolution;
        let origin =
            (on_edge(if round % 4 == 2 { -1.0 } else { 1.0 }), on_edge(if round % 4 == 3 { -1.0 } else { 1.0 }));
        let grid = Grid::new(resolution, 14, Some(origin)).unwrap();
        let leaves = survey_wide(grid, EvidenceRule::Guaranteed, 0.02, &scan);
        for i in 0..=200 {
            let turn = theta + half - 2.0 * past * f64::from(i) / 200.0;
            let point = (low * turn.cos() - narrow * turn.sin(), low * turn.sin() + narrow * turn.cos());
            let leaf = grid.leaf_at(point.0, point.1).unwrap();
            assert!(leaves.occupied(leaf), "round {round}: {point:?} at {turn} of {spec:?}, heading {theta} +- {half}");
        }
    }
}

#[test]
fn x_occ_holds_every_point_of_beams_wider_than_they_are_long() {
    let mut dice = Dice(23);
    let mut points = 0;
    for round in 0..800 {
        let opening = match dice.whole(0, 3) {
            0 => dice.pick(&[0.0, 1e-9, 0.004, 0.05]),
            1 => dice.real(0.0, 0.05),
            _ => dice.real(0.05, 3.1),
        };
        let error = dice.pick(&[0.0, 0.0005, 0.005]);
        let mut spec = sensor(opening, dice.pick(&[0.0, 0.003, 0.012, 0.05, 0.08]), error);
        spec.beam_angle_error = dice.pick(&[0.0, 0.0, 0.01, 0.5]);
        let half = dice.pick(&[0.0, 0.01, 0.2, 0.5, 1.0, 1.5, 2.5, 3.1]);
        let theta = dice.real(-4.0, 4.0);
        // Beams of many directions cover one another's sets.
        let beams = dice.pick(&[1, 1, 2, 19]);
        let angles: Vec<f64> = (0..beams).map(|_| dice.real(-3.0, 3.0)).collect();
        let ranges = angles.iter().map(|_| 10_f64.powf(dice.real(-4.0, -1.5)) as f32).collect();
        let scan = scan(spec, (theta - half, theta + half), angles, ranges);
        // Sets of hundreds of leaves, and of so few that they are drawn as small masks.
        let resolution = dice.pick(&[1e-4, 5e-4, 0.002, 0.005, 0.01, 0.02]);
        let origin = -300.0 * resolution - dice.real(0.0, resolution);
        let grid = Grid::new(resolution, 12, Some((1.7 * origin, origin))).unwrap();
        let draws = 800 / beams;
        points += check(grid, &scan, draws, format!("round {round}: {spec:?}, heading {theta} +- {half}"), &mut dice);
    }
    assert!(points > 600_000, "{points} points");
}

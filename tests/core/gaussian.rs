//! The Gaussian grid against its model asked of every cell in polar coordinates.
#![allow(clippy::unwrap_used, reason = "a test that cannot be set up has failed")]

use crate::regions_exact::Dice;
use std::f64::consts::{PI, TAU};
use ubbmap::mapping::{CellPoint, GaussianGrid, GaussianModel};
use ubbmap::quadtree::{Grid, LeafRange, NodeAddress};
use ubbmap::sensor::{Angles, Mount, PoseBox, PoseLimits, Scan, ScanLimits, ScanSpec, SensorModel, SensorSpec};

const DEPTH: u8 = 7;

fn grid(resolution: f64) -> Grid {
    Grid::new(resolution, u32::from(DEPTH), None).unwrap()
}

fn whole(grid: &Grid) -> LeafRange {
    LeafRange { min_x: 0, min_y: 0, max_x: grid.side(), max_y: grid.side() }
}

/// A scan of one pose with listed angles.
fn scan(pose: (f64, f64, f64), spec: SensorSpec, angles: Vec<f64>, ranges: Vec<f32>) -> Scan {
    let point = |v: f64| (v, v);
    let spec_of_scan = ScanSpec {
        pose: PoseBox::new(point(pose.0), point(pose.1), point(pose.2), &PoseLimits::default()).unwrap(),
        angles: Angles::Listed(angles),
        ranges,
        footprint_radius: 0.0,
        sweep_rotation: 0.0,
        sweep_translation: 0.0,
    };
    Scan::new(spec_of_scan, SensorModel::new(spec).unwrap(), &ScanLimits::default()).unwrap()
}

/// What a beam says of a cell, from the model's definition: corners for the nearest point, the angle by `atan2`.
/// `None` beyond three standard deviations; the flag tells that the answer hangs on rounding.
fn said(model: &GaussianModel, square: [(f64, f64); 4], axis: f64, range: f64, reach: f64) -> (Option<f64>, bool) {
    let (sin, cos) = axis.sin_cos();
    let seen = square.map(|(x, y)| (x * cos + y * sin, y * cos - x * sin));
    let middle = |pick: fn(&(f64, f64)) -> f64| seen.iter().map(pick).sum::<f64>() / 4.0;
    let span = |pick: fn(&(f64, f64)) -> f64| {
        let values = seen.iter().map(pick);
        (values.clone().fold(f64::INFINITY, f64::min), values.fold(f64::NEG_INFINITY, f64::max))
    };
    let (u, v) = match model.cell_point {
        CellPoint::Center => (middle(|p| p.0), middle(|p| p.1).abs()),
        CellPoint::Nearest => {
            let (near, far) = span(|p| p.0);
            let (right, left) = span(|p| p.1);
            let aside = if right <= 0.0 && left >= 0.0 { 0.0 } else { right.abs().min(left.abs()) };
            (range.min(reach).max(near).min(far), aside)
        }
    };
    let (rho, alpha) = ((u * u + v * v).sqrt(), v.atan2(u).abs());
    let limit = 3.0 * model.sigma_angle;
    let close = (rho - reach).abs() < 1e-9 || (alpha - limit).abs() < 1e-9;
    if u < 0.0 || rho > reach || alpha > limit {
        return (None, close);
    }
    let peak = (-(rho - range).powi(2) / (2.0 * model.sigma_range.powi(2))).exp();
    let weight = (-alpha.powi(2) / (2.0 * model.sigma_angle.powi(2))).exp();
    let before = if rho < range { (0.5 - model.p_free) * (1.0 - peak) } else { 0.0 };
    let p = 0.5 + weight * ((model.p_occupied - 0.5) * peak - before);
    (Some((p / (1.0 - p)).ln()), close)
}

#[test]
fn every_cell_has_what_the_model_says_of_it() {
    let mut dice = Dice(0x6a55);
    let (mut touched, mut left_out) = (0, 0);
    for round in 0..60 {
        let grid = grid(dice.pick(&[0.1, 0.05, 0.2]));
        let model = GaussianModel {
            sigma_range: dice.pick(&[0.01, 0.035, 0.1]),
            sigma_angle: dice.pick(&[0.125_f64, 0.5, 3.0]).to_radians(),
            cell_point: dice.pick(&[CellPoint::Center, CellPoint::Nearest]),
            log_odds_range: (f32::MIN, f32::MAX),
            ..GaussianModel::default()
        };
        let mount = Mount { x: dice.real(-0.3, 0.3), y: dice.real(-0.3, 0.3), theta: dice.real(-PI, PI) };
        let free_to = dice.pick(&[None, Some(2.0)]);
        let sensor = SensorSpec { range_max: 4.0, mount, no_return_free_to: free_to, ..SensorSpec::default() };
        let pose = (dice.real(-1.0, 1.0), dice.real(-1.0, 1.0), dice.real(-PI, PI));
        let angles: Vec<f64> = (0..6).map(|i| f64::from(i) - 3.0).collect();
        let ranges: Vec<f32> = (0..6).map(|_| dice.pick(&[0.02, 0.7, 1.9, 3.3, f32::NAN, f32::INFINITY])).collect();
        let mut built = GaussianGrid::new(grid, whole(&grid), model);
        built.insert(&scan(pose, sensor, angles.clone(), ranges.clone()));

        let (sin, cos) = pose.2.sin_cos();
        let origin = (pose.0 + mount.x * cos - mount.y * sin, pose.1 + mount.x * sin + mount.y * cos);
        for y in 0..grid.side() {
            for x in 0..grid.side() {
                let leaf = NodeAddress { depth: DEPTH, x, y };
                let square = grid.node_box(leaf);
                let corner = |x: f64, y: f64| (x - origin.0, y - origin.1);
                let (sx, sy) = (square.x, square.y);
                let corners = [(sx.lo(), sy.lo()), (sx.hi(), sy.lo()), (sx.hi(), sy.hi()), (sx.lo(), sy.hi())]
                    .map(|(x, y)| corner(x, y));
                let (mut expected, mut close) = (0.0, false);
                for (angle, range) in angles.iter().zip(&ranges) {
                    let (range, reach) = match (range.is_nan(), range.is_infinite(), free_to) {
                        (false, false, _) => (f64::from(*range), f64::from(*range) + 3.0 * model.sigma_range),
                        (false, true, Some(free_to)) => (f64::INFINITY, free_to),
                        _ => continue,
                    };
                    let axis = (pose.2 + mount.theta + angle).rem_euclid(TAU);
                    let (value, unsure) = said(&model, corners, axis, range, reach);
                    expected += value.unwrap_or(0.0);
                    close |= unsure;
                }
                let found = f64::from(built.log_odds(leaf));
                touched += usize::from(found != 0.0);
                left_out += usize::from(close);
                assert!(
                    close || (found - expected).abs() < 1e-4,
                    "round {round}, {leaf:?}: {found} against {expected}"
                );
            }
        }
    }
    assert!(touched > 10_000 && left_out * 20 < touched, "{touched} cells touched, {left_out} undecided");
}

#[test]
fn evidence_is_held_to_its_range_and_to_the_window() {
    let grid = grid(0.1);
    let window = LeafRange { min_x: 60, min_y: 60, max_x: 80, max_y: 70 };
    let model = GaussianModel::default();
    let mut built = GaussianGrid::new(grid, window, model);
    let ahead = scan((0.0, 0.05, 0.0), SensorSpec::default(), vec![0.0], vec![1.05]);
    for _ in 0..50 {
        built.insert(&ahead);
    }
    let at = |x: f64, y: f64| built.log_odds(grid.leaf_at(x, y).unwrap());
    assert_eq!((at(1.05, 0.05), at(0.55, 0.05)), (model.log_odds_range.1, model.log_odds_range.0));
    assert_eq!((at(1.35, 0.05), at(0.55, 0.35), at(-0.35, 0.05)), (0.0, 0.0, 0.0), "behind, beside, backwards");
    assert_eq!(built.cells().len(), 200);
    // A beam that leaves the window says nothing of what is not there.
    built.insert(&scan((0.0, 0.05, 0.0), SensorSpec::default(), vec![0.0], vec![5.0]));
    assert_eq!(built.log_odds(grid.leaf_at(5.0, 0.05).unwrap()), 0.0);
}

#[test]
fn a_cell_evaluated_at_its_centre_can_miss_the_wall_that_it_holds() {
    let grid = grid(0.1);
    // The wall is at the near edge of its cell: 0.045 m before the centre.
    let ahead = scan((0.0, 0.05, 0.0), SensorSpec::default(), vec![0.0], vec![1.005]);
    let wall = |cell_point| {
        let mut built = GaussianGrid::new(grid, whole(&grid), GaussianModel { cell_point, ..GaussianModel::default() });
        built.insert(&ahead);
        built.log_odds(grid.leaf_at(1.005, 0.05).unwrap())
    };
    let whole_peak = (0.7_f32 / 0.3).ln();
    assert!((wall(CellPoint::Nearest) - whole_peak).abs() < 1e-5);
    assert!(wall(CellPoint::Center) < 0.5 * whole_peak);
}

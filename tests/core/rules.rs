//! The evidence rules against the slow reference, on random scans of every kind.
#![allow(
    clippy::unwrap_used,
    clippy::panic,
    clippy::print_stdout,
    reason = "a test that cannot be set up has failed; counts are for the reader"
)]

use crate::regions_exact::Dice;
use crate::rules_support::{Case, Tally, config, survey, survey_wide};
use std::f64::consts::{PI, TAU};
use ubbmap::mapping::reference::pointwise_rho;
use ubbmap::mapping::{EvidenceRule, Surveyor};
use ubbmap::quadtree::Grid;
use ubbmap::sensor::{Angles, Mount, PoseBox, PoseLimits, Scan, ScanLimits, ScanSpec, SensorModel, SensorSpec};

/// A kind of scans.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Family {
    /// A sensor in the middle of the robot, a small pose box.
    Plain,
    /// Mounts, wide pose boxes, angle errors.
    Uncertain,
    /// No opening, no diameter, no obstacle width: every limit.
    Degenerate,
    /// Many failed beams and no returns, with and without `no_return_free_to`.
    Gaps,
    /// The sensor moves during the sweep.
    Sweep,
    /// Beams as wide as leaves.
    Wide,
    /// At and beyond the root's edge, far from the map's origin.
    Edge,
}

const FAMILIES: [Family; 7] =
    [Family::Plain, Family::Uncertain, Family::Degenerate, Family::Gaps, Family::Sweep, Family::Wide, Family::Edge];

fn sensor(family: Family, dice: &mut Dice) -> SensorModel {
    let error = dice.pick(&[0.0, 0.01, 0.035]);
    let range_max = dice.pick(&[6.0, 10.0, 5.6]);
    let mut spec = SensorSpec {
        range_error_minus: error,
        range_error_plus: dice.pick(&[0.0, 0.01, 0.035]),
        beam_opening: dice.pick(&[0.004_363, 0.01, 0.03]),
        beam_diameter: dice.pick(&[0.006, 0.012, 0.03]),
        range_min: dice.pick(&[0.0, 0.0, 0.2]),
        range_max,
        ..SensorSpec::default()
    };
    let mounted = Mount { x: dice.real(-0.5, 0.5), y: dice.real(-0.5, 0.5), theta: dice.real(-4.0, 4.0) };
    match family {
        Family::Plain => {}
        Family::Uncertain => {
            spec.mount = mounted;
            spec.beam_angle_error = dice.pick(&[0.0, 0.0, 0.002, 0.02]);
        }
        Family::Degenerate => {
            spec.beam_opening = dice.pick(&[0.0, 0.0, 1e-9, 0.01]);
            spec.beam_diameter = dice.pick(&[0.0, 0.02]);
            spec.mount = Mount { x: dice.pick(&[0.0, 0.3]), ..Mount::default() };
        }
        Family::Gaps => spec.no_return_free_to = dice.pick(&[None, Some(3.0), Some(range_max - error)]),
        Family::Sweep => {
            spec.mount = Mount { theta: mounted.theta, ..Mount::default() };
            spec.beam_diameter = 0.03;
        }
        Family::Wide => {
            spec.beam_opening = dice.pick(&[0.05, 0.2, 1.0]);
            spec.beam_diameter = dice.pick(&[0.05, 0.3, 0.6]);
        }
        Family::Edge => spec.mount = mounted,
    }
    SensorModel::new(spec).unwrap()
}

/// Angles of a field of view of 1 to 360 degrees; even, uneven, backwards, in any order, with a closing duplicate.
fn angles(dice: &mut Dice) -> (Angles, usize) {
    let beams = dice.pick(&[12_usize, 40, 90, 180, 181, 361]);
    let view = dice.pick(&[1.0_f64, 40.0, 180.0, 270.0, 360.0, 360.0]).to_radians();
    let closing = view > 6.2 && dice.chance(0.5);
    let gaps = if view > 6.2 && !closing { beams } else { beams - 1 };
    let step = view / gaps as f64;
    let start = dice.pick(&[-0.5 * view, 0.0, dice.clone().real(-4.0, 4.0)]);
    let backwards = dice.chance(0.3);
    if dice.chance(0.6) {
        let (min, increment) = if backwards { (start + step * (beams - 1) as f64, -step) } else { (start, step) };
        return (Angles::Uniform { min, increment }, beams);
    }
    let mut list: Vec<f64> = (0..beams)
        .map(|i| {
            let jitter = if i == 0 || i == beams - 1 { 0.0 } else { dice.real(-0.45, 0.45) };
            start + step * (i as f64 + jitter)
        })
        .collect();
    if backwards {
        list.reverse();
    }
    if dice.chance(0.2) {
        for i in (1..beams).rev() {
            list.swap(i, dice.next() as usize % (i + 1));
        }
    }
    (Angles::Listed(list), beams)
}

/// Ranges of a room with posts and openings, with failures of every kind.
fn ranges(family: Family, beams: usize, range_max: f64, dice: &mut Dice) -> Vec<f32> {
    let (failed, no_return) = match family {
        Family::Gaps => (dice.pick(&[0.05, 0.3]), dice.pick(&[0.0, 0.3])),
        _ => (0.02, 0.0),
    };
    let base = dice.real(0.5, 4.0);
    let phase = dice.real(0.0, TAU);
    let mut ranges = Vec::with_capacity(beams);
    let (mut post, mut open) = (0, 0);
    for i in 0..beams {
        if dice.chance(0.02) {
            post = 1 + dice.next() % 8;
        }
        if dice.chance(no_return * 0.2) {
            open = 1 + dice.next() % 12;
        }
        let wall = base * (1.5 + (i as f64 * TAU / beams as f64 + phase).sin()).min(2.0) + dice.real(0.0, 0.02);
        let range = if open > 0 {
            open -= 1;
            dice.pick(&[range_max, f64::INFINITY, range_max + 2.0])
        } else if dice.chance(failed) {
            dice.pick(&[f64::NAN, 0.0, -1.0, f64::NEG_INFINITY])
        } else if post > 0 {
            post -= 1;
            0.4 * wall
        } else {
            wall
        };
        ranges.push(range as f32);
    }
    ranges
}

fn scan(family: Family, dice: &mut Dice, center: (f64, f64)) -> Scan {
    let sensor = sensor(family, dice);
    let (angles, beams) = angles(dice);
    let ranges = ranges(family, beams, sensor.spec().range_max, dice);
    let (position, heading): (f64, f64) = match family {
        Family::Uncertain => (dice.pick(&[0.0, 0.05, 0.3]), dice.pick(&[0.0, 1.0, 5.0, 25.0])),
        Family::Degenerate => (dice.pick(&[0.0, 0.1]), dice.pick(&[0.0, 2.0])),
        _ => (dice.pick(&[0.0, 0.02, 0.05]), dice.pick(&[0.0, 0.5, 1.0])),
    };
    let heading = heading.to_radians();
    let theta = dice.real(-8.0, 8.0);
    let at = |dice: &mut Dice, v: f64| {
        let low = v - position * dice.real(0.0, 1.0);
        (low, low + position)
    };
    let (x, y) = (at(dice, center.0), at(dice, center.1));
    let pose = PoseBox::new(x, y, (theta, theta + heading), &PoseLimits::default()).unwrap();
    let sweeps = family == Family::Sweep;
    let spec = ScanSpec {
        pose,
        angles,
        ranges,
        footprint_radius: dice.pick(&[0.0, 0.0, 0.3]),
        sweep_rotation: if sweeps { dice.pick(&[0.0, 0.01, 0.05]) } else { 0.0 },
        sweep_translation: if sweeps { dice.pick(&[0.0, 0.005, 0.03]) } else { 0.0 },
    };
    Scan::new(spec, sensor, &ScanLimits::default()).unwrap()
}

/// A random case: where, what grid, what scan.
fn random(family: Family, seed: u64) -> (Grid, Scan, f64, Dice) {
    let mut dice = Dice(seed.wrapping_mul(0x2545_f491_4f6c_dd1d) ^ family as u64);
    let resolution = dice.pick(&[0.05, 0.1, 0.1, 0.13, 0.25]);
    let (grid, center) = if family == Family::Edge {
        let depth = dice.pick(&[1, 3, 5, 6, 7]);
        let origin = dice.pick(&[(0.0, 0.0), (-3.05, 2.01), (123_456.7, -98_765.4)]);
        let side = resolution * f64::from(1 << depth);
        let off = |dice: &mut Dice, v: f64| v + dice.pick(&[0.0, 0.5, 1.0, -0.2, 1.1, 0.9]) * side;
        let center = (off(&mut dice, origin.0), off(&mut dice, origin.1));
        (Grid::new(resolution, depth, Some(origin)).unwrap(), center)
    } else {
        let center = (dice.real(-3.0, 3.0), dice.real(-3.0, 3.0));
        (Grid::new(resolution, 10, dice.pick(&[None, Some((-25.43, -22.22))])).unwrap(), center)
    };
    let scan = scan(family, &mut dice, center);
    let width = dice.pick(&[0.0, 0.02, 0.05, 0.2]);
    (grid, scan, width, dice)
}

/// Rounds a family: more in a long run.
fn rounds() -> u64 {
    std::env::var("UBBMAP_RULE_ROUNDS").ok().and_then(|v| v.parse().ok()).unwrap_or(12)
}

fn over_all(check: impl Fn(Family, &Case<'_>, &mut Dice) -> Tally) -> Vec<(Family, Tally)> {
    let mut tallies = Vec::new();
    for family in FAMILIES {
        let mut sum = Tally::default();
        for seed in 0..rounds() {
            let (grid, scan, width, mut dice) = random(family, seed);
            let case = Case::new(grid, &scan, width, format!("{family:?} {seed}"));
            sum.add(check(family, &case, &mut dice));
        }
        println!("{family:?}: {sum:?}");
        tallies.push((family, sum));
    }
    tallies
}

#[test]
fn x_occ_holds_the_truth_and_stays_within_the_measurement_boxes() {
    let tallies = over_all(|_, case, dice| {
        let leaves = survey(case.grid, EvidenceRule::Guaranteed, case.width, case.scan);
        case.check_occupied(&leaves, 40, dice)
    });
    assert!(tallies.iter().all(|(_, t)| t.points > 1_000 && t.occupied > 50), "{tallies:?}");
}

#[test]
fn outer_holds_the_truth_and_stays_within_the_papers_test() {
    let tallies = over_all(|_, case, dice| {
        let leaves = survey(case.grid, EvidenceRule::Outer, case.width, case.scan);
        case.check_outer(&leaves, 40, dice)
    });
    assert!(tallies.iter().all(|(_, t)| t.points > 1_000 && t.empty > 500), "{tallies:?}");
}

#[test]
fn inner_stays_within_the_papers_test_and_holds_what_single_beams_cover() {
    let tallies = over_all(|_, case, _| {
        let leaves = survey(case.grid, EvidenceRule::Inner, case.width, case.scan);
        case.check_inner(&leaves)
    });
    for (family, tally) in &tallies {
        assert!(tally.found as f64 >= 0.99 * tally.expected as f64, "{family:?}: {tally:?}");
    }
    let wide = tallies.iter().find(|(family, _)| *family == Family::Wide).unwrap();
    assert!(wide.1.expected > 1_000, "{tallies:?}");
}

#[test]
fn guaranteed_proves_what_the_rule_for_whole_boxes_proves_and_nothing_that_is_not_free_by_points() {
    let tallies = over_all(|_, case, dice| {
        let leaves = survey(case.grid, EvidenceRule::Guaranteed, case.width, case.scan);
        case.check_guaranteed(&leaves, 24, true, dice)
    });
    for (family, tally) in &tallies {
        assert!(tally.found as f64 >= 0.99 * tally.expected as f64, "{family:?}: {tally:?}");
    }
    let plain: usize = tallies.iter().map(|(_, t)| t.expected).sum();
    assert!(plain > 20_000, "{tallies:?}");
}

#[test]
fn scans_too_wide_for_a_dense_window_keep_to_the_rules_too() {
    let tallies = over_all(|_, case, dice| {
        let leaves = survey_wide(case.grid, EvidenceRule::Guaranteed, case.width, case.scan);
        let mut tally = case.check_occupied(&leaves, 10, dice);
        tally.add(case.check_guaranteed(&leaves, 8, true, dice));
        tally
    });
    for (family, tally) in &tallies {
        assert!(tally.found as f64 >= 0.99 * tally.expected as f64, "{family:?}: {tally:?}");
    }
    assert!(tallies.iter().all(|(_, t)| t.points > 1_000 && t.occupied > 50), "{tallies:?}");
}

#[test]
fn the_pointwise_radius_is_the_largest_that_meets_the_conditions() {
    let lambda = 0.5_f64.sqrt();
    let mut dice = Dice(5);
    for _ in 0..20_000 {
        let (h, near) = (dice.real(0.0, PI / 2.0), dice.real(0.01, 10.0));
        let h = if dice.chance(0.5) { 0.05 * h } else { h };
        let (opening, diameter) = (dice.pick(&[0.0_f64, 0.01, 0.3]), dice.pick(&[0.0, 0.01, 0.1]));
        let width = dice.pick(&[0.0, 0.02, 0.3]);
        let kappa = h.sin() - h.cos() * (0.5 * opening).tan();
        let holds = |r: f64| {
            let disc = if 2.0 * r * kappa <= diameter {
                0.0
            } else {
                let denominator = 1.0 - 2.0 * lambda * kappa;
                if denominator <= 0.0 {
                    return false;
                }
                (2.0 * r * kappa - diameter) / denominator
            };
            disc <= width && near > r + lambda * disc
        };
        let rho = pointwise_rho(h, near, opening, diameter, width);
        let context = format!("h {h}, near {near}, opening {opening}, diameter {diameter}, width {width}: {rho}");
        assert!(rho < 1e-12 || holds(rho * (1.0 - 1e-9) - 1e-15), "{context}");
        assert!(!holds(rho * (1.0 + 1e-9) + 1e-15), "{context}");
    }
}

/// A thread lends its surveyor and holds a new one meanwhile: blanking a window for that took longer than the scan.
#[test]
fn a_surveyor_that_draws_nothing_blanked_a_window() {
    let mut surveyor = Surveyor::new();
    assert_eq!(surveyor.window_bytes(), 0);
    let (grid, scan, width, _) = random(Family::Plain, 1);
    surveyor.survey(&config(grid, EvidenceRule::Guaranteed, width, scan.sensor()), &scan);
    assert!(surveyor.window_bytes() >= 3 * 4096 * 4096 / 8);
}

/// A heading wide beside the steps has a window of as many sectors as fit into it.
#[test]
fn steps_of_next_to_nothing_asked_for_memory_without_end() {
    let sensor = SensorModel::new(SensorSpec::default()).unwrap();
    let grid = Grid::new(0.1, 10, None).unwrap();
    for increment in [1.1e-309, 1e-300, -1e-12, 1e-9, 1e-6] {
        for beams in [2, 3, 100] {
            let spec = ScanSpec {
                pose: PoseBox::new((0.0, 0.0), (0.0, 0.0), (0.0, 0.5), &PoseLimits::default()).unwrap(),
                angles: Angles::Uniform { min: 0.0, increment },
                ranges: vec![3.4; beams],
                footprint_radius: 0.0,
                sweep_rotation: 0.0,
                sweep_translation: 0.0,
            };
            let scan = Scan::new(spec, sensor, &ScanLimits::default()).unwrap();
            let leaves = survey(grid, EvidenceRule::Guaranteed, 0.05, &scan);
            assert!(leaves.sets().1.is_empty() && !leaves.sets().0.is_empty(), "{increment}, {beams} beams");
        }
    }
}

/// The half width of a heading is a hair more than whole steps, and what that hair takes away is wider than the slack: an edge
/// of leaves lies between what the steps show and what the heading shows.
#[test]
fn a_heading_a_hair_wider_than_whole_steps_was_taken_for_whole_steps() {
    let sensor = SensorModel::new(SensorSpec::default()).unwrap();
    let step = 1.0_f64.to_radians();
    for hair in [2.4e-7, 1e-6, 3.3e-6] {
        // The axis of beam 19 is level at the heading's middle; far is free below it and not above, but for the hair.
        let half_width = step + hair;
        let spec = ScanSpec {
            pose: PoseBox::new((0.0, 0.0), (0.0, 0.0), (step - half_width, step + half_width), &PoseLimits::default())
                .unwrap(),
            angles: Angles::Uniform { min: -20.0 * step, increment: step },
            ranges: (0..41).map(|beam| if beam <= 20 { 3.5 } else { 1.0 }).collect(),
            footprint_radius: 0.0,
            sweep_rotation: 0.0,
            sweep_translation: 0.0,
        };
        let scan = Scan::new(spec, sensor, &ScanLimits::default()).unwrap();
        for below in [7.6e-6, 8.0e-6, 9.0e-6, 1.0e-5] {
            let grid = Grid::new(0.1, 8, Some((-12.8, -12.8 - below))).unwrap();
            let case = Case::new(grid, &scan, 0.05, format!("{hair} rad, {below} m"));
            let leaves = survey(grid, EvidenceRule::Guaranteed, case.width, &scan);
            let tally = case.check_guaranteed(&leaves, 600, false, &mut Dice(3));
            assert!(tally.empty > 100, "{tally:?}");
        }
    }
}

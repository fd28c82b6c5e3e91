//! The rule at one exact pose, bracket by bracket, against the exact nearest obstacle point of each bracket's wedge.
//!
//! It needs no leaves and no engine: it holds the simulator and the model's inequality to each other.

use crate::placement::{angle_of, kappa};
use crate::scenario::{Family, Scenario};
use std::f64::consts::{FRAC_1_SQRT_2, PI, TAU};
use ubbmap::sensor::{ScanSpec, SensorSpec};
use ubbmap::simulation::Cone;

/// Ways to get the rule wrong.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Wrong {
    Nothing,
    SlackInCondition2,
    IgnoreLambda,
}

/// `d-` of a usable beam; `None` for one that says nothing.
fn nearest_possible(range: f32, sensor: &SensorSpec) -> Option<f64> {
    if range >= sensor.range_max as f32 {
        return sensor.no_return_free_to;
    }
    let works = range > 0.0 && range >= sensor.range_min as f32;
    let half_ulp = 0.5 * f64::from(range.next_up() - range);
    works.then(|| f64::from(range) - sensor.range_error_minus - half_ulp)
}

/// Up to where the wedge between two beams is free, by the model: `m` is the smaller of their `d-`, `half` half the
/// angle between them.
fn proven(m: f64, half: f64, width: f64, sensor: &SensorSpec, wrong: Wrong) -> f64 {
    let (lambda, kappa, w) = (FRAC_1_SQRT_2, kappa(half, sensor), sensor.beam_diameter);
    let lambda_3 = if wrong == Wrong::IgnoreLambda { 0.0 } else { lambda };
    let by_range = if 2.0 * m * kappa <= w { m } else { m * (1.0 - 2.0 * lambda_3 * kappa) + lambda_3 * w };
    let slack = if wrong == Wrong::SlackInCondition2 { 1.02 } else { 1.0 };
    let by_gap =
        if kappa > 0.0 { slack * (width * (1.0 - 2.0 * lambda * kappa) + w) / (2.0 * kappa) } else { f64::INFINITY };
    by_range.min(by_gap)
}

/// Wedges that hold an obstacle, and those of them with one nearer than what is proven.
fn check(scenario: &Scenario, spec: &ScanSpec, wrong: Wrong) -> (u64, u64) {
    let world = scenario.world();
    let (origin, heading) = scenario.motion.start.sensor(&scenario.sensor);
    let mut beams: Vec<(f64, f64)> = (0..scenario.beams)
        .filter_map(|i| {
            let angle = angle_of(&scenario.angles, i).rem_euclid(TAU);
            nearest_possible(spec.ranges[i], &scenario.sensor).map(|near| (angle, near))
        })
        .collect();
    beams.sort_by(|a, b| a.0.total_cmp(&b.0));
    let (mut wedges, mut violations) = (0, 0);
    for i in 0..beams.len() {
        let (a, b) = (beams[i], beams[(i + 1) % beams.len()]);
        let half = 0.5 * (b.0 - a.0).rem_euclid(TAU);
        if beams.len() < 2 || half >= 0.499 * PI {
            continue;
        }
        let free = proven(a.1.min(b.1), half, scenario.width, &scenario.sensor, wrong);
        let wedge = Cone::with_opening(origin, heading + a.0 + half, 2.0 * half, 0.0);
        if let Some(nearest) = world.nearest_in(&wedge) {
            wedges += 1;
            if nearest < free - 1e-8 {
                violations += 1;
                if wrong == Wrong::Nothing {
                    println!("wedge {i} of {scenario:?}: obstacle at {nearest}, proven to {free}");
                }
            }
        }
    }
    (wedges, violations)
}

fn run(wrong: Wrong, scenes: u64) -> (u64, u64) {
    let (mut wedges, mut violations) = (0, 0);
    for seed in 0..scenes {
        for family in [Family::Tight, Family::Any, Family::Edges] {
            let scenario = Scenario::generate(family, crate::base_seed() + seed);
            let moves = scenario.motion.start != scenario.motion.end;
            if moves || scenario.sensor.beam_angle_error > 0.0 {
                continue;
            }
            let spec = scenario.scan_spec(&scenario.world());
            let (w, v) = check(&scenario, &spec, wrong);
            wedges += w;
            violations += v;
        }
    }
    println!("pointwise rule, {wrong:?}: {wedges} wedges with obstacles, {violations} violations");
    (wedges, violations)
}

#[test]
fn at_one_pose_no_obstacle_point_is_nearer_than_the_rule_proves() {
    let (wedges, violations) = run(Wrong::Nothing, 2500);
    assert!(wedges > 100_000, "{wedges}");
    assert_eq!(violations, 0);
}

#[test]
fn at_one_pose_wrong_rules_are_caught() {
    for wrong in [Wrong::SlackInCondition2, Wrong::IgnoreLambda] {
        let (_, violations) = run(wrong, 500);
        assert!(violations > 0, "{wrong:?} was not caught");
    }
}

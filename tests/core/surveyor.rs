//! A surveyor keeps its windows and tables from scan to scan: none of it shows in what it says.
#![allow(clippy::unwrap_used, clippy::panic, reason = "a test that cannot be set up has failed")]

use crate::rules_support::config;
use proptest::collection::vec;
use proptest::prelude::*;
use std::f64::consts::TAU;
use ubbmap::mapping::{EvidenceRule, MapConfig, Surveyor};
use ubbmap::quadtree::Grid;
use ubbmap::sensor::{Angles, PoseBox, PoseLimits, Scan, ScanLimits, ScanSpec, SensorModel, SensorSpec};

/// A ring of ranges about the origin, on leaves of a side.
fn ring(
    resolution: f64,
    rule: EvidenceRule,
    mut ranges: Vec<f32>,
    change: impl Fn(&mut ScanSpec),
) -> (MapConfig, Scan) {
    let sensor = SensorModel::new(SensorSpec { range_max: 100.0, ..SensorSpec::default() }).unwrap();
    let grid = Grid::new(resolution, 14, None).unwrap();
    let beams = ranges.len();
    if beams > 40 {
        ranges[17] = f32::NAN;
    }
    let mut spec = ScanSpec {
        pose: PoseBox::new((0.0, 0.0), (0.0, 0.0), (0.0, 0.0), &PoseLimits::default()).unwrap(),
        angles: Angles::Uniform { min: 0.0, increment: TAU / beams as f64 },
        ranges,
        footprint_radius: 0.0,
        sweep_rotation: 0.0,
        sweep_translation: 0.0,
    };
    change(&mut spec);
    (config(grid, rule, 0.05, &sensor), Scan::new(spec, sensor, &ScanLimits::default()).unwrap())
}

/// Of a sensor that moves along, points nearer than some distance are left out: as a disc, which was larger than the window.
#[test]
fn a_scan_in_motion_left_a_window_that_was_not_blank() {
    let (near, moving) = ring(0.03, EvidenceRule::Guaranteed, vec![2.0; 720], |spec| spec.sweep_translation = 0.01);
    let (far, still) = ring(0.03, EvidenceRule::Guaranteed, vec![29.0; 720], |_| {});
    let mut used = Surveyor::new();
    used.survey(&near, &moving);
    assert!(used.survey(&far, &still) == Surveyor::new().survey(&far, &still), "the same sets are told otherwise");
}

/// A configuration and a scan of any kind: still, in motion, turning, of an uncertain pose; at even steps or not; on dense
/// windows and beyond them; by each rule.
fn any_scan() -> impl Strategy<Value = (MapConfig, Scan)> {
    let rule = prop_oneof![4 => Just(EvidenceRule::Guaranteed), 1 => Just(EvidenceRule::Outer), 1 => Just(EvidenceRule::Inner)];
    let moves = prop_oneof![Just((0.0, 0.0)), Just((0.01, 0.0)), Just((0.0, 0.02)), Just((0.03, 0.01))];
    let range = prop_oneof![2 => 0.3_f32..3.0, 2 => 3.0_f32..25.0, 1 => 60.0_f32..99.0];
    let kind = (prop::sample::select(vec![0.03, 0.05, 0.1]), rule, moves, range);
    let pose = (-3.0..3.0_f64, 0.0..0.2_f64, -4.0..4.0_f64, prop_oneof![Just(0.0_f64), 0.0..0.2_f64]);
    let beams = prop::sample::select(vec![1_usize, 7, 90, 720]);
    (kind, pose, (beams, vec(0.7_f32..1.0, 1..90)), any::<bool>(), prop::sample::select(vec![0.0, 0.3_f64])).prop_map(
        |(
            (resolution, rule, (translation, rotation), range),
            (x, width, theta, turn),
            (beams, shape),
            listed,
            footprint,
        )| {
            let ranges = shape.iter().cycle().take(beams).map(|share| range * share).collect();
            ring(resolution, rule, ranges, |spec| {
                (spec.sweep_translation, spec.sweep_rotation) = (translation, rotation);
                spec.footprint_radius = footprint;
                let pose = ((x, x + width), (-x, width - x), (theta, theta + turn));
                spec.pose = PoseBox::new(pose.0, pose.1, pose.2, &PoseLimits::default()).unwrap();
                if listed {
                    let step = 4.0 / spec.ranges.len() as f64;
                    spec.angles = Angles::Listed((0..spec.ranges.len()).map(|i| step * i as f64).collect());
                }
            })
        },
    )
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(60))]

    #[test]
    fn a_surveyor_that_was_used_answers_as_a_fresh_one(scans in vec(any_scan(), 2..8)) {
        let mut used = Surveyor::new();
        let mut masks = ubbmap::quadtree::LeafMasks::default();
        for (config, scan) in &scans {
            used.survey_into(config, scan, &mut masks);
            prop_assert!(masks == Surveyor::new().survey(config, scan), "{:?} on {:?}", scan, config.grid());
        }
    }
}

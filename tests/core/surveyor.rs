//! A surveyor keeps its windows and tables from scan to scan: none of it shows in what it says.
#![allow(clippy::unwrap_used, clippy::panic, reason = "a test that cannot be set up has failed")]

use crate::regions_exact::Dice;
use crate::rules_support::config;
use proptest::collection::vec;
use proptest::prelude::*;
use std::collections::BTreeMap;
use std::f64::consts::TAU;
use ubbmap::mapping::{EvidenceRule, MAX_REACH_CELLS, MAX_SPREAD_CELLS, MapConfig, MapConfigError, Surveyor};
use ubbmap::quadtree::{ClassScale, Grid};
use ubbmap::sensor::{Angles, Mount, PoseBox, PoseLimits, Scan, ScanLimits, ScanSpec, SensorModel, SensorSpec};

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

/// A scan of two beams from the origin whose pose box is `width` wide along x.
fn wide_scan(sensor: SensorModel, width: f64, heading: f64) -> Scan {
    let limits = PoseLimits { max_position_width: 1e6, max_heading_width: TAU };
    let spec = ScanSpec {
        pose: PoseBox::new((0.0, width), (0.0, 0.0), (0.0, heading), &limits).unwrap(),
        angles: Angles::Uniform { min: 0.0, increment: 0.1 },
        ranges: vec![0.99 * sensor.spec().range_max as f32; 2],
        footprint_radius: 100.0,
        sweep_rotation: TAU,
        sweep_translation: 100.0,
    };
    Scan::new(spec, sensor, &ScanLimits::default()).unwrap()
}

fn try_config(resolution: f64, rule: EvidenceRule, sensor: SensorModel) -> Result<MapConfig, MapConfigError> {
    let grid = Grid::new(resolution, 14, None).unwrap();
    let sensors = BTreeMap::from([("default".to_owned(), sensor)]);
    MapConfig::new(grid, ClassScale::new(10).unwrap(), rule, 10.0, sensors)
}

/// Beams 10 m wide on leaves of 0.1 mm: the window of a sensor that ranges 1 m had 400 MB.
#[test]
fn the_diameter_of_a_beam_did_not_count_as_reach() {
    let sensor = |beam_diameter| {
        SensorModel::new(SensorSpec { range_max: 1.0, beam_diameter, ..SensorSpec::default() }).unwrap()
    };
    let error = try_config(1e-4, EvidenceRule::Guaranteed, sensor(10.0)).unwrap_err();
    assert!(matches!(&error, MapConfigError::Reach { cells, .. } if (cells - 210_350.0).abs() < 1e-6), "{error}");
    assert!(error.to_string().contains("beam_diameter"), "{error}");
    assert!(try_config(1e-4, EvidenceRule::Guaranteed, sensor(0.2)).is_ok());
}

/// A limit of the server may allow boxes of a thousand kilometres: such a window has no whole numbers for its leaves.
#[test]
fn a_pose_box_wider_than_whole_numbers_of_leaves_was_drawn() {
    let sensor = SensorModel::new(SensorSpec { range_max: 1.0, ..SensorSpec::default() }).unwrap();
    for rule in [EvidenceRule::Guaranteed, EvidenceRule::Outer, EvidenceRule::Inner] {
        let config = try_config(1e-4, rule, sensor).unwrap();
        for width in [0.4097, 2.0, 1e3, 2e5, 1e6] {
            let scan = wide_scan(sensor, width, 0.0);
            let error = Surveyor::fits(&config, &scan).unwrap_err();
            assert_eq!((error.code(), error.field()), ("TOO_MANY_LEAVES", "pose"), "{error}");
            assert!(Surveyor::new().survey(&config, &scan).blocks.is_empty());
        }
        assert!(Surveyor::fits(&config, &wide_scan(sensor, 0.4096, 0.0)).is_ok());
    }
    // A sensor that the map does not have.
    let far = SensorModel::new(SensorSpec { range_max: 1e6, range_error_plus: 1e6, ..SensorSpec::default() }).unwrap();
    let config = try_config(1e-4, EvidenceRule::Guaranteed, sensor).unwrap();
    let scan = wide_scan(far, 0.0, 0.0);
    assert_eq!(Surveyor::fits(&config, &scan).unwrap_err().field(), "ranges");
    assert!(Surveyor::new().survey(&config, &scan).blocks.is_empty());
}

/// Of everything the largest that is let in.
#[test]
fn the_cost_of_a_scan_is_bounded_whatever_its_sensor_and_pose_are() {
    let mut dice = Dice(8);
    let (mut refused, mut drawn) = (0, 0);
    while drawn < 40 {
        let resolution = dice.pick(&[1e-4, 0.01, 1.0, 1e4]);
        let length = |dice: &mut Dice, most: f64| {
            (dice.pick(&[0.0_f64, 0.1, 1.0, 100.0, 2_000.0, 1e4, 1e9]) * resolution).min(most)
        };
        let spec = SensorSpec {
            range_error_minus: 0.0,
            range_error_plus: length(&mut dice, 1e6),
            beam_diameter: length(&mut dice, 100.0),
            beam_opening: dice.pick(&[0.0, 0.01, 3.1]),
            range_max: length(&mut dice, 1e6).max(resolution),
            beam_angle_error: dice.pick(&[0.0, 0.5]),
            mount: Mount { x: length(&mut dice, 100.0), ..Mount::default() },
            ..SensorSpec::default()
        };
        let sensor = SensorModel::new(spec).unwrap();
        let rule = dice.pick(&[EvidenceRule::Guaranteed, EvidenceRule::Outer]);
        let Ok(config) = try_config(resolution, rule, sensor) else {
            refused += 1;
            continue;
        };
        let scan = wide_scan(sensor, length(&mut dice, 1e6), dice.pick(&[0.0, 1.0, TAU]));
        let masks = Surveyor::new().survey(&config, &scan);
        if Surveyor::fits(&config, &scan).is_err() {
            assert!(masks.blocks.is_empty());
            refused += 1;
            continue;
        }
        drawn += 1;
        let most = (2.0 * (4.0 * MAX_REACH_CELLS + MAX_SPREAD_CELLS) / 64.0 + 2.0).powi(2);
        assert!((masks.blocks.len() as f64) < most, "{} blocks of {scan:?}", masks.blocks.len());
    }
    assert!(refused > 12, "{refused} refused");
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

//! Every scan by itself: no leaf that holds an obstacle point is in its X_EMP; and planted faults are found.

use crate::oracle::{Tally, leaf_square};
use crate::scenario::{FAMILIES, Family, Scenario};
use ubbmap::mapping::{Fault, MapConfig, Surveyor};
use ubbmap::sensor::{Scan, ScanLimits, ScanSpec, SensorModel, SensorSpec};
use ubbmap::simulation::World;
use ubbmap::vector::Path;

/// What a scan is surveyed with.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Planted {
    /// The engine as it is and the truth about the scene.
    Nothing,
    /// A fault in the engine.
    Fault(Fault),
    /// A false claim about the scene, as an engine would act that did not heed what was claimed.
    Lie(Lie),
}

/// False claims, each of them against one assumption of the model.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Lie {
    /// A4: obstacles are a tenth thinner than `min_obstacle_width`.
    ThinObstacles,
    /// A2: the cone in which detection is certain is narrower than claimed.
    WideBeam,
    /// A2: ranges are off by twice what is claimed.
    RangeError,
    /// A2: beams are turned, and no angle error is claimed.
    AngleError,
    /// A2: obstacles stand a little nearer than `no_return_free_to`.
    NoReturn,
    /// A1: the robot turned and moved, and no sweep is claimed.
    Sweep,
    /// A1: the sweep is taken for an even one, though the robot accelerates.
    EvenSweep,
    /// A1: the robot turned, and only its translation is claimed.
    TranslationAlone,
    /// A1: the robot turned during the sweep about a sensor that is not where it is claimed to be.
    Mount,
    /// A5: something is within the footprint.
    Footprint,
}

impl Planted {
    fn surveyor(self) -> Surveyor {
        match self {
            Self::Fault(fault) => Surveyor::with_fault(fault),
            _ => Surveyor::new(),
        }
    }

    /// What is claimed of a scene.
    fn claim(self, scenario: &Scenario, spec: &mut ScanSpec, sensor: &mut SensorSpec, width: &mut f64) {
        let Self::Lie(lie) = self else { return };
        match lie {
            Lie::ThinObstacles => *width *= 1.1,
            Lie::WideBeam => sensor.beam_diameter += 0.1 * scenario.width,
            Lie::RangeError => {
                sensor.range_error_minus *= 0.5;
                sensor.range_error_plus *= 0.5;
            }
            Lie::AngleError => sensor.beam_angle_error = 0.0,
            Lie::NoReturn => {
                let most = sensor.range_max - sensor.range_error_minus;
                sensor.no_return_free_to = sensor.no_return_free_to.map(|free_to| most.min(1.2 * free_to));
            }
            Lie::Sweep => (spec.sweep_rotation, spec.sweep_translation) = (0.0, 0.0),
            Lie::EvenSweep => {
                spec.sweep_rotation *= 0.5;
                spec.sweep_translation *= 0.5;
            }
            Lie::TranslationAlone => spec.sweep_rotation = 0.0,
            Lie::Mount => sensor.mount.x += 2.0 * scenario.resolution,
            Lie::Footprint => spec.footprint_radius *= 1.2,
        }
    }
}

/// The scan of a scene as the engine is told of it.
fn scan_of(scenario: &Scenario, world: &World, planted: Planted) -> (MapConfig, Scan) {
    let (mut spec, mut sensor, mut width) = (scenario.scan_spec(world), scenario.sensor, scenario.width);
    planted.claim(scenario, &mut spec, &mut sensor, &mut width);
    let config = scenario.config(&sensor, width);
    let model = SensorModel::new(sensor).unwrap_or_else(|e| panic!("{e}: {scenario:?}"));
    let scan = Scan::new(spec, model, &ScanLimits::default()).unwrap_or_else(|e| panic!("{e}: {scenario:?}"));
    (config, scan)
}

/// Surveys one scene and counts its pairs; returns the leaves that were wrongly called empty.
fn check(scenario: &Scenario, planted: Planted, surveyor: &mut Surveyor, tally: &mut Tally) -> Vec<(u32, u32)> {
    let world = scenario.world();
    let (config, scan) = scan_of(scenario, &world, planted);
    let masks = surveyor.survey(&config, &scan);
    let (from, _) = scenario.motion.start.sensor(&scenario.sensor);
    let reach = scenario.sensor.range_max + scenario.sensor.range_error_plus;
    tally.add(&masks, &world, config.grid(), (from, reach))
}

/// Takes shapes away as long as the scene still shows a violation.
fn shrink(scenario: &Scenario, planted: Planted) -> Scenario {
    let mut small = scenario.clone();
    let mut i = 0;
    while i < small.shapes.len() {
        let mut fewer = small.clone();
        fewer.shapes.remove(i);
        if check(&fewer, planted, &mut planted.surveyor(), &mut Tally::default()).is_empty() {
            i += 1;
        } else {
            small = fewer;
        }
    }
    small
}

/// Prints a scene with a violation, with as few obstacles as show it, and how to run it alone.
fn describe(scenario: &Scenario, planted: Planted) {
    let small = shrink(scenario, planted);
    let wrong = check(&small, planted, &mut planted.surveyor(), &mut Tally::default());
    println!("VIOLATION in {:?}:{} (set UBBMAP_SOUNDNESS_CASE to that)", scenario.family, scenario.seed);
    println!("  {small:?}");
    println!("  ranges {:?}", small.scan_spec(&small.world()).ranges);
    let grid = *small.config(&small.sensor, small.width).grid();
    let (from, _) = small.motion.start.sensor(&small.sensor);
    for leaf in wrong.iter().take(4) {
        let (corner, size) = leaf_square(&grid, *leaf);
        let apart = (corner.add_scalar(0.5 * size) - from).norm();
        println!(
            "  leaf {leaf:?}: from ({}, {}), {size} wide, {apart} m from the sensor, is empty",
            corner.x, corner.y
        );
    }
}

/// The engine's other ways to draw a scan: the machine's other paths, which must compute the same sets, and windows of any size,
/// which must be sound too.
struct OtherWays {
    paths: Vec<(Path, Surveyor)>,
    wide: Surveyor,
    tally: Tally,
}

impl OtherWays {
    fn new() -> Self {
        let paths = Path::all().into_iter().map(|path| (path, Surveyor::on(path))).collect();
        Self { paths, wide: Surveyor::without_dense_windows(), tally: Tally::default() }
    }

    fn check(&mut self, scenario: &Scenario) {
        let (config, scan) = scan_of(scenario, &scenario.world(), Planted::Nothing);
        let mut first = None;
        for (path, surveyor) in &mut self.paths {
            let masks = surveyor.survey(&config, &scan);
            match &first {
                None => first = Some(masks),
                Some(first) => assert_eq!(masks, *first, "{path} differs in {:?}:{}", scenario.family, scenario.seed),
            }
        }
        let wrong = check(scenario, Planted::Nothing, &mut self.wide, &mut self.tally);
        assert!(wrong.is_empty(), "on a window of any size {wrong:?} of {:?}:{}", scenario.family, scenario.seed);
    }
}

/// Checks scenes of a family until there are `pairs` pairs (or, with something planted, a violation).
fn run(family: Family, pairs: u64, planted: Planted) -> Tally {
    let mut surveyor = planted.surveyor();
    let mut tally = Tally::default();
    let mut others = OtherWays::new();
    let mut shown = 0;
    for seed in crate::base_seed().. {
        if tally.pairs >= pairs || (planted != Planted::Nothing && tally.violations > 0) {
            break;
        }
        let scenario = Scenario::generate(family, seed);
        let wrong = check(&scenario, planted, &mut surveyor, &mut tally);
        if planted == Planted::Nothing {
            others.check(&scenario);
        }
        if !wrong.is_empty() && planted == Planted::Nothing && shown < 3 {
            shown += 1;
            describe(&scenario, planted);
        }
    }
    let Tally { scans, pairs, all, contested, empty, violations } = tally;
    println!(
        "{family:?}, planted {planted:?}: {pairs} leaf-scan pairs with obstacle points in sight ({all} with hidden ones, \
         {contested} at the border of what is proven), {scans} scans, {empty} leaves proven, {violations} violations"
    );
    tally
}

fn family_is_sound(family: Family, share: f64) {
    if crate::only_case().is_some() {
        return;
    }
    let pairs = (crate::total_pairs() as f64 * share) as u64;
    let tally = run(family, pairs, Planted::Nothing);
    assert!(tally.pairs >= pairs && tally.empty > tally.pairs / 2, "the scenes show too little: {tally:?}");
    assert_eq!(tally.violations, 0, "a leaf that holds an obstacle point was called empty");
}

#[test]
fn no_obstacle_leaf_is_decremented_by_any_sensor_mount_box_and_resolution() {
    family_is_sound(Family::Any, 0.25);
}

#[test]
fn no_obstacle_leaf_is_decremented_where_the_conditions_are_tight() {
    family_is_sound(Family::Tight, 0.2);
}

#[test]
fn no_obstacle_leaf_is_decremented_with_an_uncertain_heading() {
    family_is_sound(Family::Heading, 0.1);
}

#[test]
fn no_obstacle_leaf_is_decremented_with_an_uncertain_position() {
    family_is_sound(Family::Position, 0.1);
}

#[test]
fn no_obstacle_leaf_is_decremented_by_beams_that_are_turned() {
    family_is_sound(Family::Turned, 0.1);
}

#[test]
fn no_obstacle_leaf_is_decremented_while_the_robot_moves() {
    family_is_sound(Family::Sweep, 0.15);
}

#[test]
fn no_obstacle_leaf_is_decremented_while_a_sensor_far_from_the_robots_middle_is_swung() {
    family_is_sound(Family::Lever, 0.1);
}

#[test]
fn no_obstacle_leaf_is_decremented_at_the_ends_of_the_view_and_without_returns() {
    family_is_sound(Family::Edges, 0.1);
}

#[test]
fn one_scene_by_name() {
    let Some((name, seed)) = crate::only_case() else { return };
    let family = FAMILIES.into_iter().find(|f| format!("{f:?}") == name).unwrap_or_else(|| panic!("no family {name}"));
    let scenario = Scenario::generate(family, seed);
    let mut tally = Tally::default();
    let wrong = check(&scenario, Planted::Nothing, &mut Surveyor::new(), &mut tally);
    println!("{tally:?}");
    if !wrong.is_empty() {
        describe(&scenario, Planted::Nothing);
    }
    assert!(wrong.is_empty());
}

/// What is planted must show within a million pairs.
fn is_caught(planted: Planted, families: &[Family]) {
    if crate::only_case().is_some() {
        return;
    }
    let caught = families.iter().any(|family| run(*family, 1_000_000 / families.len() as u64, planted).violations > 0);
    assert!(caught, "{planted:?} was not found");
}

#[test]
fn two_percent_of_slack_in_condition_2_is_caught() {
    is_caught(Planted::Fault(Fault::SlackInCondition2), &[Family::Tight]);
}

#[test]
fn comparing_with_the_distance_alone_is_caught() {
    is_caught(Planted::Fault(Fault::IgnoreLambda), &[Family::Tight]);
}

#[test]
fn a_heading_reduced_to_its_midpoint_is_caught() {
    is_caught(Planted::Fault(Fault::HeadingMidpoint), &[Family::Heading]);
}

#[test]
fn a_position_reduced_to_its_midpoint_is_caught() {
    is_caught(Planted::Fault(Fault::PositionMidpoint), &[Family::Position]);
}

#[test]
fn skipping_short_returns_is_caught() {
    is_caught(Planted::Fault(Fault::SkipShortReturns), &[Family::Tight]);
}

#[test]
fn an_engine_that_does_not_heed_a_bound_would_be_caught() {
    is_caught(Planted::Lie(Lie::ThinObstacles), &[Family::Tight]);
    is_caught(Planted::Lie(Lie::WideBeam), &[Family::Tight]);
    is_caught(Planted::Lie(Lie::RangeError), &[Family::Any]);
    is_caught(Planted::Lie(Lie::AngleError), &[Family::Turned]);
    is_caught(Planted::Lie(Lie::NoReturn), &[Family::Edges]);
    is_caught(Planted::Lie(Lie::Sweep), &[Family::Sweep]);
    is_caught(Planted::Lie(Lie::EvenSweep), &[Family::Sweep]);
    is_caught(Planted::Lie(Lie::TranslationAlone), &[Family::Sweep]);
    is_caught(Planted::Lie(Lie::Mount), &[Family::Tight]);
    is_caught(Planted::Lie(Lie::Footprint), &[Family::Any]);
}

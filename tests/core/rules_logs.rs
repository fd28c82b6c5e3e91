//! The evidence rules against the slow reference, on scans of real logs.
#![allow(
    clippy::unwrap_used,
    clippy::panic,
    clippy::print_stdout,
    reason = "a test that cannot be set up has failed; counts are for the reader"
)]

use crate::regions_exact::Dice;
use crate::rules_support::{Case, Tally, survey};
use std::io::{BufRead, BufReader};
use std::path::PathBuf;
use ubbmap::mapping::EvidenceRule;
use ubbmap::quadtree::Grid;
use ubbmap::sensor::{Angles, PoseBox, PoseLimits, Scan, ScanLimits, ScanSpec, SensorModel, SensorSpec};

/// A log, how uncertain its poses are (metres, degrees), how coarse its ranges are (metres), and every how many scans one
/// is taken.
struct Log {
    name: &'static str,
    position: f64,
    heading: f64,
    range_error: f64,
    every: usize,
}

const LOGS: [Log; 4] = [
    Log { name: "fr079", position: 0.03, heading: 0.7, range_error: 0.035, every: 500 },
    Log { name: "intel", position: 0.12, heading: 3.0, range_error: 0.035, every: 100 },
    Log { name: "mit-csail", position: 0.10, heading: 1.4, range_error: 0.035, every: 60 },
    Log { name: "aces3", position: 0.10, heading: 1.2, range_error: 0.05, every: 50 },
];

/// Where the logs are, if they are anywhere.
fn data() -> Option<PathBuf> {
    let beside = || PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../shared/data");
    let folder = std::env::var_os("UBBMAP_DATA").map_or_else(beside, PathBuf::from);
    folder.is_dir().then_some(folder)
}

fn scans(log: &Log, folder: &std::path::Path, exact: bool) -> Vec<Scan> {
    let path = folder.join(log.name).join(format!("{}.jsonl.gz", log.name));
    if !std::fs::read(&path).unwrap().starts_with(&[0x1f, 0x8b]) {
        println!("SKIPPED: {} is no gzip file", path.display());
        return Vec::new();
    }
    let file = std::fs::File::open(path).unwrap();
    let mut lines = BufReader::new(flate2::read::GzDecoder::new(file)).lines();
    let header: serde_json::Value = serde_json::from_str(&lines.next().unwrap().unwrap()).unwrap();
    let number = |value: &serde_json::Value, field: &str| value[field].as_f64().unwrap();
    let spec = SensorSpec {
        range_error_minus: log.range_error,
        range_error_plus: log.range_error,
        range_max: number(&header, "range_max"),
        ..SensorSpec::default()
    };
    let sensor = SensorModel::new(spec).unwrap();
    let angles = Angles::Uniform { min: number(&header, "angle_min"), increment: number(&header, "angle_increment") };
    lines
        .step_by(log.every)
        .map(|line| {
            let line: serde_json::Value = serde_json::from_str(&line.unwrap()).unwrap();
            let (position, heading) = if exact { (0.0, 0.0) } else { (log.position, log.heading.to_radians()) };
            let around = |field: &str, radius: f64| (number(&line, field) - radius, number(&line, field) + radius);
            let pose = PoseBox::new(
                around("x", position),
                around("y", position),
                around("theta", heading),
                &PoseLimits::default(),
            );
            let ranges = line["ranges"].as_array().unwrap().iter().map(|r| r.as_f64().unwrap() as f32).collect();
            let spec = ScanSpec {
                pose: pose.unwrap(),
                angles: angles.clone(),
                ranges,
                footprint_radius: 0.0,
                sweep_rotation: 0.0,
                sweep_translation: 0.0,
            };
            Scan::new(spec, sensor, &ScanLimits::default()).unwrap()
        })
        .collect()
}

/// Runs a check on the chosen scans of every log; poses as boxes and, every third scan, exact.
fn over_all(check: impl Fn(&Case<'_>, &mut Dice) -> Tally) -> Vec<(&'static str, Tally)> {
    let Some(folder) = data() else {
        println!("skipped: the logs are neither in $UBBMAP_DATA nor in ../shared/data");
        return Vec::new();
    };
    let grid = Grid::new(0.1, 16, None).unwrap();
    LOGS.iter()
        .filter_map(|log| {
            let mut sum = Tally::default();
            let mut dice = Dice(7);
            let exact = scans(log, &folder, true);
            if exact.is_empty() {
                return None;
            }
            for (i, boxed) in scans(log, &folder, false).iter().enumerate() {
                let scan = if i % 3 == 2 { &exact[i] } else { boxed };
                let case = Case::new(grid, scan, 0.05, format!("{} scan {}", log.name, i * log.every));
                sum.add(check(&case, &mut dice));
            }
            println!("{}: {sum:?}", log.name);
            Some((log.name, sum))
        })
        .collect()
}

#[test]
fn x_occ_of_logs_holds_the_truth_and_stays_within_the_measurement_boxes() {
    let tallies = over_all(|case, dice| {
        let leaves = survey(case.grid, EvidenceRule::Guaranteed, case.width, case.scan);
        case.check_occupied(&leaves, 20, dice)
    });
    assert!(tallies.iter().all(|(_, t)| t.points > 10_000 && t.occupied > 500), "{tallies:?}");
}

#[test]
fn outer_of_logs_holds_the_truth_and_stays_within_the_papers_test() {
    let tallies = over_all(|case, dice| {
        let leaves = survey(case.grid, EvidenceRule::Outer, case.width, case.scan);
        case.check_outer(&leaves, 20, dice)
    });
    assert!(tallies.iter().all(|(_, t)| t.points > 10_000 && t.empty > 5_000), "{tallies:?}");
}

#[test]
fn inner_of_logs_stays_within_the_papers_test() {
    let tallies = over_all(|case, _| {
        let leaves = survey(case.grid, EvidenceRule::Inner, case.width, case.scan);
        case.check_inner(&leaves)
    });
    for (name, tally) in &tallies {
        assert!(tally.found as f64 >= 0.99 * tally.expected as f64, "{name}: {tally:?}");
        assert!(tally.empty > 0, "{name}: {tally:?}");
    }
}

#[test]
fn guaranteed_of_logs_proves_what_the_rule_for_whole_boxes_proves_and_nothing_that_is_not_free_by_points() {
    let tallies = over_all(|case, dice| {
        let leaves = survey(case.grid, EvidenceRule::Guaranteed, case.width, case.scan);
        case.check_guaranteed(&leaves, 24, false, dice)
    });
    for (name, tally) in &tallies {
        assert!(tally.expected > 1_000, "{name}: {tally:?}");
        assert!(tally.found as f64 >= 0.99 * tally.expected as f64, "{name}: {tally:?}");
    }
}

/// What the engine may not fall below: shares of the rule for whole boxes in its simpler form (one range for all brackets of
/// a box; the prover by points has 1.02 of it), of that rule as it is, and of a prover by points (which sampling makes out to
/// be better than one can be).
const SHARES: [f64; 3] = [1.01, 0.99, 0.98];

#[test]
fn guaranteed_of_logs_proves_more_than_whole_boxes_with_one_range_and_nearly_all_that_points_would() {
    let sums = std::cell::RefCell::new(std::collections::BTreeMap::<String, [usize; 4]>::new());
    over_all(|case, dice| {
        if case.name.starts_with("fr079") || case.name.starts_with("intel") {
            let leaves = survey(case.grid, EvidenceRule::Guaranteed, case.width, case.scan);
            let proven = case.proven(&leaves, 3000, dice);
            let mut sums = sums.borrow_mut();
            let sum = sums.entry(case.name.chars().take(5).collect()).or_default();
            let counts = [proven.engine, proven.one_range, proven.whole_boxes, proven.by_points];
            sum.iter_mut().zip(counts).for_each(|(sum, more)| *sum += more);
        }
        Tally::default()
    });
    for (name, [engine, others @ ..]) in sums.into_inner() {
        let shares = others.map(|other| engine as f64 / other as f64);
        println!(
            "{name}: {engine} leaves proven; whole boxes with one range, whole boxes, points: {others:?}, {shares:.3?}"
        );
        assert!(shares.iter().zip(SHARES).all(|(share, floor)| *share >= floor), "{name}: {shares:?}");
    }
}

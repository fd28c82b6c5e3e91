//! Scans per CPU second of the evidence rules, applied to the map, beside a dense log-odds grid with Bresenham rays.
//!
//! `cargo bench --bench evidence -- [--guaranteed] [--paths] [--threads] [LOG.jsonl.gz ..]`; without logs those of
//! `$UBBMAP_DATA` or `../shared/data` and a simulated one. All engines run in turn on the same scans in the same process;
//! medians of the rounds are printed with the ratio to the grid of the same round.
//!
//! * `--guaranteed` leaves the paper's rules out;
//! * `--paths` runs the rule `guaranteed` on every set of vector instructions that the machine has, instead of the rules;
//! * `--threads` compares one thread with all cores instead: scans per second of the clock.

#![allow(clippy::print_stdout, reason = "a benchmark prints its figures")]

mod support;

use rayon::prelude::*;
use std::collections::BTreeMap;
use std::time::Instant;
use support::{DenseGrid, Log, logs, median, scans_of, seconds, simulated};
use ubbmap::mapping::{EvidenceRule, MapConfig, Surveyor};
use ubbmap::quadtree::{ClassScale, Grid, LeafMasks, OccupancyTree};
use ubbmap::sensor::{Scan, SensorModel};
use ubbmap::vector::Path;

const ROUNDS: usize = 9;

/// Scans of one round, at least: logs are run through again and again, since single runs are too short to time.
const SCANS_A_ROUND: usize = 10_000;

/// The same with the paper's rules, which take twenty times as long.
const SCANS_A_SLOW_ROUND: usize = 1_000;

/// A rule on a path.
type Engine = (EvidenceRule, Path);

fn config(rule: EvidenceRule, resolution: f64, sensor: SensorModel) -> MapConfig {
    MapConfig::new(
        Grid::new(resolution, 16, None).expect("a grid"),
        ClassScale::new(10).expect("a scale"),
        rule,
        0.05,
        BTreeMap::from([("default".to_owned(), sensor)]),
    )
    .expect("a configuration")
}

/// Seconds of processor time that an engine takes for `loops` runs through the scans.
fn time((rule, path): Engine, scans: &[Scan], resolution: f64, loops: usize) -> f64 {
    Path::force(path);
    let config = config(rule, resolution, *scans[0].sensor());
    let mut surveyor = Surveyor::on(path);
    let mut tree = OccupancyTree::new(16, config.scale());
    let (mut masks, mut changed) = (LeafMasks::default(), Vec::new());
    let start = seconds();
    for _ in 0..loops {
        for scan in scans {
            surveyor.survey_into(&config, scan, &mut masks);
            tree.apply(&masks, &mut changed);
            changed.clear();
        }
    }
    seconds() - start
}

fn run(log: &Log, engines: &[Engine], resolution: f64, error: (f64, f64)) {
    let scans = scans_of(log, error);
    let slow = engines.iter().any(|(rule, _)| *rule != EvidenceRule::Guaranteed);
    let loops = if slow { SCANS_A_SLOW_ROUND } else { SCANS_A_ROUND }.div_ceil(scans.len());
    let mut rates: Vec<Vec<f64>> = vec![Vec::new(); engines.len() + 1];
    let count = (scans.len() * loops) as f64;
    for _ in 0..ROUNDS {
        let mut grid = DenseGrid::over(log, resolution);
        let start = seconds();
        for _ in 0..loops {
            for scan in &log.scans {
                grid.insert(log, scan);
            }
        }
        rates[0].push(count / (seconds() - start));
        std::hint::black_box(&grid.cells);
        for (engine, rates) in engines.iter().zip(&mut rates[1..]) {
            rates.push(count / time(*engine, &scans, resolution, loops));
        }
    }
    print!("{:<10} {resolution:<5} +-{} m {:<4} deg", log.name, error.0, error.1.to_degrees());
    print!(" | grid {:>8.0}", median(rates[0].clone()));
    for ((rule, path), rate) in engines.iter().zip(&rates[1..]) {
        let ratio = median(rate.iter().zip(&rates[0]).map(|(a, b)| a / b).collect());
        print!(" | {rule:?} {path} {:>8.0} {ratio:>5.2}x", median(rate.clone()));
    }
    println!();
}

/// One thread beside all cores: evidence of one batch on all of them while the batch before is applied.
fn scaling(log: &Log, resolution: f64, error: (f64, f64)) {
    let scans = scans_of(log, error);
    let loops = SCANS_A_ROUND.div_ceil(scans.len());
    let config = config(EvidenceRule::Guaranteed, resolution, *scans[0].sensor());
    let mut rates = [Vec::new(), Vec::new()];
    let threads = std::thread::available_parallelism().map_or(1, usize::from);
    for _ in 0..ROUNDS {
        for (threads, rates) in [1, threads].into_iter().zip(&mut rates) {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("threads");
            let start = Instant::now();
            pool.install(|| pipeline(&config, &scans, loops));
            rates.push((scans.len() * loops) as f64 / start.elapsed().as_secs_f64());
        }
    }
    let ratio = median(rates[1].iter().zip(&rates[0]).map(|(all, one)| all / one).collect());
    let [one, all] = rates.map(median);
    println!("{:<10} {resolution:<5} | 1 thread {one:>8.0} | {threads} threads {all:>8.0} {ratio:>5.2}x", log.name);
}

fn pipeline(config: &MapConfig, scans: &[Scan], loops: usize) {
    thread_local! {
        static SURVEYOR: std::cell::RefCell<Surveyor> = std::cell::RefCell::default();
    }
    let mut tree = OccupancyTree::new(16, config.scale());
    let mut before: Vec<LeafMasks> = Vec::new();
    let survey = |scan: &Scan| SURVEYOR.with_borrow_mut(|surveyor| surveyor.survey(config, scan));
    for batch in (0..loops).flat_map(|_| scans.chunks(256)) {
        let applied = std::mem::take(&mut before);
        let apply = || applied.iter().for_each(|masks| tree.apply(masks, &mut Vec::new()));
        let evidence = || batch.par_iter().with_min_len(8).map(survey).collect();
        ((), before) = rayon::join(apply, evidence);
    }
    before.iter().for_each(|masks| tree.apply(masks, &mut Vec::new()));
    std::hint::black_box(&tree);
}

fn main() {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let has = |option: &str| arguments.iter().any(|argument| argument == option);
    let named: Vec<String> = arguments.iter().filter(|argument| !argument.starts_with("--")).cloned().collect();
    let mut all = logs(&named);
    if named.is_empty() {
        all.push(simulated());
    }
    let best = Path::best();
    let engines: Vec<Engine> = if has("--paths") {
        Path::all().into_iter().rev().map(|path| (EvidenceRule::Guaranteed, path)).collect()
    } else {
        let rules = [EvidenceRule::Guaranteed, EvidenceRule::Outer, EvidenceRule::Inner];
        rules.into_iter().take(if has("--guaranteed") { 1 } else { 3 }).map(|rule| (rule, best)).collect()
    };
    let errors = [(0.0, 0.0), (0.05, 0.5_f64.to_radians())];
    println!("scans per second, medians of {ROUNDS} alternating rounds; ratio to the first of the same round");
    for log in all {
        for resolution in [0.1, 0.05] {
            if has("--threads") {
                scaling(&log, resolution, errors[0]);
                continue;
            }
            for error in errors {
                run(&log, &engines, resolution, error);
            }
        }
    }
}

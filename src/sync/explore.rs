//! Runs a test under schedules that are chosen, not met by chance: random ones, ones with few preemptions (PCT), or all.
//!
//! What a run can be told by the environment:
//!
//! - `UBBMAP_SCHEDULES`: how many times the usual number of schedules; 100 is a run of an hour or so.
//! - `UBBMAP_SCHEDULES_SEED`: the first seed, to see others than the usual ones.
//! - `UBBMAP_SCHEDULE`: a schedule as a failure prints it, to go through that one alone.

#![allow(clippy::panic, reason = "a test fails by panicking")]

use shuttle::scheduler::{DfsScheduler, PctScheduler, RandomScheduler, ReplayScheduler, Scheduler};
use shuttle::{Config, MaxSteps, Runner};

/// For the evidence of a scan, which is computed on a task's stack.
const STACK_BYTES: usize = 1 << 20;

/// More than any test here takes; one that goes round for ever fails with it.
const MOST_STEPS: usize = 200_000;

fn number(variable: &str) -> Option<u64> {
    std::env::var(variable).ok().map(|text| text.parse().unwrap_or_else(|e| panic!("{variable}: {text:?}: {e}")))
}

fn run(scheduler: impl Scheduler + 'static, check: impl Fn() + Send + Sync + 'static) -> usize {
    let mut config = Config::new();
    config.stack_size = STACK_BYTES;
    config.max_steps = MaxSteps::FailAfter(MOST_STEPS);
    // What is memory between threads here is atomics that only count.
    config.silence_warnings = true;
    Runner::new(scheduler, config).run(check)
}

/// Goes through so many random schedules and as many of each of a few numbers of preemptions.
pub(crate) fn explore(schedules: usize, check: impl Fn() + Send + Sync + Clone + 'static) {
    if let Ok(schedule) = std::env::var("UBBMAP_SCHEDULE") {
        run(ReplayScheduler::new_from_encoded(&schedule), check);
        return;
    }
    let times = usize::try_from(number("UBBMAP_SCHEDULES").unwrap_or(1)).unwrap_or(usize::MAX);
    let schedules = schedules.saturating_mul(times);
    let seed = number("UBBMAP_SCHEDULES_SEED").unwrap_or(1);
    run(RandomScheduler::new_from_seed(seed, schedules), check.clone());
    for preemptions in 2..=4 {
        run(PctScheduler::new_from_seed(seed, preemptions, schedules), check.clone());
    }
}

/// Goes through all schedules, of which there must be at least so many: else the test lost what it was to interleave.
pub(crate) fn exhaust(at_least: usize, check: impl Fn() + Send + Sync + 'static) {
    if let Ok(schedule) = std::env::var("UBBMAP_SCHEDULE") {
        run(ReplayScheduler::new_from_encoded(&schedule), check);
        return;
    }
    let schedules = run(DfsScheduler::new(None, false), check);
    assert!(schedules >= at_least, "only {schedules} schedules");
}

//! Floor 6: the paper's experiment (section VI) repeated and carried on, as a report; and the peers that maps are compared
//! with.
//!
//! [`Experiment::run`] makes maps of one log by every method, of a simulated building with exact truth, and measures. Every
//! number of the report comes from the run that writes it.

mod beams;
mod broken;
mod figures;
pub mod maps;
pub mod octomap;
mod paper;
pub mod report;
mod seen;
mod simulated;
mod sweeps;

use crate::sensor::{Scan, SensorModel};
use maps::Setup;
use report::{Block, Report};
use std::path::PathBuf;

/// Told what is being done.
pub type Tell<'a> = dyn FnMut(&str) + 'a;

/// What an experiment is made with.
#[derive(Debug, Clone)]
pub struct Experiment {
    /// The log's name.
    pub log: String,
    /// Its scans, their poses exact.
    pub scans: Vec<Scan>,
    /// The sensor of the scans.
    pub sensor: SensorModel,
    /// Side of a leaf, metres.
    pub resolution: f64,
    /// `k`
    pub classes: u32,
    /// `s` of A4, metres.
    pub min_obstacle_width: f64,
    /// How far poses may be off where the experiment takes them as uncertain: metres and radians.
    pub pose_error: (f64, f64),
    /// Scans of the log, evenly picked, for sweeps.
    pub sample: usize,
    /// Scans of the simulated building.
    pub simulated: usize,
    /// Seed of the simulation and of what is drawn at random.
    pub seed: u64,
    /// The OctoMap driver, where there is one.
    pub octomap: Option<PathBuf>,
    /// A folder for temporary files: that of the report.
    pub folder: PathBuf,
}

/// Depth of the leaves: a root 65536 leaves wide.
const DEPTH: u32 = 16;

impl Experiment {
    /// The setup of the paper's maps.
    #[must_use]
    pub fn setup(&self) -> Setup {
        Setup {
            resolution: self.resolution,
            depth: DEPTH,
            classes: self.classes,
            min_obstacle_width: self.min_obstacle_width,
            octomap: self.octomap.clone(),
            folder: self.folder.clone(),
        }
    }

    /// At most [`Experiment::sample`] scans, evenly picked.
    #[must_use]
    pub fn sampled(&self) -> Vec<Scan> {
        let step = self.scans.len().div_ceil(self.sample.max(1)).max(1);
        self.scans.iter().step_by(step).cloned().collect()
    }

    /// Runs everything.
    ///
    /// # Errors
    /// When a map cannot be made from the scans, the numbers are refused, or OctoMap's driver fails.
    pub fn run(&self, tell: &mut Tell<'_>) -> anyhow::Result<Report> {
        let mut blocks = vec![Block::Text(self.about())];
        blocks.extend(paper::repeat(self, tell)?);
        blocks.extend(sweeps::errors(self, tell)?);
        blocks.extend(seen::compare(self, tell)?);
        blocks.extend(broken::tolerate(self, tell)?);
        blocks.extend(sweeps::run_time(self, tell)?);
        let title = format!("The paper's experiment on {}", self.log);
        Ok(Report { title, blocks })
    }

    /// Log, version, settings and machine.
    fn about(&self) -> String {
        let beams: u64 = self.scans.iter().map(|scan| scan.beams() as u64).sum();
        let octomap =
            if self.octomap.is_some() { "OctoMap stands beside" } else { "without OctoMap: no driver was given" };
        format!(
            "Section VI of M. Langerwisch and B. Wagner, Building Variable Resolution Occupancy Maps Assuming Unknown But Bounded \
             Sensor Errors, repeated by ubbmap {} on the log {}: {} scans, {beams} beams. Machine: {}. Uncertain poses: +-{} m, \
             +-{:.2} deg. Sweeps on {} scans of the log; the simulated building on {} scans, seed {}; {octomap}. Every number comes \
             from this run; times are processor time of one thread.",
            env!("CARGO_PKG_VERSION"),
            self.log,
            self.scans.len(),
            machine(),
            self.pose_error.0,
            self.pose_error.1.to_degrees(),
            self.sampled().len(),
            self.simulated,
            self.seed,
        )
    }
}

/// The processor's name as the system tells it, and how many cores there are.
fn machine() -> String {
    let cores = std::thread::available_parallelism().map_or(1, std::num::NonZeroUsize::get);
    let info = std::fs::read_to_string("/proc/cpuinfo").unwrap_or_default();
    let name =
        info.lines().find_map(|line| line.strip_prefix("model name")?.split_once(':').map(|(_, name)| name.trim()));
    format!("{}, {cores} cores, {}", name.unwrap_or("unknown processor"), std::env::consts::ARCH)
}

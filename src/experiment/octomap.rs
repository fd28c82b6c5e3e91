//! OctoMap as a peer, by the driver program that `benches/peers/run` builds (`benches/peers/octomap_peer.cpp`).

use crate::sensor::{Reading, Scan};
use anyhow::{Context, bail};
use serde::Deserialize;
use std::fmt::Write as _;
use std::fs::File;
use std::io::{BufWriter, Write};
use std::path::{Path, PathBuf};
use std::process::Command;

/// How the driver inserts a scan.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Insertion {
    /// As the library does it by default.
    Whole,
    /// Inner nodes once at the end, and the returns that fall into one voxel once: the fastest that the library offers.
    Discrete,
}

/// What the driver measured.
#[derive(Debug, Clone, PartialEq, Deserialize)]
pub struct Figures {
    /// The library's version.
    pub version: String,
    /// Processor seconds of insertion.
    pub seconds: f64,
    /// Scans a processor second.
    pub scans_per_second: f64,
    /// Leaves of the pruned tree.
    pub leaves: u64,
    /// Bytes in memory, as OctoMap counts them.
    pub memory_bytes: u64,
    /// Bytes of the `.bt` file; -1 where none was asked for.
    pub bt_bytes: i64,
}

/// The driver with the scans that it is given.
#[derive(Debug)]
pub struct OctoMap {
    driver: PathBuf,
    /// Scans, points and answers lie here, and are removed in the end.
    folder: PathBuf,
}

impl OctoMap {
    /// Writes the scans for the driver into `folder`: returns in the map frame at the middle of the pose box. Beams
    /// without a return are left out.
    ///
    /// # Errors
    /// When the driver is no file, or the scans cannot be written.
    pub fn new<'a>(driver: &Path, folder: &Path, scans: impl IntoIterator<Item = &'a Scan>) -> anyhow::Result<Self> {
        if !driver.is_file() {
            bail!("there is no OctoMap driver {}: build it with benches/peers/run --build", driver.display());
        }
        let peer = Self { driver: driver.to_owned(), folder: folder.to_owned() };
        let path = peer.path("scans");
        write_scans(&path, scans).with_context(|| format!("cannot write {}", path.display()))?;
        Ok(peer)
    }

    fn path(&self, what: &str) -> PathBuf {
        self.folder.join(format!("octomap-{what}.txt"))
    }

    /// Inserts the scans `loops` times into an empty map.
    ///
    /// # Errors
    /// When the driver fails or says what cannot be read.
    pub fn insert(&self, resolution: f64, loops: usize, insertion: Insertion) -> anyhow::Result<Figures> {
        let bt = self.path("bt");
        self.run(&[
            "--resolution".into(),
            resolution.to_string().into(),
            "--loops".into(),
            loops.to_string().into(),
            "--mode".into(),
            if insertion == Insertion::Whole { "whole" } else { "discrete" }.into(),
            "--bt".into(),
            bt.into(),
        ])
    }

    /// The probability that each point is occupied after one insertion of all scans; `None` where nothing is known.
    ///
    /// # Errors
    /// When the driver fails, or does not answer each point.
    pub fn occupancy(&self, resolution: f64, points: &[(f64, f64)]) -> anyhow::Result<Vec<Option<f64>>> {
        let (asked, answered) = (self.path("points"), self.path("answers"));
        let mut text = String::new();
        for (x, y) in points {
            writeln!(text, "{x} {y}")?;
        }
        std::fs::write(&asked, text)?;
        self.run(&[
            "--resolution".into(),
            resolution.to_string().into(),
            "--points".into(),
            asked.into(),
            "--answers".into(),
            answered.clone().into(),
        ])?;
        let answers: Vec<Option<f64>> = std::fs::read_to_string(&answered)?
            .lines()
            .map(|line| line.parse::<f64>().map(|p| (p >= 0.0).then_some(p)))
            .collect::<Result<_, _>>()?;
        if answers.len() != points.len() {
            bail!("the OctoMap driver answered {} of {} points", answers.len(), points.len());
        }
        Ok(answers)
    }

    fn run(&self, args: &[std::ffi::OsString]) -> anyhow::Result<Figures> {
        let done = Command::new(&self.driver).arg(self.path("scans")).args(args).output()?;
        if !done.status.success() {
            bail!("the OctoMap driver failed: {}", String::from_utf8_lossy(&done.stderr).trim());
        }
        serde_json::from_slice(&done.stdout).context("the OctoMap driver said what cannot be read")
    }
}

impl Drop for OctoMap {
    fn drop(&mut self) {
        for what in ["scans", "points", "answers", "bt"] {
            // Whatever is left behind is in the caller's own folder.
            let _ = std::fs::remove_file(self.path(what));
        }
    }
}

/// `x y n x1 y1 .. xn yn` a scan.
fn write_scans<'a>(path: &Path, scans: impl IntoIterator<Item = &'a Scan>) -> std::io::Result<()> {
    let mut file = BufWriter::new(File::create(path)?);
    let mut line = String::new();
    for scan in scans {
        let origins = scan.origins();
        let (x, y, heading) = (origins.x.mid(), origins.y.mid(), scan.headings().mid());
        let mut count = 0;
        line.clear();
        for beam in (0..scan.beams()).filter(|beam| matches!(scan.reading(*beam), Reading::Return { .. })) {
            let range = f64::from(scan.spec().ranges[beam]);
            let (sin, cos) = (heading + scan.angle(beam)).sin_cos();
            // A text in memory takes what is written to it.
            let _ = write!(line, " {} {}", x + range * cos, y + range * sin);
            count += 1;
        }
        writeln!(file, "{x} {y} {count}{line}")?;
    }
    file.flush()
}

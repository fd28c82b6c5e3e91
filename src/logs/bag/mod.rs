//! ROS 2 bags: MCAP files, SQLite databases (`.db3`), and folders of them.
//!
//! A bag is read twice: first for the poses, which are held in memory, since those that a scan needs may come after it;
//! then for the scans, one after the other. `docs/logs.md` tells what is read, and what a pose's box holds.

mod cdr;
mod choose;
mod file;
mod folder;
mod frames;
mod mcap_file;
mod messages;
mod motion;
mod place;
mod sqlite_file;
mod survey;
mod track;

use super::{LogError, LogScan, LogSensor, PoseError};
use crate::sensor::Angles;
use file::BagFile;
use messages::{Kind, LaserScan};
use place::{Placer, Unplaced};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::AtomicU64;
use survey::{FirstScan, Survey};
use track::Missing;

pub(super) use folder::is_bag;

/// How a bag is read.
#[derive(Debug, Clone, PartialEq)]
pub struct BagOptions {
    /// The topic of scans; `None` where there is one.
    pub scan_topic: Option<String>,
    /// The topic of poses; `None` for the transforms, else the one there is.
    pub pose_topic: Option<String>,
    /// The frame that the map is made in; `None` for `map`, else `odom`.
    pub fixed_frame: Option<String>,
    /// The robot's frame, which a topic's poses are those of; `None` for the one that they name, `base_link` or
    /// `base_footprint`.
    pub base_frame: Option<String>,
    /// Standard deviations of a covariance that make a box.
    pub sigma: f64,
    /// Longest time between two poses, seconds, where one between them is taken.
    pub max_gap: f64,
    /// Bounds of the acceleration between two poses: metres and radians, each a second squared.
    pub max_acceleration: PoseError,
    /// How far poses that do not tell their error may be off: what [`LogPose::bounds`](super::LogPose::bounds) is given. Here it
    /// counts for the motion during a sweep, and for the axes of a covariance whose variance is 0.
    pub pose_error: PoseError,
    /// Take the motion of the laser while it scans from the poses.
    pub sweep: bool,
}

impl Default for BagOptions {
    fn default() -> Self {
        Self {
            scan_topic: None,
            pose_topic: None,
            fixed_frame: None,
            base_frame: None,
            sigma: 3.0,
            max_gap: 0.5,
            max_acceleration: PoseError { position: 3.0, heading: 6.0 },
            pose_error: PoseError::default(),
            sweep: true,
        }
    }
}

/// The scans of a bag.
pub(super) struct Bag {
    files: Vec<PathBuf>,
    next: usize,
    open: Option<BagFile>,
    scans: String,
    frame: String,
    placer: Placer,
    max_beams: usize,
    /// Scans read, with and without a place.
    number: u64,
    unplaced: BTreeMap<Unplaced, u64>,
    bytes_read: Arc<AtomicU64>,
    pub(super) size: u64,
    pub(super) sensor: LogSensor,
    pub(super) words: String,
}

impl Bag {
    /// Opens a bag and reads its poses.
    ///
    /// # Errors
    /// [`LogError::Bag`] naming what is wrong, what there is, and the option that helps.
    pub(super) fn open(path: &Path, max_beams: usize, options: &BagOptions) -> Result<Self, LogError> {
        let failed = |problem| LogError::Bag { path: path.display().to_string(), problem };
        let files = folder::files(path).map_err(failed)?;
        let survey = Survey::of(&files, max_beams).map_err(failed)?;
        let firsts = survey.scans.clone();
        let damage = survey.damage.clone();
        let choice = choose::choose(survey, options).map_err(|problem| match damage {
            // What is missing may stand behind the damage.
            Some(damage) => failed(format!("{damage}; before that it {problem}")),
            None => failed(problem),
        })?;
        let first = firsts.get(&choice.scans);
        let size = files.iter().filter_map(|file| file.metadata().ok()).map(|file| file.len()).sum();
        Ok(Self {
            files,
            next: 0,
            open: None,
            scans: choice.scans,
            frame: first.map(|scan| scan.frame.clone()).unwrap_or_default(),
            placer: choice.placer,
            max_beams,
            number: 0,
            unplaced: BTreeMap::new(),
            bytes_read: Arc::new(AtomicU64::new(0)),
            size,
            sensor: first.map(sensor).unwrap_or_default(),
            words: choice.words,
        })
    }

    /// Scans read so far.
    pub(super) fn number(&self) -> u64 {
        self.number
    }

    pub(super) fn bytes_read(&self) -> Arc<AtomicU64> {
        Arc::clone(&self.bytes_read)
    }

    /// How many scans had no place so far, and why.
    pub(super) fn left_out(&self) -> (u64, Option<String>) {
        let words = self.unplaced.iter().map(|(why, count)| {
            let gap = self.placer.between.max_gap as f64 * 1e-9;
            match why {
                Unplaced::Missing(Missing::Before) => format!("{count} before the first pose"),
                Unplaced::Missing(Missing::After) => format!("{count} after the last pose"),
                Unplaced::Missing(Missing::Gap) => format!("{count} between poses more than {gap} s apart (--max-gap)"),
                Unplaced::Missing(Missing::Turn) => format!("{count} between poses that may be half a turn apart"),
                Unplaced::Slow => format!("{count} whose beams take longer than 51 s (--no-sweep)"),
                Unplaced::Tilted => format!("{count} from a laser whose plane is tilted by more than 1 deg"),
                Unplaced::Uncertain => format!("{count} with a pose wider than 2 m or 60 deg"),
            }
        });
        let words = words.collect::<Vec<_>>().join(", ");
        let count = self.unplaced.values().sum();
        (count, (count > 0).then_some(words))
    }

    /// The next scan that has a place.
    pub(super) fn find_scan(&mut self) -> Result<Option<LogScan>, LogError> {
        loop {
            let Some(message) = self.next_message()? else { return Ok(None) };
            self.number += 1;
            let failed = |problem| LogError::Scan { scan: self.number, problem };
            let scan = messages::scan(&message, self.max_beams).map_err(failed)?;
            if scan.frame != self.frame {
                let problem = format!("is of the frame {:?}, those before of {:?}", scan.frame, self.frame);
                return Err(failed(problem));
            }
            match self.placer.place(&scan) {
                Ok(placed) => return Ok(Some(log_scan(scan, &placed, self.number))),
                Err(why) => *self.unplaced.entry(why).or_default() += 1,
            }
        }
    }

    /// The next message of the topic of scans.
    fn next_message(&mut self) -> Result<Option<Vec<u8>>, LogError> {
        loop {
            let file = match &mut self.open {
                Some(file) => file,
                None => {
                    let Some(path) = self.files.get(self.next) else { return Ok(None) };
                    self.next += 1;
                    let opened = BagFile::open(path, Arc::clone(&self.bytes_read));
                    let failed = |problem| LogError::Bag { path: path.display().to_string(), problem };
                    self.open.insert(opened.map_err(failed)?)
                }
            };
            match file.next_message() {
                Ok(Some(message)) if message.kind == Kind::Scan && message.topic.name == self.scans => {
                    return Ok(Some(message.data));
                }
                Ok(Some(_)) => {}
                Ok(None) => self.open = None,
                Err(problem) => {
                    return Err(LogError::Scan { scan: self.number, problem: format!("after it {problem}") });
                }
            }
        }
    }
}

/// What a scan says of its sensor.
fn sensor(scan: &FirstScan) -> LogSensor {
    let finite = |value: f32| Some(f64::from(value)).filter(|value| value.is_finite());
    LogSensor {
        range_min: finite(scan.range_min).filter(|value| *value >= 0.0),
        range_max: finite(scan.range_max),
        ..LogSensor::default()
    }
}

fn log_scan(scan: LaserScan, placed: &place::Placed, number: u64) -> LogScan {
    let LaserScan { angle_min, angle_increment, range_min, range_max, mut ranges, .. } = scan;
    // The limits are the message's, not the bag's: what is beyond them is no return or failed whatever the first one said.
    for range in &mut ranges {
        if *range >= range_max {
            *range = f32::INFINITY;
        } else if *range < range_min {
            *range = f32::NAN;
        }
    }
    let turn = if placed.upside_down { -1.0 } else { 1.0 };
    let angles = Angles::Uniform { min: turn * f64::from(angle_min), increment: turn * f64::from(angle_increment) };
    LogScan {
        line: number,
        stamp: scan.stamp as f64 * 1e-9,
        pose: placed.pose,
        angles,
        ranges,
        footprint_radius: None,
        sweep_rotation: placed.sweep_rotation,
        sweep_translation: placed.sweep_translation,
    }
}

//! The first look through a bag: what topics and frames it has, and every pose.

use super::file::{BagFile, Topic};
use super::frames::Frames;
use super::messages::{self, Kind, LaserScan, Pose};
use super::track::{Sample, Track};
use std::collections::BTreeMap;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::AtomicU64;

/// Most poses and transforms of one bag: 100 bytes of memory each.
const MOST_SAMPLES: usize = 4_000_000;

/// The poses of one topic.
#[derive(Debug, Default)]
pub(super) struct PoseTopic {
    /// The frame that they stand in.
    pub(super) frame: String,
    /// The frame of the robot; empty where the messages do not name it.
    pub(super) child: String,
    pub(super) track: Track,
    /// Some do not know their errors.
    pub(super) uncertain: bool,
    /// What keeps them from being used.
    pub(super) fault: Option<String>,
    /// Poses that are none, and what is wrong with the first.
    pub(super) passed_over: (u64, Option<String>),
}

impl PoseTopic {
    fn add(&mut self, pose: Result<Pose, String>) {
        let pose = match pose {
            Ok(pose) => pose,
            Err(problem) => {
                self.fault.get_or_insert(problem);
                return;
            }
        };
        if self.track.is_empty() {
            self.frame.clone_from(&pose.frame);
            self.child.clone_from(&pose.child);
        }
        if self.frame != pose.frame || self.child != pose.child {
            let problem = format!("is in the frame {:?}, those before in {:?}", pose.frame, self.frame);
            self.fault.get_or_insert(problem);
        }
        match pose.pose {
            Ok(there) => {
                self.uncertain |= pose.variances.is_none_or(|variances| variances.contains(&0.0));
                self.track.push(Sample { stamp: pose.stamp, pose: there, variances: pose.variances });
            }
            Err(problem) => {
                self.passed_over.0 += 1;
                self.passed_over.1.get_or_insert(problem);
            }
        }
    }
}

/// What is kept of a scan.
#[derive(Debug, Clone, Default)]
pub(super) struct FirstScan {
    /// The laser's frame.
    pub(super) frame: String,
    /// Metres.
    pub(super) range_min: f32,
    pub(super) range_max: f32,
}

/// What a bag has.
#[derive(Debug, Default)]
pub(super) struct Survey {
    pub(super) topics: BTreeMap<String, Arc<Topic>>,
    pub(super) frames: Frames,
    pub(super) poses: BTreeMap<String, PoseTopic>,
    /// Of the first scan of each topic what is asked for later. Not its ranges: of many topics they would fill the memory.
    pub(super) scans: BTreeMap<String, FirstScan>,
    /// What ended the look early.
    pub(super) damage: Option<String>,
    samples: usize,
}

impl Survey {
    /// Looks through the files. What is damaged ends the look: the second reading meets it again, and tells it.
    ///
    /// # Errors
    /// For a file that cannot be opened, and a pose that cannot be read.
    pub(super) fn of(files: &[PathBuf], max_beams: usize) -> Result<Self, String> {
        let mut survey = Self::default();
        for path in files {
            let named = |problem: String| {
                if files.len() == 1 { problem } else { format!("{}: {problem}", path.display()) }
            };
            let mut file = BagFile::open(path, Arc::new(AtomicU64::new(0))).map_err(named)?;
            let damage = loop {
                match file.next_message() {
                    Ok(Some(message)) => {
                        survey.note(&message.topic.name, message.kind, &message.data, max_beams).map_err(named)?;
                    }
                    Ok(None) => break None,
                    Err(problem) => break Some(named(problem)),
                }
            };
            for topic in file.topics() {
                survey.topics.insert(topic.name.clone(), topic);
            }
            if damage.is_some() {
                survey.damage = damage;
                break;
            }
        }
        survey.frames.settle();
        survey.poses.values_mut().for_each(|poses| poses.track.settle());
        Ok(survey)
    }

    fn note(&mut self, topic: &str, kind: Kind, data: &[u8], max_beams: usize) -> Result<(), String> {
        let named = |problem: String| format!("a message of {topic}: {problem}");
        match kind {
            Kind::Scan => {
                if !self.scans.contains_key(topic)
                    && let Ok(scan) = messages::scan(data, max_beams)
                {
                    let LaserScan { frame, range_min, range_max, .. } = scan;
                    self.scans.insert(topic.to_owned(), FirstScan { frame, range_min, range_max });
                }
                return Ok(());
            }
            Kind::Transforms => {
                let fixed = topic.ends_with("tf_static");
                for transform in messages::transforms(data).map_err(named)? {
                    self.samples += 1;
                    self.frames.add(transform, fixed).map_err(named)?;
                }
            }
            Kind::Odometry | Kind::PoseWithCovariance | Kind::Pose => {
                self.samples += 1;
                self.poses.entry(topic.to_owned()).or_default().add(messages::pose(kind, data));
            }
        }
        if self.samples > MOST_SAMPLES {
            return Err(format!("has more than {MOST_SAMPLES} poses and transforms: cut it into shorter bags"));
        }
        Ok(())
    }

    /// The topics of some kinds, with their types: for people.
    pub(super) fn list(&self, wanted: impl Fn(Kind) -> bool) -> String {
        let of_kind = |topic: &&Arc<Topic>| Kind::of(&topic.type_name).is_some_and(&wanted);
        let words = |topic: &Arc<Topic>| match topic.encoding.as_str() {
            "cdr" => format!("{} ({})", topic.name, topic.type_name),
            other => format!("{} ({}, encoded as {other:?}, which is not read)", topic.name, topic.type_name),
        };
        self.topics.values().filter(of_kind).map(words).collect::<Vec<_>>().join(", ")
    }

    /// All topics, for people.
    pub(super) fn all(&self) -> String {
        const SHOWN: usize = 40;
        if self.topics.is_empty() {
            return "the bag has no topics".to_owned();
        }
        let shown = self.topics.values().take(SHOWN).map(|topic| format!("{} ({})", topic.name, topic.type_name));
        let more = self.topics.len().saturating_sub(SHOWN);
        let more = if more > 0 { format!(" and {more} more") } else { String::new() };
        format!("the bag has {}{more}", shown.collect::<Vec<_>>().join(", "))
    }
}

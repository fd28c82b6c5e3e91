//! Where the robots of a map are: the pose box of each one's last applied scan, in memory alone.

use super::{MapService, ServiceError};
use crate::sensor::PoseBox;
use crate::store::{MapName, RobotName};
use crate::sync::{Mutex, MutexGuard};
use std::collections::{BTreeMap, BTreeSet};
use std::sync::PoisonError;

/// What a scan says of its robot.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Sighting {
    pub(super) robot: RobotName,
    pub(super) sequence: Option<u64>,
    pub(super) stamp: f64,
    pub(super) sensor: String,
    pub(super) pose: PoseBox,
}

/// A robot at its last applied scan.
#[derive(Debug, Clone, PartialEq)]
pub struct RobotPose {
    /// Its name.
    pub robot: RobotName,
    /// The scan's number; `None` where it had none.
    pub sequence: Option<u64>,
    /// The scan's stamp, seconds since the Unix epoch, as the robot said.
    pub stamp: f64,
    /// The sensor's name.
    pub sensor: String,
    /// The box that holds the pose.
    pub pose: PoseBox,
    /// The revision that holds the scan.
    pub revision: u64,
    /// When it was applied, seconds since the Unix epoch, by the server's clock.
    pub received: f64,
}

/// The robots of a map at one revision.
#[derive(Debug, Clone, PartialEq)]
pub struct RobotsAnswer {
    /// The map's revision.
    pub revision: u64,
    /// By name.
    pub robots: Vec<RobotPose>,
}

/// The robots of one map. Written by its writer, once a round; a look holds up nobody for long.
pub(super) struct Robots {
    limit: usize,
    table: Mutex<Table>,
}

#[derive(Default)]
struct Table {
    last: BTreeMap<RobotName, RobotPose>,
    /// By the revision of their last scan, for those who ask who moved since one.
    moved: BTreeSet<(u64, RobotName)>,
}

impl Robots {
    /// No robots yet, and never more than `limit`.
    pub(super) fn new(limit: usize) -> Self {
        Self { limit, table: Mutex::default() }
    }

    fn table(&self) -> MutexGuard<'_, Table> {
        self.table.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Notes what the scans of a commit say, in the order of their arrival. Called when they are durable, and before
    /// their root is published.
    pub(super) fn note(&self, seen: &[&Sighting], revision: u64, received: f64) {
        // Of the many scans of a robot in one commit the last one counts.
        let last: BTreeMap<&RobotName, &Sighting> = seen.iter().map(|seen| (&seen.robot, *seen)).collect();
        let mut table = self.table();
        for Sighting { robot, sequence, stamp, sensor, pose } in last.into_values() {
            let pose = RobotPose {
                robot: robot.clone(),
                sequence: *sequence,
                stamp: *stamp,
                sensor: sensor.clone(),
                pose: *pose,
                revision,
                received,
            };
            if let Some(before) = table.last.insert(robot.clone(), pose) {
                table.moved.remove(&(before.revision, robot.clone()));
            }
            table.moved.insert((revision, robot.clone()));
        }
        while table.last.len() > self.limit
            && let Some((_, silent)) = table.moved.pop_first()
        {
            table.last.remove(&silent);
        }
    }

    /// All robots up to a revision, by name.
    pub(super) fn all(&self, until: u64) -> Vec<RobotPose> {
        self.table().last.values().filter(|robot| robot.revision <= until).cloned().collect()
    }

    /// The robots whose last scan is in a revision after `since` up to `until`, by name. One that is in a later revision
    /// is told with that.
    pub(super) fn moved(&self, since: u64, until: u64) -> Vec<RobotPose> {
        let table = self.table();
        let newer = table.moved.iter().rev().take_while(|(revision, _)| *revision > since);
        let names: BTreeSet<&RobotName> =
            newer.filter(|(revision, _)| *revision <= until).map(|(_, robot)| robot).collect();
        names.into_iter().filter_map(|robot| table.last.get(robot).cloned()).collect()
    }
}

impl MapService {
    /// Where the robots of a map are. Does not load it.
    ///
    /// # Errors
    /// [`super::ErrorKind::MapNotFound`]
    pub async fn robots(&self, name: &MapName) -> Result<RobotsAnswer, ServiceError> {
        let entry = self.registry.find(name)?;
        let robots = entry.robots.all(u64::MAX);
        // A commit that is durable may not be published yet.
        let newest = robots.iter().map(|robot| robot.revision).max().unwrap_or_default();
        Ok(RobotsAnswer { revision: entry.revision().max(newest), robots })
    }
}

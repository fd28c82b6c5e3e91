//! What was acknowledged, by robot and in the order in which the robot's scans were applied; and which of it a map of some
//! revision holds, whatever was restored before.
//!
//! Each robot has ground of its own and one request under way, so the order of its own scans is all that its leaves hang on.
//! A request whose answer was lost is sent again. What is then called a duplicate was applied at some revision since it
//! was first sent: it counts at the revision of the answer, and a snapshot that was taken in between is not restored.

use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::Instant;

/// A scan that is in the map: at which revision, and which of the robot's scans.
#[derive(Debug, Clone, Copy)]
pub struct Applied {
    pub revision: u32,
    pub step: u32,
}

/// A time from one moment to another.
#[derive(Debug, Clone, Copy)]
pub struct Span {
    pub begin: Instant,
    pub end: Instant,
}

/// The restoring of a snapshot.
#[derive(Debug, Clone, Copy)]
pub struct Restored {
    /// The snapshot's revision.
    pub from: u64,
    /// The revision that restoring it made.
    pub revision: u64,
}

#[derive(Debug, Default)]
struct Robot {
    applied: Vec<Applied>,
    /// When the request under way was first sent.
    open: Option<Instant>,
    /// Requests that were sent more than once.
    doubts: Vec<Span>,
}

#[derive(Debug)]
pub struct Ledger(Vec<Mutex<Robot>>);

impl Ledger {
    pub fn new(robots: usize) -> Self {
        Self((0..robots).map(|_| Mutex::default()).collect())
    }

    fn robot(&self, robot: usize) -> MutexGuard<'_, Robot> {
        self.0[robot].lock().unwrap_or_else(PoisonError::into_inner)
    }

    pub fn begin(&self, robot: usize) {
        self.robot(robot).open = Some(Instant::now());
    }

    pub fn applied(&self, robot: usize, scan: Applied) {
        self.robot(robot).applied.push(scan);
    }

    /// The request was answered; `again` where it was sent more than once.
    pub fn end(&self, robot: usize, again: bool) {
        let mut robot = self.robot(robot);
        if let Some(begin) = robot.open.take()
            && again
        {
            robot.doubts.push(Span { begin, end: Instant::now() });
        }
    }

    /// Is it known of every scan whether it is in what was kept at this time?
    pub fn is_certain(&self, kept: Span) -> bool {
        (0..self.0.len()).all(|robot| {
            let robot = self.robot(robot);
            let before = robot.open.is_none_or(|open| open > kept.end);
            before && robot.doubts.iter().all(|doubt| doubt.end < kept.begin || doubt.begin > kept.end)
        })
    }

    /// How many scans were acknowledged, and how many requests were sent more than once.
    pub fn counts(&self) -> (usize, usize) {
        let count = |robot| {
            let robot = self.robot(robot);
            (robot.applied.len(), robot.doubts.len())
        };
        (0..self.0.len()).map(count).fold((0, 0), |sum, one| (sum.0 + one.0, sum.1 + one.1))
    }

    /// The steps of a robot that the map of a revision holds, in the order of their application.
    pub fn held(&self, robot: usize, restored: &[Restored], revision: u64) -> Vec<u64> {
        let robot = self.robot(robot);
        robot
            .applied
            .iter()
            .filter(|scan| is_held(scan.revision.into(), restored, revision))
            .map(|scan| scan.step.into())
            .collect()
    }
}

/// Is what was applied at a revision in the map of another, when these snapshots were restored (the earliest first)?
fn is_held(applied: u64, restored: &[Restored], mut at: u64) -> bool {
    for restore in restored.iter().rev() {
        if restore.revision > at {
            continue;
        }
        if applied >= restore.revision {
            break;
        }
        // All that is older is what the snapshot held.
        at = restore.from;
    }
    applied <= at
}

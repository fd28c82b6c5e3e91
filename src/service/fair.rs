//! The places of a map's queue, shared fairly by the robots that send to it.
//!
//! While less than half of the places are taken, whoever comes first has one. From there on a robot that has a place
//! already gets another only up to its share: the places divided by the robots that have one or wait for one. The last
//! quarter is for robots that have none, so that one comes in beside another that sends all the time. Those that
//! wait are let in by turns of robots, not in the order in which they came: one that sends ten times as much waits ten
//! times as long, and the others do not.

use super::tasks::oneshot;
use super::{ErrorKind, ServiceError, setting};
use crate::sync::{Mutex, MutexGuard};
use std::collections::{HashMap, VecDeque};
use std::sync::{Arc, PoisonError};

/// One of so many places is kept for robots that have none.
const KEPT: usize = 4;

/// The places of one queue.
#[derive(Debug)]
pub(super) struct Places {
    capacity: usize,
    state: Mutex<State>,
}

/// One place; given back when it is dropped.
#[derive(Debug)]
pub(super) struct Place {
    places: Arc<Places>,
    robot: String,
}

#[derive(Debug, Default)]
struct State {
    taken: usize,
    robots: HashMap<String, Robot>,
    /// The robots that wait, in the order of their turns.
    turns: VecDeque<String>,
}

/// A robot that has a place or waits for one.
#[derive(Debug, Default)]
struct Robot {
    held: usize,
    waiting: VecDeque<oneshot::Sender<Place>>,
}

impl Places {
    pub(super) fn new(capacity: usize) -> Arc<Self> {
        Arc::new(Self { capacity: capacity.max(1), state: Mutex::default() })
    }

    /// Is every place taken?
    pub(super) fn full(&self) -> bool {
        self.lock().taken >= self.capacity
    }

    /// A place for a robot, at once.
    ///
    /// # Errors
    /// [`ErrorKind::Busy`] where all are taken, or the robot has its share.
    pub(super) fn take(self: &Arc<Self>, robot: &str) -> Result<Place, ServiceError> {
        let mut state = self.lock();
        if state.taken >= self.capacity {
            drop(state);
            return Err(self.refusal());
        }
        if !self.may_have(&state, robot) {
            let held = state.robots.get(robot).map_or(0, |robot| robot.held);
            drop(state);
            let robot: String = robot.chars().take(80).collect();
            let detail = format!(
                "robot {robot:?} has {held} insertions waiting, its share of a queue of {} that is over half full: try \
                 again later",
                self.capacity
            );
            return Err(ServiceError::over(ErrorKind::Busy, setting::WRITER_QUEUE, detail));
        }
        state.give(robot);
        Ok(self.place(robot))
    }

    /// What is said where all places are taken.
    pub(super) fn refusal(&self) -> ServiceError {
        let detail =
            format!("{} insertions wait at the map, as many as its queue holds: try again later", self.capacity);
        ServiceError::over(ErrorKind::Busy, setting::WRITER_QUEUE, detail)
    }

    /// A place for a robot, when it is its turn.
    pub(super) async fn wait(self: &Arc<Self>, robot: &str) -> Option<Place> {
        let receiver = {
            let mut state = self.lock();
            if state.taken < self.capacity && self.may_have(&state, robot) {
                state.give(robot);
                return Some(self.place(robot));
            }
            let (sender, receiver) = oneshot::channel();
            let entry = state.robots.entry(robot.to_owned()).or_default();
            let first = entry.waiting.is_empty();
            entry.waiting.push_back(sender);
            if first {
                state.turns.push_back(robot.to_owned());
            }
            receiver
        };
        // The sender is dropped with the places alone.
        receiver.await.ok()
    }

    fn lock(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn place(self: &Arc<Self>, robot: &str) -> Place {
        Place { places: Arc::clone(self), robot: robot.to_owned() }
    }

    /// May the robot have one more, where one is free?
    fn may_have(&self, state: &State, robot: &str) -> bool {
        let held = state.robots.get(robot).map_or(0, |robot| robot.held);
        let active = state.robots.len() + usize::from(!state.robots.contains_key(robot));
        let kept = self.capacity / KEPT;
        held == 0
            || state.taken < self.capacity / 2
            || (held < self.capacity / active && state.taken + kept < self.capacity)
    }

    /// Takes a place back and gives what is free to those whose turn it is.
    fn give_back(self: &Arc<Self>, robot: &str) {
        let mut state = self.lock();
        state.taken -= 1;
        if let Some(entry) = state.robots.get_mut(robot) {
            entry.held -= 1;
        }
        state.forget(robot);
        let mut granted = Vec::new();
        let mut passed = 0;
        while state.taken < self.capacity && passed < state.turns.len() {
            let Some(next) = state.turns.pop_front() else { break };
            if !self.may_have(&state, &next) {
                state.turns.push_back(next);
                passed += 1;
                continue;
            }
            let sender = state.next_waiting(&next);
            if state.robots.get(&next).is_some_and(|robot| !robot.waiting.is_empty()) {
                state.turns.push_back(next.clone());
            }
            match sender {
                Some(sender) => {
                    state.give(&next);
                    granted.push((sender, self.place(&next)));
                    passed = 0;
                }
                None => state.forget(&next),
            }
        }
        drop(state);
        for (sender, place) in granted {
            // One whose client has just gone comes back, and goes to the next.
            drop(sender.send(place));
        }
    }
}

impl State {
    fn give(&mut self, robot: &str) {
        self.taken += 1;
        match self.robots.get_mut(robot) {
            Some(robot) => robot.held += 1,
            None => drop(self.robots.insert(robot.to_owned(), Robot { held: 1, waiting: VecDeque::new() })),
        }
    }

    /// The first of a robot's insertions that is still waited for.
    fn next_waiting(&mut self, robot: &str) -> Option<oneshot::Sender<Place>> {
        let waiting = &mut self.robots.get_mut(robot)?.waiting;
        std::iter::from_fn(|| waiting.pop_front()).find(|sender| !sender.is_closed())
    }

    /// A robot that has nothing and waits for nothing is none.
    fn forget(&mut self, robot: &str) {
        if self.robots.get(robot).is_some_and(|robot| robot.held == 0 && robot.waiting.is_empty()) {
            self.robots.remove(robot);
        }
    }
}

impl Drop for Place {
    fn drop(&mut self) {
        self.places.give_back(&self.robot);
    }
}

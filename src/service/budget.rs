//! How much memory the insertions under way may hold.

use super::{ErrorKind, ServiceError, setting};
use crate::sync::{AtomicUsize, Mutex, MutexGuard};
use std::collections::HashMap;
use std::sync::atomic::Ordering;
use std::sync::{Arc, PoisonError};

/// Bytes that all insertions under way may hold together: their scans and their evidence until they are committed. While
/// more than half is used, a robot that has something under way already gets more only up to its share.
#[derive(Debug)]
pub(super) struct Budget {
    limit: usize,
    state: Mutex<State>,
}

#[derive(Debug, Default)]
struct State {
    used: usize,
    /// What each robot holds, of those that hold something.
    robots: HashMap<Arc<str>, usize>,
}

/// The share of one request; given back when it is dropped.
#[derive(Debug)]
pub(super) struct Reservation {
    budget: Arc<Budget>,
    robot: Arc<str>,
    held: AtomicUsize,
}

impl Budget {
    pub(super) fn new(limit: usize) -> Self {
        Self { limit, state: Mutex::default() }
    }

    /// A reservation of no bytes yet.
    pub(super) fn reservation(self: &Arc<Self>, robot: &str) -> Reservation {
        Reservation { budget: Arc::clone(self), robot: Arc::from(robot), held: AtomicUsize::new(0) }
    }

    #[cfg(test)]
    pub(super) fn used(&self) -> usize {
        self.lock().used
    }

    fn lock(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Reservation {
    /// Takes `bytes` more.
    ///
    /// # Errors
    /// [`ErrorKind::TooManyScans`] when this request alone is larger than the budget, so that sending it again would
    /// not help; [`ErrorKind::Busy`] when others hold what is missing, or the robot has its share.
    pub(super) fn grow(&self, bytes: usize) -> Result<(), ServiceError> {
        let limit = self.budget.limit;
        let held = self.held.load(Ordering::Relaxed);
        if held.saturating_add(bytes) > limit {
            let detail = format!(
                "the scans of this request and their evidence need more than {limit} bytes: send fewer a request"
            );
            return Err(ServiceError::over(ErrorKind::TooManyScans, setting::INSERT_BYTES, detail).at("scans"));
        }
        let mut state = self.budget.lock();
        let sum = state.used.saturating_add(bytes);
        let robots = state.robots.get(&self.robot).copied().unwrap_or(0);
        let active = state.robots.len() + usize::from(robots == 0);
        // What a robot has beside this request; a single one may grow as long as there is room.
        let others = robots > held;
        let shared = !others || sum <= limit / 2 || robots.saturating_add(bytes) <= limit / active;
        if sum <= limit && shared {
            state.used = sum;
            match state.robots.get_mut(&self.robot) {
                Some(held) => *held += bytes,
                None => drop(state.robots.insert(Arc::clone(&self.robot), bytes)),
            }
            self.held.fetch_add(bytes, Ordering::Relaxed);
            return Ok(());
        }
        drop(state);
        let detail = if sum > limit {
            format!("the server holds {limit} bytes of scans, as many as its memory allows: try again later")
        } else {
            let robot: String = self.robot.chars().take(80).collect();
            format!(
                "robot {robot:?} has its share of {limit} bytes for scans, of which over half are used: try again later"
            )
        };
        Err(ServiceError::over(ErrorKind::Busy, setting::INSERT_BYTES, detail))
    }
}

impl Drop for Reservation {
    fn drop(&mut self) {
        let held = *self.held.get_mut();
        let mut state = self.budget.lock();
        state.used -= held;
        if let Some(robots) = state.robots.get_mut(&self.robot) {
            *robots -= held;
            if *robots == 0 {
                state.robots.remove(&self.robot);
            }
        }
    }
}

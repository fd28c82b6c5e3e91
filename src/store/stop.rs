//! Telling a thread that works now and then that it is to end.

use super::lock;
use std::sync::{Condvar, Mutex, PoisonError};
use std::time::Duration;

/// Whether a thread is to end.
#[derive(Debug, Default)]
pub(super) struct Stop {
    asked: Mutex<bool>,
    wake: Condvar,
}

impl Stop {
    /// Asks the thread to end.
    pub(super) fn ask(&self) {
        *lock(&self.asked) = true;
        self.wake.notify_all();
    }

    /// Waits so long, or until the thread is to end; true when it is.
    pub(super) fn within(&self, time: Duration) -> bool {
        let asked = lock(&self.asked);
        *self.wake.wait_timeout_while(asked, time, |asked| !*asked).unwrap_or_else(PoisonError::into_inner).0
    }
}

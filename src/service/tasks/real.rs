//! The pool for evidence, on threads of its own.

use crate::service::{ErrorKind, ServiceError};
use rayon::prelude::*;

/// How far behind, in steps of `nice`: on a full core about a fifth of the time is left.
#[cfg(target_os = "linux")]
const BEHIND: i32 = 8;

/// Threads that compute.
pub(in crate::service) struct Pool(rayon::ThreadPool);

impl Pool {
    /// So many threads; 0 for as many as there are cores.
    pub(in crate::service) fn new(threads: usize) -> Result<Self, ServiceError> {
        rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .thread_name(|i| format!("evidence-{i}"))
            .start_handler(|_| step_back())
            .build()
            .map(Self)
            .map_err(|e| ServiceError::new(ErrorKind::Internal, format!("cannot start threads for evidence: {e}")))
    }

    /// Has the work done; returns at once.
    pub(in crate::service) fn spawn(&self, work: impl FnOnce() + Send + 'static) {
        self.0.spawn(work);
    }
}

/// Does the same with each item, on all threads of the pool that it is called on. The results are in the items' order.
pub(in crate::service) fn each<I: Send, T: Send>(items: Vec<I>, work: impl Fn(usize, I) -> T + Sync) -> Vec<T> {
    items.into_par_iter().enumerate().map(|(index, item)| work(index, item)).collect()
}

/// Evidence is the work that there is most of, and may take all cores. Behind the threads that answer, it takes what they
/// leave: a query does not wait for scans, however many there are.
fn step_back() {
    #[cfg(target_os = "linux")]
    if let Err(error) = rustix::process::nice(BEHIND) {
        // It only costs queries some milliseconds under full load.
        tracing::debug!(%error, "a thread for evidence cannot step back");
    }
}

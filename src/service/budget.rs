//! How much memory the insertions under way may hold.

use super::{ErrorKind, ServiceError};
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};

/// Bytes that all insertions under way may hold together: their scans and their evidence until they are committed.
#[derive(Debug)]
pub(super) struct Budget {
    limit: usize,
    used: AtomicUsize,
}

/// The share of one request; given back when it is dropped.
#[derive(Debug)]
pub(super) struct Reservation {
    budget: Arc<Budget>,
    held: AtomicUsize,
}

impl Budget {
    pub(super) fn new(limit: usize) -> Self {
        Self { limit, used: AtomicUsize::new(0) }
    }

    /// A reservation of no bytes yet.
    pub(super) fn reservation(self: &Arc<Self>) -> Reservation {
        Reservation { budget: Arc::clone(self), held: AtomicUsize::new(0) }
    }

    #[cfg(test)]
    pub(super) fn used(&self) -> usize {
        self.used.load(Ordering::Relaxed)
    }
}

impl Reservation {
    /// Takes `bytes` more.
    ///
    /// # Errors
    /// [`ErrorKind::TooManyScans`] when this request alone is larger than the budget, so that sending it again would
    /// not help; [`ErrorKind::Busy`] when others hold what is missing.
    pub(super) fn grow(&self, bytes: usize) -> Result<(), ServiceError> {
        let budget = &self.budget;
        let fits = |used: usize| used.checked_add(bytes).filter(|sum| *sum <= budget.limit);
        if budget.used.fetch_update(Ordering::Relaxed, Ordering::Relaxed, fits).is_ok() {
            self.held.fetch_add(bytes, Ordering::Relaxed);
            return Ok(());
        }
        let own = self.held.load(Ordering::Relaxed).saturating_add(bytes);
        Err(if own > budget.limit {
            let detail = format!(
                "the scans of this request and their evidence need more than {} bytes: send fewer a request",
                budget.limit
            );
            ServiceError::new(ErrorKind::TooManyScans, detail).at("scans")
        } else {
            ServiceError::new(ErrorKind::Busy, "the server holds as many scans as its memory allows: try again")
        })
    }
}

impl Drop for Reservation {
    fn drop(&mut self) {
        self.budget.used.fetch_sub(*self.held.get_mut(), Ordering::Relaxed);
    }
}

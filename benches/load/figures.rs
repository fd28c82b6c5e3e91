//! Latencies that many tasks record, and their percentiles.

use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

/// Seconds, shared by those who record them.
#[derive(Debug, Clone, Default)]
pub struct Latencies(Arc<Mutex<Vec<f64>>>);

impl Latencies {
    pub fn record(&self, latency: Duration) {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).push(latency.as_secs_f64());
    }

    /// Throws away what was recorded.
    pub fn forget(&self) {
        drop(self.take());
    }

    /// What was recorded, in ascending order.
    pub fn take(&self) -> Vec<f64> {
        let mut times = std::mem::take(&mut *self.0.lock().unwrap_or_else(PoisonError::into_inner));
        times.sort_by(f64::total_cmp);
        times
    }
}

/// The smallest value that a share of the sorted values do not exceed; NaN without any.
pub fn percentile(sorted: &[f64], share: f64) -> f64 {
    let at = (share * sorted.len() as f64).ceil() as usize;
    sorted.get(at.saturating_sub(1)).copied().unwrap_or(f64::NAN)
}

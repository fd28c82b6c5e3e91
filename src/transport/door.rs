//! Who may come in: operations and streams under way, the time they may take, and the end of the server.

use super::files::out_of_time;
use crate::service::{ErrorKind, ServiceError};
use metrics::{describe_gauge, gauge};
use std::sync::Arc;
use std::time::Duration;
use tokio::sync::{OwnedSemaphorePermit, Semaphore};
use tokio_util::sync::CancellationToken;

const REQUESTS: &str = "ubbmap_requests_in_flight";
const STREAMS: &str = "ubbmap_streams_open";
const TRANSFERS: &str = "ubbmap_transfers_open";

/// Tells the recorder what each metric means. Call it once, after the recorder is installed.
pub fn describe_metrics() {
    describe_gauge!(REQUESTS, "Operations under way, on all transports");
    describe_gauge!(TRANSFERS, "Map files on their way to or from clients, on all transports");
    describe_gauge!(STREAMS, "Streams of scans and watches that are open, on all transports");
}

/// Limits that all transports share.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct DoorSettings {
    /// Most operations worked on at once.
    pub requests: usize,
    /// Most streams open at once.
    pub streams: usize,
    /// Most files on their way to or from clients at once: each is in memory as a whole.
    pub transfers: usize,
    /// Longest time for one operation.
    pub request_timeout: Duration,
    /// Longest time for the transfer of one file.
    pub transfer_timeout: Duration,
}

/// The one door of a server: every operation and every stream of every transport passes it. Cheap to clone.
#[derive(Debug, Clone)]
pub struct Door(Arc<Inner>);

#[derive(Debug)]
struct Inner {
    settings: DoorSettings,
    requests: Arc<Semaphore>,
    streams: Arc<Semaphore>,
    transfers: Arc<Semaphore>,
    draining: CancellationToken,
}

/// A place among the operations or streams under way; given back when dropped, also when the client has gone.
#[derive(Debug)]
pub struct Place {
    gauge: &'static str,
    _permit: OwnedSemaphorePermit,
}

impl Drop for Place {
    fn drop(&mut self) {
        gauge!(self.gauge).decrement(1.0);
    }
}

impl Door {
    /// An open door.
    #[must_use]
    pub fn new(settings: DoorSettings) -> Self {
        let semaphore = |places: usize| Arc::new(Semaphore::new(places.min(Semaphore::MAX_PERMITS)));
        let (requests, streams) = (semaphore(settings.requests), semaphore(settings.streams));
        let transfers = semaphore(settings.transfers);
        Self(Arc::new(Inner { settings, requests, streams, transfers, draining: CancellationToken::new() }))
    }

    /// A place for one operation.
    ///
    /// # Errors
    /// [`ErrorKind::Busy`]
    pub fn request(&self) -> Result<Place, ServiceError> {
        place(&self.0.requests, REQUESTS, || format!("{} requests are under way", self.0.settings.requests))
    }

    /// A place for one stream.
    ///
    /// # Errors
    /// [`ErrorKind::Busy`], [`ErrorKind::ShuttingDown`]: no stream begins once the server ends.
    pub fn stream(&self) -> Result<Place, ServiceError> {
        if self.is_draining() {
            return Err(ending());
        }
        place(&self.0.streams, STREAMS, || format!("{} streams are open", self.0.settings.streams))
    }

    /// A place for one file on its way.
    ///
    /// # Errors
    /// [`ErrorKind::Busy`], [`ErrorKind::ShuttingDown`]: no transfer begins once the server ends.
    pub fn transfer(&self) -> Result<Place, ServiceError> {
        if self.is_draining() {
            return Err(ending());
        }
        let full = || format!("{} files are being transferred", self.0.settings.transfers);
        place(&self.0.transfers, TRANSFERS, full)
    }

    /// How long the transfer of one file may take.
    #[must_use]
    pub fn transfer_timeout(&self) -> Duration {
        self.0.settings.transfer_timeout
    }

    /// Waits for a file for as long as one may take.
    ///
    /// # Errors
    /// [`ErrorKind::Timeout`]
    pub async fn timed_transfer<T>(&self, work: impl Future<Output = T>) -> Result<T, ServiceError> {
        let limit = self.transfer_timeout();
        tokio::time::timeout(limit, work).await.map_err(|_| out_of_time(limit))
    }

    /// Waits for an operation for as long as one may take.
    ///
    /// # Errors
    /// [`ErrorKind::Timeout`]
    pub async fn timed<T>(&self, work: impl Future<Output = T>) -> Result<T, ServiceError> {
        tokio::time::timeout(self.0.settings.request_timeout, work).await.map_err(|_| {
            let seconds = self.0.settings.request_timeout.as_secs_f64();
            let detail = format!("the request was not done within {seconds} s; scans it held may still be applied");
            ServiceError::new(ErrorKind::Timeout, detail)
        })
    }

    /// From now on the server is not ready, and its streams end.
    pub fn begin_draining(&self) {
        self.0.draining.cancel();
    }

    /// True once the server ends.
    #[must_use]
    pub fn is_draining(&self) -> bool {
        self.0.draining.is_cancelled()
    }

    /// Waits until the server ends.
    pub async fn draining(&self) {
        self.0.draining.cancelled().await;
    }
}

/// What a stream is told that ends because the server does.
#[must_use]
pub fn ending() -> ServiceError {
    ServiceError::new(ErrorKind::ShuttingDown, "the server is shutting down")
}

fn place(places: &Arc<Semaphore>, name: &'static str, full: impl Fn() -> String) -> Result<Place, ServiceError> {
    let permit = Arc::clone(places)
        .try_acquire_owned()
        .map_err(|_| ServiceError::new(ErrorKind::Busy, format!("{}, the limit: try again later", full())))?;
    gauge!(name).increment(1.0);
    Ok(Place { gauge: name, _permit: permit })
}

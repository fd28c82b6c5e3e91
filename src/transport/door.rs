//! Who may come in: operations and streams under way, the time they may take, and the end of the server.

use super::client::{Client, PerClient, Share};
use super::files::out_of_time;
use super::intake::Memory;
use crate::service::{ErrorKind, ServiceError, setting};
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
    super::intake::describe_metrics();
    describe_gauge!(STREAMS, "Streams of scans and watches that are open, on all transports");
}

/// Limits that all transports share.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct DoorSettings {
    /// Most operations worked on at once.
    pub requests: usize,
    /// Of these, most insertions: reads find a place whatever is sent.
    pub insertions: usize,
    /// Most streams open at once.
    pub streams: usize,
    /// Of these, most of one client.
    pub streams_per_client: usize,
    /// Most connections of one client.
    pub connections_per_client: usize,
    /// Largest head of a request, bytes.
    pub header_bytes: usize,
    /// Most bytes of bodies that are being read or worked on.
    pub incoming_bytes: usize,
    /// Most bytes of large answers on their way out.
    pub answer_bytes: usize,
    /// Most files on their way to or from clients at once: each is in memory as a whole.
    pub transfers: usize,
    /// Longest time for one operation.
    pub request_timeout: Duration,
    /// Longest time for the transfer of one file.
    pub transfer_timeout: Duration,
    /// How long a client may leave what it asked for untaken.
    pub idle_timeout: Duration,
}

/// The one door of a server: every operation and every stream of every transport passes it. Cheap to clone.
#[derive(Debug, Clone)]
pub struct Door(Arc<Inner>);

#[derive(Debug)]
struct Inner {
    settings: DoorSettings,
    requests: Arc<Semaphore>,
    insertions: Arc<Semaphore>,
    streams: Arc<Semaphore>,
    transfers: Arc<Semaphore>,
    streams_per_client: Arc<PerClient>,
    /// Calls of health and reflection, which are for everybody.
    asides: Arc<PerClient>,
    connections: Arc<PerClient>,
    incoming: Arc<Memory>,
    answers: Arc<Memory>,
    draining: CancellationToken,
}

/// A place among the operations or streams under way; given back when dropped, also when the client has gone.
#[derive(Debug)]
pub struct Place {
    gauge: &'static str,
    _permit: OwnedSemaphorePermit,
    /// One more that an insertion needs, and a client's share of the streams.
    more: (Option<OwnedSemaphorePermit>, Option<Share>),
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
        let (incoming, answers) =
            (Memory::of_requests(settings.incoming_bytes), Memory::of_answers(settings.answer_bytes));
        incoming.show();
        answers.show();
        Self(Arc::new(Inner {
            requests: semaphore(settings.requests),
            insertions: semaphore(settings.insertions),
            streams: semaphore(settings.streams),
            transfers: semaphore(settings.transfers),
            streams_per_client: PerClient::new(settings.streams_per_client),
            asides: PerClient::new(settings.streams_per_client),
            connections: PerClient::new(settings.connections_per_client),
            incoming,
            answers,
            settings,
            draining: CancellationToken::new(),
        }))
    }

    /// A place for one operation.
    ///
    /// # Errors
    /// [`ErrorKind::Busy`]
    pub fn request(&self) -> Result<Place, ServiceError> {
        let full = || format!("{} requests are under way", self.0.settings.requests);
        place(&self.0.requests, REQUESTS, setting::REQUESTS, full)
    }

    /// A place for one insertion, which may wait long: it is one of the operations, of which reads keep some.
    ///
    /// # Errors
    /// [`ErrorKind::Busy`]
    pub fn insertion(&self) -> Result<Place, ServiceError> {
        let full = || format!("{} insertions are under way", self.0.settings.insertions);
        let second = permit(&self.0.insertions, setting::INSERTIONS, full)?;
        let mut place = self.request()?;
        place.more.0 = Some(second);
        Ok(place)
    }

    /// A place for one stream, of a client where it is known.
    ///
    /// # Errors
    /// [`ErrorKind::Busy`], [`ErrorKind::ShuttingDown`]: no stream begins once the server ends.
    pub fn stream(&self, client: Option<&Client>) -> Result<Place, ServiceError> {
        if self.is_draining() {
            return Err(ending());
        }
        let share = client.map(|client| self.share(&self.0.streams_per_client, client)).transpose()?;
        let full = || format!("{} streams are open", self.0.settings.streams);
        let mut place = place(&self.0.streams, STREAMS, setting::STREAMS, full)?;
        place.more.1 = share;
        Ok(place)
    }

    /// Streams that are open.
    #[must_use]
    pub fn streams_open(&self) -> usize {
        self.0.settings.streams.saturating_sub(self.0.streams.available_permits())
    }

    /// A client's share of what is for everybody and takes no place of what is not: health and reflection.
    ///
    /// # Errors
    /// [`ErrorKind::Busy`]
    pub fn aside(&self, client: Option<&Client>) -> Result<Option<Share>, ServiceError> {
        client.map(|client| self.share(&self.0.asides, client)).transpose()
    }

    fn share(&self, shares: &Arc<PerClient>, client: &Client) -> Result<Share, ServiceError> {
        shares.take(client.address(), 0).ok_or_else(|| {
            let most = self.0.settings.streams_per_client;
            let detail = format!("this client has {most} streams open, the limit: end some, then try again");
            ServiceError::over(ErrorKind::Busy, setting::STREAMS_PER_CLIENT, detail)
        })
    }

    /// The connections of each client.
    #[must_use]
    pub fn connections(&self) -> &Arc<PerClient> {
        &self.0.connections
    }

    /// Largest head of a request, bytes.
    #[must_use]
    pub fn header_bytes(&self) -> usize {
        self.0.settings.header_bytes
    }

    /// The memory for what comes in.
    #[must_use]
    pub fn incoming(&self) -> &Arc<Memory> {
        &self.0.incoming
    }

    /// The memory for what goes out.
    #[must_use]
    pub fn answers(&self) -> &Arc<Memory> {
        &self.0.answers
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
        place(&self.0.transfers, TRANSFERS, setting::TRANSFERS, full)
    }

    /// How long the transfer of one file may take.
    #[must_use]
    pub fn transfer_timeout(&self) -> Duration {
        self.0.settings.transfer_timeout
    }

    /// How long one operation may take.
    #[must_use]
    pub fn request_timeout(&self) -> Duration {
        self.0.settings.request_timeout
    }

    /// How long a client may leave what it asked for untaken.
    #[must_use]
    pub fn idle_timeout(&self) -> Duration {
        self.0.settings.idle_timeout
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
            ServiceError::over(ErrorKind::Timeout, setting::REQUEST_SECONDS, detail)
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

fn place(
    places: &Arc<Semaphore>,
    name: &'static str,
    setting: &'static str,
    full: impl Fn() -> String,
) -> Result<Place, ServiceError> {
    let permit = permit(places, setting, full)?;
    gauge!(name).increment(1.0);
    Ok(Place { gauge: name, _permit: permit, more: (None, None) })
}

fn permit(
    places: &Arc<Semaphore>,
    setting: &'static str,
    full: impl Fn() -> String,
) -> Result<OwnedSemaphorePermit, ServiceError> {
    let busy = || ServiceError::over(ErrorKind::Busy, setting, format!("{}, the limit: try again later", full()));
    Arc::clone(places).try_acquire_owned().map_err(|_| busy())
}

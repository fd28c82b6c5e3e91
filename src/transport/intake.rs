//! What requests and answers hold in memory on their way in and out, all clients together.

use crate::service::{ErrorKind, ServiceError, setting};
use axum::Error;
use axum::body::{Body, Bytes, HttpBody};
use axum::response::Response;
use hyper::body::{Frame, SizeHint};
use metrics::{describe_gauge, gauge};
use std::future::Future;
use std::pin::Pin;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::task::{Context, Poll, ready};
use std::time::Duration;
use tokio::time::{Sleep, sleep};

const INCOMING: &str = "ubbmap_incoming_bytes";
const ANSWERS: &str = "ubbmap_answer_bytes";

/// Tells the recorder what each metric means.
pub(super) fn describe_metrics() {
    describe_gauge!(INCOMING, "Bytes of requests that are being read or worked on, of REST and gRPC");
    describe_gauge!(ANSWERS, "Bytes of large answers on their way out, of REST and gRPC");
}

/// Answers up to this many bytes are not counted: their number is limited by that of requests.
const SMALL: usize = 64 * 1024;

/// Pieces of answers below this many bytes are not worth an owner of their own.
const COPIED: usize = 4096;

/// Bytes before a message of gRPC: a flag and the length.
const PREFIX: usize = 5;

/// Memory for one purpose, under a limit.
#[derive(Debug)]
pub struct Memory {
    setting: &'static str,
    gauge: &'static str,
    what: &'static str,
    /// What it is when one alone is larger than the limit.
    too_large: ErrorKind,
    limit: usize,
    used: AtomicUsize,
}

/// A part of it; given back when it is dropped.
#[derive(Debug)]
pub struct Held {
    memory: Arc<Memory>,
    bytes: Mutex<usize>,
}

impl Memory {
    /// So many bytes for the bodies of requests.
    #[must_use]
    pub fn of_requests(limit: usize) -> Arc<Self> {
        let (setting, what) = (setting::INCOMING_BYTES, "requests on their way");
        let too_large = ErrorKind::BodyTooLarge;
        Arc::new(Self { setting, gauge: INCOMING, what, too_large, limit, used: AtomicUsize::new(0) })
    }

    /// So many bytes for large answers.
    #[must_use]
    pub fn of_answers(limit: usize) -> Arc<Self> {
        let (setting, what) = (setting::ANSWER_BYTES, "answers on their way");
        let too_large = ErrorKind::RegionTooLarge;
        Arc::new(Self { setting, gauge: ANSWERS, what, too_large, limit, used: AtomicUsize::new(0) })
    }

    /// Shows the gauge before anything is held.
    pub(super) fn show(&self) {
        gauge!(self.gauge).set(self.used.load(Ordering::Relaxed) as f64);
    }

    /// A part of no bytes yet.
    #[must_use]
    pub fn hold(self: &Arc<Self>) -> Arc<Held> {
        Arc::new(Held { memory: Arc::clone(self), bytes: Mutex::new(0) })
    }

    /// Room for an answer of so many bytes; none is needed for a small one.
    ///
    /// # Errors
    /// As [`Held::set`].
    pub fn answer(self: &Arc<Self>, bytes: usize) -> Result<Option<Arc<Held>>, ServiceError> {
        if bytes <= SMALL {
            return Ok(None);
        }
        let held = self.hold();
        held.set(bytes)?;
        Ok(Some(held))
    }
}

impl Held {
    /// Takes so many bytes more.
    ///
    /// # Errors
    /// As [`Held::set`].
    pub fn grow(&self, bytes: usize) -> Result<(), ServiceError> {
        let held = *self.bytes.lock().unwrap_or_else(PoisonError::into_inner);
        self.set(held.saturating_add(bytes))
    }

    /// Holds so many bytes from now on.
    ///
    /// # Errors
    /// [`ErrorKind::Busy`] where others hold what is missing; where the limit itself is less, [`ErrorKind::BodyTooLarge`] of a
    /// request and [`ErrorKind::RegionTooLarge`] of an answer.
    pub fn set(&self, bytes: usize) -> Result<(), ServiceError> {
        let Memory { setting, gauge, what, too_large, limit, used } = &*self.memory;
        let mut held = self.bytes.lock().unwrap_or_else(PoisonError::into_inner);
        if bytes > *held {
            let more = bytes - *held;
            let fits = |used: usize| used.checked_add(more).filter(|sum| sum <= limit);
            if used.fetch_update(Ordering::Relaxed, Ordering::Relaxed, fits).is_err() {
                let (kind, detail) = if bytes > *limit {
                    (*too_large, format!("{bytes} bytes are needed, and {what} may take {limit} together"))
                } else {
                    (ErrorKind::Busy, format!("{what} take {limit} bytes, all that there are: try again later"))
                };
                return Err(ServiceError::over(kind, setting, detail));
            }
        } else {
            used.fetch_sub(*held - bytes, Ordering::Relaxed);
        }
        gauge!(*gauge).set(used.load(Ordering::Relaxed) as f64);
        *held = bytes;
        Ok(())
    }
}

impl Drop for Held {
    fn drop(&mut self) {
        // Giving back cannot fail.
        let _ = self.set(0);
    }
}

/// How long what comes in stays in memory.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Shape {
    /// As a whole, until the answer.
    Whole,
    /// Message by message of gRPC.
    Messages,
    /// Line by line.
    Lines,
}

/// A body whose bytes are counted as they come.
struct Incoming {
    body: Body,
    held: Arc<Held>,
    shape: Shape,
    /// Of the message or line that is coming.
    begun: usize,
    prefix: Vec<u8>,
    /// What of the message is still to come.
    rest: usize,
    /// How long a message or line may take from its first byte to its last: while it comes it holds memory that others want.
    patience: Duration,
    /// Runs while one is coming.
    coming: Option<Pin<Box<Sleep>>>,
    wrap: fn(ServiceError) -> Error,
}

/// Counts a body's bytes, and ends one of which a message or line has begun and takes longer than `patience`. `wrap` makes of a
/// refusal what the body's reader knows.
pub fn counted(body: Body, held: Arc<Held>, shape: Shape, patience: Duration, wrap: fn(ServiceError) -> Error) -> Body {
    Body::new(Incoming { body, held, shape, begun: 0, prefix: Vec::new(), rest: 0, patience, coming: None, wrap })
}

impl Incoming {
    fn take(&mut self, data: &[u8]) -> Result<(), ServiceError> {
        match self.shape {
            Shape::Whole => self.held.grow(data.len()),
            Shape::Lines => {
                let end = data.iter().rposition(|byte| *byte == b'\n');
                if end.is_some() {
                    self.coming = None;
                }
                self.begun = end.map_or(self.begun + data.len(), |end| data.len() - end - 1);
                self.held.set(self.begun)
            }
            Shape::Messages => {
                self.messages(data);
                self.held.set(self.begun)
            }
        }
    }

    /// Is it too late for the rest of what has begun? A body that is held whole begins when it is first waited for; between two
    /// messages or lines there may be any time.
    fn is_late(&mut self, context: &mut Context<'_>) -> bool {
        if self.shape != Shape::Whole && self.begun == 0 {
            return false;
        }
        let patience = self.patience;
        self.coming.get_or_insert_with(|| Box::pin(sleep(patience))).as_mut().poll(context).is_ready()
    }

    fn late(&self) -> ServiceError {
        let what = match self.shape {
            Shape::Whole => "body",
            Shape::Messages => "message",
            Shape::Lines => "line",
        };
        let detail = format!("a {what} that has begun did not end within {} s", self.patience.as_secs_f64());
        ServiceError::over(ErrorKind::Timeout, setting::REQUEST_SECONDS, detail)
    }

    /// Goes over the messages that end in `data`; `begun` is then what there is of the next.
    fn messages(&mut self, mut data: &[u8]) {
        while !data.is_empty() {
            if self.rest == 0 {
                let missing = data.len().min(PREFIX - self.prefix.len());
                self.prefix.extend_from_slice(&data[..missing]);
                data = &data[missing..];
                self.begun += missing;
                let [_, a, b, c, d] = *self.prefix.as_slice() else { continue };
                self.prefix.clear();
                self.rest = u32::from_be_bytes([a, b, c, d]) as usize;
            } else {
                let part = data.len().min(self.rest);
                data = &data[part..];
                self.begun += part;
                self.rest -= part;
            }
            if self.rest == 0 && self.prefix.is_empty() {
                (self.begun, self.coming) = (0, None);
            }
        }
    }
}

impl HttpBody for Incoming {
    type Data = Bytes;
    type Error = Error;

    fn poll_frame(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<Option<Result<Frame<Bytes>, Error>>> {
        let Poll::Ready(frame) = Pin::new(&mut self.body).poll_frame(context) else {
            if self.is_late(context) {
                let late = self.late();
                return Poll::Ready(Some(Err((self.wrap)(late))));
            }
            return Poll::Pending;
        };
        let Some(frame) = frame.transpose()? else { return Poll::Ready(None) };
        if let Some(data) = frame.data_ref()
            && let Err(error) = self.take(data)
        {
            return Poll::Ready(Some(Err((self.wrap)(error))));
        }
        Poll::Ready(Some(Ok(frame)))
    }

    fn is_end_stream(&self) -> bool {
        self.body.is_end_stream()
    }

    fn size_hint(&self) -> SizeHint {
        self.body.size_hint()
    }
}

/// The refusal that a body of [`counted`] ended in, where it did.
pub fn refusal(error: Error) -> Option<ServiceError> {
    // Each layer between has put it into an error of its own.
    match error.into_inner().downcast::<Error>() {
        Ok(inner) => refusal(*inner),
        Err(error) => error.downcast::<ServiceError>().ok().map(|error| *error),
    }
}

/// A body that holds something until it has gone out, or its client has.
struct Outgoing<T> {
    body: Body,
    kept: Arc<T>,
}

/// A piece of such a body: the connection takes it over as it is, and may have it for long.
struct Piece<T> {
    bytes: Bytes,
    _kept: Arc<T>,
}

impl<T> AsRef<[u8]> for Piece<T> {
    fn as_ref(&self) -> &[u8] {
        &self.bytes
    }
}

/// Keeps something until the answer has gone out.
pub fn keep<T: Send + Sync + 'static>(response: Response, kept: T) -> Response {
    response.map(|body| Body::new(Outgoing { body, kept: Arc::new(kept) }))
}

impl<T: Send + Sync + 'static> HttpBody for Outgoing<T> {
    type Data = Bytes;
    type Error = Error;

    fn poll_frame(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<Option<Result<Frame<Bytes>, Error>>> {
        let frame = ready!(Pin::new(&mut self.body).poll_frame(context));
        let piece = |bytes: Bytes| {
            // Small ones are copied into what goes out.
            if bytes.len() < COPIED {
                return bytes;
            }
            Bytes::from_owner(Piece { bytes, _kept: Arc::clone(&self.kept) })
        };
        Poll::Ready(frame.map(|frame| frame.map(|frame| frame.map_data(piece))))
    }

    fn is_end_stream(&self) -> bool {
        self.body.is_end_stream()
    }

    fn size_hint(&self) -> SizeHint {
        self.body.size_hint()
    }
}

#[cfg(test)]
#[path = "intake_tests.rs"]
mod tests;

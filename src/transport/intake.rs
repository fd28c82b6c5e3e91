//! What requests and answers hold in memory on their way in and out, all clients together.

use crate::service::{ErrorKind, ServiceError, setting};
use axum::Error;
use axum::body::{Body, Bytes, HttpBody};
use hyper::body::{Frame, SizeHint};
use metrics::{describe_gauge, gauge};
use std::pin::Pin;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::task::{Context, Poll};
use std::time::Duration;
use tokio::time::{Instant, Sleep, sleep};

const INCOMING: &str = "ubbmap_incoming_bytes";
const ANSWERS: &str = "ubbmap_answer_bytes";

/// Tells the recorder what each metric means.
pub(super) fn describe_metrics() {
    describe_gauge!(INCOMING, "Bytes of requests that are being read or worked on, of REST and gRPC");
    describe_gauge!(ANSWERS, "Bytes of answers above 4 KiB on their way out, of REST and gRPC");
}

/// Answers up to this many bytes are not counted: their number is limited by that of requests on all connections.
const SMALL: usize = 4096;

/// How often a clock is looked at while a message is waited for, at least.
const LONGEST_TICK: Duration = Duration::from_secs(1);

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
        gauge!(self.gauge).set(self.used() as f64);
    }

    /// Bytes that are held.
    #[must_use]
    pub fn used(&self) -> usize {
        self.used.load(Ordering::Relaxed)
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
    wrap: fn(ServiceError) -> Error,
    /// How long a message or line that was begun may be waited for.
    patience: Duration,
    /// How long it was, and the clock that counts while it is: time in which nobody reads here is not the sender's.
    waited: Duration,
    tick: Option<Pin<Box<Sleep>>>,
}

/// Counts a body's bytes. `wrap` makes of a refusal what the body's reader knows; a message or line that was begun is waited
/// for no longer than `patience`. A whole body's time is the request's.
pub fn counted(body: Body, held: Arc<Held>, shape: Shape, wrap: fn(ServiceError) -> Error, patience: Duration) -> Body {
    let (begun, prefix, rest) = (0, Vec::new(), 0);
    Body::new(Incoming { body, held, shape, begun, prefix, rest, wrap, patience, waited: Duration::ZERO, tick: None })
}

impl Incoming {
    fn take(&mut self, data: &[u8]) -> Result<(), ServiceError> {
        match self.shape {
            Shape::Whole => self.held.grow(data.len()),
            Shape::Lines => {
                let end = data.iter().rposition(|byte| *byte == b'\n');
                if end.is_some() {
                    self.done();
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
                self.begun = 0;
                self.done();
            }
        }
    }

    /// A message or line is here as a whole.
    fn done(&mut self) {
        self.waited = Duration::ZERO;
        self.tick = None;
    }

    /// Has one that was begun been waited for too long? Wakes its reader when it has.
    fn is_late(&mut self, context: &mut Context<'_>) -> bool {
        if self.shape == Shape::Whole || self.begun == 0 {
            return false;
        }
        let span = (self.patience / 8).min(LONGEST_TICK);
        let tick = self.tick.get_or_insert_with(|| Box::pin(sleep(span)));
        while self.waited < self.patience && tick.as_mut().poll(context).is_ready() {
            self.waited += span;
            tick.as_mut().reset(Instant::now() + span);
        }
        self.waited >= self.patience
    }

    fn late(&self) -> ServiceError {
        let seconds = self.patience.as_secs_f64();
        let what = if self.shape == Shape::Lines { "line" } else { "message" };
        let detail = format!("a {what} that was begun did not end within {seconds} s");
        ServiceError::over(ErrorKind::Timeout, setting::REQUEST_SECONDS, detail)
    }
}

impl HttpBody for Incoming {
    type Data = Bytes;
    type Error = Error;

    fn poll_frame(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<Option<Result<Frame<Bytes>, Error>>> {
        let frame = match Pin::new(&mut self.body).poll_frame(context) {
            Poll::Ready(frame) => frame.transpose()?,
            Poll::Pending if self.is_late(context) => return Poll::Ready(Some(Err((self.wrap)(self.late())))),
            Poll::Pending => return Poll::Pending,
        };
        let Some(frame) = frame else { return Poll::Ready(None) };
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

#[cfg(test)]
#[path = "intake_tests.rs"]
mod tests;

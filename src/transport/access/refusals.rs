//! Refusals: as an error for the client, as a count, and as a line of the log now and then.

use super::Peer;
use crate::service::{ErrorKind, ServiceError};
use metrics::{counter, describe_counter};
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

pub(super) const REFUSED: &str = "ubbmap_access_refused_total";

/// At most one line of refusals in so long: whoever knocks without end must not fill the disk.
const LINE_EVERY: Duration = Duration::from_secs(1);

/// Tells the recorder what each metric means.
pub(super) fn describe_metrics() {
    describe_counter!(REFUSED, "Requests refused by access, by reason");
}

/// Shows every reason from the start, so that a rate sees the first refusal.
pub(super) fn show_metrics() {
    Reason::ALL.into_iter().for_each(|reason| counter!(REFUSED, "reason" => reason.word()).increment(0));
}

/// Why somebody was refused, as the metric and the log say it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Reason {
    /// Nothing was shown.
    Missing,
    /// What was shown is no token.
    Malformed,
    /// A token or certificate that nobody has.
    Unknown,
    /// It was good until a time.
    Expired,
    /// It was good until it was taken back.
    Revoked,
    /// The role is too low.
    Role,
    /// The map is not one of theirs.
    Map,
    /// The robot is not theirs.
    Robot,
    /// Administration has another listener.
    Listener,
}

impl Reason {
    const ALL: [Self; 9] = [
        Self::Missing,
        Self::Malformed,
        Self::Unknown,
        Self::Expired,
        Self::Revoked,
        Self::Role,
        Self::Map,
        Self::Robot,
        Self::Listener,
    ];

    /// Its word.
    #[must_use]
    pub fn word(self) -> &'static str {
        match self {
            Self::Missing => "missing",
            Self::Malformed => "malformed",
            Self::Unknown => "unknown",
            Self::Expired => "expired",
            Self::Revoked => "revoked",
            Self::Role => "role",
            Self::Map => "map",
            Self::Robot => "robot",
            Self::Listener => "listener",
        }
    }
}

/// A refusal. It becomes the client's error when it has been noted.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Refused {
    /// Why.
    pub reason: Reason,
    error: ServiceError,
}

impl Refused {
    /// It is not known who asks.
    pub(super) fn unknown(reason: Reason, detail: impl Into<String>) -> Self {
        Self { reason, error: ServiceError::new(ErrorKind::Unauthenticated, detail) }
    }

    /// It is known, and they may not.
    pub(super) fn denied(reason: Reason, detail: impl Into<String>) -> Self {
        Self { reason, error: ServiceError::new(ErrorKind::PermissionDenied, detail) }
    }

    /// Names the field at fault.
    pub(super) fn at(mut self, field: &str) -> Self {
        self.error = self.error.at(field);
        self
    }

    /// What the client is told, without a count or a line: for tests and for what is noted elsewhere.
    #[must_use]
    pub fn into_error(self) -> ServiceError {
        self.error
    }
}

/// Where refusals are counted and logged.
#[derive(Debug, Default)]
pub(super) struct Refusals(Mutex<Lines>);

#[derive(Debug, Default)]
struct Lines {
    last: Option<Instant>,
    unsaid: u64,
}

impl Refusals {
    /// Counts a refusal, and logs it unless another was logged just now. Neither tells what was shown: it may be a token
    /// that is good elsewhere.
    pub(super) fn note(&self, refused: Refused, peer: &Peer) -> ServiceError {
        counter!(REFUSED, "reason" => refused.reason.word()).increment(1);
        if let Some(unsaid) = self.line() {
            let peer = peer.address.map(tracing::field::display);
            let Refused { reason, error } = &refused;
            let reason = reason.word();
            // Somebody who shows nothing may not know that it takes a token; who shows what is no good had one, or guesses.
            if error.kind == ErrorKind::Unauthenticated && reason != Reason::Missing.word() {
                tracing::warn!(target: "ubbmap::access", reason, peer, unsaid, "refused: {}", error.detail);
            } else {
                tracing::info!(target: "ubbmap::access", reason, peer, unsaid, "refused: {}", error.detail);
            }
        }
        refused.error
    }

    /// Whether to write a line now, and how many refusals went without one since the last.
    fn line(&self) -> Option<u64> {
        let now = Instant::now();
        let mut lines = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        if lines.last.is_some_and(|last| now.duration_since(last) < LINE_EVERY) {
            lines.unsaid += 1;
            return None;
        }
        lines.last = Some(now);
        Some(std::mem::take(&mut lines.unsaid))
    }
}

//! One line of the log for every change by an administrator: who, what, to which map, and what came of it.

use super::guarded::Origin;
use super::{Caller, Operation};
use crate::service::ServiceError;
use crate::store::MapName;

/// What the outcome is called where the request ended before the change did.
const UNKNOWN: &str = "UNKNOWN";

/// A change under way. Whatever becomes of it is written down, also when its client goes away: a change that has begun may
/// be made all the same.
pub(super) struct Change<'a> {
    caller: &'a Caller,
    origin: &'a Origin,
    operation: Operation,
    map: &'a MapName,
    /// The snapshot, where it is one of a snapshot.
    snapshot: Option<&'a str>,
    /// Nobody was asked who they are, although strangers reach the server.
    insecure: bool,
    outcome: &'static str,
}

impl<'a> Change<'a> {
    /// A change that begins now.
    pub(super) fn begin(
        caller: &'a Caller,
        origin: &'a Origin,
        insecure: bool,
        operation: Operation,
        map: &'a MapName,
        snapshot: Option<&'a str>,
    ) -> Self {
        Self { caller, origin, operation, map, snapshot, insecure, outcome: UNKNOWN }
    }

    /// Writes down what came of it.
    pub(super) fn end<T>(mut self, outcome: Result<T, ServiceError>) -> Result<T, ServiceError> {
        self.outcome = outcome.as_ref().map_or_else(|error| error.kind.code(), |_| "OK");
        outcome
    }
}

/// The same line at two levels: a change that nobody was asked to answer for is worth a warning.
macro_rules! line {
    ($level:expr, $change:expr) => {
        tracing::event!(
            target: "ubbmap::audit",
            $level,
            caller = $change.caller.name(),
            operation = $change.operation.method(),
            map = $change.map.as_str(),
            snapshot = $change.snapshot,
            outcome = $change.outcome,
            transport = $change.origin.transport,
            peer = $change.origin.peer.address.map(tracing::field::display),
            request_id = $change.origin.request_id.as_deref(),
            insecure = $change.insecure,
            "change"
        )
    };
}

impl Drop for Change<'_> {
    fn drop(&mut self) {
        if self.insecure {
            line!(tracing::Level::WARN, self);
        } else {
            line!(tracing::Level::INFO, self);
        }
    }
}

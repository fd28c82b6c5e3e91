//! In place of traces, where the program was built without the feature `otel`.

use crate::config::Telemetry;
use axum::Router;
use tracing_subscriber::{Layer, Registry};

/// The target of the spans that there would be.
pub(super) const TARGET: &str = "ubbmap::otel";

/// There are none.
#[derive(Debug)]
pub enum Traces {}

impl Traces {
    /// Starts nothing: settings that ask for traces are refused before.
    ///
    /// # Errors
    /// None.
    pub fn start(_settings: &Telemetry) -> Result<Option<Self>, String> {
        Ok(None)
    }

    /// The layer that turns the spans of requests into traces.
    #[must_use]
    pub fn layer(&self) -> Box<dyn Layer<Registry> + Send + Sync> {
        match *self {}
    }

    /// Sends what is left.
    pub fn end(self) {
        match self {}
    }
}

/// The routes as they are.
pub fn trace_requests(router: Router) -> Router {
    router
}

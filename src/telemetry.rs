//! Floor 6: log lines to stderr, traces by the feature `otel`, and the recorder of the metrics.

#[cfg(feature = "otel")]
mod otel;
#[cfg(not(feature = "otel"))]
#[path = "telemetry/no_otel.rs"]
mod otel;

use crate::config::LogFormat;
use metrics_exporter_prometheus::{PrometheusBuilder, PrometheusHandle};
use std::io::IsTerminal;
use std::sync::OnceLock;
use tracing_subscriber::layer::SubscriberExt;
use tracing_subscriber::util::SubscriberInitExt;
use tracing_subscriber::{EnvFilter, Layer, Registry};

pub use otel::{Traces, trace_requests};

/// Bounds of the histogram buckets for durations, seconds.
const SECONDS_BUCKETS: [f64; 14] =
    [0.0005, 0.001, 0.0025, 0.005, 0.01, 0.025, 0.05, 0.1, 0.25, 0.5, 1.0, 2.5, 5.0, 10.0];

/// Is this a level or filter that [`init`] takes?
///
/// # Errors
/// What is wrong with it.
pub fn check_filter(filter: &str) -> Result<(), String> {
    EnvFilter::try_new(filter).map(drop).map_err(|error| format!("invalid filter {filter:?}: {error}"))
}

/// Sends the process's log lines to stderr. `RUST_LOG` stands above `filter` where it is set and valid. Does nothing
/// when a subscriber is there already. Spans of requests go to `traces`.
pub fn init(filter: &str, format: LogFormat, traces: Option<&Traces>) {
    let filter = EnvFilter::try_from_default_env()
        .or_else(|_| EnvFilter::try_new(filter))
        .unwrap_or_else(|_| EnvFilter::new("info"));
    // Spans of requests are for traces alone.
    let filter = match format!("{}=off", otel::TARGET).parse() {
        Ok(directive) => filter.add_directive(directive),
        Err(_) => filter,
    };
    // Colours are for people at a terminal, not for files.
    let colours = std::io::stderr().is_terminal();
    let lines = tracing_subscriber::fmt::layer().with_writer(std::io::stderr).with_ansi(colours);
    let lines: Box<dyn Layer<Registry> + Send + Sync> = match format {
        LogFormat::Text => lines.compact().with_filter(filter).boxed(),
        LogFormat::Json => lines.json().flatten_event(true).with_filter(filter).boxed(),
    };
    let layers: Vec<_> = std::iter::once(lines).chain(traces.map(Traces::layer)).collect();
    // A second server of one process keeps the first one's subscriber.
    let _ = tracing_subscriber::registry().with(layers).try_init();
}

/// The recorder of the process's metrics, installed at the first call; every server of the process shows the same.
#[must_use]
pub fn metrics_handle() -> PrometheusHandle {
    static HANDLE: OnceLock<PrometheusHandle> = OnceLock::new();
    HANDLE
        .get_or_init(|| {
            let builder = PrometheusBuilder::new();
            // Fails for an empty list of buckets only.
            let recorder =
                builder.set_buckets(&SECONDS_BUCKETS).unwrap_or_else(|_| PrometheusBuilder::new()).build_recorder();
            let handle = recorder.handle();
            if metrics::set_global_recorder(recorder).is_err() {
                tracing::warn!("another metrics recorder is installed: /metrics stays empty");
            }
            crate::reload::describe_metrics();
            crate::service::describe_metrics();
            crate::transport::access::describe_metrics();
            crate::transport::door::describe_metrics();
            crate::transport::grpc::describe_metrics();
            crate::transport::http::describe_metrics();
            crate::transport::tls::describe_metrics();
            crate::transport::zenoh::describe_metrics();
            handle
        })
        .clone()
}

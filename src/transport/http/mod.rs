//! REST: routes, bodies, forms of answers and problems. What an operation means is the service's alone.

mod accept;
mod body;
#[cfg(test)]
mod http_tests;
mod maps;
mod observe;
mod params;
mod path;
mod pictures;
mod problem;
mod queries;
mod rasters;
mod respond;
mod scans;
mod serve;
mod system;

use crate::service::MapService;
use axum::Router;
use axum::routing::{get, post};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;
use tokio::sync::Semaphore;
use tower_http::catch_panic::CatchPanicLayer;
use tower_http::trace::TraceLayer;

pub use observe::describe_metrics;
pub use problem::{HttpError, Problem};
pub use serve::{ServeLimits, serve};

/// Limits that are HTTP's own; those of operations are the service's.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct HttpSettings {
    /// Largest body, bytes, also after decompression.
    pub body_bytes: usize,
    /// Largest body of a map configuration, bytes.
    pub config_bytes: usize,
    /// Most requests worked on at once.
    pub requests: usize,
    /// Longest time for one request.
    pub request_timeout: Duration,
}

/// Writes the metrics in the text form of Prometheus.
pub type RenderMetrics = Arc<dyn Fn() -> String + Send + Sync>;

/// Whether the server takes new work; a latch that only closes.
#[derive(Debug, Clone, Default)]
pub struct Draining(Arc<AtomicBool>);

impl Draining {
    /// From now on the server is not ready.
    pub fn begin(&self) {
        self.0.store(true, Ordering::Release);
    }

    /// True once it began.
    #[must_use]
    pub fn has_begun(&self) -> bool {
        self.0.load(Ordering::Acquire)
    }
}

/// What every handler has.
struct Shared {
    service: MapService,
    settings: HttpSettings,
    draining: Draining,
    metrics: RenderMetrics,
    requests: Arc<Semaphore>,
}

type App = Arc<Shared>;

/// The routes over a service.
pub fn router(service: MapService, settings: HttpSettings, draining: Draining, metrics: RenderMetrics) -> Router {
    let requests = Arc::new(Semaphore::new(settings.requests));
    let shared = Arc::new(Shared { service, settings, draining, metrics, requests });
    Router::new()
        .route("/", get(system::index))
        .route("/healthz", get(system::healthz))
        .route("/readyz", get(system::readyz))
        .route("/metrics", get(system::metrics))
        .route("/v1/maps", get(maps::list))
        .route("/v1/maps/{map}", get(maps::read).put(maps::create).delete(maps::delete))
        .route("/v1/maps/{map}/scans", post(scans::insert))
        .route("/v1/maps/{map}/classes", post(queries::classes))
        .route("/v1/maps/{map}/guaranteed-free", post(queries::guaranteed_free))
        .route("/v1/maps/{map}/region", get(queries::region))
        .route("/v1/maps/{map}/grid", get(rasters::grid))
        .route("/v1/maps/{map}/tiles/{z}/{x}/{y}", get(rasters::tile))
        .fallback(system::route_not_found)
        .method_not_allowed_fallback(system::method_not_allowed)
        .layer(CatchPanicLayer::custom(observe::panicked))
        .layer(axum::middleware::from_fn_with_state(Arc::clone(&shared), observe::observe))
        .layer(TraceLayer::new_for_http().on_failure(()))
        .with_state(shared)
}

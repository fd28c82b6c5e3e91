//! REST: routes, bodies, forms of answers and problems. What an operation means is the service's alone.

mod accept;
mod access;
mod body;
mod changes;
#[cfg(test)]
mod http_tests;
mod lines;
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
mod snapshots;
mod system;
mod transfer;
mod viewer;

use super::access::Guarded;
use super::door::Door;
use axum::Router;
use axum::routing::{delete, get, post, put};
use std::sync::Arc;
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
    /// Largest map file that is imported, bytes.
    pub import_bytes: usize,
    /// Most scans of one stream that are not acknowledged yet.
    pub scans_per_stream: usize,
}

/// What health and metrics tell that no handler knows by itself.
pub struct OutsideView {
    /// Writes the metrics in the text form of Prometheus.
    pub metrics: Box<dyn Fn() -> String + Send + Sync>,
    /// False while the server is not to be reached over another transport that it should be on.
    pub reachable: Box<dyn Fn() -> bool + Send + Sync>,
}

/// What every handler has.
struct Shared {
    service: Guarded,
    settings: HttpSettings,
    door: Door,
    outside: OutsideView,
}

type App = Arc<Shared>;

/// The routes over a service.
pub fn router(service: Guarded, settings: HttpSettings, door: Door, outside: OutsideView) -> Router {
    let shared = Arc::new(Shared { service, settings, door, outside });
    Router::new()
        .route("/", get(viewer::index))
        .route("/viewer/{*path}", get(viewer::asset))
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
        .route("/v1/maps/{map}/robots", get(queries::robots))
        .route("/v1/maps/{map}/changes", get(changes::since))
        .route("/v1/maps/{map}/events", get(changes::events))
        .route("/v1/maps/{map}/tiles/{z}/{x}/{y}", get(rasters::tile))
        .route("/v1/maps/{map}/snapshots", get(snapshots::list).post(snapshots::create))
        .route("/v1/maps/{map}/snapshots/{name}", delete(snapshots::delete))
        .route("/v1/maps/{map}/snapshots/{name}/restore", post(snapshots::restore))
        .route("/v1/maps/{map}/export", get(transfer::export))
        .route(observe::IMPORT, put(transfer::import))
        .fallback(system::route_not_found)
        .method_not_allowed_fallback(system::method_not_allowed)
        .layer(CatchPanicLayer::custom(observe::panicked))
        .layer(axum::middleware::from_fn_with_state(Arc::clone(&shared), observe::observe))
        .layer(TraceLayer::new_for_http().on_failure(()))
        .with_state(shared)
}

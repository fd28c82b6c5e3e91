//! REST: routes, bodies, forms of answers and problems. What an operation means is the service's alone.

mod accept;
mod access;
mod body;
mod changes;
mod cors;
#[cfg(test)]
mod http_tests;
mod lines;
mod lingering;
mod maps;
mod observe;
mod openapi;
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
mod steady;
mod system;
mod transfer;
mod viewer;

use super::access::Guarded;
use super::door::Door;
use crate::service::setting;
use axum::Router;
use axum::routing::get;
use body::Limit;
use std::sync::Arc;
use tower_http::catch_panic::CatchPanicLayer;
use tower_http::trace::TraceLayer;

use openapi::{Routes, table};

pub use cors::cors;
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

impl HttpSettings {
    fn body_limit(&self) -> Limit {
        Limit { bytes: self.body_bytes, setting: setting::BODY_BYTES }
    }

    fn config_limit(&self) -> Limit {
        Limit { bytes: self.config_bytes, setting: setting::CONFIG_BYTES }
    }

    fn import_limit(&self) -> Limit {
        Limit { bytes: self.import_bytes, setting: setting::IMPORT_BYTES }
    }
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
    routes()
        .done()
        .route("/viewer/{*path}", get(viewer::asset))
        .fallback(system::route_not_found)
        .method_not_allowed_fallback(system::method_not_allowed)
        .layer(CatchPanicLayer::custom(observe::panicked))
        .layer(axum::middleware::from_fn_with_state(Arc::clone(&shared), observe::observe))
        .layer(TraceLayer::new_for_http().on_failure(()))
        .with_state(shared)
}

/// Every operation with what serves it.
fn routes() -> Routes {
    Routes::default()
        .at(&table::CREATE_MAP, maps::create)
        .at(&table::LIST_MAPS, maps::list)
        .at(&table::GET_MAP, maps::read)
        .at(&table::DELETE_MAP, maps::delete)
        .at(&table::INSERT_SCANS, scans::insert)
        .at(&table::GET_CLASSES, queries::classes)
        .at(&table::CHECK_GUARANTEED_FREE, queries::guaranteed_free)
        .at(&table::GET_REGION, queries::region)
        .at(&table::GET_GRID, rasters::grid)
        .at(&table::LIST_ROBOTS, queries::robots)
        .at(&table::GET_TILE, rasters::tile)
        .at(&table::GET_CHANGES, changes::since)
        .at(&table::WATCH_MAP, changes::events)
        .at(&table::CREATE_SNAPSHOT, snapshots::create)
        .at(&table::LIST_SNAPSHOTS, snapshots::list)
        .at(&table::RESTORE_SNAPSHOT, snapshots::restore)
        .at(&table::DELETE_SNAPSHOT, snapshots::delete)
        .at(&table::EXPORT_MAP, transfer::export)
        .at(&table::IMPORT_MAP, transfer::import)
        .at(&table::INDEX, viewer::index)
        .at(&table::HEALTH, system::healthz)
        .at(&table::READY, system::readyz)
        .at(&table::METRICS, system::metrics)
        .at(&table::DESCRIPTION, openapi::description)
        .at(&table::DOCS, openapi::docs)
}

//! gRPC: the service `ubbmap.v1.MapService` on the port of REST, with gRPC-Web, reflection and health. What an
//! operation means is the service's alone.

mod access;
mod codec;
mod health;
mod observe;
mod service;
mod status;

use super::access::Guarded;
use super::door::Door;
use crate::wire;
use axum::Router;
use generated::map_service_server::MapServiceServer;
use service::MapRpc;
use tonic_web::GrpcWebLayer;
use tower_http::catch_panic::CatchPanicLayer;

pub use observe::describe_metrics;
pub use status::DOMAIN;

/// The service and a client of it, generated from `proto/`.
#[allow(missing_docs, clippy::all, reason = "generated")]
pub mod generated {
    include!(concat!(env!("OUT_DIR"), "/grpc/ubbmap.v1.rs"));
}

/// Limits that are gRPC's own; those of operations are the service's.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct GrpcSettings {
    /// Largest message, bytes.
    pub message_bytes: usize,
    /// Largest map file that is imported, bytes.
    pub import_bytes: usize,
    /// Most scans of one stream that are not acknowledged yet.
    pub scans_per_stream: usize,
}

/// Largest message of health and reflection, bytes.
const SMALL_MESSAGE: usize = 64 << 10;

/// The routes over a service, to be merged with those of REST. Starts the task that tells the health.
///
/// # Errors
/// When the interface's own description cannot be read.
pub fn router(service: Guarded, settings: GrpcSettings, door: Door) -> Result<Router, tonic_reflection::server::Error> {
    let reflection = || {
        tonic_reflection::server::Builder::configure()
            .register_encoded_file_descriptor_set(wire::DESCRIPTORS)
            .register_encoded_file_descriptor_set(tonic_health::pb::FILE_DESCRIPTOR_SET)
    };
    let limit = settings.message_bytes;
    let health = health::watched(service.clone(), door.clone()).max_decoding_message_size(SMALL_MESSAGE);
    let around = (limit, door.clone());
    let maps = MapServiceServer::new(MapRpc::new(settings, door)).max_decoding_message_size(limit);
    let router = tonic::service::Routes::new(maps)
        .add_service(health)
        .add_service(reflection().build_v1()?.max_decoding_message_size(SMALL_MESSAGE))
        .add_service(reflection().build_v1alpha()?.max_decoding_message_size(SMALL_MESSAGE))
        .into_axum_router()
        .reset_fallback();
    Ok(router
        .layer(CatchPanicLayer::custom(observe::panicked))
        .layer(axum::middleware::from_fn_with_state(service, access::admit))
        .layer(axum::middleware::from_fn_with_state(around, observe::observe))
        .layer(GrpcWebLayer::new()))
}

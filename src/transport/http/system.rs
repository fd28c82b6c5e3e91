//! Health, metrics, the index, and paths that are not there.

use super::{App, HttpError, respond};
use crate::service::{ErrorKind, ServiceError};
use crate::transport::access::{Listener, OnBehalf, Operation, Peer};
use axum::body::Bytes;
use axum::extract::{FromRequestParts, Request, State};
use axum::http::{Method, Uri};
use axum::response::Response;
use serde_json::json;

/// What there is, as `/` tells it.
const ROUTES: [&str; 23] = [
    "GET /healthz",
    "GET /readyz",
    "GET /metrics",
    "GET /v1/maps",
    "PUT /v1/maps/{map}",
    "GET /v1/maps/{map}",
    "DELETE /v1/maps/{map}",
    "POST /v1/maps/{map}/scans",
    "POST /v1/maps/{map}/classes",
    "POST /v1/maps/{map}/guaranteed-free",
    "GET /v1/maps/{map}/region?min_x=&min_y=&max_x=&max_y=&depth=&blocks=",
    "GET /v1/maps/{map}/grid?min_x=&min_y=&max_x=&max_y=&depth=&format=",
    "GET /v1/maps/{map}/changes?since=&min_x=&min_y=&max_x=&max_y=&depth=&contents=",
    "GET /v1/maps/{map}/events?since=&min_x=&min_y=&max_x=&max_y=&depth=&contents=",
    "GET /v1/maps/{map}/tiles/{z}/{x}/{y}.png",
    "GET /v1/maps/{map}/tiles/{z}/{x}/{y}.npy",
    "GET /v1/maps/{map}/tiles/{z}/{x}/{y}.pb",
    "GET /v1/maps/{map}/snapshots",
    "POST /v1/maps/{map}/snapshots",
    "POST /v1/maps/{map}/snapshots/{name}/restore",
    "DELETE /v1/maps/{map}/snapshots/{name}",
    "GET /v1/maps/{map}/export?format=&snapshot=&depth=&mode=",
    "PUT /v1/maps/{map}/import",
];

/// What `/readyz` says of a server that lets strangers in.
const INSECURE: &[u8] = b"{\"status\":\"ready\",\"insecure\":true,\
    \"warning\":\"anyone who reaches this server may read and change every map: it was started with --insecure\"}";

/// `GET /` for programs.
pub fn index() -> Response {
    let index = json!({ "name": "ubbmap", "version": env!("CARGO_PKG_VERSION"), "routes": ROUTES });
    respond::bytes_of(super::accept::JSON, Bytes::from(index.to_string()))
}

/// `GET /healthz`: the process answers.
pub async fn healthz() -> Response {
    respond::bytes_of(super::accept::JSON, Bytes::from_static(b"{\"status\":\"ok\"}"))
}

/// `GET /readyz`: it takes work.
pub async fn readyz(State(app): State<App>) -> Result<Response, HttpError> {
    if app.door.is_draining() {
        return Err(HttpError::new(ErrorKind::ShuttingDown, "the server is draining"));
    }
    if !app.service.is_ready() {
        return Err(HttpError::new(ErrorKind::StoreFailed, ServiceError::NO_MORE_WRITES));
    }
    if !(app.outside.reachable)() {
        return Err(HttpError::new(ErrorKind::Timeout, "the server does not reach itself over Zenoh"));
    }
    let ready: &[u8] = if app.service.is_insecure() { INSECURE } else { b"{\"status\":\"ready\"}" };
    Ok(respond::bytes_of(super::accept::JSON, Bytes::from_static(ready)))
}

/// `GET /metrics`: for those who may read all maps. On a listener for administration it asks nobody who they are, since
/// that is where the scraper comes to; beside such a listener it is there alone.
pub async fn metrics(State(app): State<App>, request: Request) -> Result<Response, HttpError> {
    let listener = request.extensions().get::<Peer>().map(|peer| peer.listener).unwrap_or_default();
    match listener {
        Listener::Administration => {}
        Listener::Public => return Err(route_not_found(request.uri().clone()).await),
        Listener::Only => {
            let (mut parts, _) = request.into_parts();
            OnBehalf::from_request_parts(&mut parts, &app).await?.may_at_all(Operation::ReadMetrics)?;
        }
    }
    Ok(respond::bytes_of("text/plain; version=0.0.4; charset=utf-8", Bytes::from((app.outside.metrics)())))
}

/// Any path without a route.
pub async fn route_not_found(uri: Uri) -> HttpError {
    let path: String = uri.path().chars().take(200).collect();
    HttpError::new(ErrorKind::RouteNotFound, format!("there is nothing at {path}; / names what there is"))
}

/// A route with another method; the `Allow` header is added by the router.
pub async fn method_not_allowed(method: Method) -> HttpError {
    let method: String = method.as_str().chars().take(40).collect();
    HttpError::new(ErrorKind::MethodNotAllowed, format!("{method} is not allowed here; the Allow header names what is"))
}

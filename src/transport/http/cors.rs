//! Which pages of other origins may use the server from a browser.

use axum::http::{HeaderName, HeaderValue, Method, header};
use std::time::Duration;
use tower_http::cors::{AllowOrigin, CorsLayer};

/// How long a browser may keep what it was told.
const KEPT: Duration = Duration::from_secs(600);

/// Headers that clients of REST and gRPC-Web send beside those that any page may.
const SENT: [HeaderName; 9] = [
    header::ACCEPT,
    header::AUTHORIZATION,
    header::CONTENT_ENCODING,
    header::CONTENT_TYPE,
    header::IF_NONE_MATCH,
    HeaderName::from_static("last-event-id"),
    HeaderName::from_static("x-grpc-web"),
    HeaderName::from_static("x-user-agent"),
    HeaderName::from_static("grpc-timeout"),
];

/// Headers of answers that a page may read.
const READ: [HeaderName; 10] = [
    header::ETAG,
    header::RETRY_AFTER,
    HeaderName::from_static("ubbmap-revision"),
    HeaderName::from_static("ubbmap-depth"),
    HeaderName::from_static("ubbmap-min-x"),
    HeaderName::from_static("ubbmap-min-y"),
    HeaderName::from_static("ubbmap-cell-size"),
    HeaderName::from_static("grpc-status"),
    HeaderName::from_static("grpc-message"),
    HeaderName::from_static("grpc-status-details-bin"),
];

/// Lets pages of these origins in; `*` is any, none is none. Nothing rests on cookies, so none are taken.
pub fn cors(origins: &[&str]) -> CorsLayer {
    if origins.is_empty() {
        return CorsLayer::new();
    }
    let named: Vec<HeaderValue> = origins.iter().filter_map(|origin| HeaderValue::from_str(origin).ok()).collect();
    let allowed = if origins.contains(&"*") { AllowOrigin::any() } else { AllowOrigin::list(named) };
    CorsLayer::new()
        .allow_origin(allowed)
        .allow_methods([Method::GET, Method::HEAD, Method::PUT, Method::POST, Method::DELETE])
        .allow_headers(SENT)
        .expose_headers(READ)
        .max_age(KEPT)
}

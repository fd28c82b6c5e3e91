//! Around every request: its place among the requests under way, its time, its metrics, and panics.

use super::lines;
use super::openapi::table::{IMPORT_MAP, INSERT_SCANS};
use super::problem::HttpError;
use super::serve::describe_connections;
use super::{App, Shared, access};
use crate::service::{ErrorKind, ServiceError};
use crate::transport::client::Client;
use crate::transport::guard;
use crate::transport::intake::Shape;
use axum::Error;
use axum::body::Body;
use axum::extract::{MatchedPath, Request, State};
use axum::http::{HeaderValue, Response as HttpResponse};
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};
use metrics::{counter, describe_counter, describe_histogram, histogram};
use std::any::Any;
use std::time::Instant;

/// What begins with this is limited; health and metrics answer also when the server is full.
const OPERATIONS: &str = "/v1/";

const SECONDS: &str = "ubbmap_http_request_seconds";
const TOTAL: &str = "ubbmap_http_requests_total";

/// Tells the recorder what each metric means. Call it once, after the recorder is installed.
pub fn describe_metrics() {
    describe_histogram!(SECONDS, "Seconds from a request's head to its answer, by method and route");
    describe_counter!(TOTAL, "Requests by method, route and status");
    describe_connections();
}

/// Limits, times and counts a request.
pub async fn observe(State(app): State<App>, request: Request, next: Next) -> Response {
    let method = match request.method().as_str() {
        // Any other word is the client's, and would be a label of its own.
        known @ ("GET" | "HEAD" | "PUT" | "POST" | "DELETE" | "OPTIONS" | "PATCH") => known.to_owned(),
        _ => "other".to_owned(),
    };
    let matched = request.extensions().get::<MatchedPath>().map(|path| path.as_str().to_owned());
    let route = matched.unwrap_or_else(|| "none".to_owned());
    let begun = Instant::now();
    let client = request.extensions().get::<Client>().cloned();
    let mut response =
        guarded(&app, request, next, &route).await.unwrap_or_else(|error| HttpError(error).into_response());
    guard::close_refused(client.as_ref(), &mut response);
    let status = response.status().as_u16().to_string();
    let labels = [("method", method), ("route", route)];
    histogram!(SECONDS, &labels).record(begun.elapsed().as_secs_f64());
    let [method, route] = labels;
    counter!(TOTAL, &[method, route, ("status", status)]).increment(1);
    response
}

/// Lets a request in with what it may take of the server's memory, and keeps the answer's until it has gone out.
async fn guarded(app: &Shared, request: Request, next: Next, route: &str) -> Result<Response, ServiceError> {
    let shape = if route == IMPORT_MAP.path {
        // A file has a limit of its own.
        None
    } else if route == INSERT_SCANS.path && lines::streamed(request.headers()) {
        Some(Shape::Lines)
    } else {
        Some(Shape::Whole)
    };
    let (request, admitted) = guard::admit(&app.door, request, shape, Error::new)?;
    let versioned = request.uri().path().starts_with(OPERATIONS);
    let response = if versioned {
        let (request, role) = access::admit(app, request);
        match role {
            Some(role) => {
                let answered = limited(app, request, next, route).await;
                let mut response = answered.unwrap_or_else(|error| HttpError(error).into_response());
                response.headers_mut().insert(access::ROLE, HeaderValue::from_static(role.word()));
                response
            }
            // The handler says no; it takes no place for that.
            None => app.door.timed(next.run(request)).await?,
        }
    } else {
        limited(app, request, next, route).await?
    };
    admitted.answer(&app.door, response, ())
}

/// `import`: the body is a whole map and may be long on its way, so it has a time and places of its own.
async fn limited(app: &Shared, request: Request, next: Next, route: &str) -> Result<Response, ServiceError> {
    if route == IMPORT_MAP.path {
        let _place = app.door.transfer()?;
        return app.door.timed_transfer(next.run(request)).await;
    }
    let _place = if route == INSERT_SCANS.path {
        Some(app.door.insertion()?)
    } else if request.uri().path().starts_with(OPERATIONS) {
        Some(app.door.request()?)
    } else {
        None
    };
    app.door.timed(next.run(request)).await
}

/// The answer to a request whose handler panicked. The panic's words are for the log.
#[expect(clippy::needless_pass_by_value, reason = "the layer calls it with the value")]
pub fn panicked(panic: Box<dyn Any + Send + 'static>) -> HttpResponse<Body> {
    let words = panic
        .downcast_ref::<String>()
        .map(String::as_str)
        .or_else(|| panic.downcast_ref::<&str>().copied())
        .unwrap_or("without words");
    tracing::error!(panic = words, "a request panicked");
    HttpError::new(ErrorKind::Internal, "the server failed to answer the request").into_response()
}

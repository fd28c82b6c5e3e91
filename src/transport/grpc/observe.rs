//! Around every call: its time, its metrics, panics, and the errors that the library answers by itself.

use super::status::{to_status, too_large};
use crate::service::{ErrorKind, ServiceError};
use crate::transport::access::Operation;
use crate::transport::client::Client;
use crate::transport::door::Door;
use crate::transport::guard;
use crate::transport::intake::Shape;
use axum::Error;
use axum::body::Body;
use axum::extract::{Request, State};
use axum::http::Response as HttpResponse;
use axum::middleware::Next;
use axum::response::Response;
use metrics::{counter, describe_counter, describe_histogram, histogram};
use std::any::Any;
use std::time::Instant;
use tonic::{Code, Status};

const SECONDS: &str = "ubbmap_grpc_call_seconds";
const TOTAL: &str = "ubbmap_grpc_calls_total";

/// What begins with this is the interface's own.
pub const SERVICE: &str = "/ubbmap.v1.MapService/";

/// Those whose requests are streams.
const STREAMED: [&str; 2] = ["StreamScans", "ImportMap"];

/// Tells the recorder what each metric means. Call it once, after the recorder is installed.
pub fn describe_metrics() {
    describe_histogram!(SECONDS, "Seconds from a call's head to the head of its answer, by method");
    describe_counter!(TOTAL, "Calls by method and code; a stream counts when its answer begins");
}

/// Lets a call in, times and counts it. `limit` is that of messages, bytes.
pub async fn observe(State((limit, door)): State<(usize, Door)>, request: Request, next: Next) -> Response {
    let asked = request.uri().path().strip_prefix(SERVICE).unwrap_or_default();
    // Any other word is the client's, and would be a label of its own.
    let method = Operation::of_method(asked).map_or("other", Operation::method);
    let begun = Instant::now();
    let client = request.extensions().get::<Client>().cloned();
    let answered = guarded(&door, request, next, method).await;
    let mut response = answered.unwrap_or_else(|error| to_status(&error).into_http());
    guard::close_refused(client.as_ref(), &mut response);
    let mut code = Status::from_header_map(response.headers()).map_or(Code::Ok, |status| status.code());
    // The library refuses a message above the limit before anything of ours sees it; ours come with details.
    let foreign = response.headers().get(Status::GRPC_STATUS_DETAILS).is_none();
    let ours = match code {
        Code::OutOfRange if foreign => Some(too_large(limit)),
        // A method that is not in the interface.
        Code::Unimplemented if foreign => {
            Some(ServiceError::new(ErrorKind::RouteNotFound, "the service has no such method"))
        }
        _ => None,
    };
    if let Some(error) = ours {
        let status = to_status(&error);
        code = status.code();
        response = status.into_http();
    }
    histogram!(SECONDS, "method" => method).record(begun.elapsed().as_secs_f64());
    counter!(TOTAL, "method" => method, "code" => format!("{code:?}")).increment(1);
    response
}

/// Lets a call in with what it may take of the server's memory, and keeps the answer's until it has gone out.
///
/// Health and reflection are for everybody: their messages are small, so they take nothing of the memory that others need,
/// and each client has so many of them.
async fn guarded(door: &Door, request: Request, next: Next, method: &str) -> Result<Response, ServiceError> {
    let wrap = |error: ServiceError| Error::new(to_status(&error));
    if !request.uri().path().starts_with(SERVICE) {
        let share = door.aside(request.extensions().get::<Client>())?;
        let (request, admitted) = guard::admit(door, request, None, wrap)?;
        return admitted.answer(door, next.run(request).await, share);
    }
    let streamed = STREAMED.contains(&method);
    let shape = if streamed { Shape::Messages } else { Shape::Whole };
    let (request, admitted) = guard::admit(door, request, Some(shape), wrap)?;
    // A stream's messages have a time each; the one message of a call comes within the call's.
    let response = if streamed { next.run(request).await } else { door.timed(next.run(request)).await? };
    admitted.answer(door, response, ())
}

/// The answer to a call whose handler panicked. The panic's words are for the log.
#[expect(clippy::needless_pass_by_value, reason = "the layer calls it with the value")]
pub fn panicked(panic: Box<dyn Any + Send + 'static>) -> HttpResponse<Body> {
    let words = panic
        .downcast_ref::<String>()
        .map(String::as_str)
        .or_else(|| panic.downcast_ref::<&str>().copied())
        .unwrap_or("without words");
    tracing::error!(panic = words, "a call panicked");
    to_status(&ServiceError::new(ErrorKind::Internal, "the server failed to answer the request")).into_http()
}

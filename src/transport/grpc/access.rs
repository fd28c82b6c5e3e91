//! Who asks: what the head of a call shows, before its messages are read.

use super::observe::SERVICE;
use super::status::to_status;
use crate::service::ServiceError;
use crate::transport::access::{Guarded, OnBehalf, Operation, Origin, Peer, Shown};
use axum::extract::{Request, State};
use axum::http::header;
use axum::middleware::Next;
use axum::response::Response;

/// What a client or a proxy calls a request.
const REQUEST_ID: &str = "x-request-id";

/// Lets calls of the interface through whose caller is known and may do such a thing at all. Health and reflection, which
/// tell nothing of the maps, are for everybody.
pub async fn admit(State(service): State<Guarded>, mut request: Request, next: Next) -> Response {
    let Some(method) = request.uri().path().strip_prefix(SERVICE) else { return next.run(request).await };
    match identify(&service, &request, Operation::of_method(method)) {
        Ok(caller) => {
            request.extensions_mut().insert(caller);
            next.run(request).await
        }
        Err(error) => to_status(&error).into_http(),
    }
}

fn identify(service: &Guarded, request: &Request, operation: Option<Operation>) -> Result<OnBehalf, ServiceError> {
    let headers = request.headers();
    let peer = request.extensions().get::<Peer>().cloned().unwrap_or_default();
    let request_id = headers.get(REQUEST_ID).map(|id| id.as_bytes());
    let shown = headers.get_all(header::AUTHORIZATION).iter().map(|value| value.as_bytes());
    let caller = service.identify(Shown::in_headers(shown), Origin::new("grpc", peer, request_id))?;
    // A method that is not there is told so by the service.
    operation.map_or(Ok(()), |operation| caller.may_at_all(operation))?;
    Ok(caller)
}

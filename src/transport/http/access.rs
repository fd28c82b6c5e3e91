//! Who asks: what the head of a request shows, before anything else of it is looked at.

use super::{App, HttpError, Shared};
use crate::service::ServiceError;
use crate::transport::access::{OnBehalf, Origin, Peer, Role, Shown};
use axum::body::Body;
use axum::extract::{FromRequestParts, Request};
use axum::http::request::Parts;
use axum::http::{HeaderName, header};

/// What the caller may do, told with every answer to a caller that is known: pages leave out what would be refused.
pub const ROLE: HeaderName = HeaderName::from_static("ubbmap-role");

/// What a client or a proxy calls a request.
const REQUEST_ID: &str = "x-request-id";

/// Who asks, or why that is not known. Handlers take [`OnBehalf`], which comes from here.
#[derive(Clone)]
struct Admission(Result<OnBehalf, ServiceError>);

impl FromRequestParts<App> for OnBehalf {
    type Rejection = HttpError;

    async fn from_request_parts(parts: &mut Parts, app: &App) -> Result<Self, HttpError> {
        match parts.extensions.get::<Admission>() {
            Some(Admission(known)) => Ok(known.clone()?),
            None => Ok(identify(app, parts)?),
        }
    }
}

/// Looks at who asks. The body of a request whose asker is not known is let go, so that nobody holds a place among the requests
/// under way who has no right to one; no role then.
pub fn admit(app: &Shared, request: Request) -> (Request, Option<Role>) {
    let (mut parts, body) = request.into_parts();
    let known = identify(app, &parts);
    let role = known.as_ref().ok().map(|caller| caller.caller().role_here());
    parts.extensions.insert(Admission(known));
    let body = if role.is_some() { body } else { Body::empty() };
    (Request::from_parts(parts, body), role)
}

fn identify(app: &Shared, parts: &Parts) -> Result<OnBehalf, ServiceError> {
    let peer = parts.extensions.get::<Peer>().cloned().unwrap_or_default();
    let request_id = parts.headers.get(REQUEST_ID).map(|id| id.as_bytes());
    let shown = parts.headers.get_all(header::AUTHORIZATION).iter().map(|value| value.as_bytes());
    app.service.identify(Shown::in_headers(shown), Origin::new("rest", peer, request_id))
}

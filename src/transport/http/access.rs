//! Who asks: what the head of a request shows, before anything else of it is looked at.

use super::{App, HttpError, Shared};
use crate::service::ServiceError;
use crate::transport::access::{OnBehalf, Origin, Peer, Role, Shown};
use crate::transport::intake::Held;
use axum::body::Body;
use axum::extract::{FromRequestParts, Request};
use axum::http::request::Parts;
use axum::http::{HeaderName, header};
use http_body_util::BodyExt;
use std::sync::Arc;
use std::time::Duration;

/// What the caller may do, told with every answer to a caller that is known: pages leave out what would be refused.
pub const ROLE: HeaderName = HeaderName::from_static("ubbmap-role");

/// What a client or a proxy calls a request.
const REQUEST_ID: &str = "x-request-id";

/// How long the body of a refused request is read and thrown away: a client that only reads once it has written all would
/// else never see why it was refused.
const DISCARD_FOR: Duration = Duration::from_secs(2);

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

/// Looks at who asks. Of a request whose asker is not known the body is thrown away, as far as it comes soon, so that
/// nobody holds a place among the requests under way who has no right to one; no role then.
pub async fn admit(app: &Shared, request: Request) -> (Request, Option<Role>) {
    let (mut parts, body) = request.into_parts();
    let known = identify(app, &parts);
    let role = known.as_ref().ok().map(|caller| caller.caller().role_here());
    parts.extensions.insert(Admission(known));
    if role.is_some() {
        return (Request::from_parts(parts, body), role);
    }
    discard(body, &parts, app).await;
    (Request::from_parts(parts, Body::empty()), None)
}

fn identify(app: &Shared, parts: &Parts) -> Result<OnBehalf, ServiceError> {
    let peer = parts.extensions.get::<Peer>().cloned().unwrap_or_default();
    let request_id = parts.headers.get(REQUEST_ID).map(|id| id.as_bytes());
    let shown = parts.headers.get_all(header::AUTHORIZATION).iter().map(|value| value.as_bytes());
    app.service.identify(Shown::in_headers(shown), Origin::new("rest", peer, request_id))
}

/// Reads a body and throws it away, up to the size of a large one and for a short time.
pub async fn discard(mut body: Body, parts: &Parts, app: &Shared) {
    let held = parts.extensions.get::<Arc<Held>>();
    let read = async {
        let mut total = 0;
        while let Some(Ok(frame)) = body.frame().await {
            total += frame.data_ref().map_or(0, |data| data.len());
            Held::forget(held);
            if total > app.settings.body_bytes {
                break;
            }
        }
    };
    // What takes longer is not waited for.
    let _ = tokio::time::timeout(DISCARD_FOR, read).await;
}

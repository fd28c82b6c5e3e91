//! Around every request of REST and gRPC, before anything is made of it: its head, its client's share, and the memory that
//! its body and its answer take.

use super::client::{Client, UnderWay, too_many_connections};
use super::door::Door;
use super::intake::{self, Held, Shape};
use super::outgoing;
use crate::service::{ErrorKind, ServiceError, setting};
use axum::Error;
use axum::body::HttpBody;
use axum::extract::Request;
use axum::http::request::Parts;
use axum::http::{HeaderValue, header};
use axum::response::Response;
use std::sync::Arc;

/// What a head's line takes beside its name and value (RFC 9113, 10.5.1).
const LINE: usize = 32;

/// What a request holds while it is worked on.
#[derive(Debug)]
pub struct Admitted {
    _incoming: Option<Arc<Held>>,
    under_way: Option<UnderWay>,
}

/// Lets a request in. Its body is counted as it comes (with `shape`); `wrap` makes of a refusal what the body's reader knows.
///
/// # Errors
/// [`ErrorKind::HeadersTooLarge`], [`ErrorKind::Busy`]
pub fn admit(
    door: &Door,
    request: Request,
    shape: Option<Shape>,
    wrap: fn(ServiceError) -> Error,
) -> Result<(Request, Admitted), ServiceError> {
    let (mut parts, body) = request.into_parts();
    let client = parts.extensions.get::<Client>();
    if client.is_some_and(Client::is_refused) {
        return Err(too_many_connections(door.connections().most()));
    }
    let under_way = client.map(Client::begin);
    check_head(&parts, door.header_bytes())?;
    let Some(shape) = shape else {
        return Ok((Request::from_parts(parts, body), Admitted { _incoming: None, under_way }));
    };
    let held = door.incoming().hold();
    parts.extensions.insert(Arc::clone(&held));
    let body = intake::counted(body, Arc::clone(&held), shape, wrap, door.request_timeout());
    // What comes as a stream is counted by its reader, for as long as it reads.
    let _incoming = (shape == Shape::Whole).then_some(held);
    Ok((Request::from_parts(parts, body), Admitted { _incoming, under_way }))
}

fn check_head(parts: &Parts, most: usize) -> Result<(), ServiceError> {
    let lines = parts.headers.iter().map(|(name, value)| name.as_str().len() + value.len() + LINE);
    let bytes = parts.uri.path_and_query().map_or(0, |path| path.as_str().len()) + lines.sum::<usize>();
    if bytes <= most {
        return Ok(());
    }
    let detail = format!("the request's head takes {bytes} bytes, the limit is {most}");
    Err(ServiceError::over(ErrorKind::HeadersTooLarge, setting::HEADER_BYTES, detail))
}

impl Admitted {
    /// The answer, which holds the request's place on its connection until it has gone out, the memory that it takes, and
    /// `more`.
    ///
    /// # Errors
    /// [`ErrorKind::Busy`] where answers take all the memory that they may.
    pub fn answer<T: Send + Sync + 'static>(
        self,
        door: &Door,
        mut response: Response,
        more: T,
    ) -> Result<Response, ServiceError> {
        let Self { _incoming, under_way } = self;
        // gRPC knows the size of its message where it is made.
        let held = match response.extensions_mut().remove::<Arc<Held>>() {
            Some(held) => Some(held),
            None => match response.body().size_hint().exact() {
                Some(bytes) => door.answers().answer(usize::try_from(bytes).unwrap_or(usize::MAX))?,
                None => None,
            },
        };
        Ok(outgoing::keep(response, under_way, (held, more)))
    }
}

/// Has the connection of an answer closed behind it, where its client has too many.
pub fn close_refused(client: Option<&Client>, response: &mut Response) {
    if client.is_some_and(Client::is_refused) {
        response.headers_mut().insert(header::CONNECTION, HeaderValue::from_static("close"));
    }
}

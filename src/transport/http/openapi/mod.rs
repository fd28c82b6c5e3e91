//! The interface described: `/openapi.json` for programs, `/docs` for people. The router is made of the same table.

mod document;
mod facts;
#[cfg(test)]
mod openapi_tests;
mod operation;
mod parameter;
mod problems;
mod schema;
pub mod table;

use super::params::params;
use super::{App, HttpError, accept, respond, viewer};
use crate::service::ErrorKind;
use axum::Router;
use axum::body::Bytes;
use axum::extract::Request;
use axum::handler::Handler;
use axum::http::{HeaderValue, StatusCode, header};
use axum::response::{IntoResponse, Response};
use axum::routing::on;
use std::hash::{DefaultHasher, Hash, Hasher};
use std::sync::LazyLock;
use table::{DESCRIPTION, DOCS};

pub use operation::Operation;

/// The routes of a server as they are put together.
#[derive(Debug, Default)]
pub struct Routes {
    router: Router<App>,
    known: Vec<&'static Operation>,
}

impl Routes {
    /// Serves an operation of the table.
    pub fn at<H, T>(mut self, operation: &'static Operation, handler: H) -> Self
    where
        H: Handler<T, App>,
        T: 'static,
    {
        self.router = self.router.route(operation.path, on(operation.method.filter(), handler));
        self.known.push(operation);
        self
    }

    /// The router.
    pub fn done(self) -> Router<App> {
        self.router
    }
}

/// The description as it is served, with its tag.
struct Served {
    bytes: Bytes,
    tag: HeaderValue,
}

static SERVED: LazyLock<Option<Served>> = LazyLock::new(|| {
    let mut text = match document::document() {
        Ok(document) => serde_json::to_string_pretty(&document).unwrap_or_default(),
        Err(error) => {
            tracing::error!(%error, "the description of the interface cannot be made");
            return None;
        }
    };
    text.push('\n');
    let mut hasher = DefaultHasher::new();
    text.hash(&mut hasher);
    let tag = HeaderValue::try_from(format!("\"{:016x}\"", hasher.finish())).ok()?;
    Some(Served { bytes: Bytes::from(text), tag })
});

/// `GET /openapi.json`
pub async fn description(request: Request) -> Result<Response, HttpError> {
    params(request.uri(), &DESCRIPTION)?;
    let served = SERVED.as_ref();
    let served = served.ok_or_else(|| HttpError::new(ErrorKind::Internal, "the server cannot describe itself"))?;
    let caching = [(header::ETAG, served.tag.clone()), (header::CACHE_CONTROL, HeaderValue::from_static("no-cache"))];
    if respond::matches(request.headers(), &served.tag) {
        return Ok((StatusCode::NOT_MODIFIED, caching).into_response());
    }
    Ok((caching, respond::bytes_of(accept::JSON, served.bytes.clone())).into_response())
}

/// `GET /docs`: the page that shows the description.
pub async fn docs(request: Request) -> Result<Response, HttpError> {
    params(request.uri(), &DOCS)?;
    Ok(viewer::docs(request.headers()))
}

//! Every error as RFC 9457 `application/problem+json`.

use crate::service::{ErrorKind, ServiceError};
use crate::transport::status::status;
use axum::http::{HeaderValue, StatusCode, header};
use axum::response::{IntoResponse, Response};
use serde::{Deserialize, Serialize};

/// Media type of problems.
pub const PROBLEM_JSON: &str = "application/problem+json";

/// What a client is asked for that showed nothing.
const CHALLENGE: &str = "Bearer realm=\"ubbmap\"";

/// The same for one whose token is not good.
const SHOWN_IN_VAIN: &str = "Bearer realm=\"ubbmap\", error=\"invalid_token\"";

/// The body of an error.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Problem {
    /// Names the kind of problem: `urn:ubbmap:problem:map-not-found`.
    pub r#type: String,
    /// The same for every occurrence of the kind.
    pub title: String,
    /// The status code of HTTP.
    pub status: u16,
    /// What is wrong here.
    pub detail: String,
    /// A stable word such as `MAP_NOT_FOUND`.
    pub code: String,
    /// The field at fault.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub field: Option<String>,
}

impl From<&ServiceError> for Problem {
    fn from(error: &ServiceError) -> Self {
        let row = status(error.kind);
        let code = error.kind.code();
        Self {
            r#type: format!("urn:ubbmap:problem:{}", code.to_lowercase().replace('_', "-")),
            title: row.title.to_owned(),
            status: row.http,
            detail: error.detail.clone(),
            code: code.to_owned(),
            field: error.field.clone(),
        }
    }
}

/// A failure of a handler.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct HttpError(pub ServiceError);

impl HttpError {
    /// A failure without a field.
    pub fn new(kind: ErrorKind, detail: impl Into<String>) -> Self {
        Self(ServiceError::new(kind, detail))
    }

    /// A request that is not valid at a field.
    pub fn invalid(field: impl Into<String>, detail: impl Into<String>) -> Self {
        Self(ServiceError::new(ErrorKind::InvalidRequest, detail).at(field))
    }
}

impl From<ServiceError> for HttpError {
    fn from(error: ServiceError) -> Self {
        Self(error)
    }
}

impl IntoResponse for HttpError {
    fn into_response(self) -> Response {
        let row = status(self.0.kind);
        // Strings alone cannot fail to serialize.
        let body = serde_json::to_vec(&Problem::from(&self.0)).unwrap_or_default();
        let mut response = body.into_response();
        *response.status_mut() = StatusCode::from_u16(row.http).unwrap_or(StatusCode::INTERNAL_SERVER_ERROR);
        let headers = response.headers_mut();
        headers.insert(header::CONTENT_TYPE, HeaderValue::from_static(PROBLEM_JSON));
        if self.0.kind == ErrorKind::Unauthenticated {
            // RFC 6750, 3: the error is told where something was shown.
            let challenge = if self.0.field.is_some() { SHOWN_IN_VAIN } else { CHALLENGE };
            headers.insert(header::WWW_AUTHENTICATE, HeaderValue::from_static(challenge));
        }
        if let Some(seconds) = row.retry_after {
            headers.insert(header::RETRY_AFTER, HeaderValue::from(seconds));
        }
        response
    }
}

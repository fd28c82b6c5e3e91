//! Answers as bytes.

use super::body::apart;
use super::{HttpError, accept};
use crate::service::ErrorKind;
use crate::wire::Encoding;
use axum::body::Bytes;
use axum::http::{HeaderMap, HeaderValue, StatusCode, header};
use axum::response::{IntoResponse, Response};
use prost::Message;
use serde::Serialize;

/// A message as JSON or protobuf. `size` is about how many bytes it has in memory: large ones are written on a
/// thread of their own.
///
/// # Errors
/// [`ErrorKind::Internal`] when it cannot be written.
pub async fn message<M>(encoding: Encoding, message: M, size: usize) -> Result<Response, HttpError>
where
    M: Message + Serialize + 'static,
{
    let media = match encoding {
        Encoding::Json => accept::JSON,
        Encoding::Protobuf => accept::PROTOBUF,
    };
    let bytes = apart(size, move || match encoding {
        Encoding::Protobuf => Ok(message.encode_to_vec()),
        Encoding::Json => serde_json::to_vec(&message).map_err(|error| {
            tracing::error!(%error, "an answer cannot be written as JSON");
            HttpError::new(ErrorKind::Internal, "the server failed to write the answer")
        }),
    })
    .await?;
    Ok(bytes_of(media, Bytes::from(bytes)))
}

/// Bytes with their media type. Caches are told that the form was chosen by `Accept`.
pub fn bytes_of(media: &'static str, bytes: Bytes) -> Response {
    let headers =
        [(header::CONTENT_TYPE, HeaderValue::from_static(media)), (header::VARY, HeaderValue::from_static("accept"))];
    (StatusCode::OK, headers, bytes).into_response()
}

/// Does `If-None-Match` hold the tag? Compared weakly (RFC 9110, 13.1.2).
pub fn matches(headers: &HeaderMap, tag: &HeaderValue) -> bool {
    headers
        .get_all(header::IF_NONE_MATCH)
        .iter()
        .filter_map(|value| value.to_str().ok())
        .flat_map(|value| value.split(','))
        .map(|value| value.trim())
        .any(|value| value == "*" || value.trim_start_matches("W/").as_bytes() == tag.as_bytes())
}

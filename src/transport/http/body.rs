//! Bodies of requests: read whole under a limit, decompressed under the same limit, and their form.

use super::HttpError;
use crate::service::{ErrorKind, ServiceError, setting};
use crate::transport::files;
use crate::transport::intake::{Held, refusal};
use crate::wire::Encoding;
use axum::body::{Body, Bytes};
use axum::http::request::Parts;
use axum::http::{HeaderMap, header};
use flate2::read::MultiGzDecoder;
use http_body_util::BodyExt;
use std::io::Read;
use std::sync::Arc;

/// Bodies above this many bytes are decoded on a thread of their own, so that they do not hold up other requests.
const DECODE_APART_ABOVE: usize = 64 * 1024;

/// Bytes that are unzipped at a time.
const UNZIPPED_PIECE: u64 = 256 * 1024;

/// How large a body may be, and the setting that says so.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Limit {
    /// Most bytes.
    pub bytes: usize,
    /// The setting.
    pub setting: &'static str,
}

/// How the scans of a body are written.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ScanEncoding {
    /// One message.
    Message(Encoding),
    /// One scan a line.
    Lines,
}

/// Reads a body and undoes its `Content-Encoding`.
///
/// # Errors
/// [`ErrorKind::BodyTooLarge`], [`ErrorKind::UnsupportedMediaType`] for an encoding other than gzip,
/// [`ErrorKind::InvalidRequest`] for a body that breaks off or is not gzip.
pub async fn read(parts: &Parts, body: Body, limit: Limit) -> Result<Bytes, HttpError> {
    let bytes = collect(body, limit).await?;
    let encoding = header_text(&parts.headers, &header::CONTENT_ENCODING)?;
    match encoding.as_deref() {
        None | Some("" | "identity") => Ok(bytes),
        Some("gzip" | "x-gzip") => {
            let held = parts.extensions.get::<Arc<Held>>().cloned();
            apart(bytes.len(), move || unzip(&bytes, limit, held.as_deref())).await
        }
        Some(other) => {
            let detail = format!("content-encoding {other:?} is not known: send gzip or none");
            Err(HttpError(ServiceError::new(ErrorKind::UnsupportedMediaType, detail).at("content-encoding")))
        }
    }
}

/// Refuses a `Content-Encoding`: what comes as a stream is read as it is.
///
/// # Errors
/// [`ErrorKind::UnsupportedMediaType`]
pub fn plain(headers: &HeaderMap) -> Result<(), HttpError> {
    match header_text(headers, &header::CONTENT_ENCODING)?.as_deref() {
        None | Some("" | "identity") => Ok(()),
        Some(other) => {
            let detail = format!("content-encoding {other:?} is not taken for a stream: send none");
            Err(HttpError(ServiceError::new(ErrorKind::UnsupportedMediaType, detail).at("content-encoding")))
        }
    }
}

/// The form of a body that is a message; JSON where the header is missing.
///
/// # Errors
/// [`ErrorKind::UnsupportedMediaType`]
pub fn message_encoding(headers: &HeaderMap) -> Result<Encoding, HttpError> {
    match scan_encoding(headers) {
        Ok(ScanEncoding::Message(encoding)) => Ok(encoding),
        Ok(ScanEncoding::Lines) | Err(_) => Err(unsupported(headers, "application/json or application/x-protobuf")),
    }
}

/// The form of a body of scans; JSON where the header is missing.
///
/// # Errors
/// [`ErrorKind::UnsupportedMediaType`]
pub fn scan_encoding(headers: &HeaderMap) -> Result<ScanEncoding, HttpError> {
    let known = "application/json, application/x-ndjson or application/x-protobuf";
    let text = header_text(headers, &header::CONTENT_TYPE)?;
    let media = text.as_deref().map(|text| text.split(';').next().unwrap_or_default().trim());
    match media {
        // Browsers send a page's request to another site without asking that site first when it has no content-type.
        // They name the page's origin then, and no other client does.
        None if headers.contains_key(header::ORIGIN) => Err(unsupported(headers, known)),
        None | Some("application/json") => Ok(ScanEncoding::Message(Encoding::Json)),
        Some("application/x-protobuf" | "application/protobuf") => Ok(ScanEncoding::Message(Encoding::Protobuf)),
        Some("application/x-ndjson" | "application/ndjson" | "application/jsonl") => Ok(ScanEncoding::Lines),
        Some(_) => Err(unsupported(headers, known)),
    }
}

/// Runs a piece of work here when it is small, else on a thread where it holds nobody up.
///
/// # Errors
/// Those of the work, and [`ErrorKind::Internal`] when it panics.
pub async fn apart<T: Send + 'static>(
    size: usize,
    work: impl FnOnce() -> Result<T, HttpError> + Send + 'static,
) -> Result<T, HttpError> {
    if size <= DECODE_APART_ABOVE {
        return work();
    }
    match tokio::task::spawn_blocking(work).await {
        Ok(result) => result,
        Err(error) => {
            tracing::error!(%error, "a piece of work failed");
            Err(HttpError::new(ErrorKind::Internal, "the server failed to work on the request"))
        }
    }
}

/// Reads a body whole.
///
/// # Errors
/// [`ErrorKind::BodyTooLarge`], [`ErrorKind::InvalidRequest`] for one that breaks off.
pub async fn collect(mut body: Body, limit: Limit) -> Result<Bytes, HttpError> {
    let mut kept: Vec<u8> = Vec::new();
    let mut only = Bytes::new();
    let mut total = 0;
    while let Some(frame) = body.frame().await {
        let frame = frame.map_err(|error| HttpError(broken(error)))?;
        let Ok(data) = frame.into_data() else { continue };
        if data.len() > limit.bytes - total {
            return Err(too_large(limit, ""));
        }
        if total == 0 {
            // A body of one piece is taken without a copy.
            only = data.clone();
        } else {
            if kept.is_empty() {
                kept.extend_from_slice(&only);
            }
            kept.extend_from_slice(&data);
        }
        total += data.len();
    }
    Ok(if kept.is_empty() { only } else { Bytes::from(kept) })
}

/// Undoes gzip piece by piece: what a small body unfolds to is counted before there is memory for it.
fn unzip(bytes: &[u8], limit: Limit, held: Option<&Held>) -> Result<Bytes, HttpError> {
    let mut plain = Vec::new();
    let mut reader = MultiGzDecoder::new(bytes).take(UNZIPPED_PIECE);
    loop {
        let before = plain.len();
        reader.read_to_end(&mut plain).map_err(|error| {
            let detail = format!("the body is not valid gzip: {error}");
            HttpError(ServiceError::new(ErrorKind::InvalidRequest, detail).at("body"))
        })?;
        let more = plain.len() - before;
        if plain.len() > limit.bytes {
            return Err(too_large(limit, " after decompression"));
        }
        held.map_or(Ok(()), |held| held.grow(more))?;
        if more == 0 {
            return Ok(Bytes::from(plain));
        }
        reader.set_limit(UNZIPPED_PIECE);
    }
}

fn too_large(limit: Limit, when: &str) -> HttpError {
    if limit.setting == setting::IMPORT_BYTES {
        return HttpError(files::too_large(limit.bytes));
    }
    let detail = format!("the body is larger than {} bytes{when}, the limit: send less at a time", limit.bytes);
    HttpError(ServiceError::over(ErrorKind::BodyTooLarge, limit.setting, detail).at("body"))
}

/// Why a body ended early: it was refused, or its client has gone.
pub fn broken(error: axum::Error) -> ServiceError {
    let broke_off = || ServiceError::new(ErrorKind::InvalidRequest, "the body broke off").at("body");
    refusal(error).unwrap_or_else(broke_off)
}

fn unsupported(headers: &HeaderMap, known: &str) -> HttpError {
    let given = headers.get(header::CONTENT_TYPE).map(|value| String::from_utf8_lossy(value.as_bytes()).into_owned());
    let given: String = given.unwrap_or_default().chars().take(80).collect();
    let detail = format!("content-type {given:?} is not taken here: send {known}");
    HttpError(ServiceError::new(ErrorKind::UnsupportedMediaType, detail).at("content-type"))
}

/// A header's text in lower case.
fn header_text(headers: &HeaderMap, name: &header::HeaderName) -> Result<Option<String>, HttpError> {
    let Some(value) = headers.get(name) else { return Ok(None) };
    match value.to_str() {
        Ok(text) => Ok(Some(text.trim().to_ascii_lowercase())),
        Err(_) => {
            let detail = format!("the header {name} is not readable text");
            Err(HttpError(ServiceError::new(ErrorKind::UnsupportedMediaType, detail).at(name.as_str())))
        }
    }
}

//! Streams of JSON lines (NDJSON): scans that come in one by one, and messages that go out one by one.

use super::body::{self, ScanEncoding};
use super::problem::Problem;
use crate::service::{ErrorKind, ServiceError, setting};
use crate::store::MapName;
use crate::wire::{self, v1};
use axum::body::{Body, Bytes};
use axum::http::{HeaderMap, HeaderValue, StatusCode, header};
use axum::response::{IntoResponse, Response};
use futures_util::stream::{self, Stream, StreamExt};
use http_body_util::BodyExt;
use serde::Serialize;
use std::convert::Infallible;
use tokio::sync::mpsc;
use tokio_stream::wrappers::ReceiverStream;

/// Media type of JSON lines.
pub const NDJSON: &str = "application/x-ndjson";

/// Does the client send scans as lines, and want a line for each as soon as it is durable?
pub fn streamed(headers: &HeaderMap) -> bool {
    let as_lines = body::scan_encoding(headers).is_ok_and(|form| form == ScanEncoding::Lines);
    let wanted = headers
        .get_all(header::ACCEPT)
        .iter()
        .filter_map(|value| value.to_str().ok())
        .flat_map(|value| value.split(','))
        .any(|range| range.split(';').next().unwrap_or_default().trim().eq_ignore_ascii_case(NDJSON));
    as_lines && wanted
}

/// A response of one line a message. The last line is a problem where the stream ends by an error.
pub fn response<M: Serialize + Send + 'static>(messages: mpsc::Receiver<Result<M, ServiceError>>) -> Response {
    let lines = ReceiverStream::new(messages).map(|message| {
        let mut line = match message {
            Ok(message) => json(&message),
            Err(error) => json(&Problem::from(&error)),
        };
        line.push('\n');
        Ok::<_, Infallible>(Bytes::from(line))
    });
    let headers = [
        (header::CONTENT_TYPE, HeaderValue::from_static(NDJSON)),
        (header::CACHE_CONTROL, HeaderValue::from_static("no-cache")),
    ];
    (StatusCode::OK, headers, Body::from_stream(lines)).into_response()
}

/// One line of JSON.
pub fn json<M: Serialize>(message: &M) -> String {
    serde_json::to_string(message).unwrap_or_else(|error| {
        tracing::error!(%error, "a message cannot be written as JSON");
        String::new()
    })
}

/// What is read of a body of lines.
struct Reader {
    body: Body,
    map: MapName,
    /// Bytes that came and were not taken yet.
    buffer: Vec<u8>,
    /// How many of them hold no end of a line.
    searched: usize,
    limit: usize,
    line: usize,
    scan: usize,
    ended: bool,
}

/// The scans of a body, one a line, as they come. A line has at most `limit` bytes.
pub fn scans(
    body: Body,
    map: MapName,
    limit: usize,
) -> impl Stream<Item = Result<v1::StreamScansRequest, ServiceError>> {
    let reader = Reader { body, map, buffer: Vec::new(), searched: 0, limit, line: 0, scan: 0, ended: false };
    stream::unfold(reader, |mut reader| async move { reader.next().await.map(|scan| (scan, reader)) })
}

impl Reader {
    async fn next(&mut self) -> Option<Result<v1::StreamScansRequest, ServiceError>> {
        while !self.ended {
            let line = match self.line().await {
                Ok(line) => line?,
                Err(error) => {
                    self.ended = true;
                    return Some(Err(error));
                }
            };
            let number = self.line;
            self.line += 1;
            if line.trim_ascii().is_empty() {
                continue;
            }
            let scan = wire::scan_line(&line, number, self.scan);
            self.scan += 1;
            self.ended = scan.is_err();
            return Some(scan.map(|scan| v1::StreamScansRequest { map: self.map.to_string(), scan: Some(scan) }));
        }
        None
    }

    /// The next line without its end; `None` behind the last.
    async fn line(&mut self) -> Result<Option<Vec<u8>>, ServiceError> {
        loop {
            if let Some(at) = self.buffer[self.searched..].iter().position(|byte| *byte == b'\n') {
                let rest = self.buffer.split_off(self.searched + at + 1);
                let line = std::mem::replace(&mut self.buffer, rest);
                self.searched = 0;
                return Ok(Some(line));
            }
            self.searched = self.buffer.len();
            if self.buffer.len() > self.limit {
                let detail = format!("line {} is longer than {} bytes, the limit", self.line + 1, self.limit);
                return Err(ServiceError::over(ErrorKind::BodyTooLarge, setting::BODY_BYTES, detail).at("body"));
            }
            match self.body.frame().await {
                Some(Ok(frame)) => self.buffer.extend_from_slice(&frame.into_data().unwrap_or_default()),
                Some(Err(error)) => return Err(body::broken(error)),
                None => {
                    self.ended = true;
                    self.searched = 0;
                    let last = std::mem::take(&mut self.buffer);
                    return Ok((!last.is_empty()).then_some(last));
                }
            }
        }
    }
}

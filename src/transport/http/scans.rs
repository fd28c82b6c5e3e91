//! `POST /v1/maps/{map}/scans`: a request of scans, or a stream of them.

use super::body::{self, ScanEncoding};
use super::params::no_params;
use super::path::MapPath;
use super::{App, HttpError, accept, lines, respond};
use crate::store::MapName;
use crate::transport::access::{OnBehalf, Operation};
use crate::transport::client::Client;
use crate::transport::scan_stream;
use crate::wire::{self, Batch};
use axum::body::Body;
use axum::extract::{Request, State};
use axum::http::request::Parts;
use axum::response::Response;
use tokio::sync::mpsc;

/// Acknowledgements that wait for a client to read them.
const WAITING_ACKNOWLEDGEMENTS: usize = 16;

/// Applies the scans of a body; the answer means that they are durable.
pub async fn insert(
    State(app): State<App>,
    caller: OnBehalf,
    path: Result<MapPath, HttpError>,
    request: Request,
) -> Result<Response, HttpError> {
    let (parts, body) = request.into_parts();
    if lines::streamed(&parts.headers) {
        let MapPath(map) = path?;
        return stream(app, caller, &map, &parts, body).await;
    }
    let MapPath(map) = path?;
    // Nothing is kept of one whose scans are not taken.
    caller.may(Operation::InsertScans, &map)?;
    let bytes = body::read(&parts, body, app.settings.body_limit()).await?;
    no_params(&parts.uri)?;
    let form = accept::message(&parts.headers)?;
    let encoding = body::scan_encoding(&parts.headers)?;
    // A full queue is told before the body is made scans of: that costs more than all else of a refusal.
    caller.room(&map)?;
    let most = caller.settings().max_scans_per_request;
    let named = map.clone();
    let mut batch = body::apart(bytes.len(), move || match encoding {
        ScanEncoding::Lines => Ok(Batch::new(wire::scan_lines(&bytes, most)?)),
        ScanEncoding::Message(encoding) => {
            let request = wire::insert_request(&bytes, encoding, most)?;
            wire::same_map(&named, &request.map)?;
            Ok(Batch::new(request.scans))
        }
    })
    .await?;
    let answer = caller.insert(&map, batch.take_scans()).await?;
    respond::message(form, batch.response(answer), 0).await
}

/// Applies scans as their lines come, and answers each with a line when it is durable.
async fn stream(app: App, caller: OnBehalf, map: &MapName, parts: &Parts, body: Body) -> Result<Response, HttpError> {
    caller.may(Operation::StreamScans, map)?;
    no_params(&parts.uri)?;
    body::plain(&parts.headers)?;
    // A map that is not there is a plain problem, and no stream that begins with one.
    caller.version(map).await?;
    let place = app.door.stream(parts.extensions.get::<Client>())?;
    let scans = lines::scans(body, map.clone(), app.settings.body_bytes);
    let (out, receiver) = mpsc::channel(WAITING_ACKNOWLEDGEMENTS);
    tokio::spawn(async move {
        scan_stream::run(&caller, &app.door, app.settings.scans_per_stream, scans, out).await;
        drop(place);
    });
    Ok(lines::response(receiver))
}

//! `POST /v1/maps/{map}/scans`

use super::body::{self, ScanEncoding};
use super::params::Params;
use super::path::{MapPath, same_map};
use super::{App, HttpError, accept, respond};
use crate::wire::{self, Batch};
use axum::extract::{Request, State};
use axum::response::Response;

/// Applies the scans of a body; the answer means that they are durable.
pub async fn insert(
    State(app): State<App>,
    path: Result<MapPath, HttpError>,
    request: Request,
) -> Result<Response, HttpError> {
    let (parts, body) = request.into_parts();
    let bytes = body::read(&parts.headers, body, app.settings.body_bytes).await?;
    let MapPath(map) = path?;
    Params::none(&parts.uri)?;
    let form = accept::message(&parts.headers)?;
    let encoding = body::scan_encoding(&parts.headers)?;
    let most = app.service.settings().max_scans_per_request;
    let named = map.clone();
    let mut batch = body::apart(bytes.len(), move || match encoding {
        ScanEncoding::Lines => Ok(Batch::new(wire::scan_lines(&bytes, most)?)),
        ScanEncoding::Message(encoding) => {
            let request = wire::insert_request(&bytes, encoding, most)?;
            same_map(&named, &request.map)?;
            Ok(Batch::new(request.scans))
        }
    })
    .await?;
    let answer = app.service.insert(&map, batch.take_scans()).await?;
    respond::message(form, batch.response(answer), 0).await
}

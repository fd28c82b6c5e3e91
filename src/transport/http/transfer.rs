//! Whole maps as files: `GET .../export` and `PUT .../import`.

use super::body;
use super::openapi::table::EXPORT_MAP;
use super::params::{no_params, params};
use super::path::MapPath;
use super::respond::matches;
use super::{App, HttpError, accept, respond};
use crate::service::{ExportedFile, ServiceError};
use crate::transport::access::{OnBehalf, Operation};
use crate::transport::{files, operations};
use crate::wire::v1;
use axum::body::{Body, Bytes};
use axum::extract::{Request, State};
use axum::http::{HeaderName, HeaderValue, StatusCode, header};
use axum::response::{IntoResponse, Response};
use futures_util::StreamExt;

/// `GET /v1/maps/{map}/export?format=&snapshot=&depth=&mode=`
pub async fn export(
    State(app): State<App>,
    caller: OnBehalf,
    path: MapPath,
    request: Request,
) -> Result<Response, HttpError> {
    let MapPath(map) = path;
    let params = params(request.uri(), &EXPORT_MAP)?;
    let (format, media) = match params.text("format") {
        None | Some("ubbmap") => (v1::ExportFormat::Ubbmap, "application/octet-stream"),
        Some("nav2") => (v1::ExportFormat::Nav2, "application/zip"),
        Some(_) => return Err(HttpError::invalid("format", "format must be ubbmap or nav2")),
    };
    let mode = match params.text("mode") {
        None => v1::ExportMode::Unspecified,
        Some("trinary") => v1::ExportMode::Trinary,
        Some("scale") => v1::ExportMode::Scale,
        Some(_) => return Err(HttpError::invalid("mode", "mode must be trinary or scale")),
    };
    let wanted = v1::ExportMapRequest {
        map: map.to_string(),
        format: format.into(),
        snapshot: params.snapshot()?.to_owned(),
        depth: params.number("depth", "a whole number")?,
        mode: mode.into(),
    };
    caller.may(Operation::ExportMap, &map)?;
    let place = app.door.transfer()?;
    let ExportedFile { file_name, revision, bytes } = operations::export_map(&caller, &wanted).await?;
    let tag = format!("\"{file_name}-{:08x}\"", crc32c::crc32c(&bytes));
    let tag = HeaderValue::try_from(tag).unwrap_or(HeaderValue::from_static("\"\""));
    let disposition = HeaderValue::try_from(format!("attachment; filename=\"{file_name}\""));
    let common = [
        (header::ETAG, tag.clone()),
        (header::CACHE_CONTROL, HeaderValue::from_static("no-cache")),
        (HeaderName::from_static("ubbmap-revision"), HeaderValue::from(revision)),
    ];
    if matches(request.headers(), &tag) {
        return Ok((StatusCode::NOT_MODIFIED, common).into_response());
    }
    let headers = [
        (header::CONTENT_TYPE, HeaderValue::from_static(media)),
        (header::CONTENT_LENGTH, HeaderValue::from(bytes.len())),
        (header::CONTENT_DISPOSITION, disposition.unwrap_or(HeaderValue::from_static("attachment"))),
    ];
    let pieces = files::outgoing(Bytes::from(bytes), place, &app.door);
    let pieces = pieces.map(|piece| piece.map_err(|error: ServiceError| std::io::Error::other(error.detail)));
    Ok((common, headers, Body::from_stream(pieces)).into_response())
}

/// `PUT /v1/maps/{map}/import`: the body is the file.
pub async fn import(
    State(app): State<App>,
    caller: OnBehalf,
    path: Result<MapPath, HttpError>,
    request: Request,
) -> Result<Response, HttpError> {
    let (parts, body) = request.into_parts();
    let MapPath(map) = path?;
    // Nobody holds a whole file in memory for whom nothing is made of it.
    caller.may(Operation::ImportMap, &map)?;
    body::plain(&parts.headers)?;
    let file = body::collect(body, app.settings.import_limit()).await?;
    no_params(&parts.uri)?;
    let form = accept::message(&parts.headers)?;
    let imported = operations::import_map(&caller, map.as_str(), file).await?;
    Ok((StatusCode::CREATED, respond::message(form, imported, 0).await?).into_response())
}

//! Snapshots of a map: taken, listed, restored and deleted.

use super::body;
use super::params::no_params;
use super::path::{MapPath, SnapshotPath};
use super::{App, HttpError, accept, respond};
use crate::transport::access::{OnBehalf, Operation};
use crate::transport::operations;
use crate::wire::{self, v1};
use axum::body::Body;
use axum::extract::{Request, State};
use axum::http::StatusCode;
use axum::http::request::Parts;
use axum::response::{IntoResponse, Response};

/// `POST /v1/maps/{map}/snapshots`
pub async fn create(
    State(app): State<App>,
    caller: OnBehalf,
    path: Result<MapPath, HttpError>,
    request: Request,
) -> Result<Response, HttpError> {
    let (parts, body) = request.into_parts();
    let bytes = body::read(&parts.headers, body, app.settings.config_bytes).await?;
    let MapPath(map) = path?;
    caller.may(Operation::CreateSnapshot, &map)?;
    no_params(&parts.uri)?;
    let form = accept::message(&parts.headers)?;
    let encoding = body::message_encoding(&parts.headers)?;
    let mut request: v1::CreateSnapshotRequest = wire::request(&bytes, encoding)?;
    wire::same_map(&map, &request.map)?;
    request.map = map.to_string();
    let taken = operations::create_snapshot(&caller, request).await?;
    let response = respond::message(form, taken, 0).await?;
    Ok((StatusCode::CREATED, response).into_response())
}

/// `GET /v1/maps/{map}/snapshots`
pub async fn list(caller: OnBehalf, path: MapPath, request: Request) -> Result<Response, HttpError> {
    let MapPath(map) = path;
    no_params(request.uri())?;
    let form = accept::message(request.headers())?;
    let request = v1::ListSnapshotsRequest { map: map.to_string() };
    let list = operations::list_snapshots(&caller, request).await?;
    let size = list.snapshots.len() * 2 * size_of::<v1::Snapshot>();
    respond::message(form, list, size).await
}

/// `POST /v1/maps/{map}/snapshots/{name}/restore`; a body may repeat what the path says.
pub async fn restore(
    State(app): State<App>,
    caller: OnBehalf,
    path: Result<SnapshotPath, HttpError>,
    request: Request,
) -> Result<Response, HttpError> {
    let (parts, body) = request.into_parts();
    let SnapshotPath { map, name } = named(&app, &caller, &parts, body, path).await?;
    let form = accept::message(&parts.headers)?;
    let request = v1::RestoreSnapshotRequest { map: map.to_string(), name };
    respond::message(form, operations::restore_snapshot(&caller, request).await?, 0).await
}

/// The path of a restoring whose body, if it has one, says the same. The form of the body is looked at in any case: what
/// browsers send to other sites without asking has none of ours.
async fn named(
    app: &App,
    caller: &OnBehalf,
    parts: &Parts,
    body: Body,
    path: Result<SnapshotPath, HttpError>,
) -> Result<SnapshotPath, HttpError> {
    let bytes = body::read(&parts.headers, body, app.settings.config_bytes).await?;
    let path = path?;
    caller.may(Operation::RestoreSnapshot, &path.map)?;
    no_params(&parts.uri)?;
    let encoding = body::message_encoding(&parts.headers)?;
    if !bytes.is_empty() {
        let request: v1::RestoreSnapshotRequest = wire::request(&bytes, encoding)?;
        wire::same_map(&path.map, &request.map)?;
        if !request.name.is_empty() && request.name != path.name {
            return Err(HttpError::invalid("name", "the body names another snapshot than the path"));
        }
    }
    Ok(path)
}

/// `DELETE /v1/maps/{map}/snapshots/{name}`
pub async fn delete(caller: OnBehalf, path: SnapshotPath, request: Request) -> Result<Response, HttpError> {
    no_params(request.uri())?;
    let request = v1::DeleteSnapshotRequest { map: path.map.to_string(), name: path.name };
    operations::delete_snapshot(&caller, request).await?;
    Ok(StatusCode::NO_CONTENT.into_response())
}

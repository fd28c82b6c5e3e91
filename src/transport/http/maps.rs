//! Creating, reading, listing and deleting maps.

use super::body;
use super::params::no_params;
use super::path::MapPath;
use super::{App, HttpError, accept, respond};
use crate::transport::access::{OnBehalf, Operation};
use crate::wire;
use axum::extract::{Request, State};
use axum::http::StatusCode;
use axum::response::{IntoResponse, Response};

/// `PUT /v1/maps/{map}`: 201 when the map is new, 200 when it was there with this configuration.
pub async fn create(
    State(app): State<App>,
    caller: OnBehalf,
    path: Result<MapPath, HttpError>,
    request: Request,
) -> Result<Response, HttpError> {
    let (parts, body) = request.into_parts();
    let bytes = body::read(&parts.headers, body, app.settings.config_bytes).await?;
    let MapPath(map) = path?;
    caller.may(Operation::CreateMap, &map)?;
    no_params(&parts.uri)?;
    let form = accept::message(&parts.headers)?;
    // A client that sends nothing rarely says what nothing is written in.
    let encoding = if bytes.is_empty() { wire::Encoding::Json } else { body::message_encoding(&parts.headers)? };
    let request = body::apart(bytes.len(), move || Ok(wire::create_request(&bytes, encoding)?)).await?;
    wire::same_map(&map, &request.map)?;
    let config = wire::map_config(request.config.unwrap_or_default())?;
    let created = caller.create_map(&map, config).await?;
    let status = if created.created { StatusCode::CREATED } else { StatusCode::OK };
    let response = respond::message(form, wire::create_map_response(created), 0).await?;
    Ok((status, response).into_response())
}

/// `GET /v1/maps/{map}`
pub async fn read(caller: OnBehalf, path: MapPath, request: Request) -> Result<Response, HttpError> {
    let MapPath(map) = path;
    no_params(request.uri())?;
    let form = accept::message(request.headers())?;
    let map = caller.map(&map).await?;
    respond::message(form, wire::get_map_response(map), 0).await
}

/// `GET /v1/maps`
pub async fn list(caller: OnBehalf, request: Request) -> Result<Response, HttpError> {
    no_params(request.uri())?;
    let form = accept::message(request.headers())?;
    let maps = caller.maps().await?;
    let size = maps.len() * 500;
    respond::message(form, wire::list_maps_response(maps), size).await
}

/// `DELETE /v1/maps/{map}`
pub async fn delete(caller: OnBehalf, path: MapPath, request: Request) -> Result<Response, HttpError> {
    let MapPath(map) = path;
    no_params(request.uri())?;
    caller.delete_map(&map).await?;
    Ok(StatusCode::NO_CONTENT.into_response())
}

//! Classes at points, leaves of a box, and guaranteed-free.

use super::body;
use super::openapi::table::GET_REGION;
use super::params::{no_params, params};
use super::path::MapPath;
use super::{App, HttpError, accept, respond};
use crate::quadtree::Leaf;
use crate::service::BlockChange;
use crate::wire::{self, v1};
use axum::extract::{Request, State};
use axum::response::Response;

/// `POST /v1/maps/{map}/classes`
pub async fn classes(
    State(app): State<App>,
    path: Result<MapPath, HttpError>,
    request: Request,
) -> Result<Response, HttpError> {
    let (parts, body) = request.into_parts();
    let bytes = body::read(&parts, body, app.settings.body_limit()).await?;
    let MapPath(map) = path?;
    no_params(&parts.uri)?;
    let form = accept::message(&parts.headers)?;
    let encoding = body::message_encoding(&parts.headers)?;
    let most = app.service.settings().max_points;
    let request = body::apart(bytes.len(), move || Ok(wire::classes_request(&bytes, encoding, most)?)).await?;
    wire::same_map(&map, &request.map)?;
    let points = wire::points(&request.points)?;
    let answer = app.service.classes(&map, &points, request.depth).await?;
    let size = answer.classes.len() * 4;
    respond::message(form, wire::classes_response(answer), size).await
}

/// `POST /v1/maps/{map}/guaranteed-free`
pub async fn guaranteed_free(
    State(app): State<App>,
    path: Result<MapPath, HttpError>,
    request: Request,
) -> Result<Response, HttpError> {
    let (parts, body) = request.into_parts();
    let bytes = body::read(&parts, body, app.settings.body_limit()).await?;
    let MapPath(map) = path?;
    no_params(&parts.uri)?;
    let form = accept::message(&parts.headers)?;
    let encoding = body::message_encoding(&parts.headers)?;
    let settings = app.service.settings();
    let (most, limits) = (settings.max_regions, settings.region);
    let named = map.clone();
    let (regions, tolerance) = body::apart(bytes.len(), move || {
        let request = wire::free_request(&bytes, encoding, most)?;
        wire::same_map(&named, &request.map)?;
        Ok((wire::regions(request.regions, &limits)?, request.tolerance))
    })
    .await?;
    let answers = app.service.guaranteed_free(&map, &regions, tolerance).await?;
    let size = answers.results.len() * size_of::<v1::FreeResult>();
    respond::message(form, wire::free_response(&answers), size).await
}

/// `GET /v1/maps/{map}/region`
pub async fn region(State(app): State<App>, path: MapPath, request: Request) -> Result<Response, HttpError> {
    let MapPath(map) = path;
    let params = params(request.uri(), &GET_REGION)?;
    let form = accept::message(request.headers())?;
    let answer = app.service.region_with(&map, &params.box_query()?, params.flag("blocks")?).await?;
    let size = answer.leaves.len() * size_of::<Leaf>() + answer.blocks.len() * size_of::<BlockChange>();
    respond::message(form, wire::region_response(answer), size).await
}

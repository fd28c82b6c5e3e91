//! Classes at points, leaves of a box, and guaranteed-free, each also of a snapshot; where robots are.

use super::body;
use super::params::{no_params, params};
use super::path::MapPath;
use super::{App, HttpError, accept, respond};
use crate::quadtree::Leaf;
use crate::service::BlockChange;
use crate::transport::access::{OnBehalf, Operation};
use crate::transport::operations;
use crate::wire::{self, v1};
use axum::extract::{Request, State};
use axum::response::Response;

/// `POST /v1/maps/{map}/classes`
pub async fn classes(
    State(app): State<App>,
    caller: OnBehalf,
    path: Result<MapPath, HttpError>,
    request: Request,
) -> Result<Response, HttpError> {
    let (parts, body) = request.into_parts();
    let bytes = body::read(&parts.headers, body, app.settings.body_bytes).await?;
    let MapPath(map) = path?;
    caller.may(Operation::GetClasses, &map)?;
    no_params(&parts.uri)?;
    let form = accept::message(&parts.headers)?;
    let encoding = body::message_encoding(&parts.headers)?;
    let most = caller.settings().max_points;
    let request = body::apart(bytes.len(), move || Ok(wire::classes_request(&bytes, encoding, most)?)).await?;
    wire::same_map(&map, &request.map)?;
    let points = wire::points(&request.points)?;
    let view = operations::view(&caller, Operation::GetClasses, &map, &request.snapshot).await?;
    let answer = view.classes(&points, request.depth).await?;
    let size = answer.classes.len() * 4;
    respond::message(form, wire::classes_response(answer), size).await
}

/// `POST /v1/maps/{map}/guaranteed-free`
pub async fn guaranteed_free(
    State(app): State<App>,
    caller: OnBehalf,
    path: Result<MapPath, HttpError>,
    request: Request,
) -> Result<Response, HttpError> {
    let (parts, body) = request.into_parts();
    let bytes = body::read(&parts.headers, body, app.settings.body_bytes).await?;
    let MapPath(map) = path?;
    caller.may(Operation::CheckGuaranteedFree, &map)?;
    no_params(&parts.uri)?;
    let form = accept::message(&parts.headers)?;
    let encoding = body::message_encoding(&parts.headers)?;
    let settings = caller.settings();
    let (most, limits) = (settings.max_regions, settings.region);
    let named = map.clone();
    let (regions, tolerance, snapshot) = body::apart(bytes.len(), move || {
        let request = wire::free_request(&bytes, encoding, most)?;
        wire::same_map(&named, &request.map)?;
        Ok((wire::regions(request.regions, &limits)?, request.tolerance, request.snapshot))
    })
    .await?;
    let view = operations::view(&caller, Operation::CheckGuaranteedFree, &map, &snapshot).await?;
    let answers = view.guaranteed_free(&regions, tolerance).await?;
    let size = answers.results.len() * size_of::<v1::FreeResult>();
    respond::message(form, wire::free_response(&answers), size).await
}

/// `GET /v1/maps/{map}/region`
pub async fn region(caller: OnBehalf, path: MapPath, request: Request) -> Result<Response, HttpError> {
    let MapPath(map) = path;
    let params = params(request.uri(), &["min_x", "min_y", "max_x", "max_y", "depth", "blocks", "snapshot"])?;
    let form = accept::message(request.headers())?;
    let (query, blocks, snapshot) = (params.box_query()?, params.flag("blocks")?, params.snapshot()?);
    let answer = operations::view(&caller, Operation::GetRegion, &map, snapshot).await?.region(&query, blocks).await?;
    let size = answer.leaves.len() * size_of::<Leaf>() + answer.blocks.len() * size_of::<BlockChange>();
    respond::message(form, wire::region_response(answer), size).await
}

/// `GET /v1/maps/{map}/robots`
pub async fn robots(caller: OnBehalf, path: MapPath, request: Request) -> Result<Response, HttpError> {
    let MapPath(map) = path;
    no_params(request.uri())?;
    let form = accept::message(request.headers())?;
    let request = v1::ListRobotsRequest { map: map.to_string() };
    let list = operations::list_robots(&caller, request).await?;
    let size = list.robots.len() * 2 * size_of::<v1::RobotPose>();
    respond::message(form, list, size).await
}

//! Every operation from its request message to its response message: what all transports have in common.

use super::access::{OnBehalf, Operation};
use crate::service::{ErrorKind, ExportedFile, MapView, ServiceError};
use crate::store::MapName;
use crate::wire::{self, Batch, v1};

/// Creates a map.
///
/// # Errors
/// As [`OnBehalf::create_map`].
pub async fn create_map(
    service: &OnBehalf,
    request: v1::CreateMapRequest,
) -> Result<v1::CreateMapResponse, ServiceError> {
    let name = wire::map_name(&request.map)?;
    let config = wire::map_config(request.config.unwrap_or_default())?;
    Ok(wire::create_map_response(service.create_map(&name, config).await?))
}

/// One map.
///
/// # Errors
/// As [`OnBehalf::map`].
pub async fn get_map(service: &OnBehalf, request: v1::GetMapRequest) -> Result<v1::GetMapResponse, ServiceError> {
    Ok(wire::get_map_response(service.map(&wire::map_name(&request.map)?).await?))
}

/// All maps.
///
/// # Errors
/// As [`OnBehalf::maps`].
pub async fn list_maps(service: &OnBehalf) -> Result<v1::ListMapsResponse, ServiceError> {
    Ok(wire::list_maps_response(service.maps().await?))
}

/// Deletes a map.
///
/// # Errors
/// As [`OnBehalf::delete_map`].
pub async fn delete_map(
    service: &OnBehalf,
    request: v1::DeleteMapRequest,
) -> Result<v1::DeleteMapResponse, ServiceError> {
    service.delete_map(&wire::map_name(&request.map)?).await?;
    Ok(v1::DeleteMapResponse {})
}

/// Applies scans.
///
/// # Errors
/// As [`OnBehalf::insert`].
pub async fn insert_scans(
    service: &OnBehalf,
    request: v1::InsertScansRequest,
) -> Result<v1::InsertScansResponse, ServiceError> {
    let name = wire::map_name(&request.map)?;
    limited(request.scans.len(), service.settings().max_scans_per_request, "scans", ErrorKind::TooManyScans)?;
    let mut batch = Batch::new(request.scans);
    let answer = service.insert(&name, batch.take_scans()).await?;
    Ok(batch.response(answer))
}

/// Classes at points.
///
/// # Errors
/// As [`OnBehalf::view`] and [`MapView::classes`].
pub async fn get_classes(
    service: &OnBehalf,
    request: v1::GetClassesRequest,
) -> Result<v1::GetClassesResponse, ServiceError> {
    let name = wire::map_name(&request.map)?;
    limited(request.points.len(), service.settings().max_points, "points", ErrorKind::TooManyPoints)?;
    let points = wire::points(&request.points)?;
    let view = view(service, Operation::GetClasses, &name, &request.snapshot).await?;
    Ok(wire::classes_response(view.classes(&points, request.depth).await?))
}

/// Quadtree leaves of a box.
///
/// # Errors
/// As [`OnBehalf::view`] and [`MapView::region`].
pub async fn get_region(
    service: &OnBehalf,
    request: v1::GetRegionRequest,
) -> Result<v1::GetRegionResponse, ServiceError> {
    let name = wire::map_name(&request.map)?;
    let view = view(service, Operation::GetRegion, &name, &request.snapshot).await?;
    Ok(wire::region_response(view.region(&wire::region_query(&request), request.blocks).await?))
}

/// Dense raster of a box.
///
/// # Errors
/// As [`OnBehalf::view`] and [`MapView::grid`].
pub async fn get_grid(service: &OnBehalf, request: v1::GetGridRequest) -> Result<v1::GetGridResponse, ServiceError> {
    let name = wire::map_name(&request.map)?;
    let view = view(service, Operation::GetGrid, &name, &request.snapshot).await?;
    Ok(wire::grid_response(view.grid(&wire::grid_query(&request)).await?))
}

/// One tile.
///
/// # Errors
/// As [`OnBehalf::view`] and [`MapView::tile`].
pub async fn get_tile(service: &OnBehalf, request: v1::GetTileRequest) -> Result<v1::GetTileResponse, ServiceError> {
    let name = wire::map_name(&request.map)?;
    let v1::GetTileRequest { z, x, y, .. } = request;
    let view = view(service, Operation::GetTile, &name, &request.snapshot).await?;
    Ok(wire::tile_response(view.tile(z, x, y).await?, (z, x, y)))
}

/// The guaranteed-free query.
///
/// # Errors
/// As [`OnBehalf::view`] and [`MapView::guaranteed_free`].
pub async fn check_guaranteed_free(
    service: &OnBehalf,
    request: v1::CheckGuaranteedFreeRequest,
) -> Result<v1::CheckGuaranteedFreeResponse, ServiceError> {
    let name = wire::map_name(&request.map)?;
    let settings = service.settings();
    limited(request.regions.len(), settings.max_regions, "regions", ErrorKind::TooManyRegions)?;
    let regions = wire::regions(request.regions, &settings.region)?;
    let view = view(service, Operation::CheckGuaranteedFree, &name, &request.snapshot).await?;
    Ok(wire::free_response(&view.guaranteed_free(&regions, request.tolerance).await?))
}

/// Blocks changed since a revision.
///
/// # Errors
/// As [`OnBehalf::changes`].
pub async fn get_changes(
    service: &OnBehalf,
    request: v1::GetChangesRequest,
) -> Result<v1::GetChangesResponse, ServiceError> {
    let name = wire::map_name(&request.map)?;
    let query = wire::changes_query(&request);
    Ok(wire::changes_response(service.changes(&name, request.since, &query).await?))
}

/// Where the robots of a map are.
///
/// # Errors
/// As [`OnBehalf::robots`].
pub async fn list_robots(
    service: &OnBehalf,
    request: v1::ListRobotsRequest,
) -> Result<v1::ListRobotsResponse, ServiceError> {
    Ok(wire::list_robots_response(service.robots(&wire::map_name(&request.map)?).await?))
}

/// The revision of a map that a query reads: the last, or that of the snapshot which it names.
///
/// # Errors
/// As [`OnBehalf::view`].
pub async fn view(
    service: &OnBehalf,
    operation: Operation,
    map: &MapName,
    snapshot: &str,
) -> Result<MapView, ServiceError> {
    service.view(operation, map, wire::snapshot_wanted(snapshot)?.as_ref()).await
}

/// Keeps a map's last revision under a name.
///
/// # Errors
/// As [`OnBehalf::take_snapshot`].
pub async fn create_snapshot(
    service: &OnBehalf,
    request: v1::CreateSnapshotRequest,
) -> Result<v1::CreateSnapshotResponse, ServiceError> {
    let (map, name) = (wire::map_name(&request.map)?, wire::snapshot_name(&request.name, "name")?);
    Ok(wire::create_snapshot_response(&service.take_snapshot(&map, &name).await?))
}

/// The snapshots of a map.
///
/// # Errors
/// As [`OnBehalf::snapshots`].
pub async fn list_snapshots(
    service: &OnBehalf,
    request: v1::ListSnapshotsRequest,
) -> Result<v1::ListSnapshotsResponse, ServiceError> {
    Ok(wire::list_snapshots_response(&service.snapshots(&wire::map_name(&request.map)?).await?))
}

/// Makes a snapshot's content the map's.
///
/// # Errors
/// As [`OnBehalf::restore_snapshot`].
pub async fn restore_snapshot(
    service: &OnBehalf,
    request: v1::RestoreSnapshotRequest,
) -> Result<v1::RestoreSnapshotResponse, ServiceError> {
    let (map, name) = (wire::map_name(&request.map)?, wire::snapshot_name(&request.name, "name")?);
    Ok(v1::RestoreSnapshotResponse { revision: service.restore_snapshot(&map, &name).await? })
}

/// Removes a snapshot.
///
/// # Errors
/// As [`OnBehalf::delete_snapshot`].
pub async fn delete_snapshot(
    service: &OnBehalf,
    request: v1::DeleteSnapshotRequest,
) -> Result<v1::DeleteSnapshotResponse, ServiceError> {
    let (map, name) = (wire::map_name(&request.map)?, wire::snapshot_name(&request.name, "name")?);
    service.delete_snapshot(&map, &name).await?;
    Ok(v1::DeleteSnapshotResponse {})
}

/// A whole map as a file.
///
/// # Errors
/// As [`OnBehalf::export`].
pub async fn export_map(service: &OnBehalf, request: &v1::ExportMapRequest) -> Result<ExportedFile, ServiceError> {
    let map = wire::map_name(&request.map)?;
    let (snapshot, form) = wire::export_form(request)?;
    service.export(&map, snapshot.as_ref(), form).await
}

/// A new map from a file.
///
/// # Errors
/// As [`OnBehalf::import`].
pub async fn import_map<B>(service: &OnBehalf, map: &str, file: B) -> Result<v1::ImportMapResponse, ServiceError>
where
    B: AsRef<[u8]> + Send + 'static,
{
    let map = wire::map_name(map)?;
    Ok(wire::import_response(&map, service.import(&map, file).await?))
}

fn limited(count: usize, most: usize, field: &str, kind: ErrorKind) -> Result<(), ServiceError> {
    if count <= most {
        return Ok(());
    }
    Err(ServiceError::new(kind, format!("the request has {count} {field}, the limit is {most}")).at(field))
}

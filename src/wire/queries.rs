//! What queries ask for: names, boxes and points.

use super::v1;
use crate::service::{BoxQuery, ErrorKind, ServiceError};
use crate::store::MapName;

/// The name of a map.
///
/// # Errors
/// [`ErrorKind::InvalidName`]
pub fn map_name(text: &str) -> Result<MapName, ServiceError> {
    MapName::new(text).map_err(|error| ServiceError::new(ErrorKind::InvalidName, error.to_string()).at("map"))
}

/// A request message may name its map too; then it must be the one that its path or key names.
///
/// # Errors
/// [`ErrorKind::InvalidRequest`]
pub fn same_map(map: &MapName, named: &str) -> Result<(), ServiceError> {
    if named.is_empty() || named == map.as_str() {
        return Ok(());
    }
    let named: String = named.chars().take(80).collect();
    let detail = format!("the body names map {named:?}, the path {:?}", map.as_str());
    Err(ServiceError::new(ErrorKind::InvalidRequest, detail).at("map"))
}

/// The box of a request for leaves.
#[must_use]
pub fn region_query(request: &v1::GetRegionRequest) -> BoxQuery {
    let v1::GetRegionRequest { min_x, min_y, max_x, max_y, depth, .. } = *request;
    BoxQuery { min_x, min_y, max_x, max_y, depth }
}

/// The box of a request for a raster.
#[must_use]
pub fn grid_query(request: &v1::GetGridRequest) -> BoxQuery {
    let v1::GetGridRequest { min_x, min_y, max_x, max_y, depth, .. } = *request;
    BoxQuery { min_x, min_y, max_x, max_y, depth }
}

/// Points of the map frame, metres.
///
/// # Errors
/// [`ErrorKind::InvalidPoint`] at a coordinate that is missing.
pub fn points(wire: &[v1::Point]) -> Result<Vec<(f64, f64)>, ServiceError> {
    let missing = |at: usize, axis: &str| {
        let field = format!("points[{at}].{axis}");
        ServiceError::new(ErrorKind::InvalidPoint, format!("{field} is missing")).at(field)
    };
    let pair = |(at, point): (usize, &v1::Point)| {
        Ok((point.x.ok_or_else(|| missing(at, "x"))?, point.y.ok_or_else(|| missing(at, "y"))?))
    };
    wire.iter().enumerate().map(pair).collect()
}

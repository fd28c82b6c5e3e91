//! What the path of a request names.

use super::HttpError;
use crate::service::{ErrorKind, ServiceError};
use crate::store::MapName;
use axum::extract::{FromRequestParts, RawPathParams};
use axum::http::request::Parts;

/// The map that the path names.
#[derive(Debug)]
pub struct MapPath(pub MapName);

/// The map and tile that the path names; the last part with its ending.
#[derive(Debug)]
pub struct TilePath {
    /// The map.
    pub map: MapName,
    /// Depth of the node.
    pub z: String,
    /// Column of the node.
    pub x: String,
    /// Row of the node, and the form after a dot.
    pub y: String,
}

impl<S: Send + Sync> FromRequestParts<S> for MapPath {
    type Rejection = HttpError;

    async fn from_request_parts(parts: &mut Parts, state: &S) -> Result<Self, HttpError> {
        let params = raw(parts, state).await?;
        Ok(Self(map_name(&get(&params, "map"))?))
    }
}

impl<S: Send + Sync> FromRequestParts<S> for TilePath {
    type Rejection = HttpError;

    async fn from_request_parts(parts: &mut Parts, state: &S) -> Result<Self, HttpError> {
        let params = raw(parts, state).await?;
        let map = map_name(&get(&params, "map"))?;
        Ok(Self { map, z: get(&params, "z"), x: get(&params, "x"), y: get(&params, "y") })
    }
}

/// A request message may name its map too; then it must be the one of the path.
///
/// # Errors
/// [`ErrorKind::InvalidRequest`]
pub fn same_map(path: &MapName, named: &str) -> Result<(), HttpError> {
    if named.is_empty() || named == path.as_str() {
        return Ok(());
    }
    let named: String = named.chars().take(80).collect();
    Err(HttpError::invalid("map", format!("the body names map {named:?}, the path {:?}", path.as_str())))
}

async fn raw<S: Send + Sync>(parts: &mut Parts, state: &S) -> Result<RawPathParams, HttpError> {
    RawPathParams::from_request_parts(parts, state)
        .await
        .map_err(|error| HttpError::invalid("path", format!("the path is not valid: {error}")))
}

fn get(params: &RawPathParams, name: &str) -> String {
    params.iter().find(|(known, _)| *known == name).map(|(_, value)| value.to_owned()).unwrap_or_default()
}

fn map_name(text: &str) -> Result<MapName, HttpError> {
    MapName::new(text)
        .map_err(|error| HttpError(ServiceError::new(ErrorKind::InvalidName, error.to_string()).at("map")))
}

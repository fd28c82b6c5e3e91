//! What the path of a request names.

use super::HttpError;
use crate::store::MapName;
use crate::wire;
use axum::extract::{FromRequestParts, RawPathParams};
use axum::http::request::Parts;

/// The map that the path names.
#[derive(Debug)]
pub struct MapPath(pub MapName);

/// The map and snapshot that the path names.
#[derive(Debug)]
pub struct SnapshotPath {
    /// The map.
    pub map: MapName,
    /// The snapshot, not checked yet.
    pub name: String,
}

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
        Ok(Self(wire::map_name(&get(&params, "map"))?))
    }
}

impl<S: Send + Sync> FromRequestParts<S> for SnapshotPath {
    type Rejection = HttpError;

    async fn from_request_parts(parts: &mut Parts, state: &S) -> Result<Self, HttpError> {
        let params = raw(parts, state).await?;
        Ok(Self { map: wire::map_name(&get(&params, "map"))?, name: get(&params, "name") })
    }
}

impl<S: Send + Sync> FromRequestParts<S> for TilePath {
    type Rejection = HttpError;

    async fn from_request_parts(parts: &mut Parts, state: &S) -> Result<Self, HttpError> {
        let params = raw(parts, state).await?;
        let map = wire::map_name(&get(&params, "map"))?;
        Ok(Self { map, z: get(&params, "z"), x: get(&params, "x"), y: get(&params, "y") })
    }
}

async fn raw<S: Send + Sync>(parts: &mut Parts, state: &S) -> Result<RawPathParams, HttpError> {
    RawPathParams::from_request_parts(parts, state)
        .await
        .map_err(|error| HttpError::invalid("path", format!("the path is not valid: {error}")))
}

fn get(params: &RawPathParams, name: &str) -> String {
    params.iter().find(|(known, _)| *known == name).map(|(_, value)| value.to_owned()).unwrap_or_default()
}

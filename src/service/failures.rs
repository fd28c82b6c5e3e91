//! What a client reads when something below the service fails.

use super::tasks::JoinError;
use super::{ErrorKind, ServiceError};
use crate::store::{MapFileError, MapName, SnapshotName, StoreError};

pub(super) fn map_not_found(name: &MapName) -> ServiceError {
    ServiceError::new(ErrorKind::MapNotFound, format!("there is no map {:?}", name.as_str())).at("map")
}

pub(super) fn map_exists(name: &MapName) -> ServiceError {
    ServiceError::new(ErrorKind::MapExists, format!("there is a map {:?} already", name.as_str())).at("map")
}

pub(super) fn snapshot_exists(map: &MapName, snapshot: &SnapshotName) -> ServiceError {
    let detail = format!("map {:?} has a snapshot {:?} already", map.as_str(), snapshot.as_str());
    ServiceError::new(ErrorKind::SnapshotExists, detail).at("name")
}

/// What a client reads when a map file is refused or cannot be written.
pub(super) fn file_failure(error: &MapFileError) -> ServiceError {
    ServiceError::new(ErrorKind::InvalidFile, error.to_string()).at("data")
}

pub(super) fn thread_failed(error: &JoinError) -> ServiceError {
    tracing::error!(%error, "a thread of the service failed");
    ServiceError::new(ErrorKind::Internal, "the server failed while it worked on this request")
}

/// What a client reads when the store fails at a map.
pub(super) fn store_failure(name: &MapName, doing: &str, error: &StoreError) -> ServiceError {
    match error {
        StoreError::NoMap(_) => map_not_found(name),
        StoreError::SnapshotExists(snapshot) => snapshot_exists(name, snapshot),
        StoreError::NoSnapshot(snapshot) => {
            let detail = format!("map {:?} has no snapshot {:?}", name.as_str(), snapshot.as_str());
            ServiceError::new(ErrorKind::SnapshotNotFound, detail).at("name")
        }
        other => store_error(&format!("{doing} map {:?}", name.as_str()), other),
    }
}

pub(super) fn store_error(doing: &str, error: &StoreError) -> ServiceError {
    match error {
        StoreError::Exists(name) => map_exists(name),
        StoreError::NoMap(_) => ServiceError::new(ErrorKind::MapNotFound, "the store has no such map"),
        // What is damaged is for the client to know; it names no files.
        StoreError::Damaged { .. } | StoreError::NewerFormat { .. } => {
            tracing::error!(%error, "could not {doing}");
            ServiceError::new(ErrorKind::MapDamaged, format!("the server could not {doing}: {error}"))
        }
        StoreError::SnapshotExists(_) | StoreError::NoSnapshot(_) | StoreError::Refused(_) => {
            tracing::error!(%error, "could not {doing}");
            ServiceError::new(ErrorKind::Internal, format!("the server failed to {doing}"))
        }
        StoreError::FailStop(_) => {
            tracing::error!(%error, "could not {doing}");
            let detail = format!("the store could not {doing}: {}", ServiceError::NO_MORE_WRITES);
            ServiceError::new(ErrorKind::StoreFailed, detail)
        }
        StoreError::Locked { .. } | StoreError::NoStore { .. } | StoreError::Io { .. } => {
            tracing::error!(%error, "could not {doing}");
            ServiceError::new(ErrorKind::StoreFailed, format!("the store could not {doing}"))
        }
    }
}

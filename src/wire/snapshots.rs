//! Snapshots and whole maps as files: what is asked for, and the answers.

use super::v1;
use crate::service::{ErrorKind, ExportForm, MapVersion, Nav2Mode, ServiceError};
use crate::store::{MapName, SnapshotName, StoredSnapshot};

/// The name of a snapshot, given in a field.
///
/// # Errors
/// [`ErrorKind::InvalidName`]
pub fn snapshot_name(text: &str, field: &str) -> Result<SnapshotName, ServiceError> {
    SnapshotName::new(text).map_err(|error| ServiceError::new(ErrorKind::InvalidName, error.to_string()).at(field))
}

/// The snapshot that a query reads; `None` where its field is empty: the map as it is now.
///
/// # Errors
/// [`ErrorKind::InvalidName`] at `snapshot`.
pub fn snapshot_wanted(text: &str) -> Result<Option<SnapshotName>, ServiceError> {
    if text.is_empty() { Ok(None) } else { snapshot_name(text, "snapshot").map(Some) }
}

/// The response to the taking of a snapshot.
#[must_use]
pub fn create_snapshot_response(taken: &StoredSnapshot) -> v1::CreateSnapshotResponse {
    let v1::Snapshot { name, revision, created } = snapshot(taken);
    v1::CreateSnapshotResponse { name, revision, created }
}

/// The snapshots of a map.
#[must_use]
pub fn list_snapshots_response(snapshots: &[StoredSnapshot]) -> v1::ListSnapshotsResponse {
    v1::ListSnapshotsResponse { snapshots: snapshots.iter().map(snapshot).collect() }
}

fn snapshot(stored: &StoredSnapshot) -> v1::Snapshot {
    v1::Snapshot { name: stored.name.to_string(), revision: stored.revision, created: stored.created }
}

/// What is to be exported, and from which snapshot.
///
/// # Errors
/// [`ErrorKind::InvalidName`], [`ErrorKind::InvalidRequest`] at what the format does not have.
pub fn export_form(request: &v1::ExportMapRequest) -> Result<(Option<SnapshotName>, ExportForm), ServiceError> {
    let invalid = |field: &str, why: String| {
        Err(ServiceError::new(ErrorKind::InvalidRequest, format!("{field} {why}")).at(field))
    };
    let snapshot = snapshot_wanted(&request.snapshot)?;
    let mode = match v1::ExportMode::try_from(request.mode) {
        Ok(v1::ExportMode::Unspecified) => None,
        Ok(v1::ExportMode::Trinary) => Some(Nav2Mode::Trinary),
        Ok(v1::ExportMode::Scale) => Some(Nav2Mode::Scale),
        Err(_) => return invalid("mode", format!("has no value {}", request.mode)),
    };
    let form = match v1::ExportFormat::try_from(request.format) {
        Ok(v1::ExportFormat::Nav2) => ExportForm::Nav2 { depth: request.depth, mode: mode.unwrap_or_default() },
        Ok(v1::ExportFormat::Unspecified | v1::ExportFormat::Ubbmap) => {
            let only = "is for the format nav2: a map file holds the whole map".to_owned();
            if request.depth.is_some() {
                return invalid("depth", only);
            }
            if mode.is_some() {
                return invalid("mode", only);
            }
            ExportForm::Ubbmap
        }
        Err(_) => return invalid("format", format!("has no value {}", request.format)),
    };
    Ok((snapshot, form))
}

/// The response to an import.
#[must_use]
pub fn import_response(map: &MapName, version: MapVersion) -> v1::ImportMapResponse {
    v1::ImportMapResponse { name: map.to_string(), revision: version.revision }
}

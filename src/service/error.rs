//! The one error type of the service.

use thiserror::Error;

/// What kind of failure: each has a stable code, and each transport one row in its status table.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
#[expect(missing_docs, reason = "the names and codes say it")]
pub enum ErrorKind {
    MapNotFound,
    MapExists,
    SnapshotNotFound,
    SnapshotExists,
    InvalidName,
    InvalidConfig,
    InvalidRequest,
    InvalidRegion,
    InvalidPoint,
    DepthOutOfRange,
    TileOutOfRange,
    RegionTooLarge,
    TooManyPoints,
    TooManyRegions,
    TooManyScans,
    TooManyMaps,
    TooManySnapshots,
    InvalidFile,
    BodyTooLarge,
    ToleranceTooHigh,
    UnsupportedMediaType,
    NotAcceptable,
    MethodNotAllowed,
    RouteNotFound,
    Unauthenticated,
    PermissionDenied,
    Busy,
    ShuttingDown,
    Timeout,
    AnotherServer,
    TlsRequired,
    MapDamaged,
    StoreFailed,
    Internal,
}

impl ErrorKind {
    /// The stable word that clients see.
    #[must_use]
    pub fn code(self) -> &'static str {
        match self {
            Self::MapNotFound => "MAP_NOT_FOUND",
            Self::MapExists => "MAP_EXISTS",
            Self::SnapshotNotFound => "SNAPSHOT_NOT_FOUND",
            Self::SnapshotExists => "SNAPSHOT_EXISTS",
            Self::InvalidName => "INVALID_NAME",
            Self::InvalidConfig => "INVALID_CONFIG",
            Self::InvalidRequest => "INVALID_REQUEST",
            Self::InvalidRegion => "INVALID_REGION",
            Self::InvalidPoint => "INVALID_POINT",
            Self::DepthOutOfRange => "DEPTH_OUT_OF_RANGE",
            Self::TileOutOfRange => "TILE_OUT_OF_RANGE",
            Self::RegionTooLarge => "REGION_TOO_LARGE",
            Self::TooManyPoints => "TOO_MANY_POINTS",
            Self::TooManyRegions => "TOO_MANY_REGIONS",
            Self::TooManyScans => "TOO_MANY_SCANS",
            Self::TooManyMaps => "TOO_MANY_MAPS",
            Self::TooManySnapshots => "TOO_MANY_SNAPSHOTS",
            Self::InvalidFile => "INVALID_FILE",
            Self::BodyTooLarge => "BODY_TOO_LARGE",
            Self::ToleranceTooHigh => "TOLERANCE_TOO_HIGH",
            Self::UnsupportedMediaType => "UNSUPPORTED_MEDIA_TYPE",
            Self::NotAcceptable => "NOT_ACCEPTABLE",
            Self::MethodNotAllowed => "METHOD_NOT_ALLOWED",
            Self::RouteNotFound => "ROUTE_NOT_FOUND",
            Self::Unauthenticated => "UNAUTHENTICATED",
            Self::PermissionDenied => "PERMISSION_DENIED",
            Self::Busy => "BUSY",
            Self::ShuttingDown => "SHUTTING_DOWN",
            Self::Timeout => "TIMEOUT",
            Self::AnotherServer => "ANOTHER_SERVER",
            Self::TlsRequired => "TLS_REQUIRED",
            Self::MapDamaged => "MAP_DAMAGED",
            Self::StoreFailed => "STORE_FAILED",
            Self::Internal => "INTERNAL",
        }
    }
}

/// A failure as a client sees it.
#[derive(Debug, Clone, PartialEq, Eq, Error)]
#[error("{detail}")]
pub struct ServiceError {
    /// What kind.
    pub kind: ErrorKind,
    /// A sentence for people.
    pub detail: String,
    /// The field at fault, in the request's own words.
    pub field: Option<String>,
}

impl ServiceError {
    /// What is said once a write of the store has failed.
    pub(crate) const NO_MORE_WRITES: &str = "the store takes no writes since one failed; reads go on, and the server needs a \
        restart when the cause, such as a full disk, is gone";

    /// A failure without a field.
    #[must_use]
    pub fn new(kind: ErrorKind, detail: impl Into<String>) -> Self {
        Self { kind, detail: detail.into(), field: None }
    }

    /// Names the field at fault.
    #[must_use]
    pub fn at(mut self, field: impl Into<String>) -> Self {
        self.field = Some(field.into());
        self
    }
}

//! The one error type of the service.

use thiserror::Error;

macro_rules! kinds {
    ($($kind:ident => $code:literal,)+) => {
        /// What kind of failure: each has a stable code, and each transport one row in its status table.
        #[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
        #[expect(missing_docs, reason = "the names and codes say it")]
        pub enum ErrorKind {
            $($kind,)+
        }

        impl ErrorKind {
            /// All of them, for those who describe the interface.
            pub const ALL: &[Self] = &[$(Self::$kind,)+];

            /// The stable word that clients see.
            #[must_use]
            pub fn code(self) -> &'static str {
                match self {
                    $(Self::$kind => $code,)+
                }
            }
        }
    };
}

kinds! {
    MapNotFound => "MAP_NOT_FOUND",
    MapExists => "MAP_EXISTS",
    SnapshotNotFound => "SNAPSHOT_NOT_FOUND",
    SnapshotExists => "SNAPSHOT_EXISTS",
    InvalidName => "INVALID_NAME",
    InvalidConfig => "INVALID_CONFIG",
    InvalidRequest => "INVALID_REQUEST",
    InvalidRegion => "INVALID_REGION",
    InvalidPoint => "INVALID_POINT",
    DepthOutOfRange => "DEPTH_OUT_OF_RANGE",
    TileOutOfRange => "TILE_OUT_OF_RANGE",
    RegionTooLarge => "REGION_TOO_LARGE",
    TooManyPoints => "TOO_MANY_POINTS",
    TooManyRegions => "TOO_MANY_REGIONS",
    TooManyScans => "TOO_MANY_SCANS",
    TooManyMaps => "TOO_MANY_MAPS",
    TooManySnapshots => "TOO_MANY_SNAPSHOTS",
    InvalidFile => "INVALID_FILE",
    BodyTooLarge => "BODY_TOO_LARGE",
    HeadersTooLarge => "HEADERS_TOO_LARGE",
    ToleranceTooHigh => "TOLERANCE_TOO_HIGH",
    UnsupportedMediaType => "UNSUPPORTED_MEDIA_TYPE",
    NotAcceptable => "NOT_ACCEPTABLE",
    MethodNotAllowed => "METHOD_NOT_ALLOWED",
    RouteNotFound => "ROUTE_NOT_FOUND",
    Unauthenticated => "UNAUTHENTICATED",
    PermissionDenied => "PERMISSION_DENIED",
    Busy => "BUSY",
    ShuttingDown => "SHUTTING_DOWN",
    Timeout => "TIMEOUT",
    AnotherServer => "ANOTHER_SERVER",
    TlsRequired => "TLS_REQUIRED",
    MapDamaged => "MAP_DAMAGED",
    StoreFailed => "STORE_FAILED",
    Internal => "INTERNAL",
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

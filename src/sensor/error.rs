//! Why scans are refused.

use thiserror::Error;

/// Why a scan is refused. Each names the field at fault.
#[derive(Debug, Clone, PartialEq, Error)]
#[expect(missing_docs, reason = "fields are explained by the messages")]
pub enum ScanError {
    /// A pose bound is NaN or infinite.
    #[error("{field} has a bound that is not finite")]
    PoseNotFinite { field: &'static str },
    /// `min > max`.
    #[error("{field} is inverted: min {min} is above max {max}")]
    PoseInverted { field: &'static str, min: f64, max: f64 },
    /// Beyond any map.
    #[error("{field} is beyond +-{limit}")]
    PoseOutOfRange { field: &'static str, limit: f64 },
    /// Wider than the limit.
    #[error("{field} is {width} wide, the limit is {limit}")]
    PoseTooWide { field: &'static str, width: f64, limit: f64 },
    /// No beams at all.
    #[error("ranges is empty: a scan has at least one beam")]
    NoBeams,
    /// More beams than allowed.
    #[error("ranges has {count} beams, the limit is {limit}")]
    TooManyBeams { count: usize, limit: usize },
    /// `angles` and `ranges` differ in length.
    #[error("angles has {angles} entries and ranges {ranges}: they must be as many")]
    LengthMismatch { angles: usize, ranges: usize },
    /// An angle is NaN, infinite or too large.
    #[error("{field} is not a usable angle: {value} (finite, at most 1000 rad, a step not 0)")]
    BadAngle { field: &'static str, value: f64 },
    /// The field of view is more than a full circle.
    #[error("{field}: the beams span {span} rad, more than a full circle")]
    SpanTooWide { field: &'static str, span: f64 },
    /// What the scan says would be spread over more leaves of the map than one scan may cost.
    #[error("{field} spans {cells} leaves of the map, the limit is {limit}")]
    TooManyLeaves { field: &'static str, cells: f64, limit: f64 },
    /// A scalar field is negative, not finite or too large.
    #[error("{field} must be between 0 and {limit}, got {value}")]
    OutOfRange { field: &'static str, value: f64, limit: f64 },
}

impl ScanError {
    /// A stable word for programs, such as `POSE_TOO_WIDE`.
    #[must_use]
    pub fn code(&self) -> &'static str {
        match self {
            Self::PoseNotFinite { .. } => "POSE_NOT_FINITE",
            Self::PoseInverted { .. } => "POSE_INVERTED",
            Self::PoseOutOfRange { .. } => "POSE_OUT_OF_RANGE",
            Self::PoseTooWide { .. } => "POSE_TOO_WIDE",
            Self::NoBeams => "NO_BEAMS",
            Self::TooManyBeams { .. } => "TOO_MANY_BEAMS",
            Self::LengthMismatch { .. } => "LENGTH_MISMATCH",
            Self::BadAngle { .. } => "BAD_ANGLE",
            Self::SpanTooWide { .. } => "SPAN_TOO_WIDE",
            Self::TooManyLeaves { .. } => "TOO_MANY_LEAVES",
            Self::OutOfRange { .. } => "OUT_OF_RANGE",
        }
    }

    /// The field at fault, as in the interface.
    #[must_use]
    pub fn field(&self) -> &str {
        match self {
            Self::PoseNotFinite { field }
            | Self::PoseInverted { field, .. }
            | Self::PoseOutOfRange { field, .. }
            | Self::PoseTooWide { field, .. }
            | Self::BadAngle { field, .. }
            | Self::SpanTooWide { field, .. }
            | Self::TooManyLeaves { field, .. }
            | Self::OutOfRange { field, .. } => field,
            Self::NoBeams | Self::TooManyBeams { .. } => "ranges",
            Self::LengthMismatch { .. } => "angles",
        }
    }
}

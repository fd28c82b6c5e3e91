//! Pose boxes: where the robot was, as intervals.

use super::ScanError;
use crate::interval::{Box2, Interval};

/// Largest absolute heading accepted, radians: far beyond any unwrapped odometry, small enough for exact reduction.
pub const MAX_HEADING: f64 = 1e6;

/// Largest absolute position accepted, metres.
pub const MAX_POSITION: f64 = 1e9;

/// How wide a pose box may be.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PoseLimits {
    /// Largest width of x and of y, metres.
    pub max_position_width: f64,
    /// Largest width of theta, radians.
    pub max_heading_width: f64,
}

impl Default for PoseLimits {
    /// 2 m and 60 degrees.
    fn default() -> Self {
        Self { max_position_width: 2.0, max_heading_width: 60.0_f64.to_radians() }
    }
}

/// The box `([x], [y], [theta])` that holds the pose of the robot in the map frame; metres and radians.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PoseBox {
    x: Interval,
    y: Interval,
    theta: Interval,
}

impl PoseBox {
    /// A pose box from `(min, max)` pairs.
    ///
    /// # Errors
    /// [`ScanError`] naming the field when a bound is NaN or infinite, a pair is inverted, the magnitude is beyond
    /// [`MAX_POSITION`] or [`MAX_HEADING`], or the box is wider than `limits`.
    pub fn new(x: (f64, f64), y: (f64, f64), theta: (f64, f64), limits: &PoseLimits) -> Result<Self, ScanError> {
        Ok(Self {
            x: bounded("pose.x", x, MAX_POSITION, limits.max_position_width)?,
            y: bounded("pose.y", y, MAX_POSITION, limits.max_position_width)?,
            theta: bounded("pose.theta", theta, MAX_HEADING, limits.max_heading_width)?,
        })
    }

    /// The box `[x]`, metres.
    #[must_use]
    pub fn x(&self) -> Interval {
        self.x
    }

    /// The box `[y]`, metres.
    #[must_use]
    pub fn y(&self) -> Interval {
        self.y
    }

    /// The heading `[theta]`, radians.
    #[must_use]
    pub fn theta(&self) -> Interval {
        self.theta
    }

    /// The positions alone.
    #[must_use]
    pub fn position(&self) -> Box2 {
        Box2::new(self.x, self.y)
    }
}

fn bounded(field: &'static str, (lo, hi): (f64, f64), magnitude: f64, width: f64) -> Result<Interval, ScanError> {
    if !lo.is_finite() || !hi.is_finite() {
        return Err(ScanError::PoseNotFinite { field });
    }
    if lo > hi {
        return Err(ScanError::PoseInverted { field, min: lo, max: hi });
    }
    if lo < -magnitude || hi > magnitude {
        return Err(ScanError::PoseOutOfRange { field, limit: magnitude });
    }
    // One part in 10^12 above the limit is rounding of the sender's, not a wider box.
    if hi - lo > width * (1.0 + 1e-12) {
        return Err(ScanError::PoseTooWide { field, width: hi - lo, limit: width });
    }
    Interval::new(lo, hi).ok_or(ScanError::PoseNotFinite { field })
}

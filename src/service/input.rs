//! Scans as they come in: decoded, not yet checked.

use crate::sensor::Angles;

/// Pose bounds as `(min, max)` pairs; metres and radians.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RawPose {
    /// x
    pub x: (f64, f64),
    /// y
    pub y: (f64, f64),
    /// theta
    pub theta: (f64, f64),
}

/// A scan as a transport decoded it.
#[derive(Debug, Clone, PartialEq)]
pub struct ScanInput {
    /// The robot's name; may be empty where there is no sequence.
    pub robot: String,
    /// Counts up per robot and map; `None` is always applied.
    pub sequence: Option<u64>,
    /// Seconds since the Unix epoch, as the robot says; not interpreted.
    pub stamp: f64,
    /// The sensor's name in the map's configuration; empty means `default`.
    pub sensor: String,
    /// The pose box; `None` is refused.
    pub pose: Option<RawPose>,
    /// Mirror angles.
    pub angles: Angles,
    /// Metres; NaN is a failed beam.
    pub ranges: Vec<f32>,
    /// Metres.
    pub footprint_radius: f64,
    /// Radians.
    pub sweep_rotation: f64,
    /// Metres.
    pub sweep_translation: f64,
}

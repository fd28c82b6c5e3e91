//! Floor 1: what a laser scanner measures, and what of it is certain.
//!
//! A [`Scan`] is validated once, at its construction; inside the engine the type is the proof. Angles are radians,
//! lengths metres, frames right-handed, headings counter-clockwise from +x.

mod cone;
mod error;
mod measurement;
mod model;
mod pose;
mod scan;

pub use cone::{BeamCone, BeamRectangle, EmptyCone};
pub use error::ScanError;
pub use measurement::{MeasurementSet, apex_offset, natural_measurement_box};
pub use model::{
    MAX_ANGLE_ERROR, MAX_BEAM_DIAMETER, MAX_LENGTH, MAX_MOUNT_OFFSET, MAX_MOUNT_THETA, Mount, SensorError, SensorModel,
    SensorSpec,
};
pub use pose::{MAX_HEADING, MAX_POSITION, PoseBox, PoseLimits};
pub use scan::{Angles, MAX_ANGLE, MAX_ROBOT_LENGTH, Reading, ReadingCounts, Scan, ScanLimits, ScanSpec};

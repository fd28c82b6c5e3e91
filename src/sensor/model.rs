//! The sensor model: the bounds that every beam of one sensor keeps.

use crate::interval::{down, up};
use thiserror::Error;

/// Longest range and range error accepted, metres.
pub const MAX_LENGTH: f64 = 1e6;

/// Largest beam diameter accepted, metres.
pub const MAX_BEAM_DIAMETER: f64 = 100.0;

/// Largest offset of a sensor on its robot along an axis, metres.
pub const MAX_MOUNT_OFFSET: f64 = 100.0;

/// Largest heading of a sensor on its robot, radians: any unwrapped angle, small enough to stay exact to 10^-13.
pub const MAX_MOUNT_THETA: f64 = 1e3;

/// Largest bound of the angle error of single beams, radians.
pub const MAX_ANGLE_ERROR: f64 = 0.5;

/// Where the sensor sits on the robot: `(x_s, y_s, phi_s)`, metres and radians.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Mount {
    /// Forward offset, metres.
    pub x: f64,
    /// Leftward offset, metres.
    pub y: f64,
    /// Heading of the sensor's zero angle in the robot frame, radians.
    pub theta: f64,
}

/// The plain fields of a sensor, unchecked; [`SensorModel::new`] checks them.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SensorSpec {
    /// `e-`: how much nearer than measured the obstacle may be, metres.
    pub range_error_minus: f64,
    /// `e+`: how much farther than measured the obstacle may be, metres.
    pub range_error_plus: f64,
    /// `phi_b`: full opening angle of a beam, radians, `0 <= phi_b < pi`.
    pub beam_opening: f64,
    /// `w_b`: diameter of a beam at the emitter, metres.
    pub beam_diameter: f64,
    /// Readings below are failed measurements, metres.
    pub range_min: f64,
    /// Readings at or above are no returns, metres.
    pub range_max: f64,
    /// How far a beam without a return is known to be free, metres (assumption A2); `None` says nothing.
    pub no_return_free_to: Option<f64>,
    /// eps of assumption A2: bound of the angle error of single beams, radians.
    pub beam_angle_error: f64,
    /// Where the sensor sits on the robot.
    pub mount: Mount,
}

impl Default for SensorSpec {
    /// The paper's experiment: +-0.035 m, 0.25 degrees, 12 mm, up to 81 m.
    fn default() -> Self {
        Self {
            range_error_minus: 0.035,
            range_error_plus: 0.035,
            beam_opening: 0.004_363,
            beam_diameter: 0.012,
            range_min: 0.0,
            range_max: 81.0,
            no_return_free_to: None,
            beam_angle_error: 0.0,
            mount: Mount::default(),
        }
    }
}

/// Why a sensor's parameters are refused.
#[derive(Debug, Clone, PartialEq, Error)]
#[error("{field} {problem}, got {value}")]
pub struct SensorError {
    /// The field at fault, as in the interface (`range_error.minus`).
    pub field: &'static str,
    /// What is asked of it.
    pub problem: String,
    /// What was given.
    pub value: f64,
}

/// A checked [`SensorSpec`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SensorModel {
    spec: SensorSpec,
}

impl SensorModel {
    /// Checks the fields.
    ///
    /// # Errors
    /// [`SensorError`] with the field at fault: a value not finite or out of its range, `range_min >= range_max`,
    /// `range_error.minus >= range_max` (every range would be negative), or
    /// `no_return_free_to > range_max - range_error.minus`.
    ///
    /// ```
    /// use ubbmap::sensor::{SensorModel, SensorSpec};
    /// assert!(SensorModel::new(SensorSpec::default()).is_ok());
    /// let error = SensorModel::new(SensorSpec { range_error_minus: 90.0, ..SensorSpec::default() }).unwrap_err();
    /// assert_eq!(error.field, "range_error.minus");
    /// ```
    pub fn new(spec: SensorSpec) -> Result<Self, SensorError> {
        within("range_error.minus", spec.range_error_minus, 0.0, MAX_LENGTH)?;
        within("range_error.plus", spec.range_error_plus, 0.0, MAX_LENGTH)?;
        within("range_min", spec.range_min, 0.0, MAX_LENGTH)?;
        within("range_max", spec.range_max, 0.0, MAX_LENGTH)?;
        within("beam_diameter", spec.beam_diameter, 0.0, MAX_BEAM_DIAMETER)?;
        within("beam_angle_error", spec.beam_angle_error, 0.0, MAX_ANGLE_ERROR)?;
        within("mount.x", spec.mount.x, -MAX_MOUNT_OFFSET, MAX_MOUNT_OFFSET)?;
        within("mount.y", spec.mount.y, -MAX_MOUNT_OFFSET, MAX_MOUNT_OFFSET)?;
        within("mount.theta", spec.mount.theta, -MAX_MOUNT_THETA, MAX_MOUNT_THETA)?;
        // The double nearest to pi is below pi.
        if !(0.0..std::f64::consts::PI).contains(&spec.beam_opening) {
            return Err(refusal("beam_opening", spec.beam_opening, "must be at least 0 and below pi"));
        }
        // Ranges are compared as 32-bit floats, so the limit must be one.
        if (spec.range_max as f32) < f32::MIN_POSITIVE {
            return Err(refusal("range_max", spec.range_max, "must be a positive length"));
        }
        if spec.range_min >= spec.range_max {
            let problem = format!("must be below range_max ({})", spec.range_max);
            return Err(refusal("range_min", spec.range_min, &problem));
        }
        if spec.range_error_minus >= spec.range_max {
            let problem = format!("must be below range_max ({}), else every range is negative", spec.range_max);
            return Err(refusal("range_error.minus", spec.range_error_minus, &problem));
        }
        if let Some(free_to) = spec.no_return_free_to {
            // A sender computes the limit in floating point too: its rounding is not an error of the sender's.
            let limit = spec.range_max - spec.range_error_minus;
            if !(0.0..=limit + 1e-12 * spec.range_max).contains(&free_to) {
                let problem = format!("must be between 0 and range_max - range_error.minus ({limit})");
                return Err(refusal("no_return_free_to", free_to, &problem));
            }
        }
        Ok(Self { spec })
    }

    /// `F` of assumption A2: how far a beam without a return is free, metres; `None` says nothing.
    ///
    /// At most the lower end of the range interval that a reading of `range_max` would have. A reading is taken as no
    /// return by its 32-bit form, so an obstacle measured within half an ulp of `range_max` may be one, and is as near
    /// as that, less the range error.
    #[must_use]
    pub fn no_return_free_to(&self) -> Option<f64> {
        let nearest = self.range_interval(self.spec.range_max as f32).0;
        self.spec.no_return_free_to.map(|free_to| free_to.min(nearest))
    }

    /// `[d] = [r - e-, r + e+]` of a positive 32-bit range, metres: widened by half an ulp of `r`, rounded outward and
    /// cut off at 0.
    #[must_use]
    pub(super) fn range_interval(&self, range: f32) -> (f64, f64) {
        // The ulp above is never smaller than the one below. Both are exact in 64 bits.
        let half_ulp = 0.5 * (f64::from(range.next_up()) - f64::from(range));
        let r = f64::from(range);
        // r -+ half_ulp has 25 bits: exact. One rounding remains on each side.
        let near = down(r - half_ulp - self.spec.range_error_minus).max(0.0);
        let far = up(r + half_ulp + self.spec.range_error_plus);
        (near, far)
    }

    /// The checked fields.
    #[must_use]
    pub fn spec(&self) -> &SensorSpec {
        &self.spec
    }
}

fn refusal(field: &'static str, value: f64, problem: &str) -> SensorError {
    SensorError { field, problem: problem.to_owned(), value }
}

/// Refuses what is not in `min..=max`, NaN included.
fn within(field: &'static str, value: f64, min: f64, max: f64) -> Result<(), SensorError> {
    if (min..=max).contains(&value) {
        return Ok(());
    }
    Err(refusal(field, value, &format!("must be between {min} and {max}")))
}

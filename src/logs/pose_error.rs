//! The error of a log's poses, as given on the command line.

use std::str::FromStr;
use thiserror::Error;

/// How far a pose may be off: `[x] = x +- position`, `[y] = y +- position`, `[theta] = theta +- heading`.
///
/// Written `METRES,ANGLEdeg` or `METRES,ANGLErad`:
///
/// ```
/// use ubbmap::logs::PoseError;
/// let error: PoseError = "0.02,0.5deg".parse()?;
/// assert_eq!(error.position, 0.02);
/// assert!((error.heading - 0.5_f64.to_radians()).abs() < 1e-12);
/// # Ok::<(), ubbmap::logs::PoseErrorParseError>(())
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct PoseError {
    /// Metres, not negative.
    pub position: f64,
    /// Radians, not negative.
    pub heading: f64,
}

/// A pose error that cannot be read.
#[derive(Debug, Clone, PartialEq, Eq, Error)]
#[error("{0}; write metres, then an angle with its unit: 0.02,0.5deg or 0.02,0.01rad")]
pub struct PoseErrorParseError(String);

impl FromStr for PoseError {
    type Err = PoseErrorParseError;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        let Some((position, heading)) = text.split_once(',') else {
            return Err(PoseErrorParseError(format!("{text:?} is not two values with a comma between")));
        };
        let heading = angle(heading).map_err(PoseErrorParseError)?;
        Ok(Self { position: bound(position, "the position").map_err(PoseErrorParseError)?, heading })
    }
}

/// An angle with its unit, `0.25deg` or `0.004rad`, not negative, in radians.
///
/// # Errors
/// What is wrong with the text.
pub fn angle(text: &str) -> Result<f64, String> {
    let text = text.trim();
    if let Some(degrees) = text.strip_suffix("deg") {
        Ok(bound(degrees, "the angle")?.to_radians())
    } else if let Some(radians) = text.strip_suffix("rad") {
        bound(radians, "the angle")
    } else {
        Err(format!("the angle {text:?} has no unit (deg or rad)"))
    }
}

fn bound(text: &str, what: &str) -> Result<f64, String> {
    let text = text.trim();
    match text.parse::<f64>() {
        Ok(value) if value.is_finite() && value >= 0.0 => Ok(value),
        Ok(_) => Err(format!("{what} {text:?} must be finite and not negative")),
        Err(_) => Err(format!("{what} {text:?} is not a number")),
    }
}

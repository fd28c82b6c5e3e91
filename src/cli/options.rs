//! Flags that describe a map and its sensor, shared by `build`, `replay` and `map create`.

use super::output::Failure;
use crate::logs::{LogSensor, angle};
use crate::mapping::{EvidenceRule, MapConfig};
use crate::quadtree::{ClassScale, Grid};
use crate::sensor::{SensorModel, SensorSpec};
use clap::parser::ValueSource;
use clap::{ArgMatches, Args, Command, ValueEnum};
use std::collections::BTreeMap;
use std::num::NonZeroU64;
use std::path::Path;

/// The name of the one sensor that the command line describes.
pub(super) const SENSOR: &str = "default";

/// The evidence rules by the words of the command line.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub(super) enum Evidence {
    /// No leaf that holds an obstacle is ever called empty, if the assumptions hold
    Guaranteed,
    /// The paper's outer set: every leaf that the empty part of some beam may touch
    Outer,
    /// The paper's inner set: every leaf that the empty part of one beam covers
    Inner,
}

impl Evidence {
    pub(super) fn rule(self) -> EvidenceRule {
        match self {
            Self::Guaranteed => EvidenceRule::Guaranteed,
            Self::Outer => EvidenceRule::Outer,
            Self::Inner => EvidenceRule::Inner,
        }
    }
}

/// The word for a rule.
pub(super) fn rule_name(rule: EvidenceRule) -> &'static str {
    match rule {
        EvidenceRule::Guaranteed => "guaranteed",
        EvidenceRule::Outer => "outer",
        EvidenceRule::Inner => "inner",
    }
}

/// A new map.
#[derive(Debug, Clone, Args)]
#[command(next_help_heading = "Map")]
pub(super) struct MapOptions {
    /// Which leaves a scan calls empty
    #[arg(long, value_enum, default_value = "guaranteed", value_name = "RULE")]
    pub(super) evidence: Evidence,
    /// Side of a leaf, metres
    #[arg(long, default_value_t = 0.1, value_name = "M")]
    pub(super) resolution: f64,
    /// Depth of the leaves, 1 to 24: the map is resolution * 2^depth wide
    #[arg(long, default_value_t = 16, value_name = "N")]
    pub(super) depth: u32,
    /// Min corner of the map, metres [default: the map is centred on 0,0]
    #[arg(long, value_name = "X,Y", value_parser = pair, allow_hyphen_values = true)]
    pub(super) origin: Option<(f64, f64)>,
    /// Number of classes, 4 to 255
    #[arg(long, default_value_t = 10, value_name = "K")]
    pub(super) classes: u32,
    /// Width of the thinnest obstacle, metres; 0 assumes nothing
    #[arg(long, default_value_t = 0.02, value_name = "M")]
    pub(super) min_obstacle_width: f64,
}

/// The sensor; what a flag does not say is taken from the log, where it says so.
#[derive(Debug, Clone, Args)]
#[command(next_help_heading = "Sensor")]
pub(super) struct SensorOptions {
    /// Bound of the range error, metres; two values where it is uneven: nearer,farther [default: the log's, or 0.035]
    #[arg(long, value_name = "M", value_parser = one_or_two)]
    pub(super) range_error: Option<(f64, f64)>,
    /// Full opening angle of a beam, with its unit: 0.25deg [default: the log's, or 0.004363rad]
    #[arg(long, value_name = "ANGLE", value_parser = angle)]
    pub(super) beam_opening: Option<f64>,
    /// Diameter of a beam at the emitter, metres [default: the log's, or 0.012]
    #[arg(long, value_name = "M")]
    pub(super) beam_diameter: Option<f64>,
    /// Readings below are failed measurements, metres [default: the log's, or 0]
    #[arg(long, value_name = "M")]
    pub(super) range_min: Option<f64>,
    /// Readings at or above are no returns, metres [default: the log's, or 81]
    #[arg(long, value_name = "M")]
    pub(super) range_max: Option<f64>,
    /// How far a beam without a return is known to be free, metres [default: the log's, or it says nothing]
    #[arg(long, value_name = "M")]
    pub(super) no_return_free_to: Option<f64>,
    /// Bound of the angle error of single beams, with its unit [default: the log's, or none]
    #[arg(long, value_name = "ANGLE", value_parser = angle)]
    pub(super) beam_angle_error: Option<f64>,
}

impl SensorOptions {
    /// The sensor of a log.
    ///
    /// # Errors
    /// Bad usage, naming the value.
    pub(super) fn model(&self, log: &LogSensor) -> Result<SensorModel, Failure> {
        SensorModel::new(self.spec(log)).map_err(|error| Failure::Usage(error.to_string()))
    }

    fn spec(&self, log: &LogSensor) -> SensorSpec {
        let usual = SensorSpec::default();
        let (range_error_minus, range_error_plus) =
            self.range_error.or(log.range_error).unwrap_or((usual.range_error_minus, usual.range_error_plus));
        SensorSpec {
            range_error_minus,
            range_error_plus,
            beam_opening: self.beam_opening.or(log.beam_opening).unwrap_or(usual.beam_opening),
            beam_diameter: self.beam_diameter.or(log.beam_diameter).unwrap_or(usual.beam_diameter),
            range_min: self.range_min.or(log.range_min).unwrap_or(usual.range_min),
            range_max: self.range_max.or(log.range_max).unwrap_or(usual.range_max),
            no_return_free_to: self.no_return_free_to.or(log.no_return_free_to),
            beam_angle_error: self.beam_angle_error.or(log.beam_angle_error).unwrap_or(usual.beam_angle_error),
            mount: usual.mount,
        }
    }
}

/// The configuration of a map with the one sensor [`SENSOR`].
///
/// # Errors
/// Bad usage, naming the value.
pub(super) fn map_config(map: &MapOptions, sensor: &SensorOptions, log: &LogSensor) -> Result<MapConfig, Failure> {
    let usage = |error: &dyn std::fmt::Display| Failure::Usage(error.to_string());
    let grid = Grid::new(map.resolution, map.depth, map.origin).map_err(|error| usage(&error))?;
    let scale = ClassScale::new(map.classes).map_err(|error| usage(&error))?;
    let model = sensor.model(log)?;
    let sensors = BTreeMap::from([(SENSOR.to_owned(), model)]);
    MapConfig::new(grid, scale, map.evidence.rule(), map.min_obstacle_width, sensors).map_err(|error| usage(&error))
}

/// The first flag of [`MapOptions`] or [`SensorOptions`] that was given.
pub(super) fn given(matches: &ArgMatches) -> Option<String> {
    let flags = SensorOptions::augment_args(MapOptions::augment_args(Command::new("flags")));
    flags
        .get_arguments()
        .find(|flag| {
            let id = flag.get_id().as_str();
            matches.try_contains_id(id).is_ok() && matches.value_source(id) == Some(ValueSource::CommandLine)
        })
        .and_then(|flag| flag.get_long().map(str::to_owned))
}

/// Numbers with commas, blanks or semicolons between.
///
/// # Errors
/// Which is none, or is not finite.
pub(super) fn numbers(text: &str) -> Result<Vec<f64>, String> {
    text.split([',', ';', ' '])
        .filter(|word| !word.is_empty())
        .map(|word| match word.parse::<f64>() {
            Ok(value) if value.is_finite() => Ok(value),
            Ok(_) => Err(format!("{word:?} is not finite")),
            Err(_) => Err(format!("{word:?} is not a number")),
        })
        .collect()
}

/// Refuses the name of a picture that other programs would take for another kind.
///
/// # Errors
/// Bad usage.
pub(super) fn check_png(path: Option<&Path>) -> Result<(), Failure> {
    match path.and_then(Path::extension) {
        Some(kind) if !kind.eq_ignore_ascii_case("png") => {
            Err(Failure::Usage("--png: pictures are PNG: let the name end with .png".to_owned()))
        }
        _ => Ok(()),
    }
}

/// A count of one or more.
///
/// # Errors
/// Says so of what is none.
pub(super) fn at_least_one<T: TryFrom<NonZeroU64>>(text: &str) -> Result<T, String> {
    let count = text.parse::<u64>().ok().and_then(NonZeroU64::new);
    count.and_then(|count| T::try_from(count).ok()).ok_or_else(|| "must be a whole number of at least 1".to_owned())
}

/// Seconds above 0, as a number or with units: 90, 30s or 1m30s.
///
/// # Errors
/// Says what would do.
pub(super) fn span(text: &str) -> Result<f64, String> {
    let seconds = match text.parse::<f64>() {
        Ok(seconds) => Some(seconds),
        Err(_) => humantime::parse_duration(text).ok().map(|span| span.as_secs_f64()),
    };
    let fits = seconds.filter(|seconds| *seconds > 0.0 && *seconds <= 1e9);
    fits.ok_or_else(|| "must be a time above 0: seconds, or with a unit as in 30s or 2m".to_owned())
}

fn pair(text: &str) -> Result<(f64, f64), String> {
    match numbers(text)?[..] {
        [x, y] => Ok((x, y)),
        _ => Err("must be two numbers: X,Y".to_owned()),
    }
}

fn one_or_two(text: &str) -> Result<(f64, f64), String> {
    match numbers(text)?[..] {
        [both] => Ok((both, both)),
        [minus, plus] => Ok((minus, plus)),
        _ => Err("must be one number, or two: NEARER,FARTHER".to_owned()),
    }
}

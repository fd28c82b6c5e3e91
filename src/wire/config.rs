//! Map configurations: defaults filled in on the way in, every field written out on the way back.

use super::v1;
use crate::mapping::{EvidenceRule, MapConfig, MapConfigError};
use crate::quadtree::{ClassScale, Grid, GridError};
use crate::sensor::{Mount, SensorModel, SensorSpec};
use crate::service::{ErrorKind, ServiceError};
use std::collections::BTreeMap;

/// Side of a leaf where a configuration names none, metres.
pub const DEFAULT_RESOLUTION: f64 = 0.1;

/// Depth where a configuration names none.
pub const DEFAULT_DEPTH: u32 = 16;

/// Number of classes where a configuration names none.
pub const DEFAULT_CLASSES: u32 = 10;

/// `min_obstacle_width` where a configuration names none, metres.
pub const DEFAULT_MIN_OBSTACLE_WIDTH: f64 = 0.02;

/// The sensor that a configuration without sensors has.
pub const DEFAULT_SENSOR: &str = "default";

/// A checked configuration from its message; what is left out has its default.
///
/// # Errors
/// [`ErrorKind::InvalidConfig`] at the field at fault, such as `config.sensors[default].range_error.minus`.
pub fn map_config(wire: v1::MapConfig) -> Result<MapConfig, ServiceError> {
    let rule = rule(wire.evidence)?;
    let origin = match wire.origin {
        None => None,
        Some(v1::Point { x: Some(x), y: Some(y) }) => Some((x, y)),
        Some(point) => {
            let axis = if point.x.is_none() { "x" } else { "y" };
            return Err(invalid(&format!("origin.{axis}"), "is missing: an origin has x and y"));
        }
    };
    let grid = Grid::new(wire.resolution.unwrap_or(DEFAULT_RESOLUTION), wire.depth.unwrap_or(DEFAULT_DEPTH), origin)
        .map_err(|error| config_error(&error.into()))?;
    let scale =
        ClassScale::new(wire.classes.unwrap_or(DEFAULT_CLASSES)).map_err(|error| config_error(&error.into()))?;
    let mut sensors = BTreeMap::new();
    for (name, sensor) in wire.sensors {
        let model = SensorModel::new(sensor_spec(&sensor))
            .map_err(|source| config_error(&MapConfigError::Sensor { name: name.clone(), source }))?;
        sensors.insert(name, model);
    }
    if sensors.is_empty() {
        let model = SensorModel::new(SensorSpec::default())
            .map_err(|source| config_error(&MapConfigError::Sensor { name: DEFAULT_SENSOR.to_owned(), source }))?;
        sensors.insert(DEFAULT_SENSOR.to_owned(), model);
    }
    let width = wire.min_obstacle_width.unwrap_or(DEFAULT_MIN_OBSTACLE_WIDTH);
    MapConfig::new(grid, scale, rule, width, sensors).map_err(|error| config_error(&error))
}

/// The message of a configuration, every field set but those that have no value.
#[must_use]
pub fn to_wire_config(config: &MapConfig) -> v1::MapConfig {
    let grid = config.grid();
    let (x, y) = grid.origin();
    let evidence = match config.rule() {
        EvidenceRule::Guaranteed => v1::Evidence::Guaranteed,
        EvidenceRule::Outer => v1::Evidence::Outer,
        EvidenceRule::Inner => v1::Evidence::Inner,
    };
    v1::MapConfig {
        resolution: Some(grid.resolution()),
        depth: Some(grid.depth().into()),
        origin: Some(v1::Point { x: Some(x), y: Some(y) }),
        classes: Some(config.scale().count().into()),
        evidence: evidence.into(),
        min_obstacle_width: Some(config.min_obstacle_width()),
        sensors: config.sensors().iter().map(|(name, model)| (name.clone(), to_wire_sensor(model.spec()))).collect(),
    }
}

fn rule(evidence: i32) -> Result<EvidenceRule, ServiceError> {
    match v1::Evidence::try_from(evidence) {
        Ok(v1::Evidence::Unspecified) => Ok(EvidenceRule::default()),
        Ok(v1::Evidence::Guaranteed) => Ok(EvidenceRule::Guaranteed),
        Ok(v1::Evidence::Outer) => Ok(EvidenceRule::Outer),
        Ok(v1::Evidence::Inner) => Ok(EvidenceRule::Inner),
        Err(_) => Err(invalid("evidence", &format!("has no value {evidence}"))),
    }
}

fn sensor_spec(wire: &v1::Sensor) -> SensorSpec {
    let default = SensorSpec::default();
    let error = wire.range_error.unwrap_or_default();
    let mount = wire.mount.unwrap_or_default();
    SensorSpec {
        range_error_minus: error.minus.unwrap_or(default.range_error_minus),
        range_error_plus: error.plus.unwrap_or(default.range_error_plus),
        beam_opening: wire.beam_opening.unwrap_or(default.beam_opening),
        beam_diameter: wire.beam_diameter.unwrap_or(default.beam_diameter),
        range_min: wire.range_min.unwrap_or(default.range_min),
        range_max: wire.range_max.unwrap_or(default.range_max),
        no_return_free_to: wire.no_return_free_to,
        beam_angle_error: wire.beam_angle_error.unwrap_or(default.beam_angle_error),
        mount: Mount { x: mount.x, y: mount.y, theta: mount.theta },
    }
}

fn to_wire_sensor(spec: &SensorSpec) -> v1::Sensor {
    v1::Sensor {
        range_error: Some(v1::RangeError { minus: Some(spec.range_error_minus), plus: Some(spec.range_error_plus) }),
        beam_opening: Some(spec.beam_opening),
        beam_diameter: Some(spec.beam_diameter),
        range_min: Some(spec.range_min),
        range_max: Some(spec.range_max),
        no_return_free_to: spec.no_return_free_to,
        beam_angle_error: Some(spec.beam_angle_error),
        mount: Some(v1::Mount { x: spec.mount.x, y: spec.mount.y, theta: spec.mount.theta }),
    }
}

fn config_error(error: &MapConfigError) -> ServiceError {
    let field = match error {
        MapConfigError::Grid(GridError::Resolution(_) | GridError::TooFine { .. }) => "resolution".to_owned(),
        MapConfigError::Grid(GridError::Depth(_)) => "depth".to_owned(),
        MapConfigError::Grid(GridError::Origin(_)) => "origin".to_owned(),
        MapConfigError::Classes(_) => "classes".to_owned(),
        MapConfigError::MinObstacleWidth(_) => "min_obstacle_width".to_owned(),
        MapConfigError::Sensor { name, source } => format!("sensors[{}].{}", shown(name), source.field),
        MapConfigError::Reach { name, .. } => format!("sensors[{}].range_max", shown(name)),
        MapConfigError::Sensors(_) => "sensors".to_owned(),
    };
    ServiceError::new(ErrorKind::InvalidConfig, error.to_string()).at(format!("config.{field}"))
}

/// A name from outside, cut where it is too long to be one.
fn shown(name: &str) -> String {
    name.chars().take(80).collect()
}

fn invalid(field: &str, problem: &str) -> ServiceError {
    ServiceError::new(ErrorKind::InvalidConfig, format!("{field} {problem}")).at(format!("config.{field}"))
}

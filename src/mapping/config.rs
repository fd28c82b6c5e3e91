//! A map's configuration.

use crate::quadtree::{ClassScale, ClassScaleError, Grid, GridError};
use crate::sensor::{SensorError, SensorModel};
use std::collections::BTreeMap;
use thiserror::Error;

/// Longest reach of a sensor in leaves: what one scan may cost is bounded by it.
pub const MAX_REACH_CELLS: f64 = 16_384.0;

/// Widest box of a sensor's positions in leaves: every set of a scan grows by it.
pub const MAX_SPREAD_CELLS: f64 = 4_096.0;

/// Largest `min_obstacle_width`, metres.
pub const MAX_OBSTACLE_WIDTH: f64 = 10.0;

/// Most sensors of one map.
pub const MAX_SENSORS: usize = 64;

/// Which leaves a scan calls empty.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default)]
pub enum EvidenceRule {
    /// Model section 4: no leaf that holds an obstacle point is ever decremented.
    #[default]
    Guaranteed,
    /// The paper's outer set, (9) and (12): every leaf that the empty part of some beam may touch.
    Outer,
    /// The paper's inner set, (10) and (11): every leaf that the empty part of one beam covers.
    Inner,
}

/// Why a map's configuration is refused.
#[derive(Debug, Clone, PartialEq, Error)]
pub enum MapConfigError {
    /// Resolution, depth or origin.
    #[error(transparent)]
    Grid(#[from] GridError),
    /// Number of classes.
    #[error(transparent)]
    Classes(#[from] ClassScaleError),
    /// Out of `0..=10`.
    #[error("min_obstacle_width must be between 0 and {MAX_OBSTACLE_WIDTH} m, got {0}")]
    MinObstacleWidth(f64),
    /// A sensor's parameters.
    #[error("sensors[{name:?}].{source}")]
    Sensor {
        /// The sensor's name.
        name: String,
        /// What is wrong with it.
        source: SensorError,
    },
    /// The sensor's reach is too many leaves.
    #[error(
        "sensors[{name:?}].range_max (with its error, and twice beam_diameter and mount) is {cells} leaves, the limit is \
         {MAX_REACH_CELLS}"
    )]
    Reach {
        /// The sensor's name.
        name: String,
        /// `(range_max + e+ + 2 w_b + 2 |mount|) / resolution`
        cells: f64,
    },
    /// No sensors, too many, or a bad name.
    #[error("sensors {0}")]
    Sensors(String),
}

/// A checked map configuration. It never changes, except that sensors are added or replaced for scans to come.
#[derive(Debug, Clone, PartialEq)]
pub struct MapConfig {
    grid: Grid,
    scale: ClassScale,
    rule: EvidenceRule,
    min_obstacle_width: f64,
    sensors: BTreeMap<String, SensorModel>,
}

impl MapConfig {
    /// Checks that the parts fit together. Sensor names follow the rule of map names.
    ///
    /// # Errors
    /// [`MapConfigError`] naming the field at fault.
    pub fn new(
        grid: Grid,
        scale: ClassScale,
        rule: EvidenceRule,
        min_obstacle_width: f64,
        sensors: BTreeMap<String, SensorModel>,
    ) -> Result<Self, MapConfigError> {
        if !(0.0..=MAX_OBSTACLE_WIDTH).contains(&min_obstacle_width) {
            return Err(MapConfigError::MinObstacleWidth(min_obstacle_width));
        }
        if sensors.is_empty() || sensors.len() > MAX_SENSORS {
            return Err(MapConfigError::Sensors(format!("must be 1 to {MAX_SENSORS}, got {}", sensors.len())));
        }
        for (name, sensor) in &sensors {
            if !is_name(name) {
                return Err(MapConfigError::Sensors(format!(
                    "has a bad name {name:?}: it must be [a-z0-9][a-z0-9_-]{{0,62}}"
                )));
            }
            let spec = sensor.spec();
            let aside = spec.beam_diameter + spec.mount.x.hypot(spec.mount.y);
            let metres = spec.range_max + spec.range_error_plus + 2.0 * aside;
            let cells = metres / grid.resolution();
            if cells > MAX_REACH_CELLS {
                return Err(MapConfigError::Reach { name: name.clone(), cells });
            }
        }
        Ok(Self { grid, scale, rule, min_obstacle_width, sensors })
    }

    /// Where the leaves are.
    #[must_use]
    pub fn grid(&self) -> &Grid {
        &self.grid
    }

    /// The classes.
    #[must_use]
    pub fn scale(&self) -> ClassScale {
        self.scale
    }

    /// The evidence rule.
    #[must_use]
    pub fn rule(&self) -> EvidenceRule {
        self.rule
    }

    /// `s` of assumption A4, metres; 0 assumes nothing.
    #[must_use]
    pub fn min_obstacle_width(&self) -> f64 {
        self.min_obstacle_width
    }

    /// The sensors by name.
    #[must_use]
    pub fn sensors(&self) -> &BTreeMap<String, SensorModel> {
        &self.sensors
    }

    /// The same configuration with other sensors.
    ///
    /// # Errors
    /// As [`MapConfig::new`].
    pub fn with_sensors(&self, sensors: BTreeMap<String, SensorModel>) -> Result<Self, MapConfigError> {
        Self::new(self.grid, self.scale, self.rule, self.min_obstacle_width, sensors)
    }
}

/// True for `[a-z0-9][a-z0-9_-]{0,62}`.
#[must_use]
pub fn is_name(name: &str) -> bool {
    let alphanumeric = |b: &u8| b.is_ascii_lowercase() || b.is_ascii_digit();
    let bytes = name.as_bytes();
    (1..=63).contains(&bytes.len())
        && alphanumeric(&bytes[0])
        && bytes.iter().all(|b| alphanumeric(b) || *b == b'_' || *b == b'-')
}

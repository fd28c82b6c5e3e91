//! What the types of `proto/` cannot say of a field: what is needed, bounds, rules of names, defaults.

use super::parameter::NAME_RULE;
use crate::mapping::{MAX_OBSTACLE_WIDTH, MAX_SENSORS};
use crate::sensor::{
    MAX_ANGLE_ERROR, MAX_BEAM_DIAMETER, MAX_LENGTH, MAX_MOUNT_OFFSET, MAX_MOUNT_THETA, MAX_ROBOT_LENGTH, SensorSpec,
};
use crate::wire;
use serde_json::{Value, json};

/// The rule of a map's name where the path names it already: the same, or nothing.
const MAP_OR_NOTHING: &str = "^([a-z0-9][a-z0-9_-]{0,62})?$";

/// The same of robots and snapshots.
const NAME_OR_NOTHING: &str = "^([A-Za-z0-9][A-Za-z0-9_.-]{0,62})?$";

/// Fields that a request or answer always has, beside those that an answer writes out by the rules of proto3 JSON.
const NEEDED: [&str; 26] = [
    "Point.x",
    "Point.y",
    "Interval.min",
    "Interval.max",
    "PoseBox.x",
    "PoseBox.y",
    "PoseBox.theta",
    "Scan.pose",
    "Scan.ranges",
    "BoxRegion.min_x",
    "BoxRegion.min_y",
    "BoxRegion.max_x",
    "BoxRegion.max_y",
    "DiscRegion.center",
    "DiscRegion.radius",
    "PolygonRegion.points",
    "PathRegion.points",
    "PathRegion.radius",
    "CreateSnapshotRequest.name",
    "CreateMapResponse.config",
    "CreateMapResponse.bounds",
    "GetMapResponse.config",
    "GetMapResponse.bounds",
    "RobotPose.pose",
    "MapSummary.config",
    "MapSummary.bounds",
];

/// Is the field always there?
pub fn needed(key: &str) -> bool {
    NEEDED.contains(&key)
}

/// Adds what is known of a field to its schema.
pub fn add(key: &str, schema: &mut Value) {
    let Some(Value::Object(more)) = known(key) else { return };
    for (name, value) in more {
        schema[name] = value;
    }
}

fn known(key: &str) -> Option<Value> {
    let sensor = SensorSpec::default();
    let mount = |most: f64| json!({ "minimum": -most, "maximum": most, "default": 0 });
    Some(match key {
        "Scan.ranges" => json!({
            "minItems": 1,
            "items": { "oneOf": [
                { "type": "number", "format": "float" },
                { "type": "string", "enum": ["NaN", "Infinity", "-Infinity"] },
            ] },
        }),
        "Scan.robot"
        | "RestoreSnapshotRequest.name"
        | "GetClassesRequest.snapshot"
        | "CheckGuaranteedFreeRequest.snapshot" => json!({ "pattern": NAME_OR_NOTHING }),
        "Scan.footprint_radius" | "Scan.sweep_translation" => json!({ "minimum": 0, "maximum": MAX_ROBOT_LENGTH }),
        "Scan.sweep_rotation" => json!({ "minimum": 0, "maximum": std::f64::consts::TAU }),
        "CreateSnapshotRequest.name" => json!({ "pattern": NAME_RULE }),
        "CreateMapRequest.map"
        | "InsertScansRequest.map"
        | "GetClassesRequest.map"
        | "CheckGuaranteedFreeRequest.map"
        | "CreateSnapshotRequest.map"
        | "RestoreSnapshotRequest.map" => {
            json!({ "pattern": MAP_OR_NOTHING, "description": "The map that the path names, or left out." })
        }
        "PolygonRegion.points" => json!({ "minItems": 3 }),
        "PathRegion.points" => json!({ "minItems": 1 }),
        "DiscRegion.radius" | "PathRegion.radius" => json!({ "minimum": 0, "description": "Metres." }),
        "MapConfig.resolution" => json!({ "default": wire::DEFAULT_RESOLUTION }),
        "MapConfig.depth" => json!({ "minimum": 1, "maximum": 24, "default": wire::DEFAULT_DEPTH }),
        "MapConfig.classes" => json!({ "minimum": 4, "maximum": 255, "default": wire::DEFAULT_CLASSES }),
        "MapConfig.min_obstacle_width" => {
            json!({ "minimum": 0, "maximum": MAX_OBSTACLE_WIDTH, "default": wire::DEFAULT_MIN_OBSTACLE_WIDTH })
        }
        "MapConfig.sensors" => json!({ "maxProperties": MAX_SENSORS }),
        "RangeError.minus" => length(sensor.range_error_minus),
        "RangeError.plus" => length(sensor.range_error_plus),
        "Sensor.range_min" => length(sensor.range_min),
        "Sensor.range_max" => length(sensor.range_max),
        "Sensor.no_return_free_to" => json!({ "minimum": 0, "maximum": MAX_LENGTH }),
        "Sensor.beam_opening" => json!({
            "minimum": 0, "maximum": std::f64::consts::PI, "exclusiveMaximum": true, "default": sensor.beam_opening,
        }),
        "Sensor.beam_diameter" => {
            json!({ "minimum": 0, "maximum": MAX_BEAM_DIAMETER, "default": sensor.beam_diameter })
        }
        "Sensor.beam_angle_error" => {
            json!({ "minimum": 0, "maximum": MAX_ANGLE_ERROR, "default": sensor.beam_angle_error })
        }
        "Mount.x" | "Mount.y" => mount(MAX_MOUNT_OFFSET),
        "Mount.theta" => mount(MAX_MOUNT_THETA),
        _ => return None,
    })
}

fn length(default: f64) -> Value {
    json!({ "minimum": 0, "maximum": MAX_LENGTH, "default": default })
}

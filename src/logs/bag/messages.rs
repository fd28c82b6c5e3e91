//! The messages that are read of a bag.

use super::cdr::Cdr;
use nalgebra::{Isometry3, Quaternion, Translation3, UnitQuaternion};

/// Most transforms of one message.
const MOST_TRANSFORMS: usize = 10_000;

/// How far from 1 the square of a quaternion's length may be: as ROS has it.
const QUATERNION_SLACK: f64 = 1e-2;

/// A quaternion nearer to unit length is taken as it stands.
const UNIT_SLACK: f64 = 1e-12;

/// Nanoseconds since the Unix epoch.
pub(super) type Stamp = i64;

/// The kinds of messages.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Kind {
    Scan,
    Transforms,
    Odometry,
    PoseWithCovariance,
    Pose,
}

impl Kind {
    /// The kind of a type's name, `None` for what is not read.
    pub(super) fn of(type_name: &str) -> Option<Self> {
        Some(match type_name {
            "sensor_msgs/msg/LaserScan" => Self::Scan,
            "tf2_msgs/msg/TFMessage" => Self::Transforms,
            "nav_msgs/msg/Odometry" => Self::Odometry,
            "geometry_msgs/msg/PoseWithCovarianceStamped" => Self::PoseWithCovariance,
            "geometry_msgs/msg/PoseStamped" => Self::Pose,
            _ => return None,
        })
    }

    /// Does a message of this kind say where the robot was?
    pub(super) fn is_pose(self) -> bool {
        matches!(self, Self::Odometry | Self::PoseWithCovariance | Self::Pose)
    }
}

/// `sensor_msgs/msg/LaserScan`
#[derive(Debug, Clone)]
pub(super) struct LaserScan {
    pub(super) stamp: Stamp,
    pub(super) frame: String,
    pub(super) angle_min: f32,
    pub(super) angle_increment: f32,
    /// Seconds between beams.
    pub(super) time_increment: f32,
    pub(super) range_min: f32,
    pub(super) range_max: f32,
    pub(super) ranges: Vec<f32>,
}

/// One transform of `tf2_msgs/msg/TFMessage`: `parent_from_child`.
#[derive(Debug, Clone)]
pub(super) struct Transform {
    pub(super) stamp: Stamp,
    pub(super) parent: String,
    pub(super) child: String,
    /// `Err` for one that is none: not finite, or no rotation.
    pub(super) parent_from_child: Result<Isometry3<f64>, String>,
}

/// Where the robot was, of any message that says so.
#[derive(Debug, Clone)]
pub(super) struct Pose {
    pub(super) stamp: Stamp,
    pub(super) frame: String,
    /// Empty where the message does not name it.
    pub(super) child: String,
    /// `Err` for one that is none: not finite, or no rotation.
    pub(super) pose: Result<Isometry3<f64>, String>,
    /// Variances of x, y and yaw; `None` where the message does not know.
    pub(super) variances: Option<[f64; 3]>,
}

fn header(cdr: &mut Cdr<'_>) -> Result<(Stamp, String), String> {
    let seconds = i64::from(cdr.i32("header.stamp.sec")?);
    let nanoseconds = i64::from(cdr.u32("header.stamp.nanosec")?);
    // At most 2^31 seconds: far from the ends of 64 bits.
    Ok((seconds * 1_000_000_000 + nanoseconds, frame(cdr, "header.frame_id")?))
}

/// A frame's name; a slash in front is of old.
fn frame(cdr: &mut Cdr<'_>, field: &str) -> Result<String, String> {
    Ok(cdr.name(field)?.trim_start_matches('/').to_owned())
}

fn seven(cdr: &mut Cdr<'_>, field: &str) -> Result<[f64; 7], String> {
    let mut values = [0.0; 7];
    for value in &mut values {
        *value = cdr.f64(field)?;
    }
    Ok(values)
}

fn isometry(values: [f64; 7], field: &str) -> Result<Isometry3<f64>, String> {
    let [x, y, z, i, j, k, w] = values;
    if values.iter().any(|value| !value.is_finite()) {
        return Err(format!("{field} is not finite"));
    }
    if [x, y, z].iter().any(|value| value.abs() > 1e9) {
        return Err(format!("{field} is beyond 1e9 m"));
    }
    let quaternion = Quaternion::new(w, i, j, k);
    let off = (quaternion.norm_squared() - 1.0).abs();
    if off > QUATERNION_SLACK {
        return Err(format!("{field} has a quaternion of length {:.3}, not 1", quaternion.norm()));
    }
    let rotation = if off < UNIT_SLACK {
        UnitQuaternion::new_unchecked(quaternion)
    } else {
        UnitQuaternion::new_normalize(quaternion)
    };
    Ok(Isometry3::from_parts(Translation3::new(x, y, z), rotation))
}

/// The variances of x, y and yaw of a covariance; by convention all zeros and -1 in front stand for "unknown".
fn variances(cdr: &mut Cdr<'_>) -> Result<Option<[f64; 3]>, String> {
    let mut matrix = [0.0; 36];
    for value in &mut matrix {
        *value = cdr.f64("pose.covariance")?;
    }
    if matrix[0] == -1.0 || matrix.iter().all(|value| *value == 0.0) {
        return Ok(None);
    }
    let diagonal = [matrix[0], matrix[7], matrix[35]];
    for (value, name) in diagonal.iter().zip(["x", "y", "yaw"]) {
        if !(*value >= 0.0 && value.is_finite()) {
            return Err(format!("pose.covariance has {value} for the variance of {name}"));
        }
    }
    Ok(Some(diagonal))
}

/// Reads a scan.
///
/// # Errors
/// Names the field at fault.
pub(super) fn scan(data: &[u8], max_beams: usize) -> Result<LaserScan, String> {
    let cdr = &mut Cdr::new(data)?;
    let (stamp, frame) = header(cdr)?;
    let angle_min = cdr.f32("angle_min")?;
    cdr.f32("angle_max")?;
    let angle_increment = cdr.f32("angle_increment")?;
    let time_increment = cdr.f32("time_increment")?;
    cdr.f32("scan_time")?;
    let (range_min, range_max) = (cdr.f32("range_min")?, cdr.f32("range_max")?);
    let ranges = cdr.f32s(max_beams, "ranges")?;
    for (value, field) in [
        (angle_min, "angle_min"),
        (angle_increment, "angle_increment"),
        (time_increment, "time_increment"),
        (range_min, "range_min"),
    ] {
        if !value.is_finite() {
            return Err(format!("{field} is {value}: it must be finite"));
        }
    }
    if ranges.is_empty() {
        return Err("ranges is empty".to_owned());
    }
    if range_max.is_nan() || range_max <= 0.0 {
        return Err(format!("range_max is {range_max}: it must be above 0"));
    }
    Ok(LaserScan { stamp, frame, angle_min, angle_increment, time_increment, range_min, range_max, ranges })
}

/// Reads the transforms of a message.
///
/// # Errors
/// Names the field at fault.
pub(super) fn transforms(data: &[u8]) -> Result<Vec<Transform>, String> {
    let cdr = &mut Cdr::new(data)?;
    // Stamp, two strings with their lengths, seven numbers.
    let count = cdr.length(72, MOST_TRANSFORMS, "transforms")?;
    let mut transforms = Vec::with_capacity(count);
    for _ in 0..count {
        let (stamp, parent) = header(cdr)?;
        let child = frame(cdr, "child_frame_id")?;
        let field = format!("the transform from {parent:?} to {child:?}");
        let parent_from_child = isometry(seven(cdr, &field)?, &field);
        transforms.push(Transform { stamp, parent, child, parent_from_child });
    }
    Ok(transforms)
}

/// Reads a pose of any kind.
///
/// # Errors
/// Names the field at fault.
pub(super) fn pose(kind: Kind, data: &[u8]) -> Result<Pose, String> {
    let cdr = &mut Cdr::new(data)?;
    let (stamp, frame_id) = header(cdr)?;
    let child = if kind == Kind::Odometry { frame(cdr, "child_frame_id")? } else { String::new() };
    let pose = isometry(seven(cdr, "pose")?, "pose");
    let variances = if kind == Kind::Pose { None } else { variances(cdr)? };
    Ok(Pose { stamp, frame: frame_id, child, pose, variances })
}

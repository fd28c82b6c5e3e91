//! A validated laser scan.

use super::measurement::swept;
use super::{PoseBox, ScanError, SensorModel};
use crate::interval::{Box2, Interval};
use crate::vector::{Path, on_each_path};

/// Largest absolute mirror angle accepted, radians.
pub const MAX_ANGLE: f64 = 1e3;

/// Largest `footprint_radius` and `sweep_translation` accepted, metres.
pub const MAX_ROBOT_LENGTH: f64 = 100.0;

/// How much the beams may span beyond a full circle, as a part of it: the rounding of a step of 32-bit precision.
const SPAN_SLACK: f64 = 1e-6;

/// Limits on scans that come from outside.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ScanLimits {
    /// Most beams a scan may have.
    pub max_beams: usize,
}

impl Default for ScanLimits {
    fn default() -> Self {
        Self { max_beams: 20_000 }
    }
}

/// The mirror angles of a scan's beams, radians in the sensor frame.
#[derive(Debug, Clone, PartialEq)]
pub enum Angles {
    /// `phi_i = min + i * increment`; the increment may be negative.
    Uniform {
        /// Angle of beam 0.
        min: f64,
        /// Step between beams.
        increment: f64,
    },
    /// One angle a beam, in any order.
    Listed(Vec<f64>),
}

/// The plain fields of a scan, unchecked but for the pose; [`Scan::new`] checks them.
#[derive(Debug, Clone, PartialEq)]
pub struct ScanSpec {
    /// Where the robot was during the whole scan (assumption A1).
    pub pose: PoseBox,
    /// Mirror angles.
    pub angles: Angles,
    /// Measured ranges, metres; NaN is a failed beam.
    pub ranges: Vec<f32>,
    /// Radius about the robot's origin that holds nothing but the robot (A5), metres; 0 for none.
    pub footprint_radius: f64,
    /// Rotation of the robot over the whole sweep, radians (A1).
    pub sweep_rotation: f64,
    /// Translation of the robot over the whole sweep, metres (A1).
    pub sweep_translation: f64,
}

/// What one beam says.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Reading {
    /// An obstacle at a distance within `[near, far]`, metres, rounded outward; `near >= 0`.
    Return {
        /// `d-`
        near: f64,
        /// `d+`
        far: f64,
    },
    /// Nothing came back.
    NoReturn,
    /// The measurement failed: says nothing.
    Failed,
}

/// A checked scan together with its sensor.
#[derive(Debug, Clone, PartialEq)]
pub struct Scan {
    spec: ScanSpec,
    sensor: SensorModel,
}

impl Scan {
    /// Checks a scan.
    ///
    /// # Errors
    /// [`ScanError`] naming the field at fault: no or too many beams, `angles` and `ranges` of different length, an
    /// angle that is not finite or beyond [`MAX_ANGLE`], several beams with a step of zero, beams that span more than a
    /// full circle (a last beam that closes the circle on the first is fine), or a scalar out of its range.
    pub fn new(spec: ScanSpec, sensor: SensorModel, limits: &ScanLimits) -> Result<Self, ScanError> {
        let count = spec.ranges.len();
        if count == 0 {
            return Err(ScanError::NoBeams);
        }
        if count > limits.max_beams {
            return Err(ScanError::TooManyBeams { count, limit: limits.max_beams });
        }
        check_angles(&spec.angles, count)?;
        within("footprint_radius", spec.footprint_radius, MAX_ROBOT_LENGTH)?;
        within("sweep_rotation", spec.sweep_rotation, std::f64::consts::TAU)?;
        within("sweep_translation", spec.sweep_translation, MAX_ROBOT_LENGTH)?;
        Ok(Self { spec, sensor })
    }

    /// The checked fields.
    #[must_use]
    pub fn spec(&self) -> &ScanSpec {
        &self.spec
    }

    /// The sensor that took the scan.
    #[must_use]
    pub fn sensor(&self) -> &SensorModel {
        &self.sensor
    }

    /// Where the robot was.
    #[must_use]
    pub fn pose(&self) -> &PoseBox {
        &self.spec.pose
    }

    /// Number of beams, at least 1.
    #[must_use]
    pub fn beams(&self) -> usize {
        self.spec.ranges.len()
    }

    /// Mirror angle `phi_i` of a beam, radians in the sensor frame.
    #[must_use]
    pub fn angle(&self, beam: usize) -> f64 {
        match &self.spec.angles {
            Angles::Uniform { min, increment } => min + beam as f64 * increment,
            Angles::Listed(angles) => angles[beam],
        }
    }

    /// What a beam says (section 1 of the model): compared with `range_min` and `range_max` as 32-bit floats, `[d_i]`
    /// widened by half an ulp of the 32-bit range and rounded outward.
    #[must_use]
    pub fn reading(&self, beam: usize) -> Reading {
        self.read(self.spec.ranges[beam])
    }

    /// What each beam says, in order.
    pub fn readings(&self) -> impl ExactSizeIterator<Item = Reading> + '_ {
        self.spec.ranges.iter().map(|range| self.read(*range))
    }

    /// How many beams say what.
    #[must_use]
    pub fn reading_counts(&self) -> ReadingCounts {
        let mut counts = ReadingCounts::default();
        for reading in self.readings() {
            match reading {
                Reading::Return { .. } => counts.returns += 1,
                Reading::NoReturn => counts.no_returns += 1,
                Reading::Failed => counts.failed += 1,
            }
        }
        counts
    }

    /// How far from the sensor its beams say something, metres, rounded up: the largest `d+` of a return, or how far a beam
    /// without one is free. 0 where no beam says anything.
    #[must_use]
    pub fn farthest(&self) -> f64 {
        let spec = self.sensor.spec();
        let (largest, none) = farthest(Path::best(), &self.spec.ranges, spec.range_min as f32, spec.range_max as f32);
        let returns = if largest > 0.0 { self.sensor.range_interval(largest).1 } else { 0.0 };
        let free_to = self.sensor.no_return_free_to().filter(|_| none).unwrap_or(0.0);
        returns.max(free_to)
    }

    /// Where the sensor can have been in the map frame, metres: a tight enclosure of
    /// `(x + x_s cos(theta) - y_s sin(theta), y + x_s sin(theta) + y_s cos(theta))` over the pose box.
    ///
    /// The mount turns as one vector, so its extent is that of an arc; exact up to rounding.
    #[must_use]
    pub fn origins(&self) -> Box2 {
        let mount = self.sensor.spec().mount;
        if mount.x == 0.0 && mount.y == 0.0 {
            return self.pose().position();
        }
        let arc = swept(self.pose().theta(), Box2::point(mount.x, mount.y));
        Box2::new(self.pose().x() + arc.x, self.pose().y() + arc.y)
    }

    /// The heading of the sensor's zero angle in the map frame, `[theta] + phi_s`, radians.
    #[must_use]
    pub fn headings(&self) -> Interval {
        self.pose().theta() + Interval::point(self.sensor.spec().mount.theta)
    }

    fn read(&self, range: f32) -> Reading {
        let spec = self.sensor.spec();
        // Not a positive number: NaN, zero, negative, -infinity.
        if range.is_nan() || range <= 0.0 {
            return Reading::Failed;
        }
        if range >= spec.range_max as f32 {
            return Reading::NoReturn;
        }
        if range < spec.range_min as f32 {
            return Reading::Failed;
        }
        let (near, far) = self.sensor.range_interval(range);
        Reading::Return { near, far }
    }
}

on_each_path! {
    /// The largest range that is a return, 0 where none is, and whether some beam had no return.
    fn farthest(ranges: &[f32], range_min: f32, range_max: f32) -> (f32, bool) {
        let (mut largest, mut nones) = (0_u32, 0_u32);
        for range in ranges {
            // The bits of positive floats are in their order.
            let returned = (*range > 0.0) & (*range >= range_min) & (*range < range_max);
            largest = largest.max(if returned { range.to_bits() } else { 0 });
            nones |= u32::from(*range >= range_max);
        }
        (f32::from_bits(largest), nones != 0)
    }
}

/// How many beams of a scan say what.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct ReadingCounts {
    /// Beams with an obstacle.
    pub returns: usize,
    /// Beams from which nothing came back.
    pub no_returns: usize,
    /// Failed measurements.
    pub failed: usize,
}

fn check_angles(angles: &Angles, beams: usize) -> Result<(), ScanError> {
    let usable = |field, value: f64| {
        if value.abs() <= MAX_ANGLE { Ok(()) } else { Err(ScanError::BadAngle { field, value }) }
    };
    let (field, span) = match angles {
        Angles::Uniform { min, increment } => {
            usable("angle_min", *min)?;
            usable("angle_increment", *increment)?;
            if *increment == 0.0 && beams > 1 {
                return Err(ScanError::BadAngle { field: "angle_increment", value: *increment });
            }
            ("angle_increment", (beams - 1) as f64 * increment.abs())
        }
        Angles::Listed(list) => {
            if list.len() != beams {
                return Err(ScanError::LengthMismatch { angles: list.len(), ranges: beams });
            }
            let (mut min, mut max) = (f64::INFINITY, f64::NEG_INFINITY);
            for angle in list {
                usable("angles", *angle)?;
                min = min.min(*angle);
                max = max.max(*angle);
            }
            ("angles", max - min)
        }
    };
    if span > std::f64::consts::TAU * (1.0 + SPAN_SLACK) {
        return Err(ScanError::SpanTooWide { field, span });
    }
    Ok(())
}

/// Refuses what is not in `0..=limit`, NaN included.
fn within(field: &'static str, value: f64, limit: f64) -> Result<(), ScanError> {
    if (0.0..=limit).contains(&value) { Ok(()) } else { Err(ScanError::OutOfRange { field, value, limit }) }
}

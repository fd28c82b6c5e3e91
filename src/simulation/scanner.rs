//! A laser scanner that keeps exactly the bounds that its sensor model claims, and uses them to the full.

use super::{Cone, GUARD, Point, World};
use crate::sensor::{Angles, PoseBox, PoseLimits, ScanError, ScanSpec, SensorSpec};
use rand::{Rng, RngExt};

/// A pose of the robot: metres and radians, map frame.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Pose {
    /// Position along x.
    pub x: f64,
    /// Position along y.
    pub y: f64,
    /// Heading, counter-clockwise from +x.
    pub theta: f64,
}

impl Pose {
    /// The robot's origin.
    #[must_use]
    pub fn position(&self) -> Point {
        Point::new(self.x, self.y)
    }

    /// The sensor's origin and its heading at mirror angle 0.
    #[must_use]
    pub fn sensor(&self, sensor: &SensorSpec) -> (Point, f64) {
        let (sin, cos) = self.theta.sin_cos();
        let mount = &sensor.mount;
        let origin = Point::new(self.x + mount.x * cos - mount.y * sin, self.y + mount.x * sin + mount.y * cos);
        (origin, self.theta + mount.theta)
    }
}

/// How the speed changes during a sweep.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Profile {
    /// The same motion between any two beams.
    Constant,
    /// From rest, so that the last step is about twice the mean.
    Accelerating,
    /// To rest, so that the first step is about twice the mean.
    Decelerating,
}

/// Where the robot truly is while its beams are fired in order of their index.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Motion {
    /// The pose at the first beam.
    pub start: Pose,
    /// The pose at the last beam.
    pub end: Pose,
    /// The speed between.
    pub profile: Profile,
}

impl Motion {
    /// A robot that stands still.
    #[must_use]
    pub fn still(pose: Pose) -> Self {
        Self { start: pose, end: pose, profile: Profile::Constant }
    }

    /// The true pose when beam `beam` of `beams` is fired.
    #[must_use]
    pub fn at(&self, beam: usize, beams: usize) -> Pose {
        let time = beam as f64 / (beams.max(2) - 1) as f64;
        let share = match self.profile {
            Profile::Constant => time,
            Profile::Accelerating => time * time,
            Profile::Decelerating => 1.0 - (1.0 - time) * (1.0 - time),
        };
        // Held between the two ends, which rounding could otherwise leave.
        let mix = |a: f64, b: f64| (a + share * (b - a)).clamp(a.min(b), a.max(b));
        Pose {
            x: mix(self.start.x, self.end.x),
            y: mix(self.start.y, self.end.y),
            theta: mix(self.start.theta, self.end.theta),
        }
    }

    /// Rotation of the robot over the whole sweep, radians, rounded up.
    #[must_use]
    pub fn rotation(&self) -> f64 {
        (self.end.theta - self.start.theta).abs() * (1.0 + 1e-12)
    }

    /// Translation of the robot over the whole sweep, metres, rounded up.
    #[must_use]
    pub fn translation(&self) -> f64 {
        (self.end.position() - self.start.position()).norm() * (1.0 + 1e-12)
    }
}

/// What a scanner does besides measuring, all of it within its claims.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Quirks {
    /// Share of beams that fail.
    pub failed: f64,
    /// Share of beams that miss an obstacle where the sensor model lets them: anywhere when a no-return says nothing,
    /// else at `no_return_free_to` and beyond.
    pub missed: f64,
    /// Share of errors at the end of their bounds; the rest is uniform.
    pub extreme: f64,
}

/// A scan of a world: every beam measures the nearest obstacle point in its cone, with an error within the sensor's
/// bounds. `pose` is what the robot claims; the caller sees to it that `motion` stays inside.
///
/// Each beam draws the same number of random values whatever it sees, so a world that differs in one obstacle gives
/// a scan that differs in the beams that touch it.
pub fn simulate_scan(
    world: &World,
    sensor: &SensorSpec,
    (angles, beams): (&Angles, usize),
    (pose, motion): (&PoseBox, &Motion),
    quirks: &Quirks,
    random: &mut impl Rng,
) -> ScanSpec {
    let ranges = (0..beams)
        .map(|beam| {
            let draws = draw(random);
            let angle = match angles {
                Angles::Uniform { min, increment } => min + beam as f64 * increment,
                Angles::Listed(angles) => angles.get(beam).copied().unwrap_or(0.0),
            };
            let (origin, heading) = motion.at(beam, beams).sensor(sensor);
            let error = angle_error(sensor, quirks, &draws);
            let distance = world.nearest_in(&Cone::new(origin, heading + angle + error, sensor));
            measure(distance, sensor, quirks, &draws)
        })
        .collect();
    ScanSpec {
        pose: *pose,
        angles: angles.clone(),
        ranges,
        footprint_radius: 0.0,
        sweep_rotation: motion.rotation(),
        sweep_translation: motion.translation(),
    }
}

/// The angle errors that [`simulate_scan`] gives to `beams` beams with the same random generator, radians.
pub fn angle_errors(sensor: &SensorSpec, beams: usize, quirks: &Quirks, random: &mut impl Rng) -> Vec<f64> {
    (0..beams).map(|_| angle_error(sensor, quirks, &draw(random))).collect()
}

/// All that is random about one beam.
fn draw(random: &mut impl Rng) -> [f64; 6] {
    std::array::from_fn(|_| random.random::<f64>())
}

fn angle_error(sensor: &SensorSpec, quirks: &Quirks, draws: &[f64; 6]) -> f64 {
    // A little less than the bound keeps a rounded sum within it.
    let bound = (sensor.beam_angle_error - 1e-12).max(0.0);
    within(-bound, bound, quirks.extreme, draws[0], draws[1])
}

/// A value in `[lo, hi]`: an end in a share `extreme` of the cases. `a` and `b` are uniform in 0..1.
fn within(lo: f64, hi: f64, extreme: f64, a: f64, b: f64) -> f64 {
    if a < 0.5 * extreme {
        lo
    } else if a < extreme {
        hi
    } else {
        lo + b * (hi - lo)
    }
}

/// The range that a scanner reports for a true distance.
fn measure(distance: Option<f64>, sensor: &SensorSpec, quirks: &Quirks, draws: &[f64; 6]) -> f32 {
    if draws[2] < quirks.failed {
        let others = [0.0, -1.0, f32::NEG_INFINITY];
        return others.get((draws[3] * 8.0) as usize).copied().unwrap_or(f32::NAN);
    }
    let range_max = sensor.range_max as f32;
    let nothing = if draws[3] < 0.5 { f32::INFINITY } else { range_max };
    let Some(distance) = distance else { return nothing };
    // A2 lets a beam go without a return unless an obstacle is nearer than F.
    let may_miss = sensor.no_return_free_to.is_none_or(|free| distance >= free + GUARD);
    if may_miss && draws[2] > 1.0 - quirks.missed {
        return nothing;
    }
    // r in [d - e+, d + e-]: then d is in [r - e-, r + e+]. Reported too far (the upper end) is the dangerous side, so
    // three quarters of the extremes are there. The guard covers the rounding of the distance.
    let lo = distance - sensor.range_error_plus;
    let hi = (distance + sensor.range_error_minus - 2.0 * GUARD).max(lo);
    let side = if draws[4] < 0.75 * quirks.extreme { hi } else { within(lo, hi, quirks.extreme, draws[5], draws[4]) };
    // Rounding to the nearest 32-bit float is off by half an ulp at most, which [d] is widened by.
    let range = side as f32;
    if range < range_max || may_miss { range } else { range_max.next_down() }
}

/// The pose box `pose` plus or minus the given half widths: `position` metres, `heading` radians.
///
/// # Errors
/// [`ScanError`] when the box is not a usable one, such as wider than the default limits.
pub fn pose_box_around(pose: &Pose, position: f64, heading: f64) -> Result<PoseBox, ScanError> {
    let around = |v: f64, r: f64| (v - r, v + r);
    let limits = PoseLimits::default();
    PoseBox::new(around(pose.x, position), around(pose.y, position), around(pose.theta, heading), &limits)
}

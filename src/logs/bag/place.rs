//! Where the laser was when a scan was taken, as a box in the plane.

use super::frames::{Frames, Way};
use super::messages::{LaserScan, Stamp};
use super::motion::{Look, motion};
use super::track::{Between, Missing, Near, Track, Variances, is_short_way};
use crate::interval::Interval;
use crate::logs::{LogPose, PoseError};
use crate::sensor::{MAX_ROBOT_LENGTH, PoseLimits};
use nalgebra::Vector3;
use std::f64::consts::{SQRT_2, TAU};

/// How far the laser's plane may be tilted, radians: 1 degree, whose cosine shortens 10 m by 1.5 mm.
const MOST_TILT: f64 = 0.017_46;

/// Fewest pieces into which the time of a sweep is cut.
const FEWEST_PIECES: i64 = 8;

/// Most pieces, a power of two times [`FEWEST_PIECES`].
const MOST_PIECES: i64 = 1024;

/// A longer piece is cut, nanoseconds: a laser turns by less than half a turn in it.
const LONGEST_PIECE: i64 = 50_000_000;

/// Poses before and after a sweep that are looked at for how fast the laser was.
const MOST_POSES_ABOUT: usize = 16;

/// Poses farther apart are not: any motion is within what can happen in that time, seconds.
const LONGEST_ABOUT: f64 = 2.0;

/// Why a scan has no place.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Unplaced {
    /// There is no pose for its time.
    Missing(Missing),
    /// Its plane is not that of the map.
    Tilted,
    /// The pose's box is wider than a map takes.
    Uncertain,
    /// Its sweep takes longer than can be looked at.
    Slow,
}

/// What says where the robot was.
pub(super) enum Poses {
    /// The tree of frames: the way from the map's frame to the laser.
    Frames(Way),
    /// The poses of a topic, and the way from the robot's frame to the laser.
    Topic { track: Track, mount: Way, sigma: f64 },
}

/// The place of scans.
pub(super) struct Placer {
    pub(super) frames: Frames,
    pub(super) poses: Poses,
    pub(super) between: Between,
    /// The error of what does not know its own: an axis' variance of 0, and, as the motion of a sweep goes, transforms.
    pub(super) pose_error: PoseError,
    /// Take the laser's motion during a sweep into account.
    pub(super) sweep: bool,
}

/// The place of one scan.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Placed {
    pub(super) pose: LogPose,
    /// The laser hangs upside down: its angles count the other way.
    pub(super) upside_down: bool,
    pub(super) sweep_rotation: f64,
    pub(super) sweep_translation: f64,
}

/// A box in the plane; whether it holds the errors of the poses that the bag tells.
#[derive(Debug, Clone, Copy)]
struct Spot {
    x: Interval,
    y: Interval,
    theta: Interval,
    whole: bool,
    upside_down: bool,
    /// How far the laser is from the middle of what carries it, metres.
    arm: f64,
}

impl Placer {
    /// The place of a scan.
    pub(super) fn place(&self, scan: &LaserScan) -> Result<Placed, Unplaced> {
        let steps = scan.ranges.len().saturating_sub(1) as f64;
        let nanoseconds = (f64::from(scan.time_increment) * 1e9 * steps).round();
        if !self.sweep || nanoseconds.abs() < 1.0 {
            return self.spot(scan.stamp)?.placed(0.0, 0.0);
        }
        if nanoseconds.abs() > (MOST_PIECES * LONGEST_PIECE) as f64 {
            return Err(Unplaced::Slow);
        }
        // Beams may be numbered against time.
        let begin = scan.stamp.saturating_add((nanoseconds as i64).min(0));
        let lasting = nanoseconds.abs() as i64;
        let mut pieces = FEWEST_PIECES;
        while pieces * LONGEST_PIECE < lasting {
            pieces *= 2;
        }
        // Rounded up: the last look is at the last beam or a moment after it.
        let piece = (lasting + pieces - 1) / pieces;
        let mut whole = self.spot(begin)?;
        let mut last = whole;
        let mut looks = vec![self.look(&whole, 0.0)];
        for count in 1..=pieces {
            last = self.spot(begin.saturating_add(piece * count))?.near(&last);
            whole = whole.hull(&last);
            looks.push(self.look(&last, seconds(piece * count)));
        }
        let about = self.about(begin, piece * pieces, &looks);
        let motion = motion(&looks, &about, &self.between).ok_or(Unplaced::Uncertain)?;
        whole.widened(motion.curve, motion.turn_curve).placed(motion.rotation, motion.translation)
    }

    /// Pairs of looks at the times of poses before and after a sweep.
    fn about(&self, begin: Stamp, lasting: Stamp, looks: &[Look]) -> Vec<(Look, Look)> {
        let mut pairs = Vec::new();
        let track = match &self.poses {
            Poses::Frames(way) => self.frames.carrier(way),
            Poses::Topic { track, .. } => Some(track),
        };
        let (Some(track), Some(first), Some(last)) = (track, looks.first(), looks.last()) else { return pairs };
        let (mut before, mut after) = ((begin, *first), (begin.saturating_add(lasting), *last));
        for _ in 0..MOST_POSES_ABOUT {
            let step = |stamp: Option<Stamp>, beside: &Look| {
                let stamp = stamp?;
                let mut look = self.look(&self.spot(stamp).ok()?, seconds(stamp.saturating_sub(begin)));
                look.theta += ((beside.theta - look.theta) / TAU).round() * TAU;
                Some((stamp, look))
            };
            let (earlier, later) = (step(track.earlier(before.0), &before.1), step(track.later(after.0), &after.1));
            if earlier.is_none() && later.is_none() {
                break;
            }
            before = earlier.unwrap_or(before);
            after = later.unwrap_or(after);
            if after.1.time - before.1.time > LONGEST_ABOUT {
                break;
            }
            pairs.push((before.1, after.1));
        }
        pairs
    }

    /// A place as a look at it, with all that it may be off by.
    fn look(&self, spot: &Spot, time: f64) -> Look {
        // Where the poses do not tell their errors, these come on top later: to the box, but not to the motion.
        let error = if spot.whole { PoseError::default() } else { self.pose_error };
        Look {
            time,
            x: spot.x.mid(),
            y: spot.y.mid(),
            theta: spot.theta.mid(),
            off: spot.x.radius().hypot(spot.y.radius()) + SQRT_2 * error.position,
            turn_off: spot.theta.radius() + error.heading,
            arm: spot.arm,
        }
    }

    /// Where the laser was at a time.
    fn spot(&self, stamp: Stamp) -> Result<Spot, Unplaced> {
        match &self.poses {
            Poses::Frames(way) => {
                let (laser, arm) = self.frames.along(way, stamp, &self.between).map_err(Unplaced::Missing)?;
                Spot::of(&laser, arm)
            }
            Poses::Topic { track, mount, sigma } => {
                let found = track.at(stamp, &self.between).map_err(Unplaced::Missing)?;
                let (mount, arm) = self.frames.along(mount, stamp, &self.between).map_err(Unplaced::Missing)?;
                if found.before.is_none() && found.after.is_none() {
                    // A pose that does not know its error, like a transform.
                    return Spot::of(&found.near.then(&mount), arm);
                }
                let half = worse(self.half_widths(found.before, *sigma), self.half_widths(found.after, *sigma));
                if !is_short_way(found.turn, half[2]) {
                    return Err(Unplaced::Missing(Missing::Turn));
                }
                // Errors of the heading are turns about the vertical. Where that is another way in the robot at the one pose
                // than at the other, the line between two of which each has an error is not the true line turned: they differ by
                // at most a quarter of the errors' sum times `lean`, and by terms of higher order.
                let robot = Near { heading: found.near.heading + half[2] * found.lean, ..found.near };
                Spot::with_mount(&robot, &mount, half, arm)
            }
        }
    }

    /// `sigma` standard deviations of x, y and yaw, rounded up: the box of the ellipsoid, whatever its axes. A variance of 0 is
    /// that of an axis that was not measured.
    fn half_widths(&self, variances: Variances, sigma: f64) -> [f64; 3] {
        let PoseError { position, heading } = self.pose_error;
        let up = |variance: f64| (sigma * variance.sqrt().next_up()).next_up();
        let half = |variance: f64, error: f64| if variance > 0.0 { up(variance) } else { error };
        let [x, y, yaw] = variances.unwrap_or_default();
        [half(x, position), half(y, position), half(yaw, heading)]
    }
}

fn seconds(nanoseconds: i64) -> f64 {
    nanoseconds as f64 * 1e-9
}

fn worse(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [a[0].max(b[0]), a[1].max(b[1]), a[2].max(b[2])]
}

/// An interval about a value; the value alone where there is no radius.
fn around(middle: f64, radius: f64) -> Interval {
    if radius > 0.0 { Interval::around(middle, radius) } else { Interval::point(middle) }
}

/// The heading of a frame in the plane, how far it may be off, and whether its z-axis points down.
///
/// # Errors
/// [`Unplaced::Tilted`] for one that does neither.
fn planar(near: &Near) -> Result<(Interval, bool), Unplaced> {
    let (x, z) = (near.pose.rotation * Vector3::x(), near.pose.rotation * Vector3::z());
    let tilt = z.x.hypot(z.y);
    if tilt > MOST_TILT.sin() {
        return Err(Unplaced::Tilted);
    }
    // A turn of an axis that is tilted by `t` turns its heading by up to `1 / cos t` as much.
    let steepest = tilt.asin() + near.heading;
    if steepest > 1.0 {
        return Err(Unplaced::Uncertain);
    }
    Ok((around(x.y.atan2(x.x), near.heading / steepest.cos()), z.z < 0.0))
}

impl Spot {
    /// A pose that does not know its error.
    fn of(near: &Near, arm: f64) -> Result<Self, Unplaced> {
        let (theta, upside_down) = planar(near)?;
        let at = near.pose.translation.vector;
        let (x, y) = (around(at.x, near.position), around(at.y, near.position));
        Ok(Self { x, y, theta, whole: false, upside_down, arm })
    }

    /// A pose with bounds of its own, and the laser's place on the robot.
    fn with_mount(robot: &Near, mount: &Near, half: [f64; 3], arm: f64) -> Result<Self, Unplaced> {
        // In space: a robot that pitches moves a laser that is high above its origin.
        let laser = robot.then(mount);
        let (theta, upside_down) = planar(&laser)?;
        let (at, from) = (laser.pose.translation.vector, robot.pose.translation.vector);
        let (x, y) = (around(at.x, half[0] + laser.position), around(at.y, half[1] + laser.position));
        if half[2] == 0.0 {
            return Ok(Self { x, y, theta, whole: true, upside_down, arm });
        }
        // The error of the robot's heading swings the laser about the vertical through the robot.
        let (u, v) = (Interval::point(at.x - from.x), Interval::point(at.y - from.y));
        let turn = Interval::around(0.0, half[2]);
        let (less, sin) = (turn.cos() - Interval::point(1.0), turn.sin());
        let (x, y) = (x + less * u - sin * v, y + sin * u + less * v);
        Ok(Self { x, y, theta: theta + turn, whole: true, upside_down, arm })
    }

    /// With a heading of the same turn as another's.
    fn near(mut self, other: &Self) -> Self {
        let turns = ((other.theta.mid() - self.theta.mid()) / std::f64::consts::TAU).round();
        if turns != 0.0 {
            self.theta = self.theta + Interval::point(turns) * Interval::TAU;
        }
        self
    }

    fn hull(&self, other: &Self) -> Self {
        Self {
            x: self.x.hull(other.x),
            y: self.y.hull(other.y),
            theta: self.theta.hull(other.theta),
            whole: self.whole && other.whole,
            upside_down: self.upside_down,
            arm: self.arm.max(other.arm),
        }
    }

    fn widened(mut self, position: f64, heading: f64) -> Self {
        let more = Interval::around(0.0, position);
        self.x = self.x + more;
        self.y = self.y + more;
        self.theta = self.theta + Interval::around(0.0, heading);
        self
    }

    fn placed(&self, sweep_rotation: f64, sweep_translation: f64) -> Result<Placed, Unplaced> {
        let limits = PoseLimits::default();
        let (x, y, theta) = (self.x, self.y, self.theta);
        let widest = x.width().max(y.width());
        if !(widest <= limits.max_position_width && theta.width() <= limits.max_heading_width) {
            return Err(Unplaced::Uncertain);
        }
        if !(sweep_rotation <= TAU && sweep_translation <= MAX_ROBOT_LENGTH) {
            return Err(Unplaced::Uncertain);
        }
        let pair = |interval: Interval| (interval.lo(), interval.hi());
        let (x, y, theta) = (pair(x), pair(y), pair(theta));
        let pose = if self.whole { LogPose::Box { x, y, theta } } else { LogPose::Near { x, y, theta } };
        Ok(Placed { pose, upside_down: self.upside_down, sweep_rotation, sweep_translation })
    }
}

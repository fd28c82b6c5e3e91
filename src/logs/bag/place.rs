//! Where the laser was when a scan was taken, as a box in the plane.

use super::frames::{Frames, Way};
use super::messages::{LaserScan, Stamp};
use super::track::{Between, Missing, Near, Track, Variances};
use crate::interval::Interval;
use crate::logs::LogPose;
use crate::sensor::PoseLimits;
use nalgebra::{Isometry3, Vector3};

/// How far the laser's plane may be tilted, radians: 1 degree, whose cosine shortens 10 m by 1.5 mm.
const MOST_TILT: f64 = 0.017_46;

/// Pieces into which the time of a sweep is cut.
const SWEEP_PIECES: i64 = 8;

/// Why a scan has no place.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Unplaced {
    /// There is no pose for its time.
    Missing(Missing),
    /// Its plane is not that of the map.
    Tilted,
    /// The pose's box is wider than a map takes.
    Uncertain,
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
}

impl Placer {
    /// The place of a scan.
    pub(super) fn place(&self, scan: &LaserScan) -> Result<Placed, Unplaced> {
        let first = self.spot(scan.stamp)?;
        let steps = scan.ranges.len().saturating_sub(1) as f64;
        let nanoseconds = f64::from(scan.time_increment).abs() * steps * 1e9;
        if !self.sweep || nanoseconds < 1.0 {
            return first.placed(0.0, 0.0);
        }
        // One that takes longer than a gap has no poses anyway.
        let lasting = nanoseconds.min(self.between.max_gap as f64 * SWEEP_PIECES as f64) as i64;
        // Beams may be numbered against time.
        let lasting = if scan.time_increment < 0.0 { -lasting } else { lasting };
        let mut whole = first;
        let (mut rotation, mut translation, mut last) = (0.0, 0.0, first);
        for piece in 1..=SWEEP_PIECES {
            let here = self.spot(scan.stamp.saturating_add(lasting / SWEEP_PIECES * piece))?.near(&last);
            let (dx, dy) = (here.x.mid() - last.x.mid(), here.y.mid() - last.y.mid());
            translation += dx.hypot(dy);
            rotation += (here.theta.mid() - last.theta.mid()).abs();
            whole = whole.hull(&here);
            last = here;
        }
        // What the motion between two looks can leave the line by, at its ends and in the middle.
        let piece = lasting.unsigned_abs() as f64 * 1e-9 / SWEEP_PIECES as f64;
        let curve = 0.125 * piece * piece;
        let (more, turn) = (self.between.acceleration * curve, self.between.turn * curve);
        let pieces = 2.0 * SWEEP_PIECES as f64;
        // Both ends may be off by what poses between samples are. The samples' own errors are taken for those of a drift that
        // is the same all through a sweep.
        let (slack, swing) = if first.whole {
            (0.0, 0.0)
        } else {
            (2.0 * first.reach().max(last.reach()), 2.0 * first.theta.radius().max(last.theta.radius()))
        };
        whole.widened(more, turn).placed(rotation + pieces * turn + swing, translation + pieces * more + slack)
    }

    /// Where the laser was at a time.
    fn spot(&self, stamp: Stamp) -> Result<Spot, Unplaced> {
        match &self.poses {
            Poses::Frames(way) => {
                let laser = self.frames.along(way, stamp, &self.between).map_err(Unplaced::Missing)?;
                Spot::of(&laser)
            }
            Poses::Topic { track, mount, sigma } => {
                let (robot, before, after) = track.at(stamp, &self.between).map_err(Unplaced::Missing)?;
                let mount = self.frames.along(mount, stamp, &self.between).map_err(Unplaced::Missing)?;
                match (half_widths(before, *sigma), half_widths(after, *sigma)) {
                    (Some(before), Some(after)) => Spot::with_mount(&robot, &mount, worse(before, after)),
                    // A pose that does not know its error, like a transform.
                    _ => Spot::of(&robot.then(&mount)),
                }
            }
        }
    }
}

/// `sigma` standard deviations of x, y and yaw, rounded up: the box of the ellipsoid, whatever its axes.
fn half_widths(variances: Variances, sigma: f64) -> Option<[f64; 3]> {
    let up = |variance: f64| (sigma * variance.sqrt().next_up()).next_up();
    variances.map(|variances| variances.map(|variance| if variance > 0.0 { up(variance) } else { 0.0 }))
}

fn worse(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [a[0].max(b[0]), a[1].max(b[1]), a[2].max(b[2])]
}

/// The heading of a frame in the plane, and whether its z-axis points down.
///
/// # Errors
/// [`Unplaced::Tilted`] for one that does neither.
fn planar(pose: &Isometry3<f64>) -> Result<(f64, bool), Unplaced> {
    let (x, z) = (pose.rotation * Vector3::x(), pose.rotation * Vector3::z());
    if z.x.hypot(z.y) > MOST_TILT.sin() {
        return Err(Unplaced::Tilted);
    }
    Ok((x.y.atan2(x.x), z.z < 0.0))
}

impl Spot {
    /// A pose that does not know its error.
    fn of(near: &Near) -> Result<Self, Unplaced> {
        let (heading, upside_down) = planar(&near.pose)?;
        let around = |middle: f64, radius: f64| {
            if radius > 0.0 { Interval::around(middle, radius) } else { Interval::point(middle) }
        };
        let at = near.pose.translation.vector;
        Ok(Self {
            x: around(at.x, near.position),
            y: around(at.y, near.position),
            theta: around(heading, near.heading),
            whole: false,
            upside_down,
        })
    }

    /// A pose with bounds of its own, and the laser's place on the robot.
    fn with_mount(robot: &Near, mount: &Near, half: [f64; 3]) -> Result<Self, Unplaced> {
        let (heading, robot_down) = planar(&robot.pose)?;
        let (laser_heading, laser_down) = planar(&mount.pose)?;
        if robot_down {
            return Err(Unplaced::Tilted);
        }
        let around = |middle: f64, radius: f64| {
            if radius > 0.0 { Interval::around(middle, radius) } else { Interval::point(middle) }
        };
        let theta = around(heading, half[2] + robot.heading);
        let at = robot.pose.translation.vector;
        let (x, y) = (around(at.x, half[0] + robot.position), around(at.y, half[1] + robot.position));
        let laser = mount.pose.translation.vector;
        let (lx, ly) = (around(laser.x, mount.position), around(laser.y, mount.position));
        let (x, y) = if laser.x == 0.0 && laser.y == 0.0 && mount.position == 0.0 {
            (x, y)
        } else {
            (x + theta.cos() * lx - theta.sin() * ly, y + theta.sin() * lx + theta.cos() * ly)
        };
        let theta = if laser_heading == 0.0 && mount.heading == 0.0 {
            theta
        } else {
            theta + around(laser_heading, mount.heading)
        };
        Ok(Self { x, y, theta, whole: true, upside_down: laser_down })
    }

    /// With a heading of the same turn as another's.
    fn near(mut self, other: &Self) -> Self {
        let turns = ((other.theta.mid() - self.theta.mid()) / std::f64::consts::TAU).round();
        if turns != 0.0 {
            self.theta = self.theta + Interval::point(turns) * Interval::TAU;
        }
        self
    }

    /// How far it reaches from its middle, metres.
    fn reach(&self) -> f64 {
        self.x.radius().hypot(self.y.radius())
    }

    fn hull(&self, other: &Self) -> Self {
        Self {
            x: self.x.hull(other.x),
            y: self.y.hull(other.y),
            theta: self.theta.hull(other.theta),
            whole: self.whole && other.whole,
            upside_down: self.upside_down,
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
        let pair = |interval: Interval| (interval.lo(), interval.hi());
        let (x, y, theta) = (pair(x), pair(y), pair(theta));
        let pose = if self.whole { LogPose::Box { x, y, theta } } else { LogPose::Near { x, y, theta } };
        Ok(Placed { pose, upside_down: self.upside_down, sweep_rotation, sweep_translation })
    }
}

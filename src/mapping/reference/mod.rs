//! The evidence of a scan the slow way: the oracle of the tests.
//!
//! Every question is asked of one leaf (and, for the paper's sets, of one beam), straight from the definitions of the
//! model, in code that shares nothing with the fast engine. A map is never built this way.
//!
//! * the measurement set (6): points drawn from it, and the paper's natural interval extension of it;
//! * X_EMP `outer` (8), (9) and `inner` (10), (11): points drawn from the empty part, and the natural interval test;
//! * X_EMP `guaranteed`: the rule for a whole box of the model's section 4, as it is written ([`Reference::proves`]), and
//!   its pointwise form ([`Reference::is_point_free`], [`Reference::is_proven_by_points`]);
//! * the paper's algorithms node by node: [`sivia`] (Alg. 1), [`buildsp`], [`ubbmap`] (Alg. 2).
//!
//! Questions that give an upper bound of a set are answered in outward-rounded intervals, those that draw points in plain
//! floating point (a drawn point is off by some `1e-15` of its coordinates).

mod guaranteed;
mod paper;
mod pointwise;
mod subpaving;

pub use pointwise::pointwise_rho;
pub use subpaving::{Enclosure, Subpaving, buildsp, sivia, ubbmap};

use crate::interval::{Box2, Interval};
use crate::sensor::{Reading, Scan};

/// `lambda` of assumption A4: how far the centre of the disc may be from an obstacle point, in diameters.
const LAMBDA: f64 = std::f64::consts::FRAC_1_SQRT_2;

/// One pose of the pose box: `x`, `y` in metres, `theta` in radians.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Pose {
    /// Metres.
    pub x: f64,
    /// Metres.
    pub y: f64,
    /// Radians.
    pub theta: f64,
}

/// A beam that says something about empty space.
#[derive(Debug, Clone, Copy)]
struct Ray {
    /// `phi_i`, radians in the sensor frame.
    angle: f64,
    /// `d_i-`, or `F` for a beam without a return; metres.
    near: f64,
    /// False for a beam without a return: it may be skipped.
    is_return: bool,
    /// Its place in the order of firing.
    index: usize,
}

/// A scan with its beams sorted.
#[derive(Debug)]
pub struct Reference<'a> {
    scan: &'a Scan,
    min_obstacle_width: f64,
    /// Usable beams by angle.
    rays: Vec<Ray>,
    /// The first beam of each bracket with the largest motion; of a sensor that is still, of one of them.
    most_moved: Vec<usize>,
    /// Condition 2 with one `r` for all brackets of a box.
    one_range: bool,
}

impl<'a> Reference<'a> {
    /// The reference for a scan and `min_obstacle_width`, `s` of A4 (metres).
    #[must_use]
    pub fn new(scan: &'a Scan, min_obstacle_width: f64) -> Self {
        let mut rays: Vec<Ray> = (0..scan.beams())
            .filter_map(|index| {
                let (near, is_return) = Self::empty_to_of(scan, index)?;
                Some(Ray { angle: scan.angle(index), near, is_return, index })
            })
            .collect();
        rays.sort_by(|a, b| a.angle.total_cmp(&b.angle));
        let mut reference = Self { scan, min_obstacle_width, rays, most_moved: Vec::new(), one_range: false };
        let count = reference.rays.len();
        let share = |j: usize| reference.share(&reference.rays[j], &reference.rays[(j + 1) % count]);
        let shares: Vec<f64> = (0..count).map(share).collect();
        let largest = shares.iter().copied().fold(0.0, f64::max);
        let most_moved = (0..count).filter(|j| shares[*j] == largest);
        let moves = scan.spec().sweep_rotation > 0.0 || scan.spec().sweep_translation > 0.0;
        reference.most_moved = most_moved.take(if moves { usize::MAX } else { 1 }).collect();
        reference
    }

    /// The rule for whole boxes in its simpler form: `r` of condition 2 is the largest distance of `D` in every bracket.
    #[must_use]
    pub fn with_one_range(self) -> Self {
        Self { one_range: true, ..self }
    }

    /// `d_i-` and true for a return, `F` and false for a beam without one; `None` for a beam that says nothing.
    fn empty_to_of(scan: &Scan, beam: usize) -> Option<(f64, bool)> {
        match scan.reading(beam) {
            Reading::Return { near, .. } => Some((near, true)),
            Reading::NoReturn => scan.sensor().no_return_free_to().map(|free_to| (free_to, false)),
            Reading::Failed => None,
        }
    }

    /// How far a beam is empty by itself, metres; `None` for one that says nothing.
    #[must_use]
    pub fn empty_to(&self, beam: usize) -> Option<f64> {
        Self::empty_to_of(self.scan, beam).map(|(near, _)| near)
    }

    /// The largest distance from the sensor at which the scan says that anything is empty, metres.
    #[must_use]
    pub fn reach(&self) -> f64 {
        self.rays.iter().map(|ray| ray.near).fold(0.0, f64::max)
    }

    /// A pose of the box, its corners and edges favoured; `unit` draws from `[0, 1)`.
    pub fn draw_pose(&self, unit: &mut dyn FnMut() -> f64) -> Pose {
        let pose = self.scan.pose();
        let (x, y) = (draw(unit, pose.x().lo(), pose.x().hi()), draw(unit, pose.y().lo(), pose.y().hi()));
        Pose { x, y, theta: draw(unit, pose.theta().lo(), pose.theta().hi()) }
    }

    /// The middle of the pose box.
    #[must_use]
    pub fn middle_pose(&self) -> Pose {
        let pose = self.scan.pose();
        Pose { x: pose.x().mid(), y: pose.y().mid(), theta: pose.theta().mid() }
    }

    /// Where the sensor is at a pose, metres.
    fn origin(&self, pose: Pose) -> (f64, f64) {
        let mount = self.scan.sensor().spec().mount;
        let (sin, cos) = pose.theta.sin_cos();
        (pose.x + mount.x * cos - mount.y * sin, pose.y + mount.x * sin + mount.y * cos)
    }

    /// `O`, the hull of the sensor's origins: `|m| cos(theta + arg m)` and `|m| sin(theta + arg m)` for the mount `m`.
    fn origins(&self) -> Box2 {
        let (pose, mount) = (self.scan.pose(), self.scan.sensor().spec().mount);
        let (x, y) = (Interval::point(mount.x), Interval::point(mount.y));
        if mount.x == 0.0 && mount.y == 0.0 {
            return pose.position();
        }
        let (length, direction) = (x.hypot(y), pose.theta() + y.atan2(x));
        Box2::new(pose.x() + length * direction.cos(), pose.y() + length * direction.sin())
    }

    /// `[theta] + phi_s`, radians.
    fn headings(&self) -> Interval {
        self.scan.pose().theta() + Interval::point(self.scan.sensor().spec().mount.theta)
    }

    /// A5: every point of the box is within `footprint_radius` of the robot's origin for every pose.
    #[must_use]
    pub fn is_in_footprint(&self, leaf: &Box2) -> bool {
        let radius = self.scan.spec().footprint_radius;
        let (dx, dy) = (leaf.x - self.scan.pose().x(), leaf.y - self.scan.pose().y());
        radius > 0.0 && dx.magnitude().hypot(dy.magnitude()) <= radius
    }
}

/// A number of `[lo, hi]`: each end a quarter of the time.
fn draw(unit: &mut dyn FnMut() -> f64, lo: f64, hi: f64) -> f64 {
    match unit() {
        u if u < 0.25 => lo,
        u if u < 0.5 => hi,
        _ => (lo + (hi - lo) * unit()).clamp(lo, hi),
    }
}

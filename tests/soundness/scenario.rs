//! Random scenes made to break the rule: a sensor, a pose box, a true motion, and obstacles where they are hardest to see.

use crate::placement::{self, Nose, Stage};
use rand::{Rng, RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::collections::BTreeMap;
use std::f64::consts::{PI, TAU};
use ubbmap::mapping::{EvidenceRule, MapConfig};
use ubbmap::quadtree::{ClassScale, Grid};
use ubbmap::sensor::{Angles, Mount, PoseBox, PoseLimits, ScanSpec, SensorModel, SensorSpec};
use ubbmap::simulation::{Motion, Pose, Profile, Quirks, Shape, World, angle_errors, simulate_scan};

/// What a family of scenes dwells on.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Family {
    /// Everything at random: sensors, mounts, boxes, failures, resolutions.
    Any,
    /// Small errors and thick obstacles in the gaps between beams, where conditions 2 and 3 are exact.
    Tight,
    /// As tight, with an uncertain heading.
    Heading,
    /// As tight, with an uncertain position.
    Position,
    /// As tight, with beams that are turned by as much as they may.
    Turned,
    /// The robot moves during the sweep.
    Sweep,
    /// The robot turns during the sweep, with the sensor far from its origin, looking outward: it moves sideways.
    Lever,
    /// Obstacles at the ends of the field of view, long gaps, beams without a return.
    Edges,
}

pub const FAMILIES: [Family; 8] = [
    Family::Any,
    Family::Tight,
    Family::Heading,
    Family::Position,
    Family::Turned,
    Family::Sweep,
    Family::Lever,
    Family::Edges,
];

/// One scene; everything follows from `(family, seed)`.
#[derive(Debug, Clone)]
pub struct Scenario {
    pub family: Family,
    pub seed: u64,
    pub shapes: Vec<Shape>,
    pub sensor: SensorSpec,
    pub angles: Angles,
    pub beams: usize,
    pub pose: PoseBox,
    pub motion: Motion,
    pub quirks: Quirks,
    pub footprint: f64,
    pub width: f64,
    pub resolution: f64,
    pub depth: u32,
    pub origin: (f64, f64),
}

/// What the beams of a scene draw from.
fn scan_random(seed: u64) -> ChaCha8Rng {
    ChaCha8Rng::seed_from_u64(seed ^ 0x5eed_0f5c_a95c_a95c)
}

pub fn pick<T: Copy>(random: &mut impl Rng, of: &[T]) -> T {
    of[random.random_range(0..of.len())]
}

impl Scenario {
    pub fn generate(family: Family, seed: u64) -> Self {
        let mut random = ChaCha8Rng::seed_from_u64(seed.wrapping_mul(8).wrapping_add(family as u64));
        let rng = &mut random;
        let resolution = match family {
            Family::Any | Family::Edges => pick(rng, &[0.03, 0.05, 0.1, 0.1, 0.2, 0.5]),
            _ => pick(rng, &[0.03, 0.05, 0.05, 0.1]),
        };
        let reach = (resolution * rng.random_range(20.0..110.0_f64)).clamp(0.8, 8.0);
        let (angles, beams) = random_angles(family, rng);
        let width = match (family, &angles) {
            // Such that gaps are the limit well before the walls.
            (Family::Lever, Angles::Uniform { increment, .. }) => increment.abs() * reach * rng.random_range(0.3..0.7),
            _ => random_width(family, rng),
        };
        let mut sensor = random_sensor(family, reach, rng);
        let turned = if matches!(family, Family::Any | Family::Edges) { 0.4 } else { 0.1 };
        if family == Family::Turned {
            sensor.beam_angle_error = pick(rng, &[0.002, 0.005, 0.01, 0.02]);
        } else if family != Family::Tight && rng.random_bool(turned) {
            sensor.beam_angle_error = pick(rng, &[0.0005, 0.005, 0.02]);
        }
        let pose = random_pose_box(family, rng);
        let motion = random_motion(family, &pose, rng);
        let quirks = match family {
            Family::Tight | Family::Heading | Family::Position | Family::Turned => {
                Quirks { failed: pick(rng, &[0.0, 0.0, 0.1]), missed: 0.0, extreme: 1.0 }
            }
            Family::Lever => Quirks { failed: 0.0, missed: 0.0, extreme: 1.0 },
            Family::Sweep if rng.random_bool(0.7) => Quirks { failed: 0.0, missed: 0.0, extreme: 1.0 },
            _ => Quirks {
                failed: pick(rng, &[0.0, 0.05, 0.3, 0.8]),
                missed: pick(rng, &[0.0, 0.1, 0.5]),
                extreme: pick(rng, &[1.0, 0.8, 0.3]),
            },
        };
        let footprint = if rng.random_bool(0.3) { rng.random_range(0.05..0.4) } else { 0.0 };
        let depth = if rng.random_bool(0.1) { rng.random_range(3..7) } else { rng.random_range(9..13) };
        let errors = angle_errors(&sensor, beams, &quirks, &mut scan_random(seed));
        let stage =
            Stage { errors, sensor, motion, reach, width, resolution, footprint, angles: &angles, beams, family };
        let (shapes, corner) = placement::place(&stage, rng);
        let origin = choose_origin(corner, &motion, resolution, depth, rng);
        Self {
            family,
            seed,
            shapes,
            sensor,
            angles,
            beams,
            pose,
            motion,
            quirks,
            footprint,
            width,
            resolution,
            depth,
            origin,
        }
    }

    pub fn world(&self) -> World {
        World::new(self.shapes.clone())
    }

    /// The scan of the scene; the same random draws whatever shapes there are.
    pub fn scan_spec(&self, world: &World) -> ScanSpec {
        let mut random = scan_random(self.seed);
        let beams = (&self.angles, self.beams);
        let poses = (&self.pose, &self.motion);
        let spec = simulate_scan(world, &self.sensor, beams, poses, &self.quirks, &mut random);
        ScanSpec { footprint_radius: self.footprint, ..spec }
    }

    /// The map's configuration, with what is claimed of the sensor and of the obstacles.
    pub fn config(&self, sensor: &SensorSpec, width: f64) -> MapConfig {
        let grid = Grid::new(self.resolution, self.depth, Some(self.origin)).unwrap();
        let sensors = BTreeMap::from([("default".to_owned(), SensorModel::new(*sensor).unwrap())]);
        MapConfig::new(grid, ClassScale::new(10).unwrap(), EvidenceRule::Guaranteed, width, sensors).unwrap()
    }
}

/// The root's min corner: such that the worst-placed obstacle point is just inside the far corner of its leaf.
fn choose_origin(corner: Option<Nose>, motion: &Motion, resolution: f64, depth: u32, rng: &mut impl Rng) -> (f64, f64) {
    let side = resolution * f64::from(1_u32 << depth);
    let (sx, sy) = (motion.start.x, motion.start.y);
    // The robot is somewhere in the middle half of the root.
    let (fx, fy) = (rng.random_range(0.25..0.75), rng.random_range(0.25..0.75));
    let (x, y) = (sx - fx * side, sy - fy * side);
    let Some(corner) = corner else { return (x, y) };
    let edges = corner.edges();
    let shift = |origin: f64, edge: f64| origin + (edge - origin).rem_euclid(resolution);
    (shift(x, edges.x), shift(y, edges.y))
}

fn random_angles(family: Family, rng: &mut impl Rng) -> (Angles, usize) {
    if family == Family::Lever {
        let (count, step) = (rng.random_range(30..90), f64::to_radians(rng.random_range(0.6..1.6)));
        let increment = step * pick(rng, &[1.0, -1.0]);
        return (Angles::Uniform { min: -0.5 * increment * f64::from(count - 1), increment }, count as usize);
    }
    let tight = !matches!(family, Family::Any | Family::Edges);
    let step: f64 = if tight { rng.random_range(0.5..6.0) } else { pick(rng, &[0.25, 0.5, 1.0, 3.0, 7.0, 25.0, 70.0]) };
    let step = step.to_radians();
    let most = if tight { 160 } else { 260 };
    let fov = if tight { rng.random_range(60.0..360.0) } else { pick(rng, &[1.0, 20.0, 90.0, 180.0, 270.0, 340.0]) };
    let fov = f64::to_radians(fov);
    let count = ((fov / step) as usize + 1).clamp(2, most);
    let min = rng.random_range(-PI..PI);
    match rng.random_range(0..if family == Family::Edges { 8 } else { 7 }) {
        0 | 1 => (Angles::Uniform { min, increment: step.min(fov / (count - 1) as f64) }, count),
        2 => (Angles::Uniform { min, increment: -step.min(fov / (count - 1) as f64) }, count),
        3 => {
            // A full circle, closed by the step from the last beam to the first.
            let count = ((TAU / step) as usize).clamp(4, most);
            (Angles::Uniform { min, increment: TAU / count as f64 * pick(rng, &[1.0, -1.0]) }, count)
        }
        4 => {
            // Nearly a full circle: the seam is wider than a step, or the last beam nearly repeats the first.
            let count = ((TAU / step) as usize).clamp(5, most);
            let span = TAU - step * pick(rng, &[1e-6, 0.3, 2.5]);
            (Angles::Uniform { min, increment: span / (count - 1) as f64 }, count)
        }
        5 => {
            let angles = uneven(min, fov, count, rng);
            let count = angles.len();
            (Angles::Listed(angles), count)
        }
        6 => {
            let mut angles = uneven(min, fov, count, rng);
            // Some directions are measured twice.
            for _ in 0..pick(rng, &[0, 1, 5]) {
                angles.push(angles[rng.random_range(0..angles.len())]);
            }
            angles.sort_by(f64::total_cmp);
            if rng.random_bool(0.5) {
                angles.reverse();
            } else {
                for i in (1..angles.len()).rev() {
                    angles.swap(i, rng.random_range(0..=i));
                }
            }
            let count = angles.len();
            (Angles::Listed(angles), count)
        }
        _ => {
            let count = rng.random_range(1..6);
            (
                Angles::Listed((0..count).map(|i| min + f64::from(i) * rng.random_range(0.1..1.2)).collect()),
                count as usize,
            )
        }
    }
}

/// Increasing angles with steps between a fifth and five times the mean.
fn uneven(min: f64, fov: f64, count: usize, rng: &mut impl Rng) -> Vec<f64> {
    let steps: Vec<f64> = (1..count).map(|_| rng.random_range(0.2..1.0_f64).powi(rng.random_range(1..4))).collect();
    let total: f64 = steps.iter().sum();
    let mut angle = min;
    let mut angles = vec![min];
    for step in steps {
        angle += step * fov / total;
        angles.push(angle.min(min + TAU - 1e-9));
    }
    angles
}

fn random_width(family: Family, rng: &mut impl Rng) -> f64 {
    match family {
        Family::Any | Family::Edges => pick(rng, &[0.0, 0.02, 0.05, 0.1, 0.3]),
        _ => pick(rng, &[0.05, 0.1, 0.2, 0.3]),
    }
}

fn random_sensor(family: Family, reach: f64, rng: &mut impl Rng) -> SensorSpec {
    let tight = matches!(family, Family::Tight | Family::Heading | Family::Position | Family::Turned | Family::Lever)
        || (family == Family::Sweep && rng.random_bool(0.8));
    let error = |rng: &mut _| if tight { pick(rng, &[0.0, 0.002]) } else { pick(rng, &[0.0, 0.005, 0.035, 0.1]) };
    let (minus, plus) = (error(rng), error(rng));
    let range_max = if rng.random_bool(0.7) { 2.5 * reach } else { (rng.random_range(0.4..1.0) * reach).max(0.5) };
    let no_return_free_to = rng.random_bool(if family == Family::Edges { 0.7 } else { 0.4 }).then(|| {
        let most = range_max - minus;
        if rng.random_bool(0.5) { most } else { most * rng.random_range(0.2..1.0) }
    });
    let mount = if family == Family::Lever {
        let turn: f64 = rng.random_range(-PI..PI);
        let arm = rng.random_range(0.5..2.0);
        Mount { x: arm * turn.cos(), y: arm * turn.sin(), theta: turn + pick(rng, &[0.0, 0.0, PI, 0.3]) }
    } else if rng.random_bool(0.5) {
        let arm = if family == Family::Sweep { 1.2 } else { 0.5 };
        Mount { x: rng.random_range(-arm..arm), y: rng.random_range(-arm..arm), theta: rng.random_range(-PI..PI) }
    } else {
        Mount::default()
    };
    SensorSpec {
        range_error_minus: minus,
        range_error_plus: plus,
        beam_opening: if tight {
            pick(rng, &[0.0, 0.002, 0.01])
        } else {
            pick(rng, &[0.0, 0.001, 0.004_363, 0.004_363, 0.02, 0.1, 0.5, 2.0])
        },
        beam_diameter: if tight { pick(rng, &[0.0, 0.005, 0.012]) } else { pick(rng, &[0.0, 0.005, 0.012, 0.05, 0.1]) },
        range_min: pick(rng, &[0.0, 0.0, 0.05, 0.3]),
        range_max,
        no_return_free_to,
        beam_angle_error: 0.0,
        mount,
    }
}

fn random_pose_box(family: Family, rng: &mut impl Rng) -> PoseBox {
    let (position, heading) = match family {
        Family::Tight | Family::Turned => (0.0, 0.0),
        Family::Heading => (0.0, pick(rng, &[0.3, 1.0, 3.0, 8.0])),
        Family::Lever => (pick(rng, &[0.0, 0.0, 0.01]), rng.random_range(1.0..7.0)),
        Family::Position => (pick(rng, &[0.01, 0.03, 0.08, 0.2]), 0.0),
        Family::Sweep => (pick(rng, &[0.0, 0.0, 0.01, 0.05]), pick(rng, &[0.0, 0.5, 2.0, 10.0, 25.0])),
        _ => (pick(rng, &[0.0, 0.01, 0.03, 0.1, 0.9]), pick(rng, &[0.0, 0.2, 0.7, 3.0, 10.0, 30.0])),
    };
    let spread = pick(rng, &[3.0, 3.0, 3.0, 3.0, 50.0, 2e4, 1e6]);
    let side = |width: f64, spread: f64, rng: &mut _| {
        let middle: f64 = RngExt::random_range(rng, -spread..spread);
        (middle - width, middle + width)
    };
    let (x, y) = (side(position, spread, rng), side(position * pick(rng, &[1.0, 1.0, 0.0]), spread, rng));
    let theta = side(f64::to_radians(heading), pick(rng, &[4.0, 4.0, 40.0, 1e4]), rng);
    PoseBox::new(x, y, theta, &PoseLimits::default()).unwrap()
}

/// A value of an interval, an end of it in most cases.
fn extreme(interval: ubbmap::interval::Interval, rng: &mut impl Rng) -> f64 {
    match rng.random_range(0..8) {
        0..3 => interval.lo(),
        3..6 => interval.hi(),
        _ => rng.random_range(interval.lo()..=interval.hi()),
    }
}

fn random_motion(family: Family, pose: &PoseBox, rng: &mut impl Rng) -> Motion {
    let mut draw = || Pose { x: extreme(pose.x(), rng), y: extreme(pose.y(), rng), theta: extreme(pose.theta(), rng) };
    let (mut start, mut end) = (draw(), draw());
    if family == Family::Lever {
        (start.theta, end.theta) =
            pick(rng, &[(pose.theta().lo(), pose.theta().hi()), (pose.theta().hi(), pose.theta().lo())]);
    }
    let sweeps = match family {
        Family::Sweep | Family::Lever => true,
        Family::Any | Family::Edges => rng.random_bool(0.15),
        _ => false,
    };
    if !sweeps {
        return Motion::still(start);
    }
    Motion { start, end, profile: pick(rng, &[Profile::Constant, Profile::Accelerating, Profile::Decelerating]) }
}

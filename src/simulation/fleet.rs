//! Robots that explore a building and scan it: true poses, pose boxes that hold them, and scans.

use super::{Building, Motion, Pane, Point, Pose, Quirks, fail_at_glass, pose_box_around, simulate_scan};
use crate::sensor::{Angles, Mount, ScanSpec, SensorSpec};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::f64::consts::{PI, TAU};

/// Radius of a robot's body, metres.
pub const ROBOT_RADIUS: f64 = 0.25;
/// Half width of the pose boxes, metres and radians.
const POSE_ERROR: (f64, f64) = (0.03, 0.012);
/// Speed along the route, m/s, and turning on the spot, rad/s.
const SPEED: (f64, f64) = (0.7, 1.2);
/// Time between two scans of a robot, seconds.
const INTERVAL: f64 = 0.2;
const BEAMS: usize = 360;

/// A scan of one robot and where it was in truth.
#[derive(Debug, Clone, PartialEq)]
pub struct SimulatedScan {
    /// The robot's name, `robot-0` and so on.
    pub robot: String,
    /// Counts up from 1 for each robot.
    pub sequence: u64,
    /// Seconds since the start.
    pub stamp: f64,
    /// Where the robot truly was.
    pub truth: Pose,
    /// What it reports.
    pub scan: ScanSpec,
}

/// One leg of a route.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Leg {
    Turn { at: Point, from: f64, by: f64 },
    Drive { from: Point, to: Point },
}

impl Leg {
    fn duration(&self) -> f64 {
        match self {
            Self::Turn { by, .. } => by.abs() / SPEED.1,
            Self::Drive { from, to } => (to - from).norm() / SPEED.0,
        }
    }

    fn at(&self, time: f64) -> Pose {
        let share = if self.duration() > 0.0 { (time / self.duration()).clamp(0.0, 1.0) } else { 1.0 };
        match *self {
            Self::Turn { at, from, by } => Pose { x: at.x, y: at.y, theta: from + share * by },
            Self::Drive { from, to } => {
                let here = from + (to - from) * share;
                Pose { x: here.x, y: here.y, theta: heading(from, to) }
            }
        }
    }
}

#[derive(Debug, Clone)]
struct Robot {
    legs: Vec<Leg>,
    leg: usize,
    /// Seconds into the leg.
    time: f64,
    /// How far the estimate is off, as shares of its bounds.
    offset: [f64; 3],
    sequence: u64,
    random: ChaCha8Rng,
}

/// Several robots in one building; the same seed gives the same scans. They do not see each other.
#[derive(Debug, Clone)]
pub struct Fleet {
    building: Building,
    robots: Vec<Robot>,
    steps: u64,
    /// Where beams fail; empty where the windows are walls like all others.
    panes: Vec<Pane>,
    glass: ChaCha8Rng,
}

impl Fleet {
    /// A fleet at its start: each robot begins at another room and goes round all of them for ever.
    #[must_use]
    pub fn new(seed: u64, robots: usize) -> Self {
        let building = Building::new(seed);
        let robots = (0..robots)
            .map(|i| {
                let random = ChaCha8Rng::seed_from_u64(seed.wrapping_mul(1000).wrapping_add(1 + i as u64));
                let legs = legs(&route(&building, i * building.rooms.len() / robots, i % 2 == 1));
                Robot { legs, leg: 0, time: 0.0, offset: [0.0; 3], sequence: 0, random }
            })
            .collect();
        Self { building, robots, steps: 0, panes: Vec::new(), glass: ChaCha8Rng::seed_from_u64(seed) }
    }

    /// The same fleet in the same building with panes in its windows: there beams fail as they do at glass. All other
    /// readings stay as they are.
    #[must_use]
    pub fn with_glass(mut self) -> Self {
        self.panes = Building::panes();
        self
    }

    /// The building that the robots are in.
    #[must_use]
    pub fn building(&self) -> &Building {
        &self.building
    }

    /// The sensor that all robots carry: 360 beams over 270 degrees.
    #[must_use]
    pub fn sensor() -> SensorSpec {
        SensorSpec {
            range_error_minus: 0.03,
            range_error_plus: 0.03,
            range_max: 20.0,
            no_return_free_to: Some(15.0),
            mount: Mount { x: 0.12, y: 0.0, theta: 0.0 },
            ..SensorSpec::default()
        }
    }

    /// Moves every robot on and takes one scan of each, in order of the robots.
    pub fn step(&mut self) -> Vec<SimulatedScan> {
        let stamp = self.steps as f64 * INTERVAL;
        self.steps += 1;
        let (building, panes, glass) = (&self.building, &self.panes, &mut self.glass);
        let scan = |(i, robot): (usize, &mut Robot)| {
            let truth = robot.advance();
            robot.sequence += 1;
            let mut scan = robot.scan(building, truth)?;
            if let Angles::Uniform { min, increment } = scan.angles {
                let angle = |beam: usize| min + beam as f64 * increment;
                fail_at_glass(panes, truth.sensor(&Self::sensor()), angle, &mut scan.ranges, glass);
            }
            Some(SimulatedScan { robot: format!("robot-{i}"), sequence: robot.sequence, stamp, truth, scan })
        };
        self.robots.iter_mut().enumerate().filter_map(scan).collect()
    }
}

impl Robot {
    fn advance(&mut self) -> Pose {
        let Some(leg) = self.legs.get(self.leg) else { return Pose::default() };
        let pose = leg.at(self.time);
        self.time += INTERVAL;
        // Each leg lasts some time and the route closes, so this ends.
        for _ in 0..self.legs.len() {
            let duration = self.legs[self.leg].duration();
            if self.time <= duration {
                break;
            }
            self.time -= duration;
            self.leg = (self.leg + 1) % self.legs.len();
        }
        pose
    }

    /// A scan from a true pose. The estimate drifts within its bounds; its box holds the truth.
    fn scan(&mut self, building: &Building, truth: Pose) -> Option<ScanSpec> {
        for share in &mut self.offset {
            *share = (*share + self.random.random_range(-0.2..0.2)).clamp(-0.98, 0.98);
        }
        let estimate = Pose {
            x: truth.x + self.offset[0] * POSE_ERROR.0,
            y: truth.y + self.offset[1] * POSE_ERROR.0,
            theta: truth.theta + self.offset[2] * POSE_ERROR.1,
        };
        // Never an error: the box is far narrower than the limits.
        let pose = pose_box_around(&estimate, POSE_ERROR.0, POSE_ERROR.1).ok()?;
        let field = 1.5 * PI;
        let angles = Angles::Uniform { min: -0.5 * field, increment: field / (BEAMS - 1) as f64 };
        let quirks = Quirks { failed: 0.005, missed: 0.0, extreme: 0.1 };
        let beams = (&angles, BEAMS);
        let poses = (&pose, &Motion::still(truth));
        let scan = simulate_scan(&building.world, &Fleet::sensor(), beams, poses, &quirks, &mut self.random);
        Some(ScanSpec { footprint_radius: ROBOT_RADIUS, ..scan })
    }
}

fn heading(from: Point, to: Point) -> f64 {
    (to.y - from.y).atan2(to.x - from.x)
}

/// A closed tour of all rooms, beginning with room `first`, backwards if asked for.
fn route(building: &Building, first: usize, backwards: bool) -> Vec<Point> {
    let count = building.rooms.len();
    let mut points: Vec<Point> = Vec::new();
    for i in 0..count {
        let step = if backwards { count - i } else { i };
        let mut room = building.rooms[(first + step) % count].route.clone();
        if backwards {
            room.reverse();
        }
        for point in room {
            if points.last().is_none_or(|last| (point - last).norm() > 1e-9) {
                points.push(point);
            }
        }
    }
    points
}

/// Drives between the points of a closed route, with turns on the spot.
fn legs(points: &[Point]) -> Vec<Leg> {
    let count = points.len();
    let mut legs = Vec::with_capacity(2 * count);
    let mut facing = heading(points[count - 1], points[0]);
    for i in 0..count {
        let (from, to) = (points[i], points[(i + 1) % count]);
        let by = (heading(from, to) - facing + PI).rem_euclid(TAU) - PI;
        legs.push(Leg::Turn { at: from, from: facing, by });
        legs.push(Leg::Drive { from, to });
        facing = heading(from, to);
    }
    legs
}

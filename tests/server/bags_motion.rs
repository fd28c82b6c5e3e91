//! Bags of robots that move: whatever they do within the bounds that are told, the declared boxes and motions hold the truth.
//!
//! The geometry is exact and its own: rotations are products of turns about axes, nothing is interpolated.

#![allow(clippy::unwrap_used, clippy::panic, reason = "tests")]

use super::bag_support::{Bag, ODOMETRY, Packed, Place, SCAN, Scan, TF, covariance, flat, pose, transforms};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::f64::consts::{PI, TAU};
use std::path::Path;
use ubbmap::logs::{BagOptions, LogPose, LogReader, LogScan, PoseError};
use ubbmap::sensor::ScanLimits;

type Quaternion = [f64; 4];

fn times(a: Quaternion, b: Quaternion) -> Quaternion {
    let ([ax, ay, az, aw], [bx, by, bz, bw]) = (a, b);
    [
        aw * bx + ax * bw + ay * bz - az * by,
        aw * by - ax * bz + ay * bw + az * bx,
        aw * bz + ax * by - ay * bx + az * bw,
        aw * bw - ax * bx - ay * by - az * bz,
    ]
}

/// The turn by yaw, then pitch, then roll, about axes that turn along.
fn turn(yaw: f64, pitch: f64, roll: f64) -> Quaternion {
    let about = |axis: usize, angle: f64| {
        let mut quaternion = [0.0, 0.0, 0.0, (0.5 * angle).cos()];
        quaternion[axis] = (0.5 * angle).sin();
        quaternion
    };
    times(times(about(2, yaw), about(1, pitch)), about(0, roll))
}

fn turned(quaternion: Quaternion, v: [f64; 3]) -> [f64; 3] {
    let [x, y, z, w] = quaternion;
    let there = times(times(quaternion, [v[0], v[1], v[2], 0.0]), [-x, -y, -z, w]);
    [there[0], there[1], there[2]]
}

fn place(at: [f64; 3], turn: Quaternion) -> Place {
    Place { at, turn }
}

/// A value over time whose second derivative is bounded.
#[derive(Debug, Clone)]
enum Wave {
    /// `start + rate t`, and sines of an amplitude, an angular frequency and a phase.
    Sines { start: f64, rate: f64, sines: Vec<[f64; 3]> },
    /// `rate t`, and full acceleration between samples, now this way, now the other: at all samples it is 0.
    Bumps { rate: f64, acceleration: f64, gap: f64 },
}

impl Wave {
    fn sines(random: &mut ChaCha8Rng, start: f64, rate: f64, acceleration: f64) -> Self {
        let sines = [0.6, 0.4].map(|share| {
            let frequency: f64 = random.random_range(2.0..12.0);
            [share * acceleration / frequency.powi(2), frequency, random.random_range(0.0..TAU)]
        });
        Self::Sines { start, rate, sines: sines.to_vec() }
    }

    fn at(&self, time: f64) -> f64 {
        match self {
            Self::Sines { start, rate, sines } => {
                start
                    + rate * time
                    + sines.iter().map(|[size, rate, phase]| size * (rate * time + phase).sin()).sum::<f64>()
            }
            Self::Bumps { rate, acceleration, gap } => {
                let number = (time / gap).floor();
                let since = time - number * gap;
                let way = if number.rem_euclid(2.0) == 0.0 { 0.5 } else { -0.5 };
                rate * time + way * acceleration * since * (gap - since)
            }
        }
    }

    /// Bounds of the first and the second derivative.
    fn rates(&self) -> (f64, f64) {
        match self {
            Self::Sines { rate, sines, .. } => (
                rate.abs() + sines.iter().map(|[size, rate, _]| size * rate).sum::<f64>(),
                sines.iter().map(|[size, rate, _]| size * rate * rate).sum(),
            ),
            Self::Bumps { rate, acceleration, gap } => (rate.abs() + 0.5 * acceleration * gap, *acceleration),
        }
    }
}

/// A robot on its way, its laser, and how its poses are recorded.
#[derive(Debug)]
struct World {
    x: Wave,
    y: Wave,
    yaw: Wave,
    pitch: Wave,
    roll: Wave,
    /// The plate on the robot, the laser on the plate.
    plate: ([f64; 3], Quaternion),
    laser: ([f64; 3], Quaternion),
    /// Seconds between poses, and between the first beam and the last.
    gap: f64,
    sweep: f64,
    /// Errors of the poses: x, y and yaw.
    error: [f64; 3],
    /// The poses tell their errors.
    told: bool,
}

const BEAMS: usize = 33;
const SECONDS: f64 = 50.0;
const SCANS: usize = 500;

impl World {
    fn draw(random: &mut ChaCha8Rng, number: usize) -> Self {
        let gap = [0.5, 0.2, 0.1, 0.05, 0.02][number % 5];
        let sweep = [0.1, 0.025, 0.1, 0.2, 0.0][random.random_range(0..5)];
        let way: f64 = random.random_range(0.0..TAU);
        let (a, turn_by): (f64, f64) = (random.random_range(0.5..3.0), random.random_range(0.5..5.0));
        let speed = random.random_range(-0.7..0.7);
        let small = 0.2_f64.to_radians();
        let bumps = number.is_multiple_of(3);
        let (x, y, yaw) = if bumps {
            let bump = |rate: f64, acceleration: f64| Wave::Bumps { rate, acceleration, gap };
            (bump(speed, a * way.cos()), bump(0.0, a * way.sin()), bump(random.random_range(-1.0..1.0), turn_by))
        } else {
            let (rate, start) = (random.random_range(-1.0..1.0), random.random_range(-PI..PI));
            (
                Wave::sines(random, 3.0, speed, a * way.cos()),
                Wave::sines(random, -2.0, 0.3, a * way.sin()),
                Wave::sines(random, start, rate, turn_by),
            )
        };
        // Upright, on a ramp, or nodding.
        let tilt = |random: &mut ChaCha8Rng| match number % 4 {
            0 => Wave::Sines { start: 0.0, rate: 0.0, sines: Vec::new() },
            1 => Wave::Sines { start: random.random_range(-3.0 * small..3.0 * small), rate: 0.0, sines: Vec::new() },
            _ => {
                let (frequency, phase) = (random.random_range(0.5..8.0), random.random_range(0.0..TAU));
                Wave::Sines { start: 0.0, rate: 0.0, sines: vec![[small, frequency, phase]] }
            }
        };
        let (pitch, roll) = (tilt(random), Wave::Sines { start: 0.0, rate: 0.0, sines: Vec::new() });
        let roll = if number % 4 == 1 { roll } else { tilt(random) };
        let over = if number.is_multiple_of(7) { PI } else { 0.0 };
        let arm = random.random_range(0.0..0.5);
        let told = number.is_multiple_of(2);
        let scale = [0.0, 0.3, 1.0][random.random_range(0..3)];
        let error = [0.05, 0.03, 0.04].map(|most| if told { most * (0.02 + scale) } else { most * scale });
        Self {
            x,
            y,
            yaw,
            pitch,
            roll,
            plate: ([arm, -0.1, random.random_range(0.0..1.5)], turn(random.random_range(-PI..PI), 0.0, 0.0)),
            laser: ([0.05, 0.0, 0.1], turn(0.4, if number % 4 == 3 { small } else { 0.0 }, over)),
            gap,
            sweep,
            error,
            told,
        }
    }

    /// Bounds of the accelerations: the turn's is that of a vector, of which pitch and roll have a part.
    fn bounds(&self) -> PoseError {
        let [x, y, yaw, pitch, roll] = [&self.x, &self.y, &self.yaw, &self.pitch, &self.roll].map(Wave::rates);
        let heading = yaw.1 + pitch.1 + roll.1 + yaw.0 * (pitch.0 + roll.0) + pitch.0 * roll.0;
        PoseError { position: x.1.hypot(y.1) * (1.0 + 1e-9), heading: heading * (1.0 + 1e-9) }
    }

    fn robot(&self, time: f64) -> ([f64; 3], Quaternion) {
        let turn = turn(self.yaw.at(time), self.pitch.at(time), self.roll.at(time));
        ([self.x.at(time), self.y.at(time), 0.0], turn)
    }

    /// Where the laser is in the plane.
    fn truth(&self, time: f64) -> [f64; 3] {
        let (mut at, mut turn) = self.robot(time);
        for (offset, next) in [self.plate, self.laser] {
            let offset = turned(turn, offset);
            at = [at[0] + offset[0], at[1] + offset[1], at[2] + offset[2]];
            turn = times(turn, next);
        }
        let ahead = turned(turn, [1.0, 0.0, 0.0]);
        [at[0], at[1], ahead[1].atan2(ahead[0])]
    }

    /// How far the laser is from the robot's middle.
    fn arm(&self) -> f64 {
        let offset = turned(self.plate.1, self.laser.0);
        let at = [0, 1, 2].map(|axis| self.plate.0[axis] + offset[axis]);
        at[0].hypot(at[1]).hypot(at[2])
    }

    fn bag(&self, random: &mut ChaCha8Rng) -> Bag {
        let mut bag = Bag::default();
        let (plate, laser) = (place(self.plate.0, self.plate.1), place(self.laser.0, self.laser.1));
        bag.put("/tf_static", TF, transforms(0.0, &[("base_link", "plate", plate), ("plate", "laser", laser)]));
        let [ex, ey, eyaw] = self.error;
        // Three deviations are the bound.
        let matrix = if self.told {
            covariance((ex / 3.0).powi(2), (ey / 3.0).powi(2), (eyaw / 3.0).powi(2))
        } else {
            [0.0; 36]
        };
        for count in 0..=(SECONDS / self.gap).round() as usize {
            let time = count as f64 * self.gap;
            let (at, there) = self.robot(time);
            // At a corner of the box every other time.
            let mut error = |most: f64| {
                let share: f64 = random.random_range(-1.0..1.0);
                most * if count % 2 == 0 { share } else { share.signum() } * (1.0 - 1e-9)
            };
            let at = [at[0] + error(ex), at[1] + error(ey), 0.0];
            let there = place(at, times(turn(error(eyaw), 0.0, 0.0), there));
            if self.has_chain() {
                bag.put("/tf", TF, transforms(time, &[("odom", "base_link", there)]));
                bag.put("/tf", TF, transforms(time + 0.3 * self.gap, &[("map", "odom", flat(0.0, 0.0, 0.0))]));
            } else {
                bag.put("/odom", ODOMETRY, pose(time, "map", Some("base_link"), &there, &matrix));
            }
        }
        for _ in 0..SCANS {
            let back = random.random_range(0..5) == 0;
            let scan = Scan {
                stamp: random.random_range(0.5..SECONDS - 0.8),
                frame: "laser",
                angle_min: -1.0,
                angle_increment: 0.05,
                time_increment: (self.sweep / (BEAMS - 1) as f64) as f32 * if back { -1.0 } else { 1.0 },
                range_max: 30.0,
                ranges: vec![if back { 2.0 } else { 1.0 }; BEAMS],
            };
            bag.put("/scan", SCAN, scan.message(true));
        }
        bag
    }

    /// Are its poses transforms in two steps, from the map to odom to the robot?
    fn has_chain(&self) -> bool {
        !self.told && (self.gap * 100.0).round() % 2.0 == 0.0
    }

    fn options(&self) -> BagOptions {
        let arm = self.arm();
        // What a pose is off by at the laser.
        let [x, y, heading] = self.error;
        let position = x.max(y) + arm * heading;
        let pose_error =
            if self.told { PoseError::default() } else { PoseError { position, heading: heading * 1.001 } };
        BagOptions { max_acceleration: self.bounds(), pose_error, ..BagOptions::default() }
    }
}

/// What was counted over many scans.
#[derive(Debug, Default)]
struct Tally {
    scans: usize,
    outside: usize,
    faster: usize,
    farther: usize,
    /// Declared over what the truth and the errors leave no way around: widths of boxes, motions of sweeps.
    widths: Vec<f64>,
    motions: Vec<f64>,
}

impl Tally {
    fn add(&mut self, world: &World, scan: &LogScan) {
        self.scans += 1;
        let error = world.options().pose_error;
        let bounds: [(f64, f64); 3] = scan.pose.bounds(&error).into();
        let back = if scan.ranges[0] > 1.5 { -1.0 } else { 1.0 };
        let increment = f64::from((world.sweep / (BEAMS - 1) as f64) as f32) * back;
        let middle = 0.5 * (bounds[2].0 + bounds[2].1);
        let beams: Vec<[f64; 3]> = (0..BEAMS)
            .map(|beam| {
                let [x, y, heading] = world.truth(scan.stamp + increment * beam as f64);
                [x, y, heading + ((middle - heading) / TAU).round() * TAU]
            })
            .collect();
        let held =
            |at: &[f64; 3]| at.iter().zip(bounds).all(|(value, (lo, hi))| lo - 1e-9 <= *value && *value <= hi + 1e-9);
        self.outside += usize::from(!beams.iter().all(held));
        let (mut faster, mut farther) = (false, false);
        let (mut way, mut turned): (f64, f64) = (0.0, 0.0);
        for apart in [1, 2, 4, 8, 16, BEAMS - 1] {
            // What the rule takes two beams to lie apart at most.
            let share = (2.0 * apart as f64 / (BEAMS - 1) as f64).min(1.0);
            for (a, b) in beams.iter().zip(&beams[apart..]) {
                let (moved, turn) = ((a[0] - b[0]).hypot(a[1] - b[1]), (a[2] - b[2]).abs());
                (way, turned) = (way.max(moved / share), turned.max(turn / share));
                let fits = moved <= share * scan.sweep_translation + 1e-9 && turn <= share * scan.sweep_rotation + 1e-9;
                faster |= !fits && share < 1.0;
                farther |= !fits && share == 1.0;
            }
        }
        self.faster += usize::from(faster);
        self.farther += usize::from(farther);
        self.weigh(world, scan, &beams, (way, turned));
    }

    /// How wide is it, over what it has to be in the middle between two poses?
    fn weigh(&mut self, world: &World, scan: &LogScan, beams: &[[f64; 3]], (way, turned): (f64, f64)) {
        let options = world.options();
        let bounds: [(f64, f64); 3] = scan.pose.bounds(&options.pose_error).into();
        let PoseError { position: a, heading: turn } = options.max_acceleration;
        let (arm, part) = (world.arm(), 0.125 * world.gap.powi(2));
        let [ex, ey, et] = world.error;
        let both = if world.told { [ex, ey].map(|e| e + arm * et) } else { [options.pose_error.position; 2] };
        let far = beams.iter().map(|at| at[0].hypot(at[1])).fold(0.0, f64::max);
        // The place of odom in the map may move as well, and what is far from it swings with it.
        let odom = if world.has_chain() { (a + turn * far) * part } else { 0.0 };
        let swung = a * part + arm * turn * part + odom;
        let turned_by = if world.has_chain() { 2.0 * turn * part } else { turn * part };
        let needed = [both[0] + swung, both[1] + swung, et + turned_by];
        for axis in 0..3 {
            let true_width = beams.iter().map(|at| at[axis]).fold(f64::NEG_INFINITY, f64::max)
                - beams.iter().map(|at| at[axis]).fold(f64::INFINITY, f64::min);
            let (lo, hi) = bounds[axis];
            self.widths.push((hi - lo) / (true_width + 2.0 * needed[axis]));
        }
        if world.sweep > 0.0 {
            self.motions.push(scan.sweep_translation / (way + 2.0 * needed[0].hypot(needed[1])));
            self.motions.push(scan.sweep_rotation / (turned + 2.0 * needed[2]));
        }
    }
}

fn quantile(values: &mut [f64], share: f64) -> f64 {
    values.sort_by(f64::total_cmp);
    values[((values.len() - 1) as f64 * share) as usize]
}

fn read(path: &Path, options: &BagOptions) -> Vec<LogScan> {
    LogReader::open_with(path, ScanLimits::default(), options).unwrap().map(Result::unwrap).collect()
}

#[test]
fn whatever_a_robot_does_within_its_bounds_the_declared_box_and_motion_hold_the_truth() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("world.mcap");
    let mut random = ChaCha8Rng::seed_from_u64(7);
    let mut tally = Tally::default();
    for number in 0..210 {
        let world = World::draw(&mut random, number);
        std::fs::write(&path, world.bag(&mut random).mcap(Packed::No)).unwrap();
        for scan in read(&path, &world.options()) {
            tally.add(&world, &scan);
        }
    }
    let Tally { scans, outside, faster, farther, widths, motions } = &mut tally;
    let widths = [0.5, 0.99, 1.0].map(|share| quantile(widths, share));
    let motions = [0.5, 0.99, 1.0].map(|share| quantile(motions, share));
    let words =
        format!("{scans} scans, {outside} outside, {faster} faster, {farther} farther, {widths:?}, {motions:?}");
    assert!(*scans >= 100_000, "{words}");
    assert_eq!((*outside, *faster, *farther), (0, 0, 0), "{words}");
    assert!(widths[0] < 1.1 && widths[1] < 3.0, "needlessly wide: {words}");
    assert!(motions[0] < 1.0 && motions[1] < 3.0, "needlessly wide: {words}");
}

/// The scans of a bag of poses of `base_link`, at the times, with the laser at a place on it.
fn placed(
    poses: &[(f64, Place, [f64; 36])],
    mount: Place,
    times: &[f64],
    options: &BagOptions,
) -> (Vec<LogScan>, String) {
    let folder = tempfile::tempdir().unwrap();
    let mut bag = Bag::default();
    bag.put("/tf_static", TF, transforms(0.0, &[("base_link", "laser", mount)]));
    for (time, place, matrix) in poses {
        bag.put("/odom", ODOMETRY, pose(*time, "odom", Some("base_link"), place, matrix));
    }
    for stamp in times {
        let scan = Scan {
            stamp: *stamp,
            frame: "laser",
            angle_min: 0.0,
            angle_increment: 0.01,
            time_increment: 0.001,
            range_max: 30.0,
            ranges: vec![1.0; 101],
        };
        bag.put("/scan", SCAN, scan.message(true));
    }
    let path = folder.path().join("some.mcap");
    std::fs::write(&path, bag.mcap(Packed::No)).unwrap();
    let mut reader = LogReader::open_with(&path, ScanLimits::default(), options).unwrap();
    let scans = reader.by_ref().map(Result::unwrap).collect();
    (scans, reader.left_out().1.unwrap_or_default())
}

#[test]
fn a_covariance_took_away_what_a_robot_can_move_by_between_two_poses() {
    let matrix = covariance(1e-8, 1e-8, 1e-8);
    let poses: Vec<_> = (0..4).map(|count| (0.5 * f64::from(count), flat(0.0, 0.0, 0.0), matrix)).collect();
    let (scans, _) = placed(&poses, flat(0.0, 0.0, 0.0), &[0.5], &BagOptions::default());
    // x = 1.5 t (0.5 - t), theta = 3 t (0.5 - t): back at each pose, 3 m/s2 and 6 rad/s2 all the way.
    let (way, turn) = (1.5 * 0.1 * 0.4, 3.0 * 0.1 * 0.4);
    let scan = &scans[0];
    assert!((way..2.0 * way).contains(&scan.sweep_translation), "{}", scan.sweep_translation);
    assert!((turn..2.0 * turn).contains(&scan.sweep_rotation), "{}", scan.sweep_rotation);
}

#[test]
fn the_height_of_a_laser_was_dropped_where_the_robot_pitches() {
    let pitch = 0.9_f64.to_radians();
    let nose_down = place([2.0, 1.0, 0.0], turn(0.0, pitch, 0.0));
    let poses = [0.0, 0.5].map(|time| (time, nose_down, covariance(1e-7, 1e-7, 1e-7)));
    let options = BagOptions { sweep: false, ..BagOptions::default() };
    let (scans, _) = placed(&poses, place([0.0, 0.0, 0.8], turn(0.0, 0.0, 0.0)), &[0.0], &options);
    let LogPose::Box { x, y, .. } = scans[0].pose else { panic!("no box") };
    let truth = 2.0 + 0.8 * pitch.sin();
    assert!(x.0 <= truth && truth <= x.1 && x.1 - x.0 < 0.003 && y.0 <= 1.0 && 1.0 <= y.1, "{x:?} {truth}");
    // Robot and laser together may be tilted by a degree, not each.
    let (none, why) = placed(&poses, place([0.0, 0.0, 0.8], turn(0.0, pitch, 0.0)), &[0.0], &options);
    assert!(none.is_empty() && why.contains("tilted by more than 1 deg"), "{why}");
}

#[test]
fn half_a_turn_between_two_poses_was_taken_for_the_one_way_round() {
    let matrix = covariance(1e-6, 1e-6, 1e-4);
    let poses = [(0.0, flat(0.0, 0.0, 0.0), matrix), (0.4, flat(0.0, 0.0, PI - 0.05), matrix)];
    let (none, why) = placed(&poses, flat(0.0, 0.0, 0.0), &[0.1], &BagOptions::default());
    assert!(none.is_empty() && why.contains("1 between poses that may be half a turn apart"), "{why}");
}

#[test]
fn a_variance_of_0_beside_others_was_taken_for_an_exact_heading() {
    let poses = [0.0, 0.5].map(|time| (time, flat(0.0, 0.0, 0.3), covariance(1e-4, 1e-4, 0.0)));
    let pose_error = PoseError { position: 5.0, heading: 0.02 };
    let options = BagOptions { sweep: false, pose_error, ..BagOptions::default() };
    let (scans, _) = placed(&poses, flat(0.0, 0.0, 0.0), &[0.0], &options);
    let LogPose::Box { x, theta, .. } = scans[0].pose else { panic!("no box") };
    assert!(x.1 - x.0 < 0.07 && theta.0 <= 0.28 && theta.1 >= 0.32 && theta.1 - theta.0 < 0.05, "{x:?} {theta:?}");
}

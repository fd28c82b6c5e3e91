//! Scans of the simulated building with the true poses, and the obstacle points that they saw.

use super::maps::with_pose;
use crate::sensor::{Reading, Scan, ScanLimits, SensorModel};
use crate::simulation::{Cone, Fleet, Point, Pose};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::f64::consts::PI;

/// Robots of the fleet.
const ROBOTS: usize = 4;

/// How far into the obstacle a seen point is put, metres: so that it is one, whatever was rounded.
const INSIDE: f64 = 1e-6;

/// Points are taken from every so many scans.
const POINTS_FROM: usize = 4;

/// Scans of a robot in a row whose pose is lost together.
pub const BURST: usize = 8;

/// By how many half widths of its box a lost pose is off, at least and at most.
pub const LOST: (f64, f64) = (5.0, 20.0);

/// Scans of the building whose poses are known.
#[derive(Debug, Clone)]
pub struct Simulated {
    scans: Vec<(Scan, Pose)>,
    /// Points of obstacles that were seen, metres.
    pub points: Vec<(f64, f64)>,
    seed: u64,
}

impl Simulated {
    /// Scans of a fleet that goes through the rooms.
    ///
    /// # Errors
    /// When the simulated scans are refused.
    pub fn new(seed: u64, count: usize) -> anyhow::Result<Self> {
        let mut fleet = Fleet::new(seed, ROBOTS);
        let sensor = SensorModel::new(Fleet::sensor())?;
        let mut scans = Vec::with_capacity(count);
        for _ in 0..count.div_ceil(ROBOTS) {
            for taken in fleet.step() {
                scans.push((Scan::new(taken.scan, sensor, &ScanLimits::default())?, taken.truth));
            }
        }
        let seen = scans.iter().step_by(POINTS_FROM).flat_map(|(scan, truth)| seen_points(&fleet, scan, truth));
        let points = seen.collect();
        Ok(Self { scans, points, seed })
    }

    /// The scans with pose boxes of half widths `position`, `heading`, the claimed pose anywhere within these of the truth; and
    /// how many of them break that: about the share `broken`, in bursts of [`BURST`] scans of a robot, whose claimed pose is off
    /// by [`LOST`] times its box in one direction, as when a localisation fails. Each `draw` is another one.
    ///
    /// # Errors
    /// When a box is refused.
    pub fn claimed(
        &self,
        (position, heading): (f64, f64),
        broken: f64,
        draw: u64,
    ) -> anyhow::Result<(Vec<Scan>, usize)> {
        let mut random = ChaCha8Rng::seed_from_u64(self.seed.wrapping_mul(1000).wrapping_add(draw));
        let mut claims = Vec::with_capacity(self.scans.len());
        let mut bursts = [(0, [0.0; 3]); ROBOTS];
        let mut count = 0;
        // Of a scan outside of a burst, so that the share within comes out.
        let chance = broken / (BURST as f64 * (1.0 - broken)).max(1e-9);
        for (index, (scan, truth)) in self.scans.iter().enumerate() {
            let mut within = |bound: f64| bound * random.random_range(-0.999..0.999);
            let within = [within(position), within(position), within(heading)];
            // Drawn for every scan, so that scans that keep their bounds claim the same whatever the share.
            let begins = random.random::<f64>() < chance;
            let (turn, far) = (random.random_range(-PI..PI), random.random_range(LOST.0..LOST.1));
            let (left, off) = &mut bursts[index % ROBOTS];
            if *left == 0 && begins {
                (*left, *off) =
                    (BURST, [far * position * turn.cos(), far * position * turn.sin(), far * heading * turn.signum()]);
            }
            let [dx, dy, turned] = if *left > 0 { *off } else { within };
            count += usize::from(*left > 0);
            *left = left.saturating_sub(1);
            claims.push(with_pose(scan, (truth.x + dx, truth.y + dy, truth.theta + turned), position, heading)?);
        }
        Ok((claims, count))
    }
}

/// Where the axes of the beams with a return meet an obstacle.
fn seen_points(fleet: &Fleet, scan: &Scan, truth: &Pose) -> Vec<(f64, f64)> {
    let world = &fleet.building().world;
    let (origin, heading) = truth.sensor(scan.sensor().spec());
    let returned = (0..scan.beams()).filter(|beam| matches!(scan.reading(*beam), Reading::Return { .. }));
    returned
        .filter_map(|beam| {
            let ray = Cone::ray(origin, heading + scan.angle(beam));
            let point: Point = origin + ray.axis() * (world.nearest_in(&ray)? + INSIDE);
            (world.distance(point) == 0.0).then_some((point.x, point.y))
        })
        .collect()
}

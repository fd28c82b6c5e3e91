//! A pose over time: samples, and what lies between two of them.
//!
//! Between two samples at `t0` and `t1` the pose is taken on the line between them (the heading likewise, the short way
//! round). If the true motion's acceleration is at most `a`, it leaves the line between its own poses at `t0` and `t1` by at
//! most `a (t - t0) (t1 - t) / 2`, and that line leaves the line between the samples by no more than the worse of the two
//! samples is off. So where the samples' errors are bounded, and the acceleration is, the pose between is.
//!
//! Rotations are a sphere (of unit quaternions), not a plane. Along the turn between two samples the bound is the same; across
//! it, as of a robot that pitches while it turns, lines on a sphere come together: with `x` a quarter of the turn between the
//! samples the bound is `(sec x - 1) / (x^2 / 2)` times as large, which is below `1 / cos^2 x`.

use super::messages::Stamp;
use nalgebra::{Isometry3, Translation3, Vector3};

/// How poses between samples are found.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Between {
    /// Largest time between two samples, nanoseconds.
    pub(super) max_gap: i64,
    /// Largest acceleration, metres a second squared.
    pub(super) acceleration: f64,
    /// Largest angular acceleration, radians a second squared.
    pub(super) turn: f64,
    /// How far the heading of a sample may be off where the sample does not say so, radians.
    pub(super) heading_error: f64,
}

/// A pose with how far it may be from the one that samples without errors would give.
#[derive(Debug, Clone, Copy)]
pub(super) struct Near {
    pub(super) pose: Isometry3<f64>,
    /// Metres.
    pub(super) position: f64,
    /// Radians.
    pub(super) heading: f64,
}

impl Near {
    /// Exactly here.
    pub(super) fn exact(pose: Isometry3<f64>) -> Self {
        Self { pose, position: 0.0, heading: 0.0 }
    }

    /// `self`, then `next` in the frame that it leads to.
    pub(super) fn then(&self, next: &Self) -> Self {
        // The next one's origin swings with this one's heading.
        let lever = next.pose.translation.vector.norm() + next.position;
        Self {
            pose: self.pose * next.pose,
            position: self.position + next.position + self.heading * lever,
            heading: self.heading + next.heading,
        }
    }

    /// The way back.
    pub(super) fn inverse(&self) -> Self {
        let lever = self.pose.translation.vector.norm();
        Self { pose: self.pose.inverse(), position: self.position + self.heading * lever, heading: self.heading }
    }
}

/// Why there is no pose at a time.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Missing {
    Before,
    After,
    Gap,
    /// The samples about the time are half a turn apart: which way round is not known.
    Turn,
}

/// A pose between two samples.
#[derive(Debug, Clone, Copy)]
pub(super) struct Found {
    pub(super) near: Near,
    /// What the sample before knows of its errors, and the one after.
    pub(super) before: Variances,
    pub(super) after: Variances,
    /// The turn from the one to the other, radians.
    pub(super) turn: f64,
    /// How far the vertical moves, seen from the robot, from the one to the other: a length between unit vectors.
    pub(super) lean: f64,
}

/// What a sample holds beside its pose.
pub(super) type Variances = Option<[f64; 3]>;

/// A sample.
#[derive(Debug, Clone, Copy)]
pub(super) struct Sample {
    pub(super) stamp: Stamp,
    pub(super) pose: Isometry3<f64>,
    pub(super) variances: Variances,
}

/// Samples in the order of their times.
#[derive(Debug, Clone, Default)]
pub(super) struct Track {
    samples: Vec<Sample>,
}

impl Track {
    pub(super) fn push(&mut self, sample: Sample) {
        self.samples.push(sample);
    }

    /// Orders the samples; of several at one time the last counts.
    pub(super) fn settle(&mut self) {
        self.samples.reverse();
        self.samples.sort_by_key(|sample| sample.stamp);
        self.samples.dedup_by_key(|sample| sample.stamp);
        self.samples.shrink_to_fit();
    }

    pub(super) fn is_empty(&self) -> bool {
        self.samples.is_empty()
    }

    /// The time of the last sample before a time.
    pub(super) fn earlier(&self, stamp: Stamp) -> Option<Stamp> {
        let next = self.samples.partition_point(|sample| sample.stamp < stamp);
        next.checked_sub(1).and_then(|index| self.samples.get(index)).map(|sample| sample.stamp)
    }

    /// The time of the first sample after a time.
    pub(super) fn later(&self, stamp: Stamp) -> Option<Stamp> {
        self.samples.get(self.samples.partition_point(|sample| sample.stamp <= stamp)).map(|sample| sample.stamp)
    }

    /// The pose at a time.
    ///
    /// # Errors
    /// What keeps it from being known.
    pub(super) fn at(&self, stamp: Stamp, between: &Between) -> Result<Found, Missing> {
        let next = self.samples.partition_point(|sample| sample.stamp < stamp);
        let Some(after) = self.samples.get(next) else { return Err(Missing::After) };
        if after.stamp == stamp {
            let near = Near::exact(after.pose);
            return Ok(Found { near, before: after.variances, after: after.variances, turn: 0.0, lean: 0.0 });
        }
        let Some(before) = next.checked_sub(1).and_then(|index| self.samples.get(index)) else {
            return Err(Missing::Before);
        };
        if after.stamp - before.stamp > between.max_gap {
            return Err(Missing::Gap);
        }
        let seconds = |nanoseconds: i64| nanoseconds as f64 * 1e-9;
        let (since, left) = (seconds(stamp - before.stamp), seconds(after.stamp - stamp));
        let share = since / (since + left);
        let (a, b) = (before.pose, after.pose);
        let turn = a.rotation.angle_to(&b.rotation);
        if !is_short_way(turn, between.heading_error) {
            return Err(Missing::Turn);
        }
        let translation = a.translation.vector.lerp(&b.translation.vector, share);
        // There is no such line where the two are the same but for rounding: then either will do.
        let rotation = a.rotation.try_slerp(&b.rotation, share, 1e-9).unwrap_or(a.rotation);
        let pose = Isometry3::from_parts(Translation3::from(translation), rotation);
        // A little more than the bound, for the rounding of all this.
        let curve = 0.5 * since * left * (1.0 + 1e-9);
        let sphere = (0.25 * turn).cos().powi(-2);
        let near = Near { pose, position: between.acceleration * curve, heading: between.turn * curve * sphere };
        let up = Vector3::z();
        let lean = (a.rotation.inverse() * up - b.rotation.inverse() * up).norm();
        Ok(Found { near, before: before.variances, after: after.variances, turn, lean })
    }
}

/// Is the short way round the true one, for samples that are this far apart and may each be off by `error`, radians? The robot
/// is taken to turn by less than half a turn from one pose to the next.
pub(super) fn is_short_way(turn: f64, error: f64) -> bool {
    turn + 2.0 * error < std::f64::consts::PI - 1e-6
}

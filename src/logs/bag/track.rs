//! A pose over time: samples, and what lies between two of them.
//!
//! Between two samples at `t0` and `t1` the pose is taken on the line between them (the heading likewise). If the true
//! motion's acceleration is at most `a`, it leaves the line between its own poses at `t0` and `t1` by at most
//! `a (t - t0) (t1 - t) / 2`, and that line leaves the line between the samples by no more than the worse of the two samples is
//! off. So where the samples' errors are bounded, and the acceleration is, the pose between is.

use super::messages::Stamp;
use nalgebra::{Isometry3, Translation3};

/// How poses between samples are found.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Between {
    /// Largest time between two samples, nanoseconds.
    pub(super) max_gap: i64,
    /// Largest acceleration, metres a second squared.
    pub(super) acceleration: f64,
    /// Largest angular acceleration, radians a second squared.
    pub(super) turn: f64,
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

    /// The pose at a time, and the variances of the samples about it.
    pub(super) fn at(&self, stamp: Stamp, between: &Between) -> Result<(Near, Variances, Variances), Missing> {
        let next = self.samples.partition_point(|sample| sample.stamp < stamp);
        let Some(after) = self.samples.get(next) else { return Err(Missing::After) };
        if after.stamp == stamp {
            return Ok((Near::exact(after.pose), after.variances, after.variances));
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
        let translation = a.translation.vector.lerp(&b.translation.vector, share);
        // Half a turn between two samples has no one way: the first one's heading then, and the bound is for the user to see.
        let rotation = a.rotation.try_slerp(&b.rotation, share, 1e-9).unwrap_or(a.rotation);
        let pose = Isometry3::from_parts(Translation3::from(translation), rotation);
        // A little more than the bound, for the rounding of all this.
        let curve = 0.5 * since * left * (1.0 + 1e-9);
        let near = Near { pose, position: between.acceleration * curve, heading: between.turn * curve };
        Ok((near, before.variances, after.variances))
    }
}

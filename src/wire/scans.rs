//! Scans of a request: each is converted by itself, so that a bad one does not keep the good ones out.

use super::v1;
use crate::sensor::Angles;
use crate::service::{InsertAnswer, RawPose, Rejection, ScanInput};

/// The scans of one request: those that could be converted, and the refusals of the others.
#[derive(Debug, Default)]
pub struct Batch {
    scans: Vec<ScanInput>,
    /// Where each of `scans` stands in the request.
    indices: Vec<usize>,
    rejected: Vec<Rejection>,
}

impl Batch {
    /// Converts the scans of a request.
    #[must_use]
    pub fn new(scans: Vec<v1::Scan>) -> Self {
        let mut batch = Self::default();
        for (index, scan) in scans.into_iter().enumerate() {
            batch.push(index, scan);
        }
        batch
    }

    /// Converts the scans of one robot: those that name no robot are its own, those that name another are refused.
    #[must_use]
    pub fn of_robot(scans: Vec<v1::Scan>, robot: &str) -> Self {
        let mut batch = Self::default();
        for (index, mut scan) in scans.into_iter().enumerate() {
            let named = std::mem::replace(&mut scan.robot, robot.to_owned());
            if named.is_empty() || named == robot {
                batch.push(index, scan);
            } else {
                let named: String = named.chars().take(80).collect();
                let detail = format!("robot: the key says {robot:?}, the scan {named:?}");
                batch.rejected.push(Rejection { index, code: "INVALID_ROBOT", detail });
            }
        }
        batch
    }

    fn push(&mut self, index: usize, scan: v1::Scan) {
        match scan_input(scan) {
            Ok(input) => {
                self.scans.push(input);
                self.indices.push(index);
            }
            Err((code, detail)) => self.rejected.push(Rejection { index, code, detail }),
        }
    }

    /// The scans to insert; what is left is to be [finished](Batch::response) with the answer.
    #[must_use]
    pub fn take_scans(&mut self) -> Vec<ScanInput> {
        std::mem::take(&mut self.scans)
    }

    /// The response: the service's answer with the request's own indices, and the refusals from here.
    #[must_use]
    pub fn response(self, answer: InsertAnswer) -> v1::InsertScansResponse {
        let Self { indices, mut rejected, .. } = self;
        rejected.extend(answer.rejected.into_iter().map(|rejection| Rejection {
            index: indices.get(rejection.index).copied().unwrap_or(rejection.index),
            ..rejection
        }));
        rejected.sort_by_key(|rejection| rejection.index);
        v1::InsertScansResponse {
            revision: answer.revision,
            applied: saturated(answer.applied),
            duplicates: saturated(answer.duplicates),
            rejected: rejected
                .into_iter()
                .map(|rejection| v1::RejectedScan {
                    index: u32::try_from(rejection.index).unwrap_or(u32::MAX),
                    code: rejection.code.to_owned(),
                    detail: rejection.detail,
                })
                .collect(),
        }
    }
}

type Refusal = (&'static str, String);

/// A scan as the service takes it. Numbers are checked there; here only what cannot be expressed there is refused.
fn scan_input(wire: v1::Scan) -> Result<ScanInput, Refusal> {
    let pose = pose(wire.pose)?;
    let angles = angles(wire.angle_min, wire.angle_increment, wire.angles, wire.ranges.len())?;
    Ok(ScanInput {
        robot: wire.robot,
        sequence: wire.sequence,
        stamp: wire.stamp,
        sensor: wire.sensor,
        pose: Some(pose),
        angles,
        ranges: wire.ranges,
        footprint_radius: wire.footprint_radius,
        sweep_rotation: wire.sweep_rotation,
        sweep_translation: wire.sweep_translation,
    })
}

fn pose(wire: Option<v1::PoseBox>) -> Result<RawPose, Refusal> {
    let missing =
        |field: &str| ("POSE_MISSING", format!("{field} is missing: a pose box has bounds of x, y and theta"));
    let wire = wire.ok_or_else(|| missing("pose"))?;
    let interval = |name: &str, interval: Option<v1::Interval>| {
        let interval = interval.ok_or_else(|| missing(&format!("pose.{name}")))?;
        let min = interval.min.ok_or_else(|| missing(&format!("pose.{name}.min")))?;
        let max = interval.max.ok_or_else(|| missing(&format!("pose.{name}.max")))?;
        Ok::<_, Refusal>((min, max))
    };
    Ok(RawPose { x: interval("x", wire.x)?, y: interval("y", wire.y)?, theta: interval("theta", wire.theta)? })
}

fn angles(min: Option<f64>, increment: Option<f64>, listed: Vec<f64>, beams: usize) -> Result<Angles, Refusal> {
    if !listed.is_empty() {
        if min.is_some() || increment.is_some() {
            let detail = "angles stands beside angle_min or angle_increment: give one or the other";
            return Err(("ANGLES_AMBIGUOUS", detail.to_owned()));
        }
        return Ok(Angles::Listed(listed));
    }
    let missing =
        |field: &str| ("ANGLES_MISSING", format!("{field} is missing: give angle_min and angle_increment, or angles"));
    // One beam needs no step, and a scan without beams is refused for that.
    let increment = if beams <= 1 { increment.or(Some(0.0)) } else { increment };
    let min = if beams == 0 { min.or(Some(0.0)) } else { min };
    Ok(Angles::Uniform {
        min: min.ok_or_else(|| missing("angle_min"))?,
        increment: increment.ok_or_else(|| missing("angle_increment"))?,
    })
}

fn saturated(count: u64) -> u32 {
    u32::try_from(count).unwrap_or(u32::MAX)
}

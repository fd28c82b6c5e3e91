//! Where robots are.

use super::v1;
use crate::interval::Interval;
use crate::service::{RobotPose, RobotsAnswer};

/// The robots of a map.
#[must_use]
pub fn list_robots_response(answer: RobotsAnswer) -> v1::ListRobotsResponse {
    let robots = answer.robots.into_iter().map(robot_pose).collect();
    v1::ListRobotsResponse { revision: answer.revision, robots }
}

/// One robot.
pub(super) fn robot_pose(robot: RobotPose) -> v1::RobotPose {
    let bounds = |interval: Interval| Some(v1::Interval { min: Some(interval.lo()), max: Some(interval.hi()) });
    let pose = v1::PoseBox { x: bounds(robot.pose.x()), y: bounds(robot.pose.y()), theta: bounds(robot.pose.theta()) };
    v1::RobotPose {
        robot: robot.robot.to_string(),
        // What is no number has no form in JSON that is one.
        stamp: if robot.stamp.is_finite() { robot.stamp } else { 0.0 },
        sequence: robot.sequence,
        sensor: robot.sensor,
        pose: Some(pose),
        revision: robot.revision,
        received: robot.received,
    }
}

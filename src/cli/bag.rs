//! Flags that tell what is read of a ROS 2 bag, shared by the commands that read logs.

use crate::logs::{BagOptions, PoseError};
use clap::Args;
use serde_json::{Value, json};

/// What is read of a bag; `docs/logs.md` has the whole.
#[derive(Debug, Clone, Args)]
#[command(next_help_heading = "ROS 2 bags")]
pub(super) struct BagFlags {
    /// Topic of the scans (sensor_msgs/msg/LaserScan) [default: the one there is]
    #[arg(long, value_name = "TOPIC")]
    scan_topic: Option<String>,
    /// Topic of the poses: PoseWithCovarianceStamped, Odometry, PoseStamped or /tf [default: /tf, else the one there is]
    #[arg(long, value_name = "TOPIC")]
    pose_topic: Option<String>,
    /// Frame that the map is made in [default: map, else odom]
    #[arg(long, value_name = "FRAME")]
    fixed_frame: Option<String>,
    /// Frame whose poses a topic has [default: the one it names, base_link or base_footprint]
    #[arg(long, value_name = "FRAME")]
    base_frame: Option<String>,
    /// Standard deviations of a covariance that are taken for a bound [default: 3]
    #[arg(long, value_name = "N", value_parser = sigma)]
    sigma: Option<f64>,
    /// Longest time between two poses where one between them is taken, seconds [default: 0.5]
    #[arg(long, value_name = "S", value_parser = gap)]
    max_gap: Option<f64>,
    /// Bounds of the robot's acceleration between two poses, m/s2 and an angle/s2 [default: 3,6rad]
    #[arg(long, value_name = "A,ANGLE")]
    max_acceleration: Option<PoseError>,
    /// Take every scan for one of a moment, although its beams have times of their own
    #[arg(long)]
    no_sweep: bool,
}

impl BagFlags {
    /// How bags are read, but for the error of their poses.
    pub(super) fn options(&self) -> BagOptions {
        let usual = BagOptions::default();
        BagOptions {
            scan_topic: self.scan_topic.clone(),
            pose_topic: self.pose_topic.clone(),
            fixed_frame: self.fixed_frame.clone(),
            base_frame: self.base_frame.clone(),
            sigma: self.sigma.unwrap_or(usual.sigma),
            max_gap: self.max_gap.unwrap_or(usual.max_gap),
            max_acceleration: self.max_acceleration.unwrap_or(usual.max_acceleration),
            sweep: !self.no_sweep,
            ..usual
        }
    }

    /// The first flag that was given.
    pub(super) fn given(&self) -> Option<&'static str> {
        let flags = [
            ("scan-topic", self.scan_topic.is_some()),
            ("pose-topic", self.pose_topic.is_some()),
            ("fixed-frame", self.fixed_frame.is_some()),
            ("base-frame", self.base_frame.is_some()),
            ("sigma", self.sigma.is_some()),
            ("max-gap", self.max_gap.is_some()),
            ("max-acceleration", self.max_acceleration.is_some()),
            ("no-sweep", self.no_sweep),
        ];
        flags.into_iter().find(|(_, given)| *given).map(|(flag, _)| flag)
    }

    /// The settings, for the output of programs.
    pub(super) fn json(&self) -> Value {
        let options = self.options();
        json!({
            "scan_topic": options.scan_topic,
            "pose_topic": options.pose_topic,
            "fixed_frame": options.fixed_frame,
            "base_frame": options.base_frame,
            "sigma": options.sigma,
            "max_gap": options.max_gap,
            "max_acceleration": {"position": options.max_acceleration.position, "heading": options.max_acceleration.heading},
            "sweep": options.sweep,
        })
    }
}

fn sigma(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(value) if value > 0.0 && value <= 100.0 => Ok(value),
        _ => Err("must be a number above 0 and at most 100".to_owned()),
    }
}

fn gap(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(value) if value > 0.0 && value <= 3600.0 => Ok(value),
        _ => Err("must be a number of seconds above 0 and at most 3600".to_owned()),
    }
}

//! CARMEN logs: one message a line, of which `FLASER` and `ROBOTLASER1` are scans.

use super::{LogPose, LogScan, LogSensor};
use crate::sensor::Angles;
use std::f64::consts::{FRAC_PI_2, PI};
use std::str::SplitAsciiWhitespace;

/// What `FLASER` scans have for a largest range, metres: the message does not tell.
///
/// Scanners of these logs report a missing return as their largest range: 81.83 or 81.91 m (SICK LMS) or 50 m (SICK
/// PLS). The smallest of them is right for all: a beam without a return is never taken for one with, and readings from
/// there to the scanner's own largest range, which say nothing then, do not occur in practice.
pub const FLASER_RANGE_MAX: f64 = 50.0;

/// Fields of `FLASER` besides its ranges: name, count, laser pose, odometry pose, time, host, logger time.
const FLASER_FIELDS: usize = 11;

/// Fields of `ROBOTLASER1` after its remissions: laser pose, robot pose, two velocities, two safety distances, turn
/// axis, time, host, logger time.
const ROBOTLASER_TAIL: usize = 14;

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Message {
    Flaser,
    RobotLaser,
}

/// Reads the lines of a CARMEN log. Where both messages occur, they tell of the same scans: the one that comes first
/// is read, the other skipped.
#[derive(Debug, Default)]
pub(super) struct Parser {
    message: Option<Message>,
}

impl Parser {
    /// The scan of a line, `None` for lines of other messages.
    pub(super) fn line(
        &mut self,
        text: &str,
        max_beams: usize,
        sensor: &mut LogSensor,
    ) -> Result<Option<LogScan>, String> {
        if text.starts_with('#') {
            return Ok(None);
        }
        let mut fields = Fields::new(text);
        let message = match fields.word("the message's name")? {
            "FLASER" => Message::Flaser,
            "ROBOTLASER1" => Message::RobotLaser,
            name if is_message_name(name) => return Ok(None),
            name => {
                let shown: String = name.chars().take(20).collect();
                return Err(format!("{shown:?} is no CARMEN message, and the line is no JSON object"));
            }
        };
        if *self.message.get_or_insert(message) != message {
            return Ok(None);
        }
        match message {
            Message::Flaser => flaser(&mut fields, max_beams, sensor),
            Message::RobotLaser => robot_laser(&mut fields, max_beams, sensor),
        }
        .map(Some)
    }
}

/// `FLASER n r1..rn x y theta odom_x odom_y odom_theta ipc_time host log_time`
fn flaser(fields: &mut Fields<'_>, max_beams: usize, sensor: &mut LogSensor) -> Result<LogScan, String> {
    let count = fields.count("the number of ranges", max_beams)?;
    if count == 0 {
        return Err("FLASER has no ranges".to_owned());
    }
    fields.expect_in_all("FLASER", count, FLASER_FIELDS + count)?;
    let ranges = fields.ranges(count)?;
    let pose = fields.pose("the laser's pose")?;
    for name in ["odom_x", "odom_y", "odom_theta"] {
        fields.number(name)?;
    }
    let stamp = fields.number("ipc_time")?;
    fields.word("host")?;
    fields.number("log_time")?;
    sensor.range_max.get_or_insert(FLASER_RANGE_MAX);
    Ok(scan(stamp, pose, half_circle(count), ranges))
}

/// The convention of `FLASER`, which tells no angles: beams over a half circle from -90 degrees. With an odd number
/// (181, 361) both ends are measured and the step is `pi / (n - 1)`; with an even one (180, 360) it is `pi / n`.
fn half_circle(count: usize) -> Angles {
    let steps = if count % 2 == 1 { (count - 1).max(1) } else { count };
    Angles::Uniform { min: -FRAC_PI_2, increment: PI / steps as f64 }
}

/// `ROBOTLASER1 laser_type start_angle field_of_view angular_resolution maximum_range accuracy remission_mode
/// n r1..rn m remission1..m laser_x laser_y laser_theta robot_x robot_y robot_theta laser_tv laser_rv
/// forward_safety_dist side_safety_dist turn_axis ipc_time host log_time`
fn robot_laser(fields: &mut Fields<'_>, max_beams: usize, sensor: &mut LogSensor) -> Result<LogScan, String> {
    fields.number("laser_type")?;
    let start = fields.number("start_angle")?;
    fields.number("field_of_view")?;
    let step = fields.number("angular_resolution")?;
    let range_max = fields.number("maximum_range")?;
    fields.number("accuracy")?;
    fields.number("remission_mode")?;
    let count = fields.count("the number of ranges", max_beams)?;
    if count == 0 {
        return Err("ROBOTLASER1 has no ranges".to_owned());
    }
    let mut ranges = fields.ranges(count)?;
    let remissions = fields.count("the number of remissions", max_beams)?;
    fields.expect_in_all("ROBOTLASER1", count, 10 + count + remissions + ROBOTLASER_TAIL)?;
    for _ in 0..remissions {
        fields.number("a remission")?;
    }
    let pose = fields.pose("the laser's pose")?;
    for name in [
        "robot_x",
        "robot_y",
        "robot_theta",
        "laser_tv",
        "laser_rv",
        "forward_safety_dist",
        "side_safety_dist",
        "turn_axis",
    ] {
        fields.number(name)?;
    }
    let stamp = fields.number("ipc_time")?;
    fields.word("host")?;
    fields.number("log_time")?;
    if range_max > 0.0 {
        sensor.range_max.get_or_insert(range_max);
        // The largest range is the message's, not the log's: what reaches it is no return whatever the first one said.
        for range in ranges.iter_mut().filter(|range| **range >= range_max as f32) {
            *range = f32::INFINITY;
        }
    }
    Ok(scan(stamp, pose, Angles::Uniform { min: start, increment: step }, ranges))
}

fn scan(stamp: f64, pose: LogPose, angles: Angles, ranges: Vec<f32>) -> LogScan {
    LogScan {
        line: 0,
        stamp,
        pose,
        angles,
        ranges,
        footprint_radius: None,
        sweep_rotation: 0.0,
        sweep_translation: 0.0,
    }
}

fn is_message_name(name: &str) -> bool {
    name.starts_with(|c: char| c.is_ascii_uppercase())
        && name.bytes().all(|b| b.is_ascii_uppercase() || b.is_ascii_digit() || b == b'_')
}

/// The fields of a line, taken one after the other, each error naming the field.
struct Fields<'a> {
    text: &'a str,
    words: SplitAsciiWhitespace<'a>,
    taken: usize,
}

impl<'a> Fields<'a> {
    fn new(text: &'a str) -> Self {
        Self { text, words: text.split_ascii_whitespace(), taken: 0 }
    }

    fn word(&mut self, name: &str) -> Result<&'a str, String> {
        let taken = self.taken;
        let word = self.words.next().ok_or_else(|| format!("ends after {taken} fields, before {name}"))?;
        self.taken += 1;
        Ok(word)
    }

    fn parsed<T: std::str::FromStr>(&mut self, name: &str, kind: &str) -> Result<T, String> {
        let word = self.word(name)?;
        word.parse().map_err(|_| {
            let shown: String = word.chars().take(20).collect();
            format!("field {}, {name}, is {shown:?}: it must be {kind}", self.taken)
        })
    }

    /// A finite number.
    fn number(&mut self, name: &str) -> Result<f64, String> {
        let value: f64 = self.parsed(name, "a number")?;
        if value.is_finite() {
            return Ok(value);
        }
        Err(format!("field {}, {name}, is {value}: it must be finite", self.taken))
    }

    fn count(&mut self, name: &str, limit: usize) -> Result<usize, String> {
        let count: usize = self.parsed(name, "a whole number")?;
        if count > limit { Err(format!("{name} is {count}, the limit is {limit}")) } else { Ok(count) }
    }

    fn ranges(&mut self, count: usize) -> Result<Vec<f32>, String> {
        let mut ranges = Vec::with_capacity(count);
        for _ in 0..count {
            ranges.push(self.parsed::<f64>("a range", "a number")? as f32);
        }
        Ok(ranges)
    }

    fn pose(&mut self, name: &str) -> Result<LogPose, String> {
        Ok(LogPose::Point { x: self.number(name)?, y: self.number(name)?, theta: self.number(name)? })
    }

    fn expect_in_all(&self, message: &str, ranges: usize, expected: usize) -> Result<(), String> {
        let found = self.text.split_ascii_whitespace().count();
        if found == expected {
            return Ok(());
        }
        Err(format!("has {found} fields, a {message} of {ranges} ranges has {expected}"))
    }
}

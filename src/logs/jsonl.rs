//! Logs as JSON lines: a header object, then one object a scan.
//!
//! The header tells what all scans share: `angle_min` and `angle_increment`, `beams` (checked against every scan),
//! `range_min`, `range_max`, `range_error` (a number or `{"minus", "plus"}`), `beam_opening`, `beam_diameter`,
//! `no_return_free_to`, `beam_angle_error`, `footprint_radius`; it may be left out when the scans tell enough. A scan has
//! `ranges` (numbers; `null` and `"NaN"` are failed beams, `"Infinity"` is no return), its time `t` or `stamp`, and
//! its pose: `x`, `y`, `theta`, or the box `"pose": {"x": {"min", "max"}, "y": .., "theta": ..}`. It may have
//! `angle_min` and `angle_increment`, or `angles`, `footprint_radius`, `sweep_rotation` and `sweep_translation` of its own.

use super::{LogPose, LogScan, LogSensor};
use crate::sensor::Angles;
use serde::Deserialize;
use serde::de::{Deserializer, Error, IgnoredAny, Unexpected, Visitor};
use std::fmt;

#[derive(Debug, Default, Deserialize)]
struct Header {
    beams: Option<usize>,
    angle_min: Option<f64>,
    angle_increment: Option<f64>,
    range_min: Option<f64>,
    range_max: Option<f64>,
    range_error: Option<RangeError>,
    beam_opening: Option<f64>,
    beam_diameter: Option<f64>,
    no_return_free_to: Option<f64>,
    beam_angle_error: Option<f64>,
    footprint_radius: Option<f64>,
    /// Only scans have it: tells a log without a header.
    ranges: Option<IgnoredAny>,
}

#[derive(Debug, Clone, Copy, Deserialize)]
#[serde(untagged)]
enum RangeError {
    Both(f64),
    Each { minus: f64, plus: f64 },
}

#[derive(Debug, Deserialize)]
struct ScanLine {
    t: Option<f64>,
    stamp: Option<f64>,
    x: Option<f64>,
    y: Option<f64>,
    theta: Option<f64>,
    pose: Option<PoseLine>,
    angle_min: Option<f64>,
    angle_increment: Option<f64>,
    angles: Option<Vec<f64>>,
    ranges: Option<Vec<Range>>,
    footprint_radius: Option<f64>,
    sweep_rotation: Option<f64>,
    sweep_translation: Option<f64>,
}

#[derive(Debug, Clone, Copy, Deserialize)]
struct PoseLine {
    x: Bounds,
    y: Bounds,
    theta: Bounds,
}

#[derive(Debug, Clone, Copy, Deserialize)]
struct Bounds {
    min: f64,
    max: f64,
}

impl Bounds {
    fn pair(self) -> (f64, f64) {
        (self.min, self.max)
    }
}

/// A range: a number, `null` or a word for what JSON has no number for.
#[derive(Debug, Clone, Copy)]
struct Range(f32);

impl<'de> Deserialize<'de> for Range {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        deserializer.deserialize_any(RangeVisitor)
    }
}

struct RangeVisitor;

impl Visitor<'_> for RangeVisitor {
    type Value = Range;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("a range: a number, null, \"NaN\" or \"Infinity\"")
    }

    fn visit_f64<E: Error>(self, value: f64) -> Result<Range, E> {
        Ok(Range(value as f32))
    }

    fn visit_u64<E: Error>(self, value: u64) -> Result<Range, E> {
        Ok(Range(value as f32))
    }

    fn visit_i64<E: Error>(self, value: i64) -> Result<Range, E> {
        Ok(Range(value as f32))
    }

    fn visit_unit<E: Error>(self) -> Result<Range, E> {
        Ok(Range(f32::NAN))
    }

    fn visit_str<E: Error>(self, value: &str) -> Result<Range, E> {
        match value {
            "NaN" => Ok(Range(f32::NAN)),
            "Infinity" => Ok(Range(f32::INFINITY)),
            "-Infinity" => Ok(Range(f32::NEG_INFINITY)),
            other => Err(E::invalid_value(Unexpected::Str(other), &self)),
        }
    }
}

/// Reads the lines of a log as JSON lines.
#[derive(Debug, Default)]
pub(super) struct Parser {
    started: bool,
    header: Header,
}

impl Parser {
    /// The scan of a line; `None` for the header.
    pub(super) fn line(
        &mut self,
        text: &str,
        max_beams: usize,
        sensor: &mut LogSensor,
    ) -> Result<Option<LogScan>, String> {
        if !std::mem::replace(&mut self.started, true) {
            let header: Header = parse(text)?;
            if header.ranges.is_none() {
                self.header = header;
                *sensor = self.sensor();
                return Ok(None);
            }
        }
        self.scan(parse(text)?, max_beams).map(Some)
    }

    fn sensor(&self) -> LogSensor {
        let header = &self.header;
        LogSensor {
            range_min: header.range_min,
            range_max: header.range_max,
            range_error: header.range_error.map(|error| match error {
                RangeError::Both(both) => (both, both),
                RangeError::Each { minus, plus } => (minus, plus),
            }),
            beam_opening: header.beam_opening,
            beam_diameter: header.beam_diameter,
            no_return_free_to: header.no_return_free_to,
            beam_angle_error: header.beam_angle_error,
        }
    }

    fn scan(&self, line: ScanLine, max_beams: usize) -> Result<LogScan, String> {
        let ranges: Vec<f32> = line.ranges.ok_or("has no ranges")?.into_iter().map(|range| range.0).collect();
        if ranges.is_empty() {
            return Err("ranges is empty".to_owned());
        }
        if ranges.len() > max_beams {
            return Err(format!("has {} ranges, the limit is {max_beams}", ranges.len()));
        }
        if let Some(beams) = self.header.beams.filter(|beams| *beams != ranges.len()) {
            return Err(format!("has {} ranges, the header says {beams}", ranges.len()));
        }
        let angles = match line.angles {
            Some(angles) if angles.len() != ranges.len() => {
                return Err(format!("has {} angles and {} ranges: they must be as many", angles.len(), ranges.len()));
            }
            Some(angles) => Angles::Listed(angles),
            None => Angles::Uniform {
                min: line.angle_min.or(self.header.angle_min).ok_or(missing("angle_min"))?,
                increment: line.angle_increment.or(self.header.angle_increment).ok_or(missing("angle_increment"))?,
            },
        };
        let pose = match (line.pose, line.x, line.y, line.theta) {
            (Some(pose), ..) => LogPose::Box { x: pose.x.pair(), y: pose.y.pair(), theta: pose.theta.pair() },
            (None, Some(x), Some(y), Some(theta)) => LogPose::Point { x, y, theta },
            _ => return Err("has no pose: x, y and theta, or a pose box".to_owned()),
        };
        Ok(LogScan {
            line: 0,
            stamp: line.t.or(line.stamp).unwrap_or(0.0),
            pose,
            angles,
            ranges,
            footprint_radius: line.footprint_radius.or(self.header.footprint_radius),
            sweep_rotation: line.sweep_rotation.unwrap_or(0.0),
            sweep_translation: line.sweep_translation.unwrap_or(0.0),
        })
    }
}

fn missing(field: &str) -> String {
    format!("has no {field}, and the header has none")
}

/// Parses one JSON object; the message names the column.
fn parse<'a, T: Deserialize<'a>>(text: &'a str) -> Result<T, String> {
    serde_json::from_str(text).map_err(|error| {
        // serde_json counts lines of its own text, which is always line 1 here.
        let message = error.to_string();
        message.replace(" at line 1 column ", " at column ")
    })
}

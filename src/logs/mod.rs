//! Floor 6: readers of recorded laser logs.
//!
//! A [`LogReader`] is an iterator over the scans of a log, read line by line, so a log may be larger than memory.
//! Two formats, told apart by their first character, each plain or gzip, told apart by the magic bytes:
//!
//! - JSON lines: a header object, then one object a scan (`{"t", "x", "y", "theta", "ranges"}` or with a `pose` box);
//! - CARMEN: `FLASER` and `ROBOTLASER1` messages; other messages are skipped.
//!
//! The first damage ends the iteration: it comes as the last item, an error that names the line.

mod carmen;
mod jsonl;
mod lines;
mod pose_error;

use crate::sensor::{Angles, ScanLimits};
use lines::Lines;
use std::io::Read;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::AtomicU64;
use thiserror::Error;

pub use carmen::FLASER_RANGE_MAX;
pub use pose_error::{PoseError, PoseErrorParseError, angle};

/// Longest line of a log, bytes: 20,000 ranges of 24 characters need half a megabyte.
pub const MAX_LINE_BYTES: usize = 4 << 20;

/// Why a log cannot be read further.
#[derive(Debug, Error)]
pub enum LogError {
    /// The file cannot be opened.
    #[error("{path}: {source}")]
    Open {
        /// The file.
        path: String,
        /// Why.
        source: std::io::Error,
    },
    /// A line is not what its format says.
    #[error("line {line}: {problem}")]
    Line {
        /// The line, from 1.
        line: u64,
        /// What is wrong with it.
        problem: String,
    },
    /// A compressed log ends early.
    #[error("unexpected end of the compressed data after line {line}")]
    Truncated {
        /// The last whole line, 0 for none.
        line: u64,
    },
    /// Reading failed, or compressed data is damaged.
    #[error("cannot be read after line {line}: {source}")]
    Read {
        /// The last whole line, 0 for none.
        line: u64,
        /// Why.
        source: std::io::Error,
    },
}

impl LogError {
    /// The line at fault, or the last whole line before the damage; 0 when there is none.
    #[must_use]
    pub fn line(&self) -> u64 {
        match self {
            Self::Open { .. } => 0,
            Self::Line { line, .. } | Self::Truncated { line } | Self::Read { line, .. } => *line,
        }
    }
}

/// The pose of a scan as the log has it; metres and radians.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum LogPose {
    /// A point `(x, y, theta)`, its error unknown to the log.
    Point {
        /// x
        x: f64,
        /// y
        y: f64,
        /// theta
        theta: f64,
    },
    /// A box that holds the pose, as `(min, max)` pairs.
    Box {
        /// x
        x: (f64, f64),
        /// y
        y: (f64, f64),
        /// theta
        theta: (f64, f64),
    },
}

/// Pose bounds `(min, max)` of x, y (metres) and theta (radians).
pub type PoseBounds = ((f64, f64), (f64, f64), (f64, f64));

impl LogPose {
    /// The bounds of the pose: the log's own box, else the point widened by `error` and rounded outward.
    #[must_use]
    pub fn bounds(&self, error: &PoseError) -> PoseBounds {
        let widen = |v: f64, e: f64| if e > 0.0 { ((v - e).next_down(), (v + e).next_up()) } else { (v, v) };
        match *self {
            Self::Point { x, y, theta } => {
                (widen(x, error.position), widen(y, error.position), widen(theta, error.heading))
            }
            Self::Box { x, y, theta } => (x, y, theta),
        }
    }
}

/// What a log says of its sensor. `None`: nothing.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct LogSensor {
    /// Readings below are failed, metres.
    pub range_min: Option<f64>,
    /// Readings at or above are no returns, metres.
    pub range_max: Option<f64>,
    /// `(e-, e+)`, metres.
    pub range_error: Option<(f64, f64)>,
    /// Full opening angle of a beam, radians.
    pub beam_opening: Option<f64>,
    /// Diameter of a beam at the emitter, metres.
    pub beam_diameter: Option<f64>,
    /// How far a beam without a return is known to be free, metres.
    pub no_return_free_to: Option<f64>,
    /// Bound of the angle error of single beams, radians.
    pub beam_angle_error: Option<f64>,
}

/// One scan of a log.
#[derive(Debug, Clone, PartialEq)]
pub struct LogScan {
    /// The line it stands on, from 1.
    pub line: u64,
    /// When it was taken, seconds, as the log says.
    pub stamp: f64,
    /// Where the laser was.
    pub pose: LogPose,
    /// Mirror angles, radians.
    pub angles: Angles,
    /// Ranges, metres, at least one; NaN is a failed beam, infinite no return.
    pub ranges: Vec<f32>,
    /// Metres, where the log has it.
    pub footprint_radius: Option<f64>,
    /// Radians; 0 where the log has none.
    pub sweep_rotation: f64,
    /// Metres; 0 where the log has none.
    pub sweep_translation: f64,
}

enum Parser {
    Json(jsonl::Parser),
    Carmen(carmen::Parser),
}

/// The scans of a log, in its order. After an error the iteration is over.
pub struct LogReader {
    lines: Lines,
    parser: Option<Parser>,
    sensor: LogSensor,
    max_beams: usize,
    /// The first scan, read ahead for what it says of the sensor.
    first: Option<Result<LogScan, LogError>>,
    ended: bool,
}

impl LogReader {
    /// Opens a log file and reads up to its first scan.
    ///
    /// # Errors
    /// [`LogError::Open`] when the file cannot be opened. Damage comes as an item of the iteration.
    pub fn open(path: &Path, limits: ScanLimits) -> Result<Self, LogError> {
        let error = |source| LogError::Open { path: path.display().to_string(), source };
        let file = std::fs::File::open(path).map_err(error)?;
        if file.metadata().map_err(error)?.is_dir() {
            return Err(error(std::io::Error::from(std::io::ErrorKind::IsADirectory)));
        }
        Ok(Self::new(file, limits))
    }

    /// Reads a log from any source of bytes, up to its first scan.
    #[must_use]
    pub fn new(source: impl Read + Send + 'static, limits: ScanLimits) -> Self {
        let mut reader = Self {
            lines: Lines::new(source, MAX_LINE_BYTES),
            parser: None,
            sensor: LogSensor::default(),
            max_beams: limits.max_beams,
            first: None,
            ended: false,
        };
        reader.first = reader.read_scan();
        reader
    }

    /// What the log says of its sensor, in its header or its first scan.
    #[must_use]
    pub fn sensor(&self) -> &LogSensor {
        &self.sensor
    }

    /// Lines read so far.
    #[must_use]
    pub fn line(&self) -> u64 {
        self.lines.number()
    }

    /// A counter of the bytes taken from the source so far, compressed ones where it is: for a progress bar.
    #[must_use]
    pub fn bytes_read(&self) -> Arc<AtomicU64> {
        self.lines.bytes_read()
    }

    fn read_scan(&mut self) -> Option<Result<LogScan, LogError>> {
        if self.ended {
            return None;
        }
        let found = self.find_scan().transpose();
        self.ended = !matches!(found, Some(Ok(_)));
        found
    }

    fn find_scan(&mut self) -> Result<Option<LogScan>, LogError> {
        while let Some((number, text)) = self.lines.next_line()? {
            let text = text.trim();
            if text.is_empty() {
                continue;
            }
            let parser = self.parser.get_or_insert_with(|| {
                if text.starts_with('{') {
                    Parser::Json(jsonl::Parser::default())
                } else {
                    Parser::Carmen(carmen::Parser::default())
                }
            });
            let parsed = match parser {
                Parser::Json(parser) => parser.line(text, self.max_beams, &mut self.sensor),
                Parser::Carmen(parser) => parser.line(text, self.max_beams, &mut self.sensor),
            };
            match parsed {
                Ok(Some(scan)) => return Ok(Some(LogScan { line: number, ..scan })),
                Ok(None) => {}
                Err(problem) => return Err(LogError::Line { line: number, problem }),
            }
        }
        Ok(None)
    }
}

impl Iterator for LogReader {
    type Item = Result<LogScan, LogError>;

    fn next(&mut self) -> Option<Self::Item> {
        match self.first.take() {
            Some(first) => Some(first),
            None => self.read_scan(),
        }
    }
}

//! Floor 6: readers of recorded laser logs.
//!
//! A [`LogReader`] is an iterator over the scans of a log, read one after the other, so a log may be larger than memory.
//! Two formats of text, told apart by their first character, each plain or gzip, told apart by the magic bytes:
//!
//! - JSON lines: a header object, then one object a scan (`{"t", "x", "y", "theta", "ranges"}` or with a `pose` box);
//! - CARMEN: `FLASER` and `ROBOTLASER1` messages; other messages are skipped;
//!
//! and ROS 2 bags (MCAP, SQLite, a folder of either), of which the poses are held in memory.
//!
//! The first damage ends the iteration: it comes as the last item, an error that names the line or the scan.

mod bag;
mod carmen;
mod jsonl;
mod lines;
mod pose_error;

use crate::sensor::{Angles, ScanLimits};
use bag::Bag;
use lines::Lines;
use std::io::Read;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::AtomicU64;
use thiserror::Error;

pub use bag::BagOptions;
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
    /// A bag cannot be read, or it is not clear what is to be read of it.
    #[error("{path}: {problem}")]
    Bag {
        /// The file or folder.
        path: String,
        /// What is wrong, what there is, and what helps.
        problem: String,
    },
    /// A scan of a bag is not what its format says.
    #[error("scan {scan}: {problem}")]
    Scan {
        /// The scan, from 1, or the last one before the damage.
        scan: u64,
        /// What is wrong with it.
        problem: String,
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
    /// The line or scan at fault, or the last whole one before the damage; 0 when there is none.
    #[must_use]
    pub fn line(&self) -> u64 {
        match self {
            Self::Open { .. } | Self::Bag { .. } => 0,
            Self::Scan { scan, .. } => *scan,
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
    /// Where the pose is if the log's poses have no error, as `(min, max)` pairs; their error is unknown to the log.
    Near {
        /// x
        x: (f64, f64),
        /// y
        y: (f64, f64),
        /// theta
        theta: (f64, f64),
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
        let both = |(min, max): (f64, f64), e: f64| (widen(min, e).0, widen(max, e).1);
        match *self {
            Self::Point { x, y, theta } => {
                (widen(x, error.position), widen(y, error.position), widen(theta, error.heading))
            }
            Self::Near { x, y, theta } => {
                (both(x, error.position), both(y, error.position), both(theta, error.heading))
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
    /// The line it stands on, from 1; its number among the scans of a bag.
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

/// A log of text.
struct Text {
    lines: Lines,
    parser: Option<Parser>,
    sensor: LogSensor,
    max_beams: usize,
    size: u64,
}

#[expect(clippy::large_enum_variant, reason = "there is one a log")]
enum Source {
    Text(Text),
    Bag(Box<Bag>),
}

/// The scans of a log, in its order. After an error the iteration is over.
pub struct LogReader {
    source: Source,
    /// The first scan, read ahead for what it says of the sensor.
    first: Option<Result<LogScan, LogError>>,
    ended: bool,
}

impl LogReader {
    /// Opens a log and reads up to its first scan; of a bag that leaves no choice.
    ///
    /// # Errors
    /// As [`LogReader::open_with`].
    pub fn open(path: &Path, limits: ScanLimits) -> Result<Self, LogError> {
        Self::open_with(path, limits, &BagOptions::default())
    }

    /// Opens a log, by `options` where it is a bag, and reads up to its first scan.
    ///
    /// # Errors
    /// [`LogError::Open`] when the file cannot be opened, [`LogError::Bag`] for a bag that cannot be read or leaves a choice.
    /// Damage comes as an item of the iteration.
    pub fn open_with(path: &Path, limits: ScanLimits, options: &BagOptions) -> Result<Self, LogError> {
        let error = |source| LogError::Open { path: path.display().to_string(), source };
        let metadata = std::fs::metadata(path).map_err(error)?;
        if bag::is_bag(path) {
            let bag = Bag::open(path, limits.max_beams, options)?;
            return Ok(Self::of(Source::Bag(Box::new(bag))));
        }
        let file = std::fs::File::open(path).map_err(error)?;
        Ok(Self::of(Source::Text(Text { size: metadata.len(), ..Text::new(file, limits) })))
    }

    /// Reads a log of text from any source of bytes, up to its first scan.
    #[must_use]
    pub fn new(source: impl Read + Send + 'static, limits: ScanLimits) -> Self {
        Self::of(Source::Text(Text::new(source, limits)))
    }

    fn of(source: Source) -> Self {
        let mut reader = Self { source, first: None, ended: false };
        reader.first = reader.read_scan();
        reader
    }

    /// What the log says of its sensor, in its header or its first scan.
    #[must_use]
    pub fn sensor(&self) -> &LogSensor {
        match &self.source {
            Source::Text(text) => &text.sensor,
            Source::Bag(bag) => &bag.sensor,
        }
    }

    /// The first scan, or what keeps it from being read; `None` for a log without scans, and once it was taken.
    #[must_use]
    pub fn first(&self) -> Option<Result<&LogScan, &LogError>> {
        self.first.as_ref().map(Result::as_ref)
    }

    /// What a log without scans lacks, for people.
    #[must_use]
    pub fn nothing(&self) -> String {
        match &self.source {
            Source::Text(_) => "it has no FLASER, ROBOTLASER1 or JSON scans".to_owned(),
            Source::Bag(bag) => match bag.left_out() {
                (count, Some(why)) => format!("all {count} have no place: {why}; {}", bag.words),
                _ => format!("it has no messages for them; {}", bag.words),
            },
        }
    }

    /// What is read of a bag that leaves choices, for people; `None` for text.
    #[must_use]
    pub fn chosen(&self) -> Option<&str> {
        match &self.source {
            Source::Text(_) => None,
            Source::Bag(bag) => Some(&bag.words),
        }
    }

    /// How many scans were passed over so far, since it is not known where they were taken, and for people why.
    #[must_use]
    pub fn left_out(&self) -> (u64, Option<String>) {
        match &self.source {
            Source::Text(_) => (0, None),
            Source::Bag(bag) => bag.left_out(),
        }
    }

    /// What [`LogScan::line`] counts: lines, or the scans of a bag.
    #[must_use]
    pub fn unit(&self) -> &'static str {
        match &self.source {
            Source::Text(_) => "line",
            Source::Bag(_) => "scan",
        }
    }

    /// Bytes of the log, in the count of [`LogReader::bytes_read`]; 0 where that is not known.
    #[must_use]
    pub fn size(&self) -> u64 {
        match &self.source {
            Source::Text(text) => text.size,
            Source::Bag(bag) => bag.size,
        }
    }

    /// Lines read so far, or scans of a bag.
    #[must_use]
    pub fn line(&self) -> u64 {
        match &self.source {
            Source::Text(text) => text.lines.number(),
            Source::Bag(bag) => bag.number(),
        }
    }

    /// A counter of the bytes taken from the source so far, compressed ones where it is: for a progress bar.
    #[must_use]
    pub fn bytes_read(&self) -> Arc<AtomicU64> {
        match &self.source {
            Source::Text(text) => text.lines.bytes_read(),
            Source::Bag(bag) => bag.bytes_read(),
        }
    }

    fn read_scan(&mut self) -> Option<Result<LogScan, LogError>> {
        if self.ended {
            return None;
        }
        let found = match &mut self.source {
            Source::Text(text) => text.find_scan(),
            Source::Bag(bag) => bag.find_scan(),
        };
        let found = found.transpose();
        self.ended = !matches!(found, Some(Ok(_)));
        found
    }
}

impl Text {
    fn new(source: impl Read + Send + 'static, limits: ScanLimits) -> Self {
        Self {
            lines: Lines::new(source, MAX_LINE_BYTES),
            parser: None,
            sensor: LogSensor::default(),
            max_beams: limits.max_beams,
            size: 0,
        }
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

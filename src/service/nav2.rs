//! A map as Nav2's map server reads it: `map.yaml` and `map.pgm` in one zip.
//!
//! What is written free is proven free: a cell is free where its class, the maximum over its leaves, is below unknown.

use super::queries::QueryError;
use super::{ErrorKind, ServiceError};
use crate::mapping::{EvidenceRule, MapConfig};
use crate::quadtree::{Class, ClassScale, LeafRange, NodeAddress, PagedTree};
use std::fmt::Write as _;
use std::io::{self, Cursor, Write as _};
use zip::write::SimpleFileOptions;
use zip::{CompressionMethod, DateTime, ZipWriter};

/// Pixels darker than this share are occupied: Nav2's usual value.
const OCCUPIED_THRESHOLD: f64 = 0.65;

/// Pixels lighter than this share are free: Nav2's usual value, just below [`UNKNOWN`].
const FREE_THRESHOLD: f64 = 0.196;

/// The usual pixels of maps in the mode trinary: `(255 - 205) / 255` is 0.19608, between the thresholds.
const FREE: u8 = 254;
const UNKNOWN: u8 = 205;
const OCCUPIED: u8 = 0;

/// How pixels are to be read.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default)]
pub enum Nav2Mode {
    /// Free, unknown or occupied.
    #[default]
    Trinary,
    /// A grey for every class. Nav2 takes nothing for unknown in this mode, since a PGM has no transparency: unknown is a
    /// middle grey.
    Scale,
}

/// What is drawn.
pub(super) struct Drawing<'a> {
    pub(super) map: &'a str,
    pub(super) revision: u64,
    pub(super) config: &'a MapConfig,
    pub(super) tree: &'a PagedTree,
    pub(super) depth: u8,
    pub(super) mode: Nav2Mode,
    pub(super) max_cells: usize,
}

impl Drawing<'_> {
    /// The zip: the same map gives the same bytes.
    pub(super) fn zip(&self) -> Result<Vec<u8>, QueryError> {
        let range = self.known()?;
        self.check_size(&range)?;
        let classes = self.tree.try_raster(&range, self.depth)?;
        let (yaml, pgm) = (self.yaml(&range), self.pgm(&range, &classes));
        drop(classes);
        let zipped = zip(&[("map.yaml", yaml.as_bytes()), ("map.pgm", &pgm)]);
        zipped.map_err(|error| {
            tracing::error!(%error, "a map for Nav2 cannot be written");
            ServiceError::new(ErrorKind::Internal, "the server failed to write the file").into()
        })
    }

    /// The smallest box, in nodes of the depth, that holds all that are not unknown; where none is, the middle one.
    fn known(&self) -> Result<LeafRange, QueryError> {
        let (side, unknown) = (self.config.grid().side(), self.config.scale().unknown());
        let whole = LeafRange { min_x: 0, min_y: 0, max_x: side, max_y: side };
        let mut known: Option<LeafRange> = None;
        self.tree.try_visit_leaves(&whole, self.depth, &mut |leaf| {
            if leaf.class != unknown {
                let cells = self.depth - leaf.node.depth;
                let (min_x, min_y) = (leaf.node.x << cells, leaf.node.y << cells);
                let (max_x, max_y) = (min_x + (1 << cells), min_y + (1 << cells));
                let old = known.unwrap_or(LeafRange { min_x, min_y, max_x, max_y });
                known = Some(LeafRange {
                    min_x: old.min_x.min(min_x),
                    min_y: old.min_y.min(min_y),
                    max_x: old.max_x.max(max_x),
                    max_y: old.max_y.max(max_y),
                });
            }
            true
        })?;
        let middle = (1_u32 << self.depth) / 2;
        let one = LeafRange { min_x: middle, min_y: middle, max_x: middle + 1, max_y: middle + 1 };
        Ok(known.unwrap_or(one))
    }

    fn check_size(&self, range: &LeafRange) -> Result<(), ServiceError> {
        let limit = self.max_cells as u64;
        // At a coarser depth the box is at most the one of the nodes that hold this one.
        let cells = |levels: u8| {
            let side = |min: u32, max: u32| u64::from(((max - 1) >> levels) + 1 - (min >> levels));
            side(range.min_x, range.max_x) * side(range.min_y, range.max_y)
        };
        if cells(0) <= limit {
            return Ok(());
        }
        let (width, height) = (range.max_x - range.min_x, range.max_y - range.min_y);
        let fits = (1..=self.depth).find(|levels| cells(*levels) <= limit);
        let hint =
            fits.map_or_else(|| "no depth fits".to_owned(), |levels| format!("depth {} fits", self.depth - levels));
        let detail =
            format!("the image has {width} x {height} cells at depth {}, the limit is {limit}; {hint}", self.depth);
        Err(ServiceError::new(ErrorKind::RegionTooLarge, detail).at("depth"))
    }

    fn yaml(&self, range: &LeafRange) -> String {
        let grid = self.config.grid();
        let size = grid.node_size(self.depth);
        // The shortest number that is right: the corner of a leaf at 3 * 0.1 is 0.3.
        let (x, y) = grid.node_min(NodeAddress { depth: self.depth, x: range.min_x, y: range.min_y });
        let mode = match self.mode {
            Nav2Mode::Trinary => "trinary",
            Nav2Mode::Scale => "scale",
        };
        let free = match self.config.rule() {
            EvidenceRule::Guaranteed => "proven free",
            EvidenceRule::Outer => "called empty by the rule outer, not proven",
            EvidenceRule::Inner => "called empty by the rule inner, not proven",
        };
        let mut text = String::new();
        let lines = [
            format!(
                "# Map {:?} of ubbmap, revision {}, depth {}. Free is {free}.",
                self.map, self.revision, self.depth
            ),
            "image: map.pgm".to_owned(),
            format!("mode: {mode}"),
            format!("resolution: {}", decimal(size)),
            format!("origin: [{}, {}, 0.0]", decimal(x), decimal(y)),
            "negate: 0".to_owned(),
            format!("occupied_thresh: {OCCUPIED_THRESHOLD}"),
            format!("free_thresh: {FREE_THRESHOLD}"),
        ];
        for line in lines {
            // Writing to a string cannot fail.
            let _ = writeln!(text, "{line}");
        }
        text
    }

    /// The first row of an image is the highest, that of a raster the lowest.
    fn pgm(&self, range: &LeafRange, classes: &[Class]) -> Vec<u8> {
        let (width, height) = ((range.max_x - range.min_x) as usize, range.max_y - range.min_y);
        let mut pixels: [u8; 256] = [UNKNOWN; 256];
        for (class, pixel) in (0..=Class::MAX).zip(&mut pixels) {
            *pixel = shade(class, self.config.scale(), self.mode);
        }
        let mut image = format!("P5\n{width} {height}\n255\n").into_bytes();
        image.reserve(classes.len());
        for row in classes.chunks_exact(width).rev() {
            image.extend(row.iter().map(|class| pixels[usize::from(*class)]));
        }
        image
    }
}

/// The pixel of a class.
fn shade(class: Class, scale: ClassScale, mode: Nav2Mode) -> u8 {
    match mode {
        Nav2Mode::Trinary if class < scale.unknown() => FREE,
        Nav2Mode::Trinary if class > scale.unknown() => OCCUPIED,
        Nav2Mode::Trinary => UNKNOWN,
        Nav2Mode::Scale => {
            let highest = u32::from(scale.count()) - 1;
            let below = highest.saturating_sub(u32::from(class.max(1)) - 1);
            // At most 255.
            ((255 * below + highest / 2) / highest) as u8
        }
    }
}

/// A number as every YAML parser takes it for one: never with an exponent, always with a point.
fn decimal(value: f64) -> String {
    let text = value.to_string();
    if text.contains('.') { text } else { format!("{text}.0") }
}

fn zip(files: &[(&str, &[u8])]) -> io::Result<Vec<u8>> {
    let mut writer = ZipWriter::new(Cursor::new(Vec::new()));
    let options = SimpleFileOptions::default()
        .compression_method(CompressionMethod::Deflated)
        .last_modified_time(DateTime::default())
        .unix_permissions(0o644);
    for (name, bytes) in files {
        writer.start_file(*name, options).map_err(io::Error::other)?;
        writer.write_all(bytes)?;
    }
    Ok(writer.finish().map_err(io::Error::other)?.into_inner())
}

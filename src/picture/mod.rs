//! Floor 6: a map as a picture that a person reads at once.
//!
//! Free is white, unknown grey, occupied black, graded by class; the picture is cropped to what is known, small maps
//! are drawn with several pixels a cell and huge ones by the coarse maxima of the tree, so nothing occupied is lost. A
//! band below has a scale bar, a legend and a caption. [`Drawing`] and [`Chart`] are the figures of reports.

mod chart;
mod drawing;
mod font;
mod footer;

use crate::quadtree::{BLOCK_SIDE, BlockView, Class, ClassScale, Grid, LeafRange, OccupancyTree};
use std::fs::File;
use std::io::{BufWriter, Write};
use std::path::Path;

pub use chart::{Axis, Chart, LINES, Series, short};
pub use drawing::{Colour, Drawing, INK, LINE, PAPER};

/// Longest side of the map's part of a picture, pixels.
pub const MAX_SIDE: u32 = 4000;

/// Small maps are enlarged by whole factors while their longest side stays within this, pixels.
const GOOD_SIDE: u32 = 1600;

/// Most pixels along one side of a cell.
const MAX_SCALE: u32 = 8;

/// Narrowest picture, pixels: room for the band below.
const MIN_WIDTH: u32 = 560;

/// Grey of unknown.
pub const UNKNOWN: u8 = 176;

/// Grey of the class just below unknown; lower ones are lighter, down to white.
const BARELY_FREE: u8 = 226;

/// Grey of the class just above unknown; higher ones are darker, up to black.
const BARELY_OCCUPIED: u8 = 112;

/// An 8-bit grey picture, row-major from the top.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Picture {
    width: u32,
    height: u32,
    pixels: Vec<u8>,
}

/// The smallest range of leaves that holds every leaf of a class other than unknown; `None` for an empty map.
#[must_use]
pub fn known_range(tree: &OccupancyTree) -> Option<LeafRange> {
    let unknown = tree.scale().unknown();
    let side = BLOCK_SIDE.min(1 << tree.depth());
    let mut known: Option<LeafRange> = None;
    tree.visit_blocks(&mut |address, view| {
        let corner = (address.x * BLOCK_SIDE, address.y * BLOCK_SIDE);
        let inner = match view {
            BlockView::Uniform(class) if *class == unknown => None,
            BlockView::Uniform(_) => Some((0, 0, side - 1, side - 1)),
            BlockView::Mixed(block) => extent(block.leaves(), unknown, side),
        };
        if let Some((left, low, right, high)) = inner {
            let found = known.get_or_insert(LeafRange { min_x: u32::MAX, min_y: u32::MAX, max_x: 0, max_y: 0 });
            found.min_x = found.min_x.min(corner.0 + left);
            found.min_y = found.min_y.min(corner.1 + low);
            found.max_x = found.max_x.max(corner.0 + right + 1);
            found.max_y = found.max_y.max(corner.1 + high + 1);
        }
    });
    known
}

/// First and last column and row of a block that are not unknown: `(left, low, right, high)`.
fn extent(leaves: &[Class; 64 * 64], unknown: Class, side: u32) -> Option<(u32, u32, u32, u32)> {
    let mut found: Option<(u32, u32, u32, u32)> = None;
    for y in 0..side {
        let row = &leaves[(y * BLOCK_SIDE) as usize..][..side as usize];
        let Some(left) = row.iter().position(|class| *class != unknown) else { continue };
        let right = row.iter().rposition(|class| *class != unknown).unwrap_or(left);
        let (old_left, low, old_right, _) = found.unwrap_or((left as u32, y, right as u32, y));
        found = Some((old_left.min(left as u32), low, old_right.max(right as u32), y));
    }
    found
}

/// The grey of a class: white is free, black occupied.
#[must_use]
pub fn shade(class: Class, scale: ClassScale) -> u8 {
    let between = |from: u8, to: u8, step: u8, steps: u8| {
        let share = if steps == 0 { 1.0 } else { f64::from(step) / f64::from(steps) };
        (f64::from(from) + (f64::from(to) - f64::from(from)) * share).round() as u8
    };
    let unknown = scale.unknown();
    match class.cmp(&unknown) {
        std::cmp::Ordering::Equal => UNKNOWN,
        // Steps from the class next to unknown to the last one.
        std::cmp::Ordering::Less => between(BARELY_FREE, 255, unknown - 1 - class, unknown - 2),
        std::cmp::Ordering::Greater => between(BARELY_OCCUPIED, 0, class - unknown - 1, scale.occupied() - unknown - 1),
    }
}

/// Which cells are drawn, of which depth, with how many pixels a side.
struct Frame {
    range: LeafRange,
    depth: u8,
    scale: u32,
}

/// Crops to the known leaves with a margin and chooses depth and scale.
fn frame(tree: &OccupancyTree) -> Frame {
    let side = 1_u32 << tree.depth();
    let middle = side / 2;
    let known = known_range(tree).unwrap_or(LeafRange { min_x: middle, min_y: middle, max_x: middle, max_y: middle });
    let longest = (known.max_x - known.min_x).max(known.max_y - known.min_y);
    let margin = (longest / 40).max(6);
    let low = |v: u32| v.saturating_sub(margin);
    let high = |v: u32| v.saturating_add(margin).min(side);
    let leaves = LeafRange {
        min_x: low(known.min_x),
        min_y: low(known.min_y),
        max_x: high(known.max_x),
        max_y: high(known.max_y),
    };
    let at = |shift: u8| LeafRange {
        min_x: leaves.min_x >> shift,
        min_y: leaves.min_y >> shift,
        max_x: ((leaves.max_x - 1) >> shift) + 1,
        max_y: ((leaves.max_y - 1) >> shift) + 1,
    };
    let length = |range: &LeafRange| (range.max_x - range.min_x).max(range.max_y - range.min_y);
    let mut shift = 0;
    while length(&at(shift)) > MAX_SIDE && shift < tree.depth() {
        shift += 1;
    }
    let range = at(shift);
    let scale = (GOOD_SIDE / length(&range).max(1)).clamp(1, MAX_SCALE);
    Frame { range, depth: tree.depth() - shift, scale }
}

impl Picture {
    /// Draws a map. `caption` is a line of text below it; letters are drawn small.
    #[must_use]
    pub fn of_map(tree: &OccupancyTree, grid: &Grid, caption: &str) -> Self {
        let frame = frame(tree);
        let cells = tree.raster(&frame.range, frame.depth);
        let columns = frame.range.max_x - frame.range.min_x;
        let rows = frame.range.max_y - frame.range.min_y;
        let (map_width, map_height) = (columns * frame.scale, rows * frame.scale);
        let cell_size = grid.node_size(frame.depth);
        let width = map_width.max(MIN_WIDTH);
        let footer = footer::Footer::new(width, f64::from(frame.scale) / cell_size, caption);
        let mut picture = Self::blank(width, map_height + footer.height(), UNKNOWN);
        let left = (width - map_width) / 2;
        for (row, line) in cells.chunks_exact(columns as usize).enumerate() {
            let top = (rows - 1 - row as u32) * frame.scale;
            for (column, class) in line.iter().enumerate() {
                let grey = shade(*class, tree.scale());
                picture.fill(left + column as u32 * frame.scale, top, frame.scale, frame.scale, grey);
            }
        }
        footer.draw(&mut picture, map_height, tree.scale());
        picture
    }

    fn blank(width: u32, height: u32, grey: u8) -> Self {
        Self { width, height, pixels: vec![grey; width as usize * height as usize] }
    }

    /// Width, pixels.
    #[must_use]
    pub fn width(&self) -> u32 {
        self.width
    }

    /// Height, pixels.
    #[must_use]
    pub fn height(&self) -> u32 {
        self.height
    }

    /// Greys, row-major from the top; 0 is black.
    #[must_use]
    pub fn pixels(&self) -> &[u8] {
        &self.pixels
    }

    /// Fills a rectangle; what lies outside the picture is left out.
    fn fill(&mut self, x: u32, y: u32, width: u32, height: u32, grey: u8) {
        let from = x.min(self.width) as usize;
        let to = x.saturating_add(width).min(self.width) as usize;
        for row in y.min(self.height)..y.saturating_add(height).min(self.height) {
            let start = row as usize * self.width as usize;
            self.pixels[start + from..start + to].fill(grey);
        }
    }

    /// Writes the picture to a PNG file.
    ///
    /// # Errors
    /// Failures of the file.
    pub fn save(&self, path: &Path) -> std::io::Result<()> {
        let mut file = BufWriter::new(File::create(path)?);
        self.write_png(&mut file)?;
        file.flush()
    }

    /// Writes the picture as PNG.
    ///
    /// # Errors
    /// Failures of the writer.
    pub fn write_png(&self, into: impl Write) -> std::io::Result<()> {
        let mut encoder = png::Encoder::new(into, self.width, self.height);
        encoder.set_color(png::ColorType::Grayscale);
        encoder.set_depth(png::BitDepth::Eight);
        let mut writer = encoder.write_header()?;
        writer.write_image_data(&self.pixels)?;
        writer.finish()?;
        Ok(())
    }
}

//! Figures 4 and 5: maps side by side, the section where they differ most, and the tree read coarsely.

use super::maps::hits;
use crate::mapping::GaussianGrid;
use crate::picture::{Colour, Drawing, INK, LINE, PAPER, UNKNOWN, shade};
use crate::quadtree::{ClassScale, Grid, LeafRange, NodeAddress, OccupancyTree};
use crate::sensor::Scan;

/// Cells that hold returns and are called free.
const LOST: Colour = [225, 40, 30];

/// Returns in a cell that make it a cell of an obstacle: fewer may be people or noise.
const OBSTACLE_RETURNS: u32 = 10;

/// Longest side of a whole map's panel, pixels.
const PANEL: u32 = 1200;

/// Most nodes along a side of it: larger maps are drawn by the maxima of coarser nodes.
const MOST: u32 = 2400;

/// Side of the enlarged section, metres, and of its panels, pixels.
const SECTION: f64 = 8.0;
const SECTION_PANEL: u32 = 400;

/// Unknown leaves drawn about what is known.
const MARGIN: u32 = 6;

/// A map of either kind.
#[derive(Debug, Clone, Copy)]
pub enum View<'a> {
    /// A quadtree.
    Tree(&'a OccupancyTree),
    /// A dense grid.
    Grid(&'a GaussianGrid),
}

impl View<'_> {
    /// Grey of a node, and whether it is called free: by the maximum of its leaves, which are `levels` below.
    fn node(&self, node: NodeAddress, levels: u8) -> (u8, bool) {
        match self {
            Self::Tree(tree) => {
                let class = tree.max_class(node);
                (shade(class, tree.scale()), class < tree.scale().unknown())
            }
            Self::Grid(grid) => {
                let (x, y, side) = (node.x << levels, node.y << levels, 1_u32 << levels);
                let leaf = |x, y| NodeAddress { depth: node.depth + levels, x, y };
                let below = (y..y + side).flat_map(|y| (x..x + side).map(move |x| leaf(x, y)));
                let log_odds = below.map(|leaf| grid.log_odds(leaf)).fold(f32::NEG_INFINITY, f32::max);
                (shade_of_log_odds(log_odds), log_odds < 0.0)
            }
        }
    }
}

/// The grey of log-odds, graded as classes are.
fn shade_of_log_odds(log_odds: f32) -> u8 {
    if log_odds == 0.0 {
        return UNKNOWN;
    }
    // As many shades as a class has bytes: 127 is unknown, 1 free, 254 occupied.
    let Ok(scale) = ClassScale::new(254) else { return UNKNOWN };
    let p = 1.0 / (1.0 + (-f64::from(log_odds)).exp());
    let class = (p * 254.0).round().clamp(1.0, 254.0) as u8;
    let unknown = scale.unknown();
    let class = if log_odds < 0.0 { class.min(unknown - 1) } else { class.max(unknown + 1) };
    shade(class, scale)
}

/// The nodes of a range of one map, of a depth so many levels above the leaves, `pixels` a node; red where at least [`OBSTACLE_RETURNS`] returns fell into a leaf that is
/// called free, where `lost` has their counts.
fn panel(
    view: View<'_>,
    range: &LeafRange,
    (depth, levels): (u8, u8),
    pixels: u32,
    title: &str,
    lost: Option<&[u32]>,
) -> Drawing {
    let (columns, rows) = (range.max_x - range.min_x, range.max_y - range.min_y);
    let top = LINE + 4;
    let mut drawing = Drawing::new(columns * pixels, rows * pixels + top, PAPER);
    for row in 0..rows {
        for column in 0..columns {
            let node = NodeAddress { depth, x: range.min_x + column, y: range.min_y + row };
            let (grey, is_free) = view.node(node, levels);
            let returns = lost.map_or(0, |hits| hits[(row * columns + column) as usize]);
            let colour = if is_free && returns >= OBSTACLE_RETURNS { LOST } else { [grey; 3] };
            let at = (i64::from(column * pixels), i64::from(top + (rows - 1 - row) * pixels));
            drawing.fill(at, (pixels, pixels), colour);
        }
    }
    drawing.text((0, 2), title, 1, INK);
    drawing.outline((0, i64::from(top)), (columns * pixels, rows * pixels), INK);
    drawing
}

fn grown(range: &LeafRange, margin: u32, side: u32) -> LeafRange {
    LeafRange {
        min_x: range.min_x.saturating_sub(margin),
        min_y: range.min_y.saturating_sub(margin),
        max_x: (range.max_x + margin).min(side),
        max_y: (range.max_y + margin).min(side),
    }
}

/// A map with its title.
pub type Named<'a> = (&'a str, View<'a>);

/// Figure 4: whole maps one below the other, or beside where they are narrow.
#[must_use]
pub fn whole_maps(grid: &Grid, known: &LeafRange, maps: &[Named<'_>]) -> Drawing {
    let mut range = grown(known, MARGIN, grid.side());
    let mut levels = 0;
    while (range.max_x - range.min_x).max(range.max_y - range.min_y) > MOST && levels < grid.depth() {
        levels += 1;
        range = LeafRange {
            min_x: range.min_x >> 1,
            min_y: range.min_y >> 1,
            max_x: range.max_x.div_ceil(2),
            max_y: range.max_y.div_ceil(2),
        };
    }
    let (width, height) = (range.max_x - range.min_x, range.max_y - range.min_y);
    // Wide maps stand below each other.
    let (columns, panel_side) = if 2 * width > 3 * height { (1, PANEL) } else { (maps.len(), PANEL / 2) };
    let pixels = (panel_side / width.max(height).max(1)).clamp(1, 6);
    let draw = |(title, view): &Named<'_>| panel(*view, &range, (grid.depth() - levels, levels), pixels, title, None);
    let parts: Vec<Drawing> = maps.iter().map(draw).collect();
    Drawing::beside(&parts, columns)
}

/// Where two maps differ most: the square section in which most obstacle leaves of the first are called free by the
/// second, with their number.
#[must_use]
pub fn differing_section(
    grid: &Grid,
    known: &LeafRange,
    scans: &[Scan],
    holds: View<'_>,
    loses: View<'_>,
) -> (LeafRange, u32) {
    let side = ((SECTION / grid.resolution()).round() as u32).max(8);
    let step = (side / 8).max(1);
    let counts = hits(grid, known, scans);
    let columns = known.max_x - known.min_x;
    let is_lost = |x: u32, y: u32| {
        let leaf = NodeAddress { depth: grid.depth(), x, y };
        let returns = counts[((y - known.min_y) * columns + x - known.min_x) as usize];
        returns >= OBSTACLE_RETURNS && !holds.node(leaf, 0).1 && loses.node(leaf, 0).1
    };
    // Lost leaves by squares of `step`, then windows of eight of them.
    let (across, up) = (columns.div_ceil(step) as usize, (known.max_y - known.min_y).div_ceil(step) as usize);
    let mut sums = vec![0_u32; across * up];
    for y in known.min_y..known.max_y {
        for x in known.min_x..known.max_x {
            let at = ((y - known.min_y) / step) as usize * across + ((x - known.min_x) / step) as usize;
            sums[at] += u32::from(is_lost(x, y));
        }
    }
    let window = |left: usize, low: usize| {
        let rows = low..(low + 8).min(up);
        rows.map(|row| sums[row * across + left..row * across + (left + 8).min(across)].iter().sum::<u32>())
            .sum::<u32>()
    };
    let corners = (0..up).flat_map(|low| (0..across).map(move |left| (left, low)));
    let best = corners.max_by_key(|(left, low)| (window(*left, *low), std::cmp::Reverse((*low, *left))));
    let (left, low) = best.unwrap_or((0, 0));
    // Held to the root: the section may run over what is known.
    let at = |origin: u32, index: usize| (origin + index as u32 * step).min(grid.side() - side.min(grid.side()));
    let (min_x, min_y) = (at(known.min_x, left), at(known.min_y, low));
    let section = LeafRange { min_x, min_y, max_x: min_x + side, max_y: min_y + side };
    (section, window(left, low))
}

/// The section of several maps, enlarged, with lost obstacle leaves in red.
#[must_use]
pub fn section(grid: &Grid, range: &LeafRange, scans: &[Scan], maps: &[Named<'_>]) -> Drawing {
    let lost = hits(grid, range, scans);
    let pixels = (SECTION_PANEL / (range.max_x - range.min_x).max(1)).max(1);
    let draw = |(title, view): &Named<'_>| panel(*view, range, (grid.depth(), 0), pixels, title, Some(&lost));
    let parts: Vec<Drawing> = maps.iter().map(draw).collect();
    Drawing::beside(&parts, 3)
}

/// Obstacle leaves: those into which at least [`OBSTACLE_RETURNS`] returns fell; how many of them a map calls free.
#[must_use]
pub fn lost_leaves(grid: &Grid, range: &LeafRange, scans: &[Scan], view: View<'_>) -> (u64, u64) {
    let columns = range.max_x - range.min_x;
    let counts = hits(grid, range, scans);
    let obstacles = (0..).zip(&counts).filter(|(_, returns)| **returns >= OBSTACLE_RETURNS);
    obstacles.fold((0, 0), |(all, lost), (index, _)| {
        let index: u32 = index;
        let leaf =
            NodeAddress { depth: grid.depth(), x: range.min_x + index % columns, y: range.min_y + index / columns };
        (all + 1, lost + u64::from(view.node(leaf, 0).1))
    })
}

/// Figure 5: a tree read down to a depth, each of its cells outlined.
#[must_use]
pub fn coarse(tree: &OccupancyTree, grid: &Grid, known: &LeafRange, depth: u8) -> Drawing {
    const LATTICE: Colour = [140, 160, 190];
    let levels = grid.depth() - depth;
    let range = grown(known, MARGIN, grid.side());
    let (low_x, low_y) = (range.min_x >> levels, range.min_y >> levels);
    let (columns, rows) = (((range.max_x - 1) >> levels) + 1 - low_x, ((range.max_y - 1) >> levels) + 1 - low_y);
    let pixels = (PANEL / columns.max(rows).max(1)).clamp(3, 14);
    let mut drawing = Drawing::new(columns * pixels + 1, rows * pixels + 1, PAPER);
    tree.visit_leaves(&range, depth, &mut |leaf| {
        let above = depth - leaf.node.depth;
        let side = i64::from(pixels) << above;
        let x = ((i64::from(leaf.node.x) << above) - i64::from(low_x)) * i64::from(pixels);
        let y = (i64::from(rows) - ((i64::from(leaf.node.y) + 1) << above) + i64::from(low_y)) * i64::from(pixels);
        // The part of the node that lies in the drawing: a node of unknown may be kilometres wide.
        let (left, upper) = (x.max(-1), y.max(-1));
        let right = (x + side).min(i64::from(drawing.width()));
        let lower = (y + side).min(i64::from(drawing.height()));
        if let (Ok(width), Ok(height)) = (u32::try_from(right - left + 1), u32::try_from(lower - upper + 1)) {
            drawing.fill((left, upper), (width, height), LATTICE);
            let inner = (width.saturating_sub(2), height.saturating_sub(2));
            drawing.fill((left + 1, upper + 1), inner, [shade(leaf.class, tree.scale()); 3]);
        }
        true
    });
    drawing
}

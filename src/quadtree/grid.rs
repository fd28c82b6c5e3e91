//! Where the leaves of a map are in the world.

use super::{LeafRange, NodeAddress, exact};
use crate::interval::{Box2, Interval};
use std::cmp::Ordering;
use thiserror::Error;

/// Deepest tree.
pub const MAX_DEPTH: u8 = 24;

/// Largest absolute coordinate of a root's corner, metres.
pub const MAX_COORDINATE: f64 = 1e9;

/// Smallest side of a leaf, metres.
pub const MIN_RESOLUTION: f64 = 1e-4;

/// Largest side of a leaf, metres.
pub const MAX_RESOLUTION: f64 = 1e4;

/// Largest [`Grid::cell_slack`], in leaves.
pub const MAX_CELL_SLACK: f64 = 1.0 / 64.0;

/// Why a grid is refused; each names the field at fault.
#[derive(Debug, Clone, PartialEq, Error)]
pub enum GridError {
    /// Not a number in [`MIN_RESOLUTION`]`..=`[`MAX_RESOLUTION`].
    #[error("resolution must be between {MIN_RESOLUTION} and {MAX_RESOLUTION} m, got {0}")]
    Resolution(f64),
    /// Out of `1..=24`.
    #[error("depth must be between 1 and {MAX_DEPTH}, got {0}")]
    Depth(u32),
    /// Not finite, or the root reaches beyond [`MAX_COORDINATE`].
    #[error("origin puts a corner of the root at {0} m: it must be finite and within +-{MAX_COORDINATE} m")]
    Origin(f64),
    /// The leaves are too small for the floating-point coordinates at the root's corners.
    #[error("resolution {resolution} m is too fine for coordinates up to {coordinate} m")]
    TooFine {
        /// The resolution asked for, metres.
        resolution: f64,
        /// The largest coordinate, metres.
        coordinate: f64,
    },
}

/// The leaves of a map: `2^depth` closed squares of side `resolution` along each axis, from the root's min corner.
///
/// Leaf `i` along an axis is the real interval `[origin + i * resolution, origin + (i + 1) * resolution]` with exact
/// real arithmetic on the two given floats. Evidence and queries both reach leaves through this type alone.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Grid {
    origin_x: f64,
    origin_y: f64,
    resolution: f64,
    depth: u8,
}

impl Grid {
    /// A grid; `origin` is the root's min corner in metres, `None` centres the root on (0, 0).
    ///
    /// ```
    /// use ubbmap::quadtree::Grid;
    /// let grid = Grid::new(0.1, 16, None)?;
    /// assert_eq!(grid.origin(), (-3276.8, -3276.8));
    /// # Ok::<(), ubbmap::quadtree::GridError>(())
    /// ```
    ///
    /// # Errors
    /// [`GridError`] naming the field at fault.
    pub fn new(resolution: f64, depth: u32, origin: Option<(f64, f64)>) -> Result<Self, GridError> {
        if !(MIN_RESOLUTION..=MAX_RESOLUTION).contains(&resolution) {
            return Err(GridError::Resolution(resolution));
        }
        let levels = u8::try_from(depth).ok().filter(|d| (1..=MAX_DEPTH).contains(d));
        let depth = levels.ok_or(GridError::Depth(depth))?;
        // Both products are exact: one factor is a power of two.
        let side = resolution * f64::from(1_u32 << depth);
        let (origin_x, origin_y) = origin.unwrap_or((-0.5 * side, -0.5 * side));
        let mut reach = 0.0_f64;
        for corner in [origin_x, origin_y, origin_x + side, origin_y + side] {
            if corner.is_nan() || corner.abs() > MAX_COORDINATE {
                return Err(GridError::Origin(corner));
            }
            reach = reach.max(corner.abs());
        }
        let grid = Self { origin_x, origin_y, resolution, depth };
        if grid.cell_slack() > MAX_CELL_SLACK {
            return Err(GridError::TooFine { resolution, coordinate: reach });
        }
        Ok(grid)
    }

    /// Side of a leaf, metres.
    #[must_use]
    pub fn resolution(&self) -> f64 {
        self.resolution
    }

    /// Depth of the leaves.
    #[must_use]
    pub fn depth(&self) -> u8 {
        self.depth
    }

    /// The root's min corner `(x, y)`, metres.
    #[must_use]
    pub fn origin(&self) -> (f64, f64) {
        (self.origin_x, self.origin_y)
    }

    /// Leaves along one side of the root, `2^depth`.
    #[must_use]
    pub fn side(&self) -> u32 {
        1 << self.depth
    }

    /// Side of a node at `depth`, metres: `resolution * 2^(depth of the leaves - depth)`, exact.
    #[must_use]
    pub fn node_size(&self, depth: u8) -> f64 {
        self.resolution * 2.0_f64.powi(i32::from(self.depth) - i32::from(depth))
    }

    /// The min corner `(x, y)` of a node as one floating-point number each, metres: for display, not for decisions.
    ///
    /// A number with at most nine decimals is taken where it is within the rounding of origin and resolution, so that
    /// the leaf that begins at `3 * 0.1` is shown at 0.3.
    #[must_use]
    pub fn node_min(&self, node: NodeAddress) -> (f64, f64) {
        let (x, y) = (self.leaf_index(node.x, node.depth), self.leaf_index(node.y, node.depth));
        (self.shown_edge(self.origin_x, x), self.shown_edge(self.origin_y, y))
    }

    /// An enclosure, outward rounded, of a node's closed square; metres. It is the square itself where its edges are
    /// floating-point numbers. Nodes deeper than the leaves have the box of their leaf.
    #[must_use]
    pub fn node_box(&self, node: NodeAddress) -> Box2 {
        let depth = node.depth.min(self.depth);
        let above = u32::from(node.depth - depth);
        let axis = |origin: f64, index: u32| {
            let index = index.checked_shr(above).unwrap_or(0);
            let edge = |i: u32| Self::edge(origin, self.resolution, self.leaf_index(i, depth));
            edge(index).hull(edge(index.saturating_add(1)))
        };
        Box2::new(axis(self.origin_x, node.x), axis(self.origin_y, node.y))
    }

    /// An upper bound, in leaves, of the error of `(v - origin) / resolution` computed in `f64` for a coordinate `v`
    /// within the root: the slack that evidence adds to every boundary. At most 1/64.
    ///
    /// `v` may itself be the result of a few rounded operations on coordinates, and may lie outside the root by up to
    /// `2^26` leaves. The bound, with `e = 2^-53` the rounding unit, `C` the largest absolute coordinate of the root
    /// and `N = 2^depth <= 2^24`:
    ///
    /// * the subtraction and the division each err by the factor `1 + e` at most: together `2.1 e (N + 2^26)` leaves,
    ///   below `2^-24`;
    /// * `v` in error by up to 32 rounding units of its size `C + 2^26 resolution` adds
    ///   `32 e C / resolution + 32 e 2^26 = 2^-48 C / resolution + 2^-22` leaves.
    ///
    /// `2^-20 + 2^-48 C / resolution` is above their sum, and above its own rounding.
    #[must_use]
    pub fn cell_slack(&self) -> f64 {
        const BASE: f64 = 1.0 / 1_048_576.0;
        const UNITS: f64 = 32.0 * 0.5 * f64::EPSILON;
        let side = self.node_size(0);
        let corners = [self.origin_x, self.origin_y, self.origin_x + side, self.origin_y + side];
        let reach = corners.iter().fold(0.0_f64, |most, v| most.max(v.abs()));
        BASE + UNITS * (reach / self.resolution)
    }

    /// The leaf that holds a point, leaves taken as half-open squares; `None` outside the root or for NaN. Exact: edges
    /// are compared as real numbers.
    #[must_use]
    pub fn leaf_at(&self, x: f64, y: f64) -> Option<NodeAddress> {
        let index = |origin: f64, v: f64| {
            (!v.is_nan()).then(|| u32::try_from(self.cell(origin, v)).ok()).flatten().filter(|i| *i < self.side())
        };
        Some(NodeAddress { depth: self.depth, x: index(self.origin_x, x)?, y: index(self.origin_y, y)? })
    }

    /// All leaves whose closed square meets the closed box, held to the root, and whether the box reaches beyond the
    /// root. Exact on the box's bounds, so a leaf that the box merely touches counts.
    #[must_use]
    pub fn leaves_meeting(&self, area: &Box2) -> (LeafRange, bool) {
        let (min_x, max_x, out_x) = self.meeting(self.origin_x, area.x);
        let (min_y, max_y, out_y) = self.meeting(self.origin_y, area.y);
        (LeafRange { min_x, min_y, max_x, max_y }, out_x || out_y)
    }

    /// The leaves of a half-open box `[min_x, max_x) x [min_y, max_y)` (metres) that have interior points in common
    /// with it, held to the root: what a region or grid query answers. Bounds within one part in 10^9 of a leaf's edge
    /// (or within the rounding of coordinates as large as the root's, where that is more) are taken as that edge, so
    /// that `min_x = 0.3` names the leaf that begins at `3 * 0.1`. Empty for an inverted box or NaN.
    #[must_use]
    pub fn leaves_within(&self, min_x: f64, min_y: f64, max_x: f64, max_y: f64) -> LeafRange {
        if !(min_x < max_x && min_y < max_y) {
            return LeafRange { min_x: 0, min_y: 0, max_x: 0, max_y: 0 };
        }
        let axis = |origin: f64, min: f64, max: f64| (self.snapped(origin, min).0, self.snapped(origin, max).1);
        let ((min_x, max_x), (min_y, max_y)) = (axis(self.origin_x, min_x, max_x), axis(self.origin_y, min_y, max_y));
        LeafRange { min_x, min_y, max_x, max_y }
    }

    /// The root's closed square, rounded outward; metres.
    #[must_use]
    pub fn bounds(&self) -> Box2 {
        self.node_box(NodeAddress { depth: 0, x: 0, y: 0 })
    }

    /// The interval of one axis, for callers that hold leaf indices: `origin + i * resolution`, outward rounded; a point
    /// where the sum is a floating-point number.
    #[must_use]
    pub fn edge(origin: f64, resolution: f64, index: u32) -> Interval {
        if index > 1 << MAX_DEPTH {
            return Interval::point(origin) + Interval::point(f64::from(index)) * Interval::point(resolution);
        }
        let (sum, rest) = exact::edge(origin, resolution, index);
        if rest == 0.0 { Interval::point(sum) } else { Interval::point(sum) + Interval::around(rest, 0.0) }
    }

    /// The first leaf below a node's index along one axis, for a node no deeper than the leaves.
    fn leaf_index(&self, index: u32, depth: u8) -> u32 {
        index << self.depth.saturating_sub(depth)
    }

    /// The leaf whose half-open interval along an axis holds `v` (not NaN): -1 below the root, `side` from its far edge.
    fn cell(&self, origin: f64, v: f64) -> i64 {
        let side = i64::from(self.side());
        // Within a leaf of the root the guess errs by less than one: see `cell_slack`.
        let guess = ((v - origin) / self.resolution).floor();
        let mut cell = guess.clamp(-1.0, side as f64) as i64;
        if !v.is_finite() {
            return cell;
        }
        while cell >= 0 && self.against_edge(v, origin, cell) == Ordering::Less {
            cell -= 1;
        }
        while cell < side && self.against_edge(v, origin, cell + 1) != Ordering::Less {
            cell += 1;
        }
        cell
    }

    /// Exact comparison of `v` with edge `index` (`0..=side`) of the axis.
    fn against_edge(&self, v: f64, origin: f64, index: i64) -> Ordering {
        exact::compare_with_edge(v, origin, self.resolution, index as u32)
    }

    /// First leaf, leaf behind the last, and whether the interval reaches beyond the root.
    fn meeting(&self, origin: f64, extent: Interval) -> (u32, u32, bool) {
        let side = self.side();
        let (low, high) = (self.cell(origin, extent.lo()), self.cell(origin, extent.hi()));
        let on_edge = |v: f64, cell: i64| cell >= 0 && v.is_finite() && self.against_edge(v, origin, cell).is_eq();
        // A bound on an edge touches the leaf before that edge too.
        let first = low - i64::from(low > 0 && on_edge(extent.lo(), low));
        let behind = (high + 1).min(i64::from(side));
        let beyond = low < 0 || (high == i64::from(side) && !on_edge(extent.hi(), high));
        (first.max(0) as u32, behind.max(0) as u32, beyond)
    }

    /// For a bound `v` of a half-open box: the first leaf of a box that begins there, and the leaf behind the last of a
    /// box that ends there.
    fn snapped(&self, origin: f64, v: f64) -> (u32, u32) {
        let side = f64::from(self.side());
        let position = (v - origin) / self.resolution;
        let nearest = position.round();
        let rounding = 4.0 * f64::EPSILON * (side + 2.0 * origin.abs() / self.resolution);
        if (position - nearest).abs() <= rounding.max(1e-9) {
            let edge = nearest.clamp(0.0, side) as u32;
            return (edge, edge);
        }
        let cell = self.cell(origin, v);
        let behind = (cell + 1).clamp(0, i64::from(self.side())) as u32;
        (cell.max(0) as u32, behind)
    }

    fn shown_edge(&self, origin: f64, index: u32) -> f64 {
        let (sum, rest) = exact::edge(origin, self.resolution, index.min(1 << MAX_DEPTH));
        let value = sum + rest;
        let decimal = (value * 1e9).round() / 1e9;
        let rounding = f64::EPSILON * (origin.abs() + self.node_size(0));
        if (decimal - value).abs() <= rounding { decimal } else { value }
    }
}

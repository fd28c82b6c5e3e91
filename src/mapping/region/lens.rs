//! A region in units of a map's leaves: quick tests of nodes whose corners are small whole numbers.
//!
//! A node's corners are exact in these units, a region's numbers are not. A lens therefore decides only what is clear by
//! more than a slack; the leaves in between are decided by the region's own test, on the leaf's exact box. So its answers
//! are those of [`Region::meets`], and nearly all of them cost a few operations.
//!
//! **The slack**, in leaves. Let `d` be [`Grid::cell_slack`], at least `2^-20`: the error of one coordinate of a point. A
//! lens is made only for regions within `2^24` leaves of the root, so that differences of coordinates, radii and lengths
//! stay below `2^27`. The extent that the region's own test is relative to is a sum of them, and may be a little more: below
//! `9 * 2^24`. With `u = 2^-53`:
//!
//! * points that are off by `d` along each axis change a distance by at most `1.5 d`;
//! * a distance to a line (by projection on it) errs by `12 u 2^27`, the comparison of squares by `4 u 2^27`, the radius
//!   by `2 u 2^25`: together below `2^-21 <= d / 2`;
//! * the region's own test widens by `LEAF_SLACK` of the extent, `32 u 9 2^24`, which is `9 / 16 d` at most, and by the outward
//!   rounding of the leaf's box and of the region's bounds, a few `u` of the coordinates: below `d / 4`.
//!
//! Their sum is below `2.9 d`; the slack is `4 d`.

use super::probe::Cover;
use super::segment::{LEAF_SLACK, Segment};
use super::{Region, Shape};
use crate::interval::Box2;
use crate::quadtree::{BLOCK_SIDE, BlockAddress, Grid, LeafRange, MAX_DEPTH, NodeAddress};
use std::f64::consts::SQRT_2;

/// How far beyond the root a region may reach, in leaves.
const REACH: f64 = (1 << 24) as f64;

/// Pieces of a path that are looked at together: one bit each in a word.
const GROUP: usize = 64;

/// Nodes above this side, in leaves, are held against the box about the region first: one that is no smaller than it
/// hardly tells more by the region itself.
const BOX_SIDE: f64 = 32.0;

/// A piece whose squared length is below this, in leaves, is taken for its start: it is shorter than any rounding.
pub(super) const POINT: f64 = 1e-30;

/// A region as seen from one map, for one descent at a time.
pub struct Lens<'a> {
    pub(super) grid: &'a Grid,
    bounds: Box2,
    pub(super) slack: f64,
    pub(super) shape: Scaled<'a>,
    /// The box about the part that is looked at, in leaves with the slack: `(min, max)`.
    part: ((f64, f64), (f64, f64)),
    /// The leaves that meet the bounds, exactly; computed when the first leaf is in doubt.
    range: Option<LeafRange>,
}

/// A shape in leaves from the root's min corner.
#[expect(clippy::large_enum_variant, reason = "one a query, on the stack: a box would cost more than the query")]
pub(super) enum Scaled<'a> {
    Rectangle { lo: (f64, f64), hi: (f64, f64) },
    Disc { center: (f64, f64), radius: f64, region: &'a Region },
    Path(Capsules<'a>),
}

/// The pieces of a path, looked at in groups.
pub(super) struct Capsules<'a> {
    pieces: &'a [Segment],
    pub(super) lines: Vec<Line>,
    pub(super) radius: f64,
    /// The radius in metres.
    radius_m: f64,
    /// The first piece of the group that is looked at.
    pub(super) first: usize,
    /// Depth of the part's first node.
    top: u8,
    /// By depth: the pieces of the group that the parent of a node there left open.
    pub(super) open: [u64; MAX_DEPTH as usize + 2],
}

/// A piece of a path in leaves.
#[derive(Clone, Copy)]
pub(super) struct Line {
    pub(super) start: (f64, f64),
    step: (f64, f64),
    /// 1 over the squared length; 0 for a point.
    inverse: f64,
}

/// A distance from a region against a radius.
#[derive(PartialEq)]
enum Reach {
    Beyond,
    Within,
    Doubtful,
}

/// The closed square of a node, in leaves.
#[derive(Clone, Copy)]
struct Square {
    min: (f64, f64),
    side: f64,
}

impl Square {
    fn max(self) -> (f64, f64) {
        (self.min.0 + self.side, self.min.1 + self.side)
    }

    /// The vector from a point to the nearest of the square, squared length.
    fn near_squared(self, (x, y): (f64, f64)) -> f64 {
        let max = self.max();
        let dx = (self.min.0 - x).max(x - max.0).max(0.0);
        let dy = (self.min.1 - y).max(y - max.1).max(0.0);
        dx * dx + dy * dy
    }

    /// Squared distance of the farthest point.
    fn far_squared(self, (x, y): (f64, f64)) -> f64 {
        let max = self.max();
        let (dx, dy) = ((max.0 - x).max(x - self.min.0), (max.1 - y).max(y - self.min.1));
        dx * dx + dy * dy
    }
}

impl Line {
    /// Does the box about it and everything within `radius` of it meet a block?
    pub(super) fn is_near(&self, block: BlockAddress, radius: f64) -> bool {
        let near = |start: f64, step: f64, index: u32| {
            let (min, max) = (f64::from(index * BLOCK_SIDE), f64::from((index + 1) * BLOCK_SIDE));
            start + step.min(0.0) - radius <= max && start + step.max(0.0) + radius >= min
        };
        near(self.start.0, self.step.0, block.x) && near(self.start.1, self.step.1, block.y)
    }

    pub(super) fn end(&self) -> (f64, f64) {
        (self.start.0 + self.step.0, self.start.1 + self.step.1)
    }

    fn distance_squared(&self, (x, y): (f64, f64)) -> f64 {
        let (px, py) = (x - self.start.0, y - self.start.1);
        let along = ((px * self.step.0 + py * self.step.1) * self.inverse).clamp(0.0, 1.0);
        let (dx, dy) = (px - along * self.step.0, py - along * self.step.1);
        dx * dx + dy * dy
    }

    /// Squared distance of the nearest point of a square.
    fn gap_squared(&self, square: Square) -> f64 {
        let (min, max) = (square.min, square.max());
        if self.crosses(min, max) {
            return 0.0;
        }
        // Of two convex sets apart, one's nearest point is a corner of the square or an end of the line.
        let corners = [min, (max.0, min.1), max, (min.0, max.1)];
        let ends = square.near_squared(self.start).min(square.near_squared(self.end()));
        corners.into_iter().fold(ends, |least, corner| least.min(self.distance_squared(corner)))
    }

    /// Has the line a point in the box? Where rounding decides, the line is at one of the corners, within rounding.
    fn crosses(&self, min: (f64, f64), max: (f64, f64)) -> bool {
        let (mut from, mut to) = (0.0_f64, 1.0_f64);
        for (start, step, min, max) in
            [(self.start.0, self.step.0, min.0, max.0), (self.start.1, self.step.1, min.1, max.1)]
        {
            if step == 0.0 {
                if start < min || start > max {
                    return false;
                }
            } else {
                let (a, b) = ((min - start) / step, (max - start) / step);
                from = from.max(a.min(b));
                to = to.min(a.max(b));
            }
        }
        from <= to
    }
}

impl<'a> Lens<'a> {
    /// A region seen from a map; `None` for polygons and for regions too far from the root.
    pub fn new(region: &'a Region, grid: &'a Grid) -> Option<Self> {
        let bounds = region.bounds();
        let shape = match region.shape() {
            Shape::Rectangle => Scaled::Rectangle {
                lo: in_leaves(grid, (bounds.x.lo(), bounds.y.lo())),
                hi: in_leaves(grid, (bounds.x.hi(), bounds.y.hi())),
            },
            Shape::Disc { center, radius } => {
                Scaled::Disc { center: in_leaves(grid, *center), radius: radius / grid.resolution(), region }
            }
            Shape::Polygon { .. } => return None,
            Shape::Path { pieces, radius } => Scaled::Path(Capsules::new(pieces, *radius, grid)),
        };
        Self::of(shape, bounds, grid)
    }

    /// One piece of a path, or a stretch of one, and everything within `radius` of it. `bounds` are those of the whole path: a
    /// leaf that meets the path meets one of its pieces only if both are asked about the same leaves.
    pub fn capsule(piece: &'a [Segment; 1], radius: f64, bounds: Box2, grid: &'a Grid) -> Option<Self> {
        Self::of(Scaled::Path(Capsules::new(piece, radius, grid)), bounds, grid)
    }

    fn of(shape: Scaled<'a>, bounds: Box2, grid: &'a Grid) -> Option<Self> {
        let (lo, hi) =
            (in_leaves(grid, (bounds.x.lo(), bounds.y.lo())), in_leaves(grid, (bounds.x.hi(), bounds.y.hi())));
        let most = f64::from(grid.side()) + REACH;
        let near = lo.0 >= -REACH && lo.1 >= -REACH && hi.0 <= most && hi.1 <= most;
        near.then(|| Self { grid, bounds, slack: 4.0 * grid.cell_slack(), shape, part: (lo, hi), range: None })
    }

    /// Parts of the region that are looked at one after the other, each with a descent of its own.
    pub fn parts(&self) -> usize {
        match &self.shape {
            Scaled::Path(capsules) => capsules.pieces.len().div_ceil(GROUP),
            _ => 1,
        }
    }

    /// Turns to a part; the smallest node that holds all of its leaves, `None` when it has none in the root.
    pub fn turn_to(&mut self, part: usize) -> Option<NodeAddress> {
        let (lo, hi) = match &mut self.shape {
            Scaled::Rectangle { lo, hi } => (*lo, *hi),
            Scaled::Disc { center: (x, y), radius, .. } => ((*x - *radius, *y - *radius), (*x + *radius, *y + *radius)),
            Scaled::Path(capsules) => capsules.turn_to(part * GROUP),
        };
        let (lo, hi) = ((lo.0 - self.slack, lo.1 - self.slack), (hi.0 + self.slack, hi.1 + self.slack));
        self.part = (lo, hi);
        let last = f64::from(self.grid.side() - 1);
        let ((first_x, first_y), (last_x, last_y)) = ((lo.0.floor(), lo.1.floor()), (hi.0.floor(), hi.1.floor()));
        if first_x > last || first_y > last || last_x < 0.0 || last_y < 0.0 {
            return None;
        }
        let index = |v: f64| v.clamp(0.0, last) as u32;
        let top = smallest_node(self.grid.depth(), [index(first_x), index(first_y)], [index(last_x), index(last_y)]);
        if let Scaled::Path(capsules) = &mut self.shape {
            capsules.open[usize::from(top.depth)] = capsules.all();
            capsules.top = top.depth;
        }
        Some(top)
    }

    /// Does a leaf meet the capsule that this is a lens of? By itself, without a descent.
    pub fn meets(&mut self, leaf: NodeAddress) -> bool {
        if let Scaled::Path(capsules) = &mut self.shape {
            capsules.open[usize::from(leaf.depth)] = capsules.all();
        }
        self.classify(leaf) == Cover::All
    }

    /// How much of a node the part meets; for a path the node's parent came before it, or it is the part's first.
    pub fn classify(&mut self, node: NodeAddress) -> Cover {
        let levels = self.grid.depth() - node.depth;
        let side = f64::from(1_u32 << levels);
        let square = Square { min: (f64::from(node.x) * side, f64::from(node.y) * side), side };
        let (is_leaf, slack) = (levels == 0, self.slack);
        if side > BOX_SIDE {
            let ((lo, hi), max) = (self.part, square.max());
            if lo.0 > max.0 || lo.1 > max.1 || hi.0 < square.min.0 || hi.1 < square.min.1 {
                return Cover::Apart;
            }
            if side >= (hi.0 - lo.0).max(hi.1 - lo.1) {
                if let Scaled::Path(capsules) = &mut self.shape {
                    capsules.open[usize::from(node.depth) + 1] = capsules.open[usize::from(node.depth)];
                }
                return Cover::Some;
            }
        }
        let (reach, covers) = match &mut self.shape {
            Scaled::Rectangle { lo, hi } => rectangle(*lo, *hi, square, slack),
            Scaled::Disc { center, radius, .. } => {
                let reach = against(square.near_squared(*center), *radius, slack);
                (reach, !is_leaf && against(square.far_squared(*center), *radius, slack) == Reach::Within)
            }
            Scaled::Path(capsules) if is_leaf => (capsules.leaf(square, node.depth, slack), false),
            Scaled::Path(capsules) => return capsules.node(square, node.depth, slack),
        };
        match reach {
            Reach::Beyond => Cover::Apart,
            _ if !is_leaf => {
                if covers {
                    Cover::All
                } else {
                    Cover::Some
                }
            }
            Reach::Within => Cover::All,
            Reach::Doubtful if self.meets_exactly(node) => Cover::All,
            Reach::Doubtful => Cover::Apart,
        }
    }

    /// The region's own test of a leaf, by its exact box.
    #[cold]
    fn meets_exactly(&mut self, leaf: NodeAddress) -> bool {
        let range = *self.range.get_or_insert_with(|| self.grid.leaves_meeting(&self.bounds).0);
        if leaf.x < range.min_x || leaf.x >= range.max_x || leaf.y < range.min_y || leaf.y >= range.max_y {
            return false;
        }
        let square = self.grid.node_box(leaf);
        match &self.shape {
            // Exact in the range above.
            Scaled::Rectangle { .. } => true,
            Scaled::Disc { region, .. } => region.meets(&square),
            Scaled::Path(capsules) => {
                capsules.open[usize::from(leaf.depth) + 1] != 0 && capsules.doubtful(leaf, &square)
            }
        }
    }
}

impl<'a> Capsules<'a> {
    fn new(pieces: &'a [Segment], radius: f64, grid: &Grid) -> Self {
        let line = |piece: &Segment| {
            let (start, end) = (in_leaves(grid, piece.start), in_leaves(grid, piece.end));
            let step = (end.0 - start.0, end.1 - start.1);
            let squared = step.0 * step.0 + step.1 * step.1;
            Line { start, step, inverse: if squared > POINT { squared.recip() } else { 0.0 } }
        };
        Self {
            pieces,
            lines: pieces.iter().map(line).collect(),
            radius: radius / grid.resolution(),
            radius_m: radius,
            first: 0,
            top: 0,
            open: [0; MAX_DEPTH as usize + 2],
        }
    }

    fn group(&self) -> &[Line] {
        &self.lines[self.first..self.lines.len().min(self.first + GROUP)]
    }

    /// The bits of all pieces of the group.
    fn all(&self) -> u64 {
        u64::MAX >> (GROUP - self.group().len().clamp(1, GROUP))
    }

    /// The pieces that may meet the node at this depth that was classified last, or all where the search began below.
    pub(super) fn candidates(&self, depth: u8) -> u64 {
        if self.top > depth { self.all() } else { self.open[usize::from(depth) + 1] }
    }

    /// The bounds of a group.
    fn turn_to(&mut self, first: usize) -> ((f64, f64), (f64, f64)) {
        self.first = first;
        let (mut lo, mut hi) = ((f64::INFINITY, f64::INFINITY), (f64::NEG_INFINITY, f64::NEG_INFINITY));
        for line in self.group() {
            for (x, y) in [line.start, line.end()] {
                lo = (lo.0.min(x), lo.1.min(y));
                hi = (hi.0.max(x), hi.1.max(y));
            }
        }
        let r = self.radius;
        ((lo.0 - r, lo.1 - r), (hi.0 + r, hi.1 + r))
    }

    /// A node above the leaves, by the circles about and within it: what they do not settle its children do.
    fn node(&mut self, square: Square, depth: u8, slack: f64) -> Cover {
        let half = 0.5 * square.side;
        let center = (square.min.0 + half, square.min.1 + half);
        let (out, within) = (self.radius + slack + half * SQRT_2, self.radius - slack - half * SQRT_2);
        let (out, within) = (out * out, if within > 0.0 { within * within } else { -1.0 });
        let mut some = 0;
        for bit in bits(self.open[usize::from(depth)]) {
            let distance = self.lines[self.first + bit].distance_squared(center);
            if distance <= within {
                // The children of a node that one piece covers need to know of no other.
                self.open[usize::from(depth) + 1] = 1 << bit;
                return Cover::All;
            }
            some |= u64::from(distance <= out) << bit;
        }
        self.open[usize::from(depth) + 1] = some;
        if some == 0 { Cover::Apart } else { Cover::Some }
    }

    /// A leaf; the pieces in doubt are noted below it.
    fn leaf(&mut self, square: Square, depth: u8, slack: f64) -> Reach {
        let half = 0.5 * square.side;
        let center = (square.min.0 + half, square.min.1 + half);
        let (out, sure) = (self.radius + slack + half * SQRT_2, self.radius - slack + half);
        let (out, sure) = (out * out, sure * sure);
        let mut doubtful = 0;
        for bit in bits(self.open[usize::from(depth)]) {
            let line = &self.lines[self.first + bit];
            let distance = line.distance_squared(center);
            if distance > out {
                continue;
            }
            let reach =
                if distance <= sure { Reach::Within } else { against(line.gap_squared(square), self.radius, slack) };
            match reach {
                Reach::Within => return Reach::Within,
                Reach::Doubtful => doubtful |= 1 << bit,
                Reach::Beyond => {}
            }
        }
        self.open[usize::from(depth) + 1] = doubtful;
        if doubtful == 0 { Reach::Beyond } else { Reach::Doubtful }
    }

    /// The exact test of the pieces that were in doubt at a leaf.
    fn doubtful(&self, leaf: NodeAddress, square: &Box2) -> bool {
        bits(self.open[usize::from(leaf.depth) + 1])
            .any(|bit| self.pieces[self.first + bit].comes_within(square, self.radius_m, LEAF_SLACK))
    }
}

/// The places of the ones in a word.
pub(super) fn bits(mut word: u64) -> impl Iterator<Item = usize> {
    std::iter::from_fn(move || {
        let bit = word.trailing_zeros() as usize;
        let found = word != 0;
        word &= word.wrapping_sub(1);
        found.then_some(bit)
    })
}

/// A squared distance against a radius.
fn against(squared: f64, radius: f64, slack: f64) -> Reach {
    let (out, within) = (radius + slack, radius - slack);
    if squared > out * out {
        Reach::Beyond
    } else if within >= 0.0 && squared <= within * within {
        Reach::Within
    } else {
        Reach::Doubtful
    }
}

/// A box against a square, and whether it holds all of it.
fn rectangle(lo: (f64, f64), hi: (f64, f64), square: Square, slack: f64) -> (Reach, bool) {
    let (min, max) = (square.min, square.max());
    // How far the two reach into one another along each axis; below zero they are apart.
    let overlap = (max.0 - lo.0).min(hi.0 - min.0).min(max.1 - lo.1).min(hi.1 - min.1);
    let inside = (min.0 - lo.0).min(hi.0 - max.0).min(min.1 - lo.1).min(hi.1 - max.1);
    let reach = if overlap < -slack {
        Reach::Beyond
    } else if overlap > slack {
        Reach::Within
    } else {
        Reach::Doubtful
    };
    (reach, inside > slack)
}

fn in_leaves(grid: &Grid, (x, y): (f64, f64)) -> (f64, f64) {
    let (origin_x, origin_y) = grid.origin();
    ((x - origin_x) / grid.resolution(), (y - origin_y) / grid.resolution())
}

/// The deepest node that holds the leaves from `first` to `last`.
pub fn smallest_node(depth: u8, first: [u32; 2], last: [u32; 2]) -> NodeAddress {
    let differing = (first[0] ^ last[0]) | (first[1] ^ last[1]);
    let levels = u32::BITS - differing.leading_zeros();
    NodeAddress { depth: depth - levels as u8, x: first[0] >> levels, y: first[1] >> levels }
}

//! A region's test of the nodes of a tree, in the order of a descent from the root.

use super::polygon::PolygonProbe;
use super::segment::{LEAF_SLACK, NODE_SLACK, Segment};
use super::{Region, Shape};
use crate::interval::Box2;

/// How much of a node a region meets.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Cover {
    /// No leaf of the node meets the region.
    Apart,
    /// Some leaves may meet it. Never said of a leaf.
    Some,
    /// Every leaf of the node meets it.
    All,
}

/// Tests the nodes of one descent from the root, each after its parent: what a parent could not settle is handed down.
#[derive(Debug)]
pub enum Probe<'a> {
    /// A closed box.
    Rectangle(Box2),
    /// A closed disc.
    Disc {
        /// Centre, metres.
        center: (f64, f64),
        /// Squared radius, rounded up.
        outer: f64,
        /// Squared radius, rounded down.
        inner: f64,
    },
    /// A polygon.
    Polygon(PolygonProbe<'a>),
    /// A path.
    Path(PathProbe<'a>),
}

impl<'a> Probe<'a> {
    pub fn new(region: &'a Region) -> Self {
        match region.shape() {
            Shape::Rectangle => Self::Rectangle(region.bounds()),
            Shape::Disc { center, radius } => {
                // Gaps between a float and a box are rounded once; the two squares, their sum and the radius' square
                // add 5 roundings of 2^-53 each. Squares below the smallest normal number lose more than that.
                let squared = radius * radius;
                let outer = squared * (1.0 + 4.0 * f64::EPSILON) + f64::MIN_POSITIVE;
                let inner = squared * (1.0 - 4.0 * f64::EPSILON);
                Self::Disc { center: *center, outer, inner }
            }
            Shape::Polygon { edges } => Self::Polygon(PolygonProbe::new(edges)),
            Shape::Path { pieces, radius } => Self::Path(PathProbe::new(pieces, *radius)),
        }
    }

    /// The probe of a path of the given pieces.
    pub fn capsule(pieces: &'a [Segment], radius: f64) -> Self {
        Self::Path(PathProbe::new(pieces, radius))
    }

    /// Classifies a node at `depth` (0 for the first of a descent) with the closed box `square`; its parent came before.
    pub fn classify(&mut self, depth: u8, square: &Box2, is_leaf: bool) -> Cover {
        match self {
            Self::Rectangle(bounds) => by(bounds.meets(*square), is_leaf || bounds.encloses(*square)),
            Self::Disc { center, outer, inner } => {
                let (near, far) = distances_squared(square, *center);
                by(near <= *outer, is_leaf || far <= *inner)
            }
            Self::Polygon(probe) => probe.classify(depth, square, is_leaf),
            Self::Path(probe) => probe.classify(depth, square, is_leaf),
        }
    }
}

fn by(meets: bool, all: bool) -> Cover {
    match (meets, all) {
        (false, _) => Cover::Apart,
        (true, true) => Cover::All,
        (true, false) => Cover::Some,
    }
}

/// Squares of the smallest and the largest distance between a point and a box.
///
/// Differences, squares and sums of floats round monotonically, so a box within another never has a smaller one.
fn distances_squared(square: &Box2, (x, y): (f64, f64)) -> (f64, f64) {
    let axis = |lo: f64, hi: f64, v: f64| ((lo - v).max(v - hi).max(0.0), (hi - v).max(v - lo));
    let (near_x, far_x) = axis(square.x.lo(), square.x.hi(), x);
    let (near_y, far_y) = axis(square.y.lo(), square.y.hi(), y);
    (near_x * near_x + near_y * near_y, far_x * far_x + far_y * far_y)
}

/// A union of capsules: the pieces that may come within reach of a node are passed down to its children.
#[derive(Debug)]
pub struct PathProbe<'a> {
    pieces: &'a [Segment],
    radius: f64,
    /// Numbers of pieces, the lists of the nodes from the root to the one looked at last.
    lists: Vec<u32>,
    /// Ends of these lists, of the list of all pieces first.
    ends: Vec<(usize, usize)>,
}

impl<'a> PathProbe<'a> {
    pub fn new(pieces: &'a [Segment], radius: f64) -> Self {
        let mut lists = Vec::with_capacity(2 * pieces.len() + 32);
        lists.extend((0_u32..).take(pieces.len()));
        Self { pieces, radius, lists, ends: vec![(0, pieces.len())] }
    }

    fn classify(&mut self, depth: u8, square: &Box2, is_leaf: bool) -> Cover {
        let slack = if is_leaf { LEAF_SLACK } else { NODE_SLACK };
        self.ends.truncate(usize::from(depth) + 1);
        let Some((start, end)) = self.ends.last().copied() else { return Cover::Some };
        self.lists.truncate(end);
        for i in start..end {
            let number = self.lists[i];
            let piece = &self.pieces[number as usize];
            if piece.comes_within(square, self.radius, slack) {
                if is_leaf || piece.covers(square, self.radius) {
                    // The children of a node that one piece covers need to know of no other.
                    self.lists.truncate(end);
                    self.lists.push(number);
                    self.ends.push((end, end + 1));
                    return Cover::All;
                }
                self.lists.push(number);
            }
        }
        self.ends.push((end, self.lists.len()));
        if self.lists.len() > end { Cover::Some } else { Cover::Apart }
    }
}

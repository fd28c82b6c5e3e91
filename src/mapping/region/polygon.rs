//! Polygons against nodes: edges are passed down from a node to its children, so that each node looks only at those
//! that its parent could not settle.

use super::Cover;
use super::segment::{LEAF_SLACK, NODE_SLACK, Segment};
use crate::interval::Box2;

/// What one node hands to its children: edges that meet it, edges to its right on which the parity of some of its
/// points still depends, and the parity of all others to its right.
#[derive(Debug, Clone, Copy)]
struct Level {
    /// First edge of the node's list.
    start: usize,
    /// End of the edges that meet the node; edges to the right follow.
    near_end: usize,
    /// End of the list.
    end: usize,
    /// True when an odd number of the edges that are settled lie to the right of every point of the node.
    odd: bool,
}

/// Tests the nodes of one descent from the root, each after its parent.
#[derive(Debug)]
pub struct PolygonProbe<'a> {
    edges: &'a [Segment],
    /// Edge numbers, the lists of the nodes from the root to the one looked at last.
    lists: Vec<u32>,
    levels: Vec<Level>,
}

impl<'a> PolygonProbe<'a> {
    pub fn new(edges: &'a [Segment]) -> Self {
        let mut lists = Vec::with_capacity(2 * edges.len() + 64);
        lists.extend((0_u32..).take(edges.len()));
        let all = Level { start: 0, near_end: edges.len(), end: edges.len(), odd: false };
        Self { edges, lists, levels: vec![all] }
    }

    /// Classifies a node by the list of the one `depth` levels above which it stands.
    ///
    /// A closed box meets the closed polygon when it meets an edge; else it lies inside or outside as a whole, and the
    /// parity of the edges that a ray from its centre to the right crosses tells which. Such an edge is apart from the
    /// box by more than the rounding, so on which side of it the edge passes is certain.
    pub fn classify(&mut self, depth: u8, square: &Box2, is_leaf: bool) -> Cover {
        let slack = if is_leaf { LEAF_SLACK } else { NODE_SLACK };
        self.levels.truncate(usize::from(depth) + 1);
        let Some(parent) = self.levels.last().copied() else { return Cover::Some };
        self.lists.truncate(parent.end);
        let mut odd = parent.odd;
        for i in parent.start..parent.near_end {
            let edge = self.lists[i];
            if self.edges[edge as usize].comes_within(square, 0.0, slack) {
                if is_leaf {
                    return Cover::All;
                }
                self.lists.push(edge);
            }
        }
        let near_end = self.lists.len();
        for i in parent.start..parent.end {
            let edge = &self.edges[self.lists[i] as usize];
            if i < parent.near_end && near_end > parent.end && edge.comes_within(square, 0.0, slack) {
                continue;
            }
            match beside(edge, square) {
                Side::Apart => {}
                Side::RightOfAll => odd = !odd,
                Side::RightOfSome => {
                    let edge = self.lists[i];
                    self.lists.push(edge);
                }
            }
        }
        let level = Level { start: parent.end, near_end, end: self.lists.len(), odd };
        self.levels.push(level);
        if level.near_end > level.start {
            return Cover::Some;
        }
        let y = square.y.mid();
        let crossed = self.lists[level.near_end..level.end].iter().filter(|e| counts_at(&self.edges[**e as usize], y));
        if (crossed.count() % 2 == 1) == odd { Cover::Apart } else { Cover::All }
    }
}

/// An edge counts for the rays at heights in `[min, max)` of its ends: each corner once, a level edge never.
fn counts_at(edge: &Segment, y: f64) -> bool {
    (edge.start.1 <= y) != (edge.end.1 <= y)
}

/// Where an edge that does not meet a box passes it.
enum Side {
    /// Left of it, above or below: no ray from the box to the right crosses it.
    Apart,
    /// Every ray from the box to the right crosses it.
    RightOfAll,
    /// Some rays from the box to the right may cross it.
    RightOfSome,
}

fn beside(edge: &Segment, square: &Box2) -> Side {
    let (low, high) = if edge.start.1 <= edge.end.1 { (edge.start, edge.end) } else { (edge.end, edge.start) };
    let (bottom, top) = (square.y.lo(), square.y.hi());
    if low.1 == high.1 || high.1 <= bottom || low.1 > top || low.0.max(high.0) < square.x.lo() {
        return Side::Apart;
    }
    if low.0.min(high.0) <= square.x.hi() {
        // A point of the edge at a height of the box: the edge's part at these heights is on the same side of the box,
        // for it is connected and does not meet it.
        let y = 0.5 * (low.1.max(bottom) + high.1.min(top));
        let share = ((y - low.1) / (high.1 - low.1)).clamp(0.0, 1.0);
        if low.0 + share * (high.0 - low.0) < square.x.mid() {
            return Side::Apart;
        }
    }
    if low.1 <= bottom && high.1 > top { Side::RightOfAll } else { Side::RightOfSome }
}

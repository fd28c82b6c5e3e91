//! The paper's algorithms as it has them: regular subpavings, SIVIA (Alg. 1), BUILDSP and UBBMAP (Alg. 2), node by node on
//! the quadtree.
//!
//! The fast engine draws whole scans on bit canvases and shares none of this; tests hold it between what these algorithms
//! show and what they allow.

use super::Reference;
use crate::interval::{Box2, Verdict};
use crate::mapping::{EvidenceRule, MapConfig};
use crate::quadtree::{Grid, NodeAddress, ReferenceTree};
use crate::sensor::{Reading, Scan, natural_measurement_box};

/// The root of every tree.
const ROOT: NodeAddress = NodeAddress { depth: 0, x: 0, y: 0 };

/// A regular subpaving: nodes of the quadtree, none below another, in Z-order. Four siblings are held as their parent, so a
/// set of leaves has one form.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Subpaving {
    nodes: Vec<NodeAddress>,
}

impl Subpaving {
    /// The nodes, in Z-order.
    #[must_use]
    pub fn nodes(&self) -> &[NodeAddress] {
        &self.nodes
    }

    /// True when a node, or one above it, is a member.
    #[must_use]
    pub fn holds(&self, node: NodeAddress) -> bool {
        self.nodes.iter().any(|member| {
            let levels = node.depth.checked_sub(member.depth);
            levels.is_some_and(|levels| node.x >> levels == member.x && node.y >> levels == member.y)
        })
    }

    /// The members' leaves in a tree of `depth`, in Z-order of the members.
    pub fn leaves(&self, depth: u8) -> impl Iterator<Item = NodeAddress> + '_ {
        self.nodes.iter().flat_map(move |node| {
            let levels = depth.saturating_sub(node.depth);
            let (x, y, side) = (node.x << levels, node.y << levels, 1_u32 << levels);
            (y..y + side).flat_map(move |y| (x..x + side).map(move |x| NodeAddress { depth, x, y }))
        })
    }

    /// Adds a node behind all others, and merges it with its siblings where it is the last of four.
    fn push(&mut self, node: NodeAddress) {
        self.nodes.push(node);
        while let [.., a, b, c, d] = &self.nodes[..]
            && d.depth > 0
            && [a, b, c].iter().all(|sibling| sibling.depth == d.depth)
            && [a, b, c].iter().all(|sibling| parent(**sibling) == parent(*d))
        {
            let merged = parent(*d);
            self.nodes.truncate(self.nodes.len() - 4);
            self.nodes.push(merged);
        }
    }
}

fn parent(node: NodeAddress) -> NodeAddress {
    NodeAddress { depth: node.depth.saturating_sub(1), x: node.x >> 1, y: node.y >> 1 }
}

fn children(node: NodeAddress) -> [NodeAddress; 4] {
    let (depth, x, y) = (node.depth + 1, 2 * node.x, 2 * node.y);
    [(0, 0), (1, 0), (0, 1), (1, 1)].map(|(dx, dy)| NodeAddress { depth, x: x + dx, y: y + dy })
}

/// What SIVIA finds of a set: `inside` lies in it, and it lies in `inside` and `boundary` together.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Enclosure {
    /// Nodes that the test showed to be in the set.
    pub inside: Subpaving,
    /// Leaves that the test could not decide.
    pub boundary: Subpaving,
}

/// SIVIA, set inversion via interval analysis (Alg. 1): the set on which `test` holds, enclosed by two subpavings.
///
/// A node that the test decides is kept or dropped whole; one that it does not is split, down to the leaves (the paper's
/// epsilon). The paper bisects, which visits the same leaves by twice as many steps.
pub fn sivia(grid: &Grid, test: &mut dyn FnMut(&Box2) -> Verdict) -> Enclosure {
    let mut found = Enclosure::default();
    invert(grid, ROOT, test, &mut found);
    found
}

fn invert(grid: &Grid, node: NodeAddress, test: &mut dyn FnMut(&Box2) -> Verdict, found: &mut Enclosure) {
    match test(&grid.node_box(node)) {
        Verdict::No => {}
        Verdict::Yes => found.inside.push(node),
        Verdict::Unknown if node.depth == grid.depth() => found.boundary.push(node),
        Verdict::Unknown => children(node).into_iter().for_each(|child| invert(grid, child, test, found)),
    }
}

/// BUILDSP: the smallest regular subpaving of leaves that covers closed boxes (metres), as far as they lie in the root.
#[must_use]
pub fn buildsp(grid: &Grid, boxes: &[Box2]) -> Subpaving {
    let mut cover = Subpaving::default();
    build(grid, ROOT, boxes, &mut cover);
    cover
}

fn build(grid: &Grid, node: NodeAddress, boxes: &[Box2], cover: &mut Subpaving) {
    let square = grid.node_box(node);
    let met: Vec<Box2> = boxes.iter().copied().filter(|other| other.meets(square)).collect();
    if met.is_empty() {
        return;
    }
    if node.depth == grid.depth() || met.iter().any(|other| other.encloses(square)) {
        cover.push(node);
    } else {
        children(node).into_iter().for_each(|child| build(grid, child, &met, cover));
    }
}

impl Reference<'_> {
    /// X_OCC (7): BUILDSP of the paper's measurement boxes.
    #[must_use]
    pub fn occupied_set(&self, grid: &Grid) -> Subpaving {
        let (pose, sensor) = (self.scan.pose(), self.scan.sensor());
        let boxes: Vec<Box2> = (0..self.scan.beams())
            .filter_map(|beam| match self.scan.reading(beam) {
                Reading::Return { near, far } => {
                    Some(natural_measurement_box(pose, sensor, self.scan.angle(beam), near, far))
                }
                Reading::NoReturn | Reading::Failed => None,
            })
            .collect();
        buildsp(grid, &boxes)
    }

    /// The empty part of any beam by SIVIA with the inclusion test (8), (9): `inside` for every pose.
    #[must_use]
    pub fn empty_set(&self, grid: &Grid) -> Enclosure {
        sivia(grid, &mut |square| {
            (0..self.scan.beams()).fold(Verdict::No, |found, beam| match found {
                Verdict::Yes => found,
                _ => found.or(self.inclusion(beam, square)),
            })
        })
    }
}

/// One step of UBBMAP (Alg. 2): X_OCC by BUILDSP, X_EMP by SIVIA, `X_EMP := X_EMP \ X_OCC`, and a step of the class of every
/// leaf in either.
///
/// By the rule `outer`, X_EMP (12) is all that SIVIA does not exclude; by `inner` (10), (11) the inside and those leaves of the
/// boundary that pass for one beam with all their corners; by `guaranteed` (model section 4) every leaf of what SIVIA does not
/// exclude that the rule for whole boxes proves, and the footprint is left out.
pub fn ubbmap(tree: &mut ReferenceTree, config: &MapConfig, scan: &Scan) {
    let reference = Reference::new(scan, config.min_obstacle_width());
    let (grid, depth) = (config.grid(), config.grid().depth());
    let occupied = reference.occupied_set(grid);
    let Enclosure { inside, boundary } = reference.empty_set(grid);
    let proven = |leaf: &NodeAddress| reference.proves(&grid.node_box(*leaf));
    let passes = |leaf: &NodeAddress| {
        let square = grid.node_box(*leaf);
        (0..scan.beams()).any(|beam| reference.may_be_inner(beam, &square, 0.0))
    };
    let empty: Vec<NodeAddress> = match config.rule() {
        EvidenceRule::Outer => inside.leaves(depth).chain(boundary.leaves(depth)).collect(),
        EvidenceRule::Inner => inside.leaves(depth).chain(boundary.leaves(depth).filter(passes)).collect(),
        EvidenceRule::Guaranteed => inside.leaves(depth).chain(boundary.leaves(depth)).filter(proven).collect(),
    };
    for leaf in empty.into_iter().filter(|leaf| !occupied.holds(*leaf)) {
        tree.update(leaf.x, leaf.y, false);
    }
    for leaf in occupied.leaves(depth) {
        tree.update(leaf.x, leaf.y, true);
    }
}

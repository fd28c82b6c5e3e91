//! The guaranteed-free query: model section 4, "What a class then says".

use super::Region;
use super::outside::{self, Overhang};
use super::region::{Cover, Probe, Segment, Shape};
use crate::interval::Box2;
use crate::quadtree::{Class, Grid, LeafRange, NodeAddress, OccupancyTree};

/// Why a region is not guaranteed free.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Reason {
    /// The witness's class is above unknown.
    Occupied,
    /// The witness is unknown, or outside the root.
    Unknown,
    /// The witness is below unknown, but not by enough for the tolerance.
    Tolerance,
}

/// A leaf that keeps a region from being guaranteed free.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Witness {
    /// The leaf at the map's depth; `None` where the witness lies outside the root.
    pub node: Option<NodeAddress>,
    /// Its class; unknown outside the root.
    pub class: Class,
    /// Its min corner, metres; outside the root, of the cell of the same lattice.
    pub min: (f64, f64),
    /// Its side, metres.
    pub size: f64,
    /// For a path: how far along it from its start the witness is first met, metres.
    pub distance: Option<f64>,
}

/// The answer for one region.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FreeAnswer {
    /// True exactly when every leaf that meets the region has class `<= u - 1 - tolerance`.
    pub free: bool,
    /// The largest class of the leaves that meet the region; unknown counts for what is outside the root.
    pub max_class: Class,
    /// Why not, and where: of the worst class for boxes, discs and polygons, the first one along a path.
    pub refusal: Option<(Reason, Witness)>,
}

/// Is a region guaranteed free in a map, if at most `tolerance` of the scans applied there broke an assumption?
///
/// Coarse nodes first: a node whose maximum is low enough answers for all its leaves. Tests round outward: a leaf that
/// merely touches the closed region counts. `tolerance` is at most `u - 2` (checked by the caller; larger is never met).
///
/// The witness is the first leaf in Z-order of the largest class, a leaf of the map before one outside the root; along
/// a path it is the leaf above the allowed class that a disc of the path's radius touches first on its way, of those
/// touched at the same moment the first in Z-order. A region that touches the root's edge from within does not reach
/// outside.
#[must_use]
pub fn guaranteed_free(tree: &OccupancyTree, grid: &Grid, region: &Region, tolerance: u8) -> FreeAnswer {
    let unknown = tree.scale().unknown();
    // 0 where no class is low enough: classes start at 1.
    let limit = unknown.saturating_sub(1).saturating_sub(tolerance);
    let query = Query { tree, grid, unknown };
    let overhang = outside::overhang(region, grid);
    let inside = query.largest_class(region);
    let max_class = if overhang.is_some() { inside.max(unknown) } else { inside };
    if max_class <= limit {
        return FreeAnswer { free: true, max_class, refusal: None };
    }
    let witness = match region.shape() {
        Shape::Path { pieces, radius } => query.first_along(pieces, *radius, limit),
        _ if inside == max_class => query.first_of_class(region, max_class),
        _ => overhang.map(|overhang| query.outer_witness(overhang, None)),
    };
    let refusal = witness.map(|witness| (reason(witness.class, unknown), witness));
    FreeAnswer { free: false, max_class, refusal }
}

fn reason(class: Class, unknown: Class) -> Reason {
    match class.cmp(&unknown) {
        std::cmp::Ordering::Greater => Reason::Occupied,
        std::cmp::Ordering::Equal => Reason::Unknown,
        std::cmp::Ordering::Less => Reason::Tolerance,
    }
}

/// A map as it is asked.
struct Query<'a> {
    tree: &'a OccupancyTree,
    grid: &'a Grid,
    unknown: Class,
}

/// How a walk goes on from a node.
enum Next {
    /// Not below this node.
    Skip,
    /// Into its children.
    Into,
    /// Nowhere: the walk ends.
    Stop,
}

/// A walk over the nodes that meet a region, each before its children, in Z-order.
///
/// It begins at the smallest node that holds the region. Of each node the place among whole cells is asked first, then
/// its maximum class, and only then the geometry.
struct Walk<'a, 'p, W, V> {
    query: &'a Query<'a>,
    range: LeafRange,
    /// Depth of the node at which it began.
    base: u8,
    probe: &'a mut Probe<'p>,
    /// Is anything wanted below a node of this maximum class?
    wanted: W,
    visit: V,
}

impl<W: Fn(Class) -> bool, V: FnMut(NodeAddress, Class, Cover) -> Next> Walk<'_, '_, W, V> {
    /// Walks a node and what is below; false when the walk was stopped.
    fn node(&mut self, node: NodeAddress) -> bool {
        let levels = self.query.tree.depth() - node.depth;
        if !overlaps(&self.range, node, levels) {
            return true;
        }
        let max = self.query.tree.max_class(node);
        if !(self.wanted)(max) {
            return true;
        }
        let square = self.query.grid.node_box(node);
        let next = match self.probe.classify(node.depth - self.base, &square, levels == 0) {
            Cover::Apart => Next::Skip,
            cover => (self.visit)(node, max, cover),
        };
        match next {
            Next::Skip => true,
            Next::Stop => false,
            Next::Into => {
                levels == 0
                    || [(0, 0), (1, 0), (0, 1), (1, 1)].into_iter().all(|(x, y)| {
                        self.node(NodeAddress { depth: node.depth + 1, x: node.x << 1 | x, y: node.y << 1 | y })
                    })
            }
        }
    }
}

impl Query<'_> {
    /// Walks the nodes that may hold a leaf that meets a region with these bounds.
    fn walk(
        &self,
        bounds: &Box2,
        probe: &mut Probe<'_>,
        wanted: impl Fn(Class) -> bool,
        visit: impl FnMut(NodeAddress, Class, Cover) -> Next,
    ) {
        let (range, _) = self.grid.leaves_meeting(bounds);
        if range.is_empty() {
            return;
        }
        let (last_x, last_y) = (range.max_x - 1, range.max_y - 1);
        let differing = (range.min_x ^ last_x) | (range.min_y ^ last_y);
        let levels = u32::BITS - differing.leading_zeros();
        let base = self.tree.depth().saturating_sub(levels as u8);
        let top = NodeAddress { depth: base, x: range.min_x >> levels, y: range.min_y >> levels };
        Walk { query: self, range, base, probe, wanted, visit }.node(top);
    }

    /// The largest class of the leaves that meet a region; 0 when none does.
    fn largest_class(&self, region: &Region) -> Class {
        let largest = std::cell::Cell::new(0);
        let top = self.tree.scale().occupied();
        let visit = |_: NodeAddress, max: Class, cover: Cover| {
            if cover == Cover::Some {
                return Next::Into;
            }
            largest.set(max);
            if max >= top { Next::Stop } else { Next::Skip }
        };
        self.walk(&region.bounds(), &mut Probe::new(region), |max| max > largest.get(), visit);
        largest.get()
    }

    /// The first leaf in Z-order of a class that meets a region, where none of a larger class does.
    fn first_of_class(&self, region: &Region, class: Class) -> Option<Witness> {
        let mut found = None;
        let visit = |node: NodeAddress, max: Class, _: Cover| {
            if node.depth < self.tree.depth() {
                return Next::Into;
            }
            found = Some(self.inner_witness(node, max, None));
            Next::Stop
        };
        self.walk(&region.bounds(), &mut Probe::new(region), |max| max >= class, visit);
        found
    }

    /// The first leaf above `limit` that a disc meets on its way along a path.
    fn first_along(&self, pieces: &[Segment], radius: f64, limit: Class) -> Option<Witness> {
        let mut walked = 0.0;
        for piece in pieces {
            let inner = self.first_on_piece(piece, radius, limit);
            // What is outside is unknown, which no tolerance allows.
            let outer = outside::overhang_along(piece, radius, self.grid);
            match (inner, outer) {
                (Some((along, leaf, class)), None) => {
                    return Some(self.inner_witness(leaf, class, Some(walked + along)));
                }
                (Some((along, leaf, class)), Some((edge, _))) if along <= edge => {
                    return Some(self.inner_witness(leaf, class, Some(walked + along)));
                }
                (_, Some((edge, overhang))) => return Some(self.outer_witness(overhang, Some(walked + edge))),
                (None, None) => walked += piece.length(),
            }
        }
        None
    }

    /// The leaf above `limit` that a disc touches first on its way along one straight piece, and how far along.
    fn first_on_piece(&self, piece: &Segment, radius: f64, limit: Class) -> Option<(f64, NodeAddress, Class)> {
        let mut best: Option<(f64, NodeAddress, Class)> = None;
        // What a computed touch may be off by: where a box is grazed, a root of rounding (2^-26) of the sizes involved.
        let slack = 1e-7 * (piece.length() + radius + self.grid.resolution());
        let pieces = [*piece];
        let capsule = Region::capsule(piece, radius);
        let visit = |node: NodeAddress, max: Class, _: Cover| {
            let along = piece.first_touch(&self.grid.node_box(node), radius);
            let is_leaf = node.depth == self.tree.depth();
            match best {
                Some((first, ..)) if along > first + slack => Next::Skip,
                _ if !is_leaf => Next::Into,
                Some((first, ..)) if along >= first => Next::Skip,
                _ => {
                    best = Some((along, node, max));
                    Next::Skip
                }
            }
        };
        self.walk(&capsule, &mut Probe::capsule(&pieces, radius), |max| max > limit, visit);
        best
    }

    fn inner_witness(&self, leaf: NodeAddress, class: Class, distance: Option<f64>) -> Witness {
        let min = (self.edge(self.grid.origin().0, leaf.x), self.edge(self.grid.origin().1, leaf.y));
        Witness { node: Some(leaf), class, min, size: self.grid.resolution(), distance }
    }

    fn edge(&self, origin: f64, index: u32) -> f64 {
        origin + f64::from(index) * self.grid.resolution()
    }

    fn outer_witness(&self, overhang: Overhang, distance: Option<f64>) -> Witness {
        Witness { node: None, class: self.unknown, min: overhang.cell_min, size: self.grid.resolution(), distance }
    }
}

/// True when a node, `levels` above the leaves, has a leaf in the range.
fn overlaps(range: &LeafRange, node: NodeAddress, levels: u8) -> bool {
    let side = 1_u32 << levels;
    let (x, y) = (node.x << levels, node.y << levels);
    x < range.max_x && x + side > range.min_x && y < range.max_y && y + side > range.min_y
}

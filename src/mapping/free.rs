//! The guaranteed-free query: model section 4, "What a class then says".

use super::Region;
use super::outside::{self, Overhang};
use super::region::{Cover, Lens, Probe, Segment, Shape, smallest_node};
use crate::interval::Box2;
use crate::quadtree::{
    Block, BlockAddress, BlockSlot, Class, Descent, Grid, LeafRange, NodeAddress, OccupancyTree, Searcher, Tree,
};
use std::cell::Cell;
use std::f64::consts::FRAC_1_SQRT_2;

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
    let Ok(answer) = try_guaranteed_free(tree, grid, region, tolerance);
    answer
}

/// [`guaranteed_free`] in a map whose blocks may have to be fetched; only those are that the maxima above them do not
/// answer for.
///
/// # Errors
/// When such a block cannot be read.
pub fn try_guaranteed_free<S: BlockSlot>(
    tree: &Tree<S>,
    grid: &Grid,
    region: &Region,
    tolerance: u8,
) -> Result<FreeAnswer, S::Error> {
    let unknown = tree.scale().unknown();
    // 0 where no class is low enough: classes start at 1.
    let limit = unknown.saturating_sub(1).saturating_sub(tolerance);
    let query = Query { tree, grid, unknown };
    let overhang = outside::overhang(region, grid);
    let inside = query.largest_class(region)?;
    let max_class = if overhang.is_some() { inside.max(unknown) } else { inside };
    if max_class <= limit {
        return Ok(FreeAnswer { free: true, max_class, refusal: None });
    }
    let witness = match region.shape() {
        Shape::Path { pieces, radius } => {
            query.first_along(&Way { pieces, radius: *radius, bounds: region.bounds() }, limit)?
        }
        _ if inside == max_class => query.first_of_class(region, max_class)?,
        _ => overhang.map(|overhang| query.outer_witness(overhang, None)),
    };
    let refusal = witness.map(|witness| (reason(witness.class, unknown), witness));
    Ok(FreeAnswer { free: false, max_class, refusal })
}

fn reason(class: Class, unknown: Class) -> Reason {
    match class.cmp(&unknown) {
        std::cmp::Ordering::Greater => Reason::Occupied,
        std::cmp::Ordering::Equal => Reason::Unknown,
        std::cmp::Ordering::Less => Reason::Tolerance,
    }
}

/// A stretch of a path so many radii long is searched as it is.
const STRETCH: f64 = 4.0;

/// How far along a piece a leaf is touched, metres, the leaf and its class.
type Touch = (f64, NodeAddress, Class);

/// A path as its first leaf is looked for.
struct Way<'a> {
    pieces: &'a [Segment],
    /// Metres.
    radius: f64,
    /// Of the whole path.
    bounds: Box2,
}

/// A map as it is asked.
struct Query<'a, S: BlockSlot> {
    tree: &'a Tree<S>,
    grid: &'a Grid,
    unknown: Class,
}

/// How the nodes that a region meets are found.
#[expect(clippy::large_enum_variant, reason = "one a query, on the stack: a box would cost more than the query")]
enum Sieve<'a> {
    /// Nearly always.
    Quick(Lens<'a>),
    /// By exact boxes, for what no lens is made for: polygons and regions far from the root.
    Exact(Probe<'a>, Box2),
}

impl<'a> Sieve<'a> {
    fn new(region: &'a Region, grid: &'a Grid) -> Self {
        match Lens::new(region, grid) {
            Some(lens) => Self::Quick(lens),
            None => Self::Exact(Probe::new(region), region.bounds()),
        }
    }
}

impl<S: BlockSlot> Query<'_, S> {
    /// Visits the nodes that meet a region, each before its children, in Z-order, where anything is `wanted` of their
    /// maximum class; for a path once for each of its parts.
    ///
    /// It begins at the smallest node that holds the region. Of each node the class is asked before the geometry.
    fn walk(
        &self,
        sieve: Sieve<'_>,
        wanted: impl Fn(Class) -> bool,
        mut visit: impl FnMut(NodeAddress, Class, Cover) -> Descent,
    ) -> Result<(), S::Error> {
        match sieve {
            Sieve::Quick(mut lens) => {
                for part in 0..lens.parts() {
                    let Some(top) = lens.turn_to(part) else { continue };
                    let ran_through = self.tree.search(top, &mut |node: NodeAddress, max: Class| {
                        if !wanted(max) {
                            return Descent::Skip;
                        }
                        match lens.classify(node) {
                            Cover::Apart => Descent::Skip,
                            cover => visit(node, max, cover),
                        }
                    })?;
                    if !ran_through {
                        break;
                    }
                }
            }
            Sieve::Exact(mut probe, bounds) => {
                let (range, _) = self.grid.leaves_meeting(&bounds);
                if range.is_empty() {
                    return Ok(());
                }
                let (first, last) = ([range.min_x, range.min_y], [range.max_x - 1, range.max_y - 1]);
                let top = smallest_node(self.tree.depth(), first, last);
                self.tree.search(top, &mut |node: NodeAddress, max: Class| {
                    let levels = self.tree.depth() - node.depth;
                    if !wanted(max) || !overlaps(&range, node, levels) {
                        return Descent::Skip;
                    }
                    let square = self.grid.node_box(node);
                    match probe.classify(node.depth - top.depth, &square, levels == 0) {
                        Cover::Apart => Descent::Skip,
                        cover => visit(node, max, cover),
                    }
                })?;
            }
        }
        Ok(())
    }

    /// The largest class of the leaves that meet a region; 0 when none does.
    fn largest_class(&self, region: &Region) -> Result<Class, S::Error> {
        if let Some(lens) = Lens::new(region, self.grid) {
            return Largest { lens, largest: 0, top: self.tree.scale().occupied() }.find(self.tree);
        }
        let largest = Cell::new(0);
        let top = self.tree.scale().occupied();
        let visit = |_: NodeAddress, max: Class, cover: Cover| {
            if cover == Cover::Some {
                return Descent::Into;
            }
            largest.set(max);
            if max >= top { Descent::Stop } else { Descent::Skip }
        };
        self.walk(Sieve::new(region, self.grid), |max| max > largest.get(), visit)?;
        Ok(largest.get())
    }

    /// The first leaf in Z-order of a class that meets a region, where none of a larger class does.
    fn first_of_class(&self, region: &Region, class: Class) -> Result<Option<Witness>, S::Error> {
        let mut found = None;
        let visit = |node: NodeAddress, max: Class, _: Cover| {
            if node.depth < self.tree.depth() {
                return Descent::Into;
            }
            found = Some(self.inner_witness(node, max, None));
            Descent::Stop
        };
        self.walk(Sieve::new(region, self.grid), |max| max >= class, visit)?;
        Ok(found)
    }

    /// The first leaf above `limit` that a disc meets on its way along a path.
    fn first_along(&self, way: &Way<'_>, limit: Class) -> Result<Option<Witness>, S::Error> {
        let mut walked = 0.0;
        for piece in way.pieces {
            let inner = self.first_on_piece(way, piece, limit)?;
            // What is outside is unknown, which no tolerance allows.
            let outer = outside::overhang_along(piece, way.radius, self.grid);
            match (inner, outer) {
                (Some((along, leaf, class)), None) => {
                    return Ok(Some(self.inner_witness(leaf, class, Some(walked + along))));
                }
                (Some((along, leaf, class)), Some((edge, _))) if along <= edge => {
                    return Ok(Some(self.inner_witness(leaf, class, Some(walked + along))));
                }
                (_, Some((edge, overhang))) => return Ok(Some(self.outer_witness(overhang, Some(walked + edge)))),
                (None, None) => walked += piece.length(),
            }
        }
        Ok(None)
    }

    /// The leaf above `limit` that a disc touches first on its way along one straight piece, and how far along.
    fn first_on_piece(&self, way: &Way<'_>, piece: &Segment, limit: Class) -> Result<Option<Touch>, S::Error> {
        let (whole, radius) = ([*piece], way.radius);
        let Some(mut lens) = Lens::capsule(&whole, radius, way.bounds, self.grid) else {
            let sieve = Sieve::Exact(Probe::capsule(&whole, radius), way.bounds);
            return self.first_in(sieve, piece, radius, limit, |_| true);
        };
        // Most pieces have none, which is known much sooner than the first of some.
        if !self.any_above(way, &whole, radius, limit)? {
            return Ok(None);
        }
        let stretch = [self.first_stretch(way, piece, limit)?];
        let wide = radius + self.touch_slack(piece, radius);
        if let Some(near) = Lens::capsule(&stretch, wide, way.bounds, self.grid) {
            let found = self.first_in(Sieve::Quick(near), piece, radius, limit, |leaf| lens.meets(leaf))?;
            if found.is_some() {
                return Ok(found);
            }
        }
        self.first_in(Sieve::Quick(lens), piece, radius, limit, |_| true)
    }

    /// The first of the leaves above `limit` of a sieve that `meets` lets through.
    fn first_in(
        &self,
        sieve: Sieve<'_>,
        piece: &Segment,
        radius: f64,
        limit: Class,
        mut meets: impl FnMut(NodeAddress) -> bool,
    ) -> Result<Option<Touch>, S::Error> {
        let mut best: Option<Touch> = None;
        let slack = self.touch_slack(piece, radius);
        let visit = |node: NodeAddress, max: Class, _: Cover| {
            let first = best.map(|(first, ..)| first);
            if first.is_some_and(|first| self.least_along(piece, radius, node) > first + slack) {
                return Descent::Skip;
            }
            if node.depth < self.tree.depth() {
                return Descent::Into;
            }
            let along = piece.first_touch(&self.grid.node_box(node), radius);
            if first.is_none_or(|first| along < first) && meets(node) {
                best = Some((along, node, max));
            }
            Descent::Skip
        };
        self.walk(sieve, |max| max > limit, visit)?;
        Ok(best)
    }

    /// A stretch of a piece that has leaves above `limit` on which the first of them is touched, by halving.
    fn first_stretch(&self, way: &Way<'_>, piece: &Segment, limit: Class) -> Result<Segment, S::Error> {
        let radius = way.radius;
        let slack = self.touch_slack(piece, radius);
        let (mut from, mut to) = (0.0, piece.length());
        while to - from > STRETCH * (radius + self.grid.resolution()) {
            let middle = 0.5 * (from + to) + slack;
            let half = [Segment::new(piece.at(from), piece.at(middle))];
            if self.any_above(way, &half, radius + slack, limit)? {
                to = middle;
            } else {
                from = middle - slack;
            }
        }
        Ok(Segment::new(piece.at(from), piece.at(to)))
    }

    /// Does a leaf above `limit` meet a piece of a way and what is within `radius` of it? True also where no lens can tell.
    fn any_above(&self, way: &Way<'_>, piece: &[Segment; 1], radius: f64, limit: Class) -> Result<bool, S::Error> {
        let Some(lens) = Lens::capsule(piece, radius, way.bounds, self.grid) else { return Ok(true) };
        Ok(Largest { lens, largest: limit, top: limit + 1 }.find(self.tree)? > limit)
    }

    /// What a computed touch may be off by, metres: where a box is grazed, a root of rounding (2^-26) of the sizes involved,
    /// and the rounding of coordinates.
    fn touch_slack(&self, piece: &Segment, radius: f64) -> f64 {
        let resolution = self.grid.resolution();
        1e-7 * (piece.length() + radius + resolution) + self.grid.cell_slack() * resolution
    }

    /// A lower bound, but for rounding, of how far along a piece a disc is when it first touches a node: its centre is then
    /// no farther from the node's than its radius and half the node's diagonal.
    fn least_along(&self, piece: &Segment, radius: f64, node: NodeAddress) -> f64 {
        let size = self.grid.node_size(node.depth);
        let (x, y) = self.grid.origin();
        let center = (x + (f64::from(node.x) + 0.5) * size, y + (f64::from(node.y) + 0.5) * size);
        piece.along(center) - radius - size * FRAC_1_SQRT_2
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

/// A search for the largest class of the leaves that meet a region: by nodes down to the blocks, by rows within them.
struct Largest<'a> {
    lens: Lens<'a>,
    largest: Class,
    /// The highest class of the scale.
    top: Class,
}

impl Largest<'_> {
    fn find<S: BlockSlot>(mut self, tree: &Tree<S>) -> Result<Class, S::Error> {
        for part in 0..self.lens.parts() {
            let Some(top) = self.lens.turn_to(part) else { continue };
            if !tree.search(top, &mut self)? {
                break;
            }
        }
        Ok(self.largest)
    }
}

impl Searcher for Largest<'_> {
    fn node(&mut self, node: NodeAddress, max: Class) -> Descent {
        if max <= self.largest {
            return Descent::Skip;
        }
        match self.lens.classify(node) {
            Cover::Apart => Descent::Skip,
            Cover::Some => Descent::Into,
            Cover::All => {
                self.largest = max;
                if max >= self.top { Descent::Stop } else { Descent::Skip }
            }
        }
    }

    fn block(&mut self, address: BlockAddress, block: &Block) -> Option<bool> {
        self.largest = self.lens.largest_in(address, block, self.largest);
        Some(self.largest < self.top)
    }
}

/// True when a node, `levels` above the leaves, has a leaf in the range.
fn overlaps(range: &LeafRange, node: NodeAddress, levels: u8) -> bool {
    let side = 1_u32 << levels;
    let (x, y) = (node.x << levels, node.y << levels);
    x < range.max_x && x + side > range.min_x && y < range.max_y && y + side > range.min_y
}

//! Reading a tree: visits in Z-order, rasters and counts.

use super::block::Levels;
use super::tree::{Inner, Node, root_level};
use super::{BLOCK_LEVELS, Block, BlockAddress, BlockView, Class, Leaf, LeafRange, NodeAddress, OccupancyTree};
use std::sync::Arc;

/// How a visit goes on from a node.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Descent {
    /// Not below this node.
    Skip,
    /// Into its children.
    Into,
    /// Nowhere: the visit ends.
    Stop,
}

/// Size and area of a map.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct TreeStatistics {
    /// Nodes of the quadtree, inner ones and leaves.
    pub nodes: u64,
    /// Leaves of the quadtree, merged ones counted once.
    pub leaves: u64,
    /// Smallest cells of class below unknown.
    pub free_cells: u64,
    /// Smallest cells of class unknown, up to the root's edge.
    pub unknown_cells: u64,
    /// Smallest cells of class above unknown.
    pub occupied_cells: u64,
    /// Bytes held in memory.
    pub memory_bytes: u64,
}

/// A node while it is visited.
#[derive(Clone, Copy)]
enum Place<'a> {
    Uniform(Class),
    Inner(&'a Inner),
    /// The node at a level of a block, with the block's minima once it is entered.
    Block(&'a Block, u8, Option<&'a Levels>),
}

impl<'a> Place<'a> {
    fn of(node: &'a Node, depth: u8) -> Self {
        match node {
            Node::Uniform(class) => Self::Uniform(*class),
            Node::Inner(inner) => Self::Inner(inner),
            Node::Block(block) => Self::Block(block, root_level(depth), None),
        }
    }

    fn max(self, at: NodeAddress) -> Class {
        match self {
            Self::Uniform(class) => class,
            Self::Inner(inner) => inner.max(),
            Self::Block(block, level, _) => block.max_at(level, at.x, at.y),
        }
    }
}

/// The four children of a node in Z-order.
fn children_of(node: NodeAddress) -> [NodeAddress; 4] {
    let (depth, x, y) = (node.depth + 1, node.x << 1, node.y << 1);
    [(0, 0), (1, 0), (0, 1), (1, 1)].map(|(dx, dy)| NodeAddress { depth, x: x | dx, y: y | dy })
}

/// The smallest cells of a node as columns and rows: first, and behind the last. In `u64`: a root may end at 2^32.
fn cells_of(node: NodeAddress, depth: u8) -> [(u64, u64); 2] {
    let shift = depth - node.depth;
    [node.x, node.y].map(|i| (u64::from(i) << shift, (u64::from(i) + 1) << shift))
}

impl OccupancyTree {
    /// Visits nodes from the root down, each before its children, children in Z-order. The visitor is told the node, the
    /// maximum class below it and whether it is a leaf, and answers how to go on. Returns `false` when it was stopped.
    ///
    /// Below a leaf above the smallest cells, [`Descent::Into`] goes on into the parts of it as if it were split: all of
    /// its class and all leaves.
    pub fn descend(&self, visitor: &mut dyn FnMut(NodeAddress, Class, bool) -> Descent) -> bool {
        let root = NodeAddress { depth: 0, x: 0, y: 0 };
        descend(Place::of(self.root(), self.depth()), root, self.depth(), visitor)
    }

    /// Visits the leaves of the tree read down to `depth` that meet `range` (in smallest cells), in Z-order, until the
    /// visitor returns `false`. Returns `false` when it was stopped.
    pub fn visit_leaves(&self, range: &LeafRange, depth: u8, visitor: &mut dyn FnMut(Leaf) -> bool) -> bool {
        if range.is_empty() {
            return true;
        }
        let last = depth.min(self.depth());
        self.descend(&mut |node, class, is_leaf| {
            let [(min_x, max_x), (min_y, max_y)] = cells_of(node, self.depth());
            let apart = max_x <= u64::from(range.min_x)
                || min_x >= u64::from(range.max_x)
                || max_y <= u64::from(range.min_y)
                || min_y >= u64::from(range.max_y);
            if apart {
                Descent::Skip
            } else if !is_leaf && node.depth < last {
                Descent::Into
            } else if visitor(Leaf { node, class }) {
                Descent::Skip
            } else {
                Descent::Stop
            }
        })
    }

    /// Maximum classes of the nodes at `depth` with columns `range.min_x..max_x` and rows `range.min_y..max_y` (in
    /// nodes of that depth), row-major from the lowest row; unknown outside the root. A `depth` beyond the tree's counts
    /// as the tree's. One byte a node is allocated: the caller limits the range.
    #[must_use]
    pub fn raster(&self, range: &LeafRange, depth: u8) -> Vec<Class> {
        if range.is_empty() {
            return Vec::new();
        }
        let (width, height) = ((range.max_x - range.min_x) as usize, (range.max_y - range.min_y) as usize);
        let mut raster = Raster {
            classes: vec![self.scale().unknown(); width * height],
            width,
            range: *range,
            depth: depth.min(self.depth()),
        };
        raster.draw(Place::of(self.root(), self.depth()), NodeAddress { depth: 0, x: 0, y: 0 });
        raster.classes
    }

    /// Every block that is not of class unknown throughout, in Z-order.
    pub fn visit_blocks(&self, visitor: &mut dyn FnMut(BlockAddress, &BlockView)) {
        visit_blocks(self.root(), self.levels(), BlockAddress { x: 0, y: 0 }, self.scale().unknown(), visitor);
    }

    /// Counts nodes, leaves and cells, in time proportional to the number of nodes.
    #[must_use]
    pub fn statistics(&self) -> TreeStatistics {
        let mut counts =
            Counts { depth: self.depth(), unknown: self.scale().unknown(), inner: 0, cells: [0; 3], bytes: 0 };
        counts.add(self.root(), 0);
        let [free_cells, unknown_cells, occupied_cells] = counts.cells;
        TreeStatistics {
            // Every inner node has four children.
            nodes: 4 * counts.inner + 1,
            leaves: 3 * counts.inner + 1,
            free_cells,
            unknown_cells,
            occupied_cells,
            memory_bytes: counts.bytes + size_of::<Self>() as u64,
        }
    }
}

fn descend(
    place: Place<'_>,
    node: NodeAddress,
    last: u8,
    visitor: &mut dyn FnMut(NodeAddress, Class, bool) -> Descent,
) -> bool {
    let class = place.max(node);
    let is_leaf = match place {
        Place::Uniform(_) => true,
        Place::Inner(_) => false,
        Place::Block(_, level, minima) => {
            level >= BLOCK_LEVELS || minima.is_some_and(|minima| minima.at(level, node.x, node.y) == class)
        }
    };
    match visitor(node, class, is_leaf) {
        Descent::Stop => return false,
        Descent::Skip => return true,
        Descent::Into if node.depth >= last => return true,
        Descent::Into => {}
    }
    let children = children_of(node).into_iter();
    match place {
        Place::Uniform(_) => children.into_iter().all(|child| descend(place, child, last, visitor)),
        Place::Block(..) if is_leaf => {
            children.into_iter().all(|child| descend(Place::Uniform(class), child, last, visitor))
        }
        Place::Inner(inner) => {
            children.zip(inner.children()).all(|(child, below)| descend(Place::of(below, last), child, last, visitor))
        }
        Place::Block(block, level, Some(minima)) => children
            .into_iter()
            .all(|child| descend(Place::Block(block, level + 1, Some(minima)), child, last, visitor)),
        Place::Block(block, level, None) => {
            let minima = block.minima();
            children
                .into_iter()
                .all(|child| descend(Place::Block(block, level + 1, Some(&minima)), child, last, visitor))
        }
    }
}

fn visit_blocks(
    node: &Node,
    levels: u8,
    address: BlockAddress,
    unknown: Class,
    visitor: &mut dyn FnMut(BlockAddress, &BlockView),
) {
    let child = |index: u32| BlockAddress { x: address.x << 1 | index & 1, y: address.y << 1 | index >> 1 };
    match node {
        Node::Uniform(class) if *class == unknown => {}
        Node::Uniform(class) if levels == 0 => visitor(address, &BlockView::Uniform(*class)),
        Node::Uniform(_) => (0..4).for_each(|i| visit_blocks(node, levels - 1, child(i), unknown, visitor)),
        Node::Block(block) => visitor(address, &BlockView::Mixed(Arc::clone(block))),
        Node::Inner(inner) => {
            for (below, index) in inner.children().iter().zip(0..4) {
                visit_blocks(below, levels - 1, child(index), unknown, visitor);
            }
        }
    }
}

/// A raster while it is drawn: nodes of `depth` in `range`, row-major.
struct Raster {
    classes: Vec<Class>,
    width: usize,
    range: LeafRange,
    depth: u8,
}

impl Raster {
    /// The columns and rows of the raster's depth that a node has in common with the range.
    fn common(&self, node: NodeAddress) -> LeafRange {
        let shift = self.depth - node.depth;
        LeafRange {
            min_x: (node.x << shift).max(self.range.min_x),
            min_y: (node.y << shift).max(self.range.min_y),
            max_x: ((node.x + 1) << shift).min(self.range.max_x),
            max_y: ((node.y + 1) << shift).min(self.range.max_y),
        }
    }

    fn row(&mut self, y: u32, common: &LeafRange) -> &mut [Class] {
        let start = (y - self.range.min_y) as usize * self.width;
        let columns = (common.min_x - self.range.min_x) as usize..(common.max_x - self.range.min_x) as usize;
        &mut self.classes[start..start + self.width][columns]
    }

    fn draw(&mut self, place: Place<'_>, node: NodeAddress) {
        let common = self.common(node);
        if common.is_empty() {
            return;
        }
        match place {
            Place::Inner(inner) if node.depth < self.depth => {
                for (child, below) in children_of(node).into_iter().zip(inner.children()) {
                    // Below the blocks' own level nothing is drawn node by node, so the level is the first one.
                    let place = match below {
                        Node::Uniform(class) => Place::Uniform(*class),
                        Node::Inner(inner) => Place::Inner(inner),
                        Node::Block(block) => Place::Block(block, 0, None),
                    };
                    self.draw(place, child);
                }
            }
            Place::Block(block, level, _) => {
                let level = level + (self.depth - node.depth);
                let columns = 1_u32 << level;
                let first = (common.min_x % columns) as usize;
                for y in common.min_y..common.max_y {
                    let row = self.row(y, &common);
                    row.copy_from_slice(&block.level_row(level, y)[first..first + row.len()]);
                }
            }
            Place::Inner(_) | Place::Uniform(_) => {
                let class = place.max(node);
                for y in common.min_y..common.max_y {
                    self.row(y, &common).fill(class);
                }
            }
        }
    }
}

/// Counts while they are taken; cells free, unknown, occupied.
struct Counts {
    depth: u8,
    unknown: Class,
    inner: u64,
    cells: [u64; 3],
    bytes: u64,
}

impl Counts {
    fn add(&mut self, node: &Node, depth: u8) {
        /// Strong and weak count before what an `Arc` holds.
        const ARC: usize = 2 * size_of::<usize>();
        match node {
            Node::Uniform(class) => self.cells[self.kind(*class)] += 1 << (2 * (self.depth - depth)),
            Node::Inner(inner) => {
                self.inner += 1;
                self.bytes += (ARC + size_of::<Inner>()) as u64;
                inner.children().iter().for_each(|child| self.add(child, depth + 1));
            }
            Node::Block(block) => {
                self.bytes += (ARC + size_of::<Block>()) as u64;
                self.inner += block.inner_nodes(root_level(self.depth));
                let side = 1_usize << self.depth.min(BLOCK_LEVELS);
                for row in &block.rows()[..side] {
                    // A row has 64 leaves, so a byte counts them: that compiles to vector code.
                    let free = u64::from(row[..side].iter().map(|class| u8::from(*class < self.unknown)).sum::<u8>());
                    let unknown =
                        u64::from(row[..side].iter().map(|class| u8::from(*class == self.unknown)).sum::<u8>());
                    self.cells[0] += free;
                    self.cells[1] += unknown;
                    self.cells[2] += side as u64 - free - unknown;
                }
            }
        }
    }

    fn kind(&self, class: Class) -> usize {
        1 + usize::from(class > self.unknown) - usize::from(class < self.unknown)
    }
}

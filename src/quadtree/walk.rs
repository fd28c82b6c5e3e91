//! Reading a tree: visits in Z-order, rasters and counts.

use super::block::Levels;
use super::slot::BlockSlot;
use super::tree::{Inner, Node, Tree, root_level};
use super::{BLOCK_LEVELS, Block, BlockAddress, BlockView, Class, Leaf, LeafRange, NodeAddress, OccupancyTree};
use std::sync::Arc;

/// The deepest level of a block down to which single nodes are looked at for being of one class; a visit that goes
/// deeper takes the minima of the whole block.
const SINGLE_LEVELS: u8 = 3;

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

/// The four children of a node in Z-order.
pub(super) fn children_of(node: NodeAddress) -> [NodeAddress; 4] {
    let (depth, x, y) = (node.depth + 1, node.x << 1, node.y << 1);
    [(0, 0), (1, 0), (0, 1), (1, 1)].map(|(dx, dy)| NodeAddress { depth, x: x | dx, y: y | dy })
}

/// The smallest cells of a node as columns and rows: first, and behind the last. In `u64`: a root may end at 2^32.
fn cells_of(node: NodeAddress, depth: u8) -> [(u64, u64); 2] {
    let shift = depth - node.depth;
    [node.x, node.y].map(|i| (u64::from(i) << shift, (u64::from(i) + 1) << shift))
}

/// The root of every tree.
const ROOT: NodeAddress = NodeAddress { depth: 0, x: 0, y: 0 };

/// Is told a node, the maximum class below it and whether it is a leaf.
type Visitor<'a> = dyn FnMut(NodeAddress, Class, bool) -> Descent + 'a;

impl<S: BlockSlot> Tree<S> {
    /// Visits nodes from the root down, each before its children, children in Z-order. The visitor is told the node, the
    /// maximum class below it and whether it is a leaf, and answers how to go on. Returns `false` when it was stopped.
    ///
    /// Below a leaf above the smallest cells, [`Descent::Into`] goes on into the parts of it as if it were split: all of
    /// its class and all leaves.
    ///
    /// # Errors
    /// When a block that is entered cannot be read.
    pub fn try_descend(&self, visitor: &mut Visitor<'_>) -> Result<bool, S::Error> {
        Visit { tree: self, deepest: self.depth(), visitor }.node(self.root(), ROOT)
    }

    /// Visits the leaves of the tree read down to `depth` that meet `range` (in smallest cells), in Z-order, until the
    /// visitor returns `false`. Returns `false` when it was stopped.
    ///
    /// # Errors
    /// When a block that is entered cannot be read.
    pub fn try_visit_leaves(
        &self,
        range: &LeafRange,
        depth: u8,
        visitor: &mut dyn FnMut(Leaf) -> bool,
    ) -> Result<bool, S::Error> {
        if range.is_empty() {
            return Ok(true);
        }
        let deepest = depth.min(self.depth());
        let visitor = &mut |node: NodeAddress, class: Class, is_leaf: bool| {
            let [(min_x, max_x), (min_y, max_y)] = cells_of(node, self.depth());
            let apart = max_x <= u64::from(range.min_x)
                || min_x >= u64::from(range.max_x)
                || max_y <= u64::from(range.min_y)
                || min_y >= u64::from(range.max_y);
            if apart {
                Descent::Skip
            } else if !is_leaf && node.depth < deepest {
                Descent::Into
            } else if visitor(Leaf { node, class }) {
                Descent::Skip
            } else {
                Descent::Stop
            }
        };
        Visit { tree: self, deepest, visitor }.node(self.root(), ROOT)
    }

    /// Maximum classes of the nodes at `depth` with columns `range.min_x..max_x` and rows `range.min_y..max_y` (in
    /// nodes of that depth), row-major from the lowest row; unknown outside the root. A `depth` beyond the tree's counts
    /// as the tree's. One byte a node is allocated: the caller limits the range.
    ///
    /// # Errors
    /// When a block that is entered cannot be read; none is where `depth` is above the blocks.
    pub fn try_raster(&self, range: &LeafRange, depth: u8) -> Result<Vec<Class>, S::Error> {
        if range.is_empty() {
            return Ok(Vec::new());
        }
        let (width, height) = ((range.max_x - range.min_x) as usize, (range.max_y - range.min_y) as usize);
        let mut raster = Raster {
            classes: vec![self.scale().unknown(); width * height],
            width,
            range: *range,
            depth: depth.min(self.depth()),
        };
        raster.draw(self, self.root(), ROOT)?;
        Ok(raster.classes)
    }

    /// Every block that is not of class unknown throughout, in Z-order.
    ///
    /// # Errors
    /// When a block cannot be read.
    pub fn try_visit_blocks(&self, visitor: &mut dyn FnMut(BlockAddress, &BlockView)) -> Result<(), S::Error> {
        self.visit_blocks_below(self.root(), self.levels(), BlockAddress { x: 0, y: 0 }, visitor)
    }

    fn visit_blocks_below(
        &self,
        node: &Node<S>,
        levels: u8,
        address: BlockAddress,
        visitor: &mut dyn FnMut(BlockAddress, &BlockView),
    ) -> Result<(), S::Error> {
        let child = |index: u32| BlockAddress { x: address.x << 1 | index & 1, y: address.y << 1 | index >> 1 };
        match node {
            Node::Uniform(class) if *class == self.scale().unknown() => {}
            Node::Uniform(class) if levels == 0 => visitor(address, &BlockView::Uniform(*class)),
            Node::Uniform(_) => {
                for index in 0..4 {
                    self.visit_blocks_below(node, levels - 1, child(index), visitor)?;
                }
            }
            Node::Block(slot) => visitor(address, &BlockView::Mixed(slot.share(self.access())?)),
            Node::Inner(inner) => {
                for (below, index) in inner.children().iter().zip(0..4) {
                    self.visit_blocks_below(below, levels - 1, child(index), visitor)?;
                }
            }
        }
        Ok(())
    }
}

impl OccupancyTree {
    /// Visits nodes from the root down, each before its children, children in Z-order. The visitor is told the node, the
    /// maximum class below it and whether it is a leaf, and answers how to go on. Returns `false` when it was stopped.
    ///
    /// Below a leaf above the smallest cells, [`Descent::Into`] goes on into the parts of it as if it were split: all of
    /// its class and all leaves.
    pub fn descend(&self, visitor: &mut dyn FnMut(NodeAddress, Class, bool) -> Descent) -> bool {
        let Ok(ran_through) = self.try_descend(visitor);
        ran_through
    }

    /// Visits the leaves of the tree read down to `depth` that meet `range` (in smallest cells), in Z-order, until the
    /// visitor returns `false`. Returns `false` when it was stopped.
    pub fn visit_leaves(&self, range: &LeafRange, depth: u8, visitor: &mut dyn FnMut(Leaf) -> bool) -> bool {
        let Ok(ran_through) = self.try_visit_leaves(range, depth, visitor);
        ran_through
    }

    /// Maximum classes of the nodes at `depth` with columns `range.min_x..max_x` and rows `range.min_y..max_y` (in
    /// nodes of that depth), row-major from the lowest row; unknown outside the root. A `depth` beyond the tree's counts
    /// as the tree's. One byte a node is allocated: the caller limits the range.
    #[must_use]
    pub fn raster(&self, range: &LeafRange, depth: u8) -> Vec<Class> {
        let Ok(classes) = self.try_raster(range, depth);
        classes
    }

    /// Every block that is not of class unknown throughout, in Z-order.
    pub fn visit_blocks(&self, visitor: &mut dyn FnMut(BlockAddress, &BlockView)) {
        let Ok(()) = self.try_visit_blocks(visitor);
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

/// A visit of nodes from the root down.
struct Visit<'a, 'v, S: BlockSlot> {
    tree: &'a Tree<S>,
    /// Below this depth the visitor does not go; at it, whether a node is a leaf is not looked at.
    deepest: u8,
    visitor: &'a mut Visitor<'v>,
}

/// A block that is entered, with its minima where they are worth their cost.
struct Entered<'a> {
    block: &'a Block,
    minima: Option<Levels>,
}

impl<S: BlockSlot> Visit<'_, '_, S> {
    /// Visits a node and what is below it; false when the visit was stopped.
    fn node(&mut self, node: &Node<S>, at: NodeAddress) -> Result<bool, S::Error> {
        match (self.visitor)(at, node.max(), matches!(node, Node::Uniform(_))) {
            Descent::Stop => return Ok(false),
            Descent::Into if at.depth < self.tree.depth() => {}
            Descent::Skip | Descent::Into => return Ok(true),
        }
        match node {
            Node::Uniform(class) => Ok(self.parts(*class, at)),
            Node::Inner(inner) => {
                for (child, below) in children_of(at).into_iter().zip(inner.children()) {
                    if !self.node(below, child)? {
                        return Ok(false);
                    }
                }
                Ok(true)
            }
            Node::Block(slot) => {
                let block = slot.read(self.tree.access())?;
                let level = root_level(self.tree.depth());
                let deepest = level + self.deepest.saturating_sub(at.depth);
                let minima = (deepest > SINGLE_LEVELS).then(|| block.minima());
                let entered = Entered { block: &block, minima };
                Ok(children_of(at).into_iter().all(|child| self.within(&entered, level + 1, child)))
            }
        }
    }

    /// The parts of a leaf.
    fn parts(&mut self, class: Class, at: NodeAddress) -> bool {
        at.depth >= self.tree.depth()
            || children_of(at).into_iter().all(|child| match (self.visitor)(child, class, true) {
                Descent::Stop => false,
                Descent::Skip => true,
                Descent::Into => self.parts(class, child),
            })
    }

    /// A node at a level of a block below its first.
    fn within(&mut self, entered: &Entered<'_>, level: u8, at: NodeAddress) -> bool {
        let class = entered.block.max_at(level, at.x, at.y);
        let is_leaf = level >= BLOCK_LEVELS || (at.depth < self.deepest && entered.is_uniform(level, at, class));
        match (self.visitor)(at, class, is_leaf) {
            Descent::Stop => false,
            Descent::Into if at.depth < self.tree.depth() => {
                if is_leaf {
                    return self.parts(class, at);
                }
                children_of(at).into_iter().all(|child| self.within(entered, level + 1, child))
            }
            Descent::Skip | Descent::Into => true,
        }
    }
}

impl Entered<'_> {
    /// Are all leaves below a node of this maximum of one class?
    fn is_uniform(&self, level: u8, at: NodeAddress, class: Class) -> bool {
        if let Some(minima) = &self.minima {
            return minima.at(level, at.x, at.y) == class;
        }
        let expected = [class; 64];
        let (x, y) = (at.x % (1 << level), at.y % (1 << level));
        // The nodes one level below tell most mixed ones at once.
        [level + 1, BLOCK_LEVELS].into_iter().all(|below| {
            let side = 1_u32 << (below - level);
            let columns = (x * side) as usize..((x + 1) * side) as usize;
            let expected = &expected[..columns.len()];
            (y * side..(y + 1) * side).all(|row| self.block.level_row(below, row)[columns.clone()] == *expected)
        })
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

    fn draw<S: BlockSlot>(&mut self, tree: &Tree<S>, node: &Node<S>, at: NodeAddress) -> Result<(), S::Error> {
        let common = self.common(at);
        if common.is_empty() {
            return Ok(());
        }
        match node {
            Node::Inner(inner) if at.depth < self.depth => {
                for (child, below) in children_of(at).into_iter().zip(inner.children()) {
                    self.draw(tree, below, child)?;
                }
            }
            Node::Block(slot) if at.depth < self.depth => {
                let block = slot.read(tree.access())?;
                let level = root_level(tree.depth()) + (self.depth - at.depth);
                let columns = 1_u32 << level;
                let first = (common.min_x % columns) as usize;
                for y in common.min_y..common.max_y {
                    let row = self.row(y, &common);
                    row.copy_from_slice(&block.level_row(level, y)[first..first + row.len()]);
                }
            }
            _ => {
                let class = node.max();
                for y in common.min_y..common.max_y {
                    self.row(y, &common).fill(class);
                }
            }
        }
        Ok(())
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
                self.bytes += (ARC + size_of::<Inner<Arc<Block>>>()) as u64;
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

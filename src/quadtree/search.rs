//! Searching a tree: one descent that a visitor steers, for questions that few nodes answer.

use super::slot::BlockSlot;
use super::tree::{Node, Tree, root_level};
use super::walk::children_of;
use super::{Block, BlockAddress, Class, Descent, NodeAddress};

/// Steers a search. A closure is one that looks at nodes alone.
pub trait Searcher {
    /// How to go on from a node, told with the maximum class below it.
    fn node(&mut self, node: NodeAddress, max: Class) -> Descent;

    /// Is shown a block that is entered, or of which a part is searched, and may look at its leaves by itself: then it
    /// answers with whether the search goes on; `None` has the nodes of the block visited.
    fn block(&mut self, _address: BlockAddress, _block: &Block) -> Option<bool> {
        None
    }
}

impl<F: FnMut(NodeAddress, Class) -> Descent> Searcher for F {
    fn node(&mut self, node: NodeAddress, max: Class) -> Descent {
        self(node, max)
    }
}

impl<S: BlockSlot> Tree<S> {
    /// Visits a node, then what is below it, each node before its children, children in Z-order, down to the leaves of
    /// the map. The visitor is told the node and the maximum class below it; it is not told whether the node is a leaf
    /// of the quadtree, and goes into uniform nodes as if they were split. Returns `false` when it was stopped.
    ///
    /// A node that the visitor skips costs a few nanoseconds: maxima stand beside one another in the parent.
    ///
    /// # Errors
    /// When a block that is entered cannot be read.
    pub fn search(&self, top: NodeAddress, visitor: &mut impl Searcher) -> Result<bool, S::Error> {
        if top.depth > self.depth() || top.x >> top.depth != 0 || top.y >> top.depth != 0 {
            return Ok(true);
        }
        let mut node = self.root();
        for level in 0..top.depth {
            let Node::Inner(inner) = node else { break };
            let bit = top.depth - level - 1;
            node = &inner.children()[((top.x >> bit & 1) | (top.y >> bit & 1) << 1) as usize];
        }
        let mut search = Search { tree: self, visitor };
        match node {
            Node::Block(slot) if top.depth > self.levels() => {
                let into = top.depth - self.levels();
                let level = root_level(self.depth()) + into;
                let block = slot.read(self.access())?;
                if let Some(goes_on) = search.ask(&block, BlockAddress { x: top.x >> into, y: top.y >> into }) {
                    return Ok(goes_on);
                }
                Ok(search.visit_within(&block, level, top, block.max_at(level, top.x, top.y)))
            }
            _ => search.visit(node, top, node.max()),
        }
    }
}

struct Search<'a, S: BlockSlot, V> {
    tree: &'a Tree<S>,
    visitor: &'a mut V,
}

impl<S: BlockSlot, V: Searcher> Search<'_, S, V> {
    /// Shows a block to the visitor, where it is a whole one.
    fn ask(&mut self, block: &Block, address: BlockAddress) -> Option<bool> {
        if root_level(self.tree.depth()) == 0 { self.visitor.block(address, block) } else { None }
    }

    fn visit(&mut self, node: &Node<S>, at: NodeAddress, max: Class) -> Result<bool, S::Error> {
        match self.visitor.node(at, max) {
            Descent::Stop => return Ok(false),
            Descent::Into if at.depth < self.tree.depth() => {}
            Descent::Skip | Descent::Into => return Ok(true),
        }
        match node {
            Node::Uniform(class) => Ok(self.parts(at, *class)),
            Node::Inner(inner) => {
                for ((child, below), max) in children_of(at).into_iter().zip(inner.children()).zip(inner.maxima()) {
                    if !self.visit(below, child, *max)? {
                        return Ok(false);
                    }
                }
                Ok(true)
            }
            Node::Block(slot) => {
                let block = slot.read(self.tree.access())?;
                if let Some(goes_on) = self.ask(&block, BlockAddress { x: at.x, y: at.y }) {
                    return Ok(goes_on);
                }
                Ok(self.below(&block, root_level(self.tree.depth()), at))
            }
        }
    }

    /// The parts of a node that is not split.
    fn parts(&mut self, at: NodeAddress, class: Class) -> bool {
        at.depth >= self.tree.depth()
            || children_of(at).into_iter().all(|child| match self.visitor.node(child, class) {
                Descent::Stop => false,
                Descent::Skip => true,
                Descent::Into => self.parts(child, class),
            })
    }

    /// The children of a node at a level of a block.
    fn below(&mut self, block: &Block, level: u8, at: NodeAddress) -> bool {
        let column = (at.x << 1) as usize % (2 << level);
        [0, 1].into_iter().all(|dy| {
            let y = at.y << 1 | dy;
            let row = block.level_row(level + 1, y);
            [0, 1].into_iter().all(|dx| {
                let child = NodeAddress { depth: at.depth + 1, x: at.x << 1 | dx, y };
                self.visit_within(block, level + 1, child, row[column + dx as usize])
            })
        })
    }

    fn visit_within(&mut self, block: &Block, level: u8, at: NodeAddress, max: Class) -> bool {
        match self.visitor.node(at, max) {
            Descent::Stop => false,
            Descent::Into if at.depth < self.tree.depth() => self.below(block, level, at),
            Descent::Skip | Descent::Into => true,
        }
    }
}

//! Searching a tree: one descent that a visitor steers, for questions that few nodes answer.

use super::slot::BlockSlot;
use super::tree::{Node, Tree, root_level};
use super::walk::children_of;
use super::{Block, Class, Descent, NodeAddress};

impl<S: BlockSlot> Tree<S> {
    /// Visits a node, then what is below it, each node before its children, children in Z-order, down to the leaves of
    /// the map. The visitor is told the node and the maximum class below it; it is not told whether the node is a leaf
    /// of the quadtree, and goes into uniform nodes as if they were split. Returns `false` when it was stopped.
    ///
    /// A node that the visitor skips costs a few nanoseconds: maxima stand beside one another in the parent.
    ///
    /// # Errors
    /// When a block that is entered cannot be read.
    pub fn search(
        &self,
        top: NodeAddress,
        visitor: &mut impl FnMut(NodeAddress, Class) -> Descent,
    ) -> Result<bool, S::Error> {
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
                let level = root_level(self.depth()) + top.depth - self.levels();
                let block = slot.read(self.access())?;
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

impl<S: BlockSlot, V: FnMut(NodeAddress, Class) -> Descent> Search<'_, S, V> {
    fn visit(&mut self, node: &Node<S>, at: NodeAddress, max: Class) -> Result<bool, S::Error> {
        match (self.visitor)(at, max) {
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
                Ok(self.below(&block, root_level(self.tree.depth()), at))
            }
        }
    }

    /// The parts of a node that is not split.
    fn parts(&mut self, at: NodeAddress, class: Class) -> bool {
        at.depth >= self.tree.depth()
            || children_of(at).into_iter().all(|child| match (self.visitor)(child, class) {
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
        match (self.visitor)(at, max) {
            Descent::Stop => false,
            Descent::Into if at.depth < self.tree.depth() => self.below(block, level, at),
            Descent::Skip | Descent::Into => true,
        }
    }
}

//! The k-OQM node by node, as model section 3 tells it: the readable form that tests hold the block form to.
//!
//! Nothing is shared, packed or skipped here: a leaf is reached by splitting, stepped, and its parents merge on the way
//! back. It is slow and small, and that is its purpose; maps are [`super::OccupancyTree`]s.

use super::{BLOCK_SIDE, BlockMasks, Class, ClassScale, Leaf, LeafMasks, NodeAddress};

/// A node of the quadtree.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum ReferenceNode {
    /// A node without children: every smallest cell below has this class.
    Leaf(Class),
    /// A node with its children in Z-order: `x + 2 y`.
    Inner(Box<[ReferenceNode; 4]>),
}

/// A k-OQM held as plain nodes.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ReferenceTree {
    depth: u8,
    scale: ClassScale,
    root: ReferenceNode,
}

impl ReferenceNode {
    /// The class of a leaf, the maximum class of an inner node's children.
    #[must_use]
    pub fn max_class(&self) -> Class {
        match self {
            Self::Leaf(class) => *class,
            Self::Inner(children) => children.iter().map(Self::max_class).fold(0, Class::max),
        }
    }

    /// Number of nodes and of leaves from here down.
    #[must_use]
    pub fn counts(&self) -> (u64, u64) {
        match self {
            Self::Leaf(_) => (1, 1),
            Self::Inner(children) => {
                children.iter().map(Self::counts).fold((1, 0), |(n, l), (nodes, leaves)| (n + nodes, l + leaves))
            }
        }
    }

    /// Steps the smallest cell `(x, y)` below this node, which is `levels` above the smallest cells.
    fn update(&mut self, levels: u8, x: u32, y: u32, step: impl Fn(Class) -> Class) {
        if levels == 0 {
            *self = Self::Leaf(step(self.max_class()));
            return;
        }
        if let Self::Leaf(class) = *self {
            *self = Self::Inner(Box::new([const { Self::Leaf(0) }; 4].map(|_| Self::Leaf(class))));
        }
        let Self::Inner(children) = self else { return };
        let bit = levels - 1;
        children[((x >> bit & 1) + 2 * (y >> bit & 1)) as usize].update(bit, x, y, step);
        if let Self::Leaf(first) = children[0]
            && children.iter().all(|child| *child == Self::Leaf(first))
        {
            *self = Self::Leaf(first);
        }
    }

    fn leaves(&self, node: NodeAddress, depth: u8, found: &mut Vec<Leaf>) {
        match self {
            Self::Inner(children) if node.depth < depth => {
                for (child, index) in children.iter().zip(0..4) {
                    let (x, y) = (2 * node.x + index % 2, 2 * node.y + index / 2);
                    child.leaves(NodeAddress { depth: node.depth + 1, x, y }, depth, found);
                }
            }
            _ => found.push(Leaf { node, class: self.max_class() }),
        }
    }
}

impl ReferenceTree {
    /// One root node of class unknown; `depth` in `1..=24`.
    #[must_use]
    pub fn new(depth: u8, scale: ClassScale) -> Self {
        Self { depth, scale, root: ReferenceNode::Leaf(scale.unknown()) }
    }

    /// The root.
    #[must_use]
    pub fn root(&self) -> &ReferenceNode {
        &self.root
    }

    /// Adds 1 to the class of the smallest cell `(x, y)` where it is occupied, takes 1 where it is empty. Cells outside
    /// the root are passed over.
    pub fn update(&mut self, x: u32, y: u32, occupied: bool) {
        if x >> self.depth == 0 && y >> self.depth == 0 {
            let scale = self.scale;
            self.root.update(self.depth, x, y, |class| scale.step(class, occupied, !occupied));
        }
    }

    /// Applies one scan's evidence, leaf by leaf.
    pub fn apply(&mut self, masks: &LeafMasks) {
        for (address, masks) in &masks.blocks {
            for y in 0..BLOCK_SIDE {
                for x in 0..BLOCK_SIDE {
                    let (occupied, empty) = match masks {
                        BlockMasks::AllEmpty => (false, true),
                        BlockMasks::Some { occupied, empty } => {
                            (occupied[y as usize] >> x & 1 == 1, empty[y as usize] >> x & 1 == 1)
                        }
                    };
                    if occupied || empty {
                        self.update(address.x * BLOCK_SIDE + x, address.y * BLOCK_SIDE + y, occupied);
                    }
                }
            }
        }
    }

    /// The maximum class below a node, no deeper than the tree and within the root.
    #[must_use]
    pub fn max_class(&self, node: NodeAddress) -> Class {
        let mut current = &self.root;
        for bit in (0..node.depth).rev() {
            let ReferenceNode::Inner(children) = current else { break };
            current = &children[((node.x >> bit & 1) + 2 * (node.y >> bit & 1)) as usize];
        }
        current.max_class()
    }

    /// All leaves of the tree read down to `depth`, in Z-order; a node that is cut has its maximum class.
    #[must_use]
    pub fn leaves(&self, depth: u8) -> Vec<Leaf> {
        let mut found = Vec::new();
        self.root.leaves(NodeAddress { depth: 0, x: 0, y: 0 }, depth, &mut found);
        found
    }
}

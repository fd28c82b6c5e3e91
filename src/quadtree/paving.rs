//! The k-OPM: the same map as a paving of boxes that are bisected.
//!
//! A node is bisected along x, its halves along y, and so on in turn; two siblings of one class merge. So it needs a
//! node less where a quad's cells differ along one axis only. [`OccupancyPaving::from_tree`] and
//! [`OccupancyPaving::to_tree`] convert without loss.

use super::tree::{Node, root_level};
use super::{BLOCK_LEVELS, Block, Class, ClassScale, LeafRange, OccupancyTree};
use std::sync::Arc;

/// A k-class occupancy paving map.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct OccupancyPaving {
    depth: u8,
    scale: ClassScale,
    root: Part,
}

/// A box of the paving.
#[derive(Debug, Clone, PartialEq, Eq)]
enum Part {
    Leaf(Class),
    /// The lower and the upper half, not both leaves of one class.
    Halves(Box<[Part; 2]>),
}

impl Part {
    /// Two halves, merged where they are leaves of one class.
    fn of_halves(low: Self, high: Self) -> Self {
        match (&low, &high) {
            (Self::Leaf(a), Self::Leaf(b)) if a == b => low,
            _ => Self::Halves(Box::new([low, high])),
        }
    }

    /// A square of four quads in Z-order: halves along x, each with its halves along y.
    fn of_quads([low_left, low_right, up_left, up_right]: [Self; 4]) -> Self {
        Self::of_halves(Self::of_halves(low_left, up_left), Self::of_halves(low_right, up_right))
    }

    /// Both halves; a leaf's are the leaf.
    fn halves(&self) -> [&Self; 2] {
        match self {
            Self::Leaf(_) => [self, self],
            Self::Halves(halves) => [&halves[0], &halves[1]],
        }
    }

    /// A square's quads in Z-order.
    fn quads(&self) -> [&Self; 4] {
        let [left, right] = self.halves().map(Self::halves);
        [left[0], right[0], left[1], right[1]]
    }

    fn leaf_count(&self) -> u64 {
        match self {
            Self::Leaf(_) => 1,
            Self::Halves(halves) => halves.iter().map(Self::leaf_count).sum(),
        }
    }

    fn visit(&self, area: LeafRange, along_x: bool, visitor: &mut dyn FnMut(LeafRange, Class)) {
        let (low, high) = match self {
            Self::Leaf(class) => return visitor(area, *class),
            Self::Halves(halves) => (&halves[0], &halves[1]),
        };
        let (mut lower, mut upper) = (area, area);
        if along_x {
            lower.max_x = area.min_x + (area.max_x - area.min_x) / 2;
            upper.min_x = lower.max_x;
        } else {
            lower.max_y = area.min_y + (area.max_y - area.min_y) / 2;
            upper.min_y = lower.max_y;
        }
        low.visit(lower, !along_x, visitor);
        high.visit(upper, !along_x, visitor);
    }

    /// The quadtree node of a square `levels` above the smallest cells of a tree of `depth`.
    fn to_node(&self, levels: u8, depth: u8, scale: ClassScale) -> Node {
        if let Self::Leaf(class) = self {
            return Node::Uniform(*class);
        }
        if levels > BLOCK_LEVELS {
            return Node::of_children(self.quads().map(|quad| quad.to_node(levels - 1, depth, scale)));
        }
        let mut leaves = Box::new([scale.free(); 64 * 64]);
        let side = 64_u32 >> root_level(depth);
        let square = LeafRange { min_x: 0, min_y: 0, max_x: side, max_y: side };
        self.visit(square, true, &mut |area, class| {
            for row in &mut leaves.as_chunks_mut::<64>().0[area.min_y as usize..area.max_y as usize] {
                row[area.min_x as usize..area.max_x as usize].fill(class);
            }
        });
        Node::of_block(Arc::new(Block::from_leaves(leaves)), depth)
    }
}

impl OccupancyPaving {
    /// The paving of a quadtree's map.
    #[must_use]
    pub fn from_tree(tree: &OccupancyTree) -> Self {
        // Leaves come in Z-order, so the fourth node of a depth in a row completes the quads of one parent.
        let mut open: Vec<(u8, Part)> = Vec::new();
        let all = LeafRange { min_x: 0, min_y: 0, max_x: u32::MAX, max_y: u32::MAX };
        tree.visit_leaves(&all, tree.depth(), &mut |leaf| {
            open.push((leaf.node.depth, Part::Leaf(leaf.class)));
            while let [.., a, b, c, d] = &mut *open
                && [a.0, b.0, c.0] == [d.0; 3]
            {
                let depth = d.0;
                let quads = [a, b, c, d].map(|(_, part)| std::mem::replace(part, Part::Leaf(0)));
                open.truncate(open.len() - 4);
                open.push((depth - 1, Part::of_quads(quads)));
            }
            true
        });
        let root = open.pop().map_or(Part::Leaf(tree.scale().unknown()), |(_, part)| part);
        Self { depth: tree.depth(), scale: tree.scale(), root }
    }

    /// The quadtree of the same map.
    #[must_use]
    pub fn to_tree(&self) -> OccupancyTree {
        OccupancyTree::from_root(self.depth, self.scale, self.root.to_node(self.depth, self.depth, self.scale))
    }

    /// Depth of the smallest cells in the quadtree; they are `2 * depth` bisections below the root.
    #[must_use]
    pub fn depth(&self) -> u8 {
        self.depth
    }

    /// The class scale.
    #[must_use]
    pub fn scale(&self) -> ClassScale {
        self.scale
    }

    /// Number of leaves.
    #[must_use]
    pub fn leaf_count(&self) -> u64 {
        self.root.leaf_count()
    }

    /// Number of nodes: inner ones, which have two children each, and leaves.
    #[must_use]
    pub fn node_count(&self) -> u64 {
        2 * self.leaf_count() - 1
    }

    /// Visits every leaf with its box in smallest cells, lower halves first.
    pub fn visit_leaves(&self, visitor: &mut dyn FnMut(LeafRange, Class)) {
        let side = 1 << self.depth;
        self.root.visit(LeafRange { min_x: 0, min_y: 0, max_x: side, max_y: side }, true, visitor);
    }
}

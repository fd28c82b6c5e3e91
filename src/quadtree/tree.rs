//! The k-OQM: a sparse persistent quadtree over blocks.

use super::slot::BlockSlot;
use super::{BLOCK_LEVELS, Block, BlockAddress, BlockMasks, Class, ClassScale, LeafMasks, NodeAddress, RowMask};
use std::sync::Arc;

/// A leaf of the quadtree: a node without children (merged leaves are one node), or one cut by a depth.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Leaf {
    /// Where.
    pub node: NodeAddress,
    /// Its class; the maximum below it where it is cut.
    pub class: Class,
}

/// What stands at a block's address.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum BlockView {
    /// All leaves have this class.
    Uniform(Class),
    /// Mixed classes.
    Mixed(Arc<Block>),
}

/// A k-class occupancy quadtree map. `clone` is cheap and shares blocks.
///
/// `S` is how the blocks are held: [`OccupancyTree`] has all of them in memory and its reads cannot fail;
/// [`super::PagedTree`] fetches them when they are looked into. What is a method of the one is, with a `Result`, a
/// method `try_..` of both.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Tree<S: BlockSlot> {
    depth: u8,
    scale: ClassScale,
    root: Node<S>,
    access: S::Access,
}

/// A map that is in memory as a whole.
///
/// Two trees are equal when they have the same depth, scale and leaves: there is one form for each map.
pub type OccupancyTree = Tree<Arc<Block>>;

/// A node at or above the level of blocks. In a tree of depth below 6 the root itself is at the level of blocks.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) enum Node<S = Arc<Block>> {
    /// All leaves below have this class.
    Uniform(Class),
    /// Above the level of blocks; children not all uniform of one class.
    Inner(Arc<Inner<S>>),
    /// At the level of blocks; not of one class. Leaves that do not exist (depth below 6) have the lowest class, which
    /// changes no maximum.
    Block(S),
}

/// Four children in Z-order, `x + 2 y`, and the maximum class of each.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Inner<S> {
    maxima: [Class; 4],
    children: [Node<S>; 4],
}

impl<S> Inner<S> {
    pub(super) fn max(&self) -> Class {
        self.maxima.iter().copied().fold(0, Class::max)
    }

    pub(super) fn maxima(&self) -> &[Class; 4] {
        &self.maxima
    }

    pub(super) fn children(&self) -> &[Node<S>; 4] {
        &self.children
    }
}

impl<S: BlockSlot> Node<S> {
    pub(super) fn max(&self) -> Class {
        match self {
            Self::Uniform(class) => *class,
            Self::Inner(inner) => inner.max(),
            Self::Block(slot) => slot.max(),
        }
    }

    /// A node of four children: merged where they are uniform of one class.
    pub(super) fn of_children(children: [Self; 4]) -> Self {
        match one_class(&children) {
            Some(class) => Self::Uniform(class),
            None => Self::Inner(Arc::new(Inner { maxima: children.each_ref().map(Self::max), children })),
        }
    }

    /// A node at the level of blocks for a tree of `depth`: merged where the leaves that exist have one class.
    pub(super) fn of_block(block: Arc<Block>, depth: u8) -> Self {
        match block.node_uniform(root_level(depth)) {
            Some(class) => Self::Uniform(class),
            None => Self::Block(block.into()),
        }
    }

    /// The node that holds a block's leaves, below this one `levels` above the blocks.
    fn towards(&self, address: BlockAddress, levels: u8) -> &Self {
        let mut node = self;
        for levels in (1..=levels).rev() {
            let Self::Inner(inner) = node else { break };
            node = &inner.children[child_towards(address, levels)];
        }
        node
    }
}

/// The class of four nodes that are uniform of one class.
fn one_class<S>(children: &[Node<S>; 4]) -> Option<Class> {
    let Node::Uniform(first) = children[0] else { return None };
    children.iter().all(|child| matches!(child, Node::Uniform(class) if *class == first)).then_some(first)
}

/// The level within a block at which a tree of `depth` begins: 0 unless the whole tree is smaller than a block.
pub(super) fn root_level(depth: u8) -> u8 {
    BLOCK_LEVELS.saturating_sub(depth)
}

/// Index of the child that leads to `address`, seen from `levels` above the blocks (at least 1).
fn child_towards(address: BlockAddress, levels: u8) -> usize {
    let bit = u32::from(levels - 1);
    ((address.x >> bit & 1) | (address.y >> bit & 1) << 1) as usize
}

/// What changes the node of one block, and tells whether it did.
type Step<'a, S> = dyn FnMut(&mut Node<S>) -> Result<bool, <S as BlockSlot>::Error> + 'a;

/// Changes the node of one block below `node`, which is `levels` above the blocks. Where `step` changes nothing, nothing
/// above is copied, split or merged.
fn update<S: BlockSlot>(
    node: &mut Node<S>,
    levels: u8,
    address: BlockAddress,
    step: &mut Step<'_, S>,
) -> Result<bool, S::Error> {
    if levels == 0 {
        return step(node);
    }
    let index = child_towards(address, levels);
    match node {
        Node::Uniform(class) => {
            let class = *class;
            let mut child = Node::Uniform(class);
            if !update(&mut child, levels - 1, address, step)? {
                return Ok(false);
            }
            let mut children = [const { Node::Uniform(0) }; 4];
            children.fill(Node::Uniform(class));
            children[index] = child;
            *node = Node::of_children(children);
        }
        Node::Inner(shared) => match Arc::get_mut(shared) {
            Some(inner) => {
                if !update(&mut inner.children[index], levels - 1, address, step)? {
                    return Ok(false);
                }
                inner.maxima[index] = inner.children[index].max();
                if let Some(class) = one_class(&inner.children) {
                    *node = Node::Uniform(class);
                }
            }
            None => {
                let mut child = shared.children[index].clone();
                if !update(&mut child, levels - 1, address, step)? {
                    return Ok(false);
                }
                let mut children = shared.children.clone();
                children[index] = child;
                *node = Node::of_children(children);
            }
        },
        // Blocks stand at level 0 alone.
        Node::Block(_) => return Ok(false),
    }
    Ok(true)
}

impl<S: BlockSlot> Tree<S> {
    /// One root node of class unknown; `depth` in `1..=24` (checked by [`super::Grid`]).
    #[must_use]
    pub fn new(depth: u8, scale: ClassScale) -> Self {
        Self::from_root(depth, scale, Node::Uniform(scale.unknown()))
    }

    pub(super) fn from_root(depth: u8, scale: ClassScale, root: Node<S>) -> Self {
        Self { depth, scale, root, access: S::Access::default() }
    }

    pub(super) fn root(&self) -> &Node<S> {
        &self.root
    }

    pub(super) fn access(&self) -> S::Access {
        self.access
    }

    /// The same map, its blocks read in another way.
    pub(super) fn with_access(&self, access: S::Access) -> Self {
        Self { root: self.root.clone(), access, ..*self }
    }

    /// Depth of the smallest cells.
    #[must_use]
    pub fn depth(&self) -> u8 {
        self.depth
    }

    /// The class scale.
    #[must_use]
    pub fn scale(&self) -> ClassScale {
        self.scale
    }

    /// Levels above that of the blocks.
    pub(super) fn levels(&self) -> u8 {
        self.depth.saturating_sub(BLOCK_LEVELS)
    }

    pub(super) fn holds(&self, address: BlockAddress) -> bool {
        let side = 1_u32 << self.levels();
        address.x < side && address.y < side
    }

    /// The node that holds the leaves of a block within the root.
    pub(super) fn node_of(&self, address: BlockAddress) -> &Node<S> {
        self.root.towards(address, self.levels())
    }

    /// Changes the node of one block within the root.
    pub(super) fn update(&mut self, address: BlockAddress, step: &mut Step<'_, S>) -> Result<bool, S::Error> {
        let levels = self.levels();
        update(&mut self.root, levels, address, step)
    }

    /// Applies one scan's evidence; adds the addresses of the blocks whose classes changed to `changed` (a block may
    /// come more than once over several calls). Leaves outside the root are passed over.
    ///
    /// # Errors
    /// When a block cannot be read: a part of the evidence may be applied then.
    pub fn try_apply(&mut self, masks: &LeafMasks, changed: &mut Vec<BlockAddress>) -> Result<(), S::Error> {
        let (depth, scale) = (self.depth, self.scale);
        for (address, masks) in &masks.blocks {
            if !self.holds(*address) {
                continue;
            }
            let clipped = if depth < BLOCK_LEVELS { Some(clip(masks, depth)) } else { None };
            let masks = clipped.as_ref().unwrap_or(masks);
            if self.update(*address, &mut |node| step(node, masks, depth, scale))? {
                changed.push(*address);
            }
        }
        Ok(())
    }

    /// What stands at a block's address; outside the root: unknown.
    ///
    /// # Errors
    /// When the block cannot be read.
    pub fn try_block(&self, address: BlockAddress) -> Result<BlockView, S::Error> {
        if !self.holds(address) {
            return Ok(BlockView::Uniform(self.scale.unknown()));
        }
        Ok(match self.node_of(address) {
            Node::Block(slot) => BlockView::Mixed(slot.share(self.access)?),
            other => BlockView::Uniform(other.max()),
        })
    }

    /// The maximum class below a node (its class, where it is a leaf); deeper than the leaves: the leaf's class.
    /// Outside the root: unknown.
    ///
    /// # Errors
    /// When the node lies within a block that cannot be read.
    pub fn try_max_class(&self, node: NodeAddress) -> Result<Class, S::Error> {
        let deeper = u32::from(node.depth.saturating_sub(self.depth));
        let depth = node.depth.min(self.depth);
        let (x, y) = (node.x.checked_shr(deeper).unwrap_or(0), node.y.checked_shr(deeper).unwrap_or(0));
        if x >> depth != 0 || y >> depth != 0 {
            return Ok(self.scale.unknown());
        }
        let mut current = &self.root;
        for level in 0..depth {
            let Node::Inner(inner) = current else { break };
            let bit = depth - level - 1;
            current = &inner.children[((x >> bit & 1) | (y >> bit & 1) << 1) as usize];
        }
        match current {
            Node::Block(slot) if depth > self.levels() => {
                Ok(slot.read(self.access)?.max_at(depth + root_level(self.depth) - self.levels(), x, y))
            }
            other => Ok(other.max()),
        }
    }
}

impl OccupancyTree {
    /// Applies one scan's evidence; adds the addresses of the blocks whose classes changed to `changed` (a block may
    /// come more than once over several calls). Leaves outside the root are passed over.
    pub fn apply(&mut self, masks: &LeafMasks, changed: &mut Vec<BlockAddress>) {
        let Ok(()) = self.try_apply(masks, changed);
    }

    /// What stands at a block's address; outside the root: unknown.
    #[must_use]
    pub fn block(&self, address: BlockAddress) -> BlockView {
        let Ok(view) = self.try_block(address);
        view
    }

    /// The maximum class below a node (its class, where it is a leaf); deeper than the leaves: the leaf's class.
    /// Outside the root: unknown.
    #[must_use]
    pub fn max_class(&self, node: NodeAddress) -> Class {
        let Ok(class) = self.try_max_class(node);
        class
    }

    /// Replaces a block; a mixed block of one class is stored as uniform, equal siblings merge.
    ///
    /// Classes off the scale are held to it. An address outside the root is passed over.
    pub fn set_block(&mut self, address: BlockAddress, view: BlockView) {
        if !self.holds(address) {
            return;
        }
        let new = match view {
            BlockView::Uniform(class) => Node::Uniform(class.clamp(self.scale.free(), self.scale.occupied())),
            BlockView::Mixed(block) => Node::of_block(self.fitted(block), self.depth),
        };
        let Ok(_) = self.update(address, &mut |node| {
            let differs = *node != new;
            if differs {
                *node = new.clone();
            }
            Ok(differs)
        });
    }

    /// The block with its classes held to the scale and the lowest class where no leaf exists; itself where it fits.
    fn fitted(&self, block: Arc<Block>) -> Arc<Block> {
        let (lowest, highest) = (self.scale.free(), self.scale.occupied());
        let side = 1_usize << self.depth.min(BLOCK_LEVELS);
        let least = block.leaves().iter().copied().fold(highest, Class::min);
        let fits = side == 64 && block.max_at(0, 0, 0) <= highest && least >= lowest;
        if fits {
            return block;
        }
        let mut leaves = Box::new([lowest; 64 * 64]);
        for (row, source) in leaves.as_chunks_mut::<64>().0.iter_mut().zip(block.rows()).take(side) {
            for (class, source) in row.iter_mut().zip(source).take(side) {
                *class = (*source).clamp(lowest, highest);
            }
        }
        Arc::new(Block::from_leaves(leaves))
    }
}

/// Steps the node of one block; returns whether a class changed. `masks` names leaves that exist only, or all.
fn step<S: BlockSlot>(node: &mut Node<S>, masks: &BlockMasks, depth: u8, scale: ClassScale) -> Result<bool, S::Error> {
    match (&mut *node, masks) {
        (Node::Uniform(class), BlockMasks::AllEmpty) => {
            let new = scale.step(*class, false, true);
            let changed = new != *class;
            *class = new;
            Ok(changed)
        }
        (Node::Uniform(class), BlockMasks::Some { occupied, empty }) => {
            let rises = scale.step(*class, true, false) != *class && occupied.iter().any(|row| *row != 0);
            let falls =
                scale.step(*class, false, true) != *class && empty.iter().zip(&**occupied).any(|(e, o)| e & !o != 0);
            if !rises && !falls {
                return Ok(false);
            }
            let mut block = existing(*class, depth, scale);
            block.apply(occupied, empty, scale);
            *node = Node::of_block(Arc::new(block), depth);
            Ok(true)
        }
        (Node::Block(slot), masks) => {
            let Some(block) = slot.step(masks, scale)? else { return Ok(false) };
            if let Some(class) = block.node_uniform(root_level(depth)) {
                *node = Node::Uniform(class);
            }
            Ok(true)
        }
        (Node::Inner(_), _) => Ok(false),
    }
}

/// A block of one class where leaves exist.
fn existing(class: Class, depth: u8, scale: ClassScale) -> Block {
    if depth >= BLOCK_LEVELS {
        return Block::uniform(class);
    }
    let side = 1_usize << depth;
    let mut leaves = Box::new([scale.free(); 64 * 64]);
    for row in leaves.as_chunks_mut::<64>().0.iter_mut().take(side) {
        row[..side].fill(class);
    }
    Block::from_leaves(leaves)
}

/// The masks without leaves that do not exist in a tree of `depth` below 6.
fn clip(masks: &BlockMasks, depth: u8) -> BlockMasks {
    let side = 1_usize << depth;
    let clipped = |mask: &RowMask| {
        let mut rows = Box::new([0; 64]);
        for (row, source) in rows.iter_mut().zip(mask).take(side) {
            *row = source & ((1 << side) - 1);
        }
        rows
    };
    match masks {
        BlockMasks::AllEmpty => BlockMasks::AllEmpty,
        BlockMasks::Some { occupied, empty } => BlockMasks::Some { occupied: clipped(occupied), empty: clipped(empty) },
    }
}

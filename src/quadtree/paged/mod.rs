//! A map larger than memory: its blocks are fetched when they are looked into, and let go under a limit.
//!
//! Above the blocks a [`PagedTree`] is all there: every node with its maximum, so what the maxima answer needs no block.
//! For a block stands a [`BlockCell`], which holds the block or not. All trees that share a block share its cell.
//!
//! **A tree reads its own revision, whatever is committed meanwhile.** The store keeps a block's last record only, so
//! before a commit replaces it, the writer *holds* the cell of the old one ([`PagedTree::hold_replaced`]): it is in memory
//! then and stays there for as long as a tree has it. A cell fetches and is held under one lock. So a fetch that begins
//! before the hold finds the old record, and after it nothing is left to fetch.
//!
//! **What is not durable cannot be let go**, by its type: a block that the writer changed is [`PagedBlock::Own`], and
//! becomes a cell in [`PagedTree::settle`], which is called when its record is in the store.

mod cache;
mod cell;
#[cfg(all(test, feature = "shuttle"))]
mod schedules;

pub use cache::{BlockCache, CacheStatistics};
pub use cell::{Access, BlockCell, BlockPager, BlockSource, BlockTag, Held, PageError, PagedBlock, SourceError};

use super::tree::{Node, Tree};
use super::{BlockAddress, BlockView, Class, LeafMasks, OccupancyTree};
use std::sync::Arc;

/// A map whose blocks are fetched when they are looked into.
pub type PagedTree = Tree<PagedBlock>;

impl PagedTree {
    /// The same map, read without fetching anything: what is not in memory is [`PageError::Absent`].
    #[must_use]
    pub fn in_memory(&self) -> Self {
        self.with_access(Access::InMemory)
    }

    /// Puts a stored block of one class at its address; an address outside the root is passed over.
    pub fn place_uniform(&mut self, address: BlockAddress, class: Class) {
        self.place(address, &Node::Uniform(class.clamp(self.scale().free(), self.scale().occupied())));
    }

    /// Puts a stored block of mixed classes at its address, not fetched yet.
    pub fn place_stored(&mut self, tag: BlockTag, pager: &Arc<BlockPager>) {
        let cell = BlockCell::absent(tag, pager);
        self.place(tag.address, &Node::Block(PagedBlock::Cell(Arc::new(cell))));
    }

    /// Replaces a block: it is the tree's own until it is [settled](PagedTree::settle). A mixed block of one class becomes
    /// uniform; an address outside the root is passed over.
    pub fn replace(&mut self, address: BlockAddress, view: BlockView) {
        match view {
            BlockView::Uniform(class) => self.place_uniform(address, class),
            BlockView::Mixed(block) => self.place(address, &Node::of_block(block, self.depth())),
        }
    }

    fn place(&mut self, address: BlockAddress, new: &Node<PagedBlock>) {
        if self.holds(address) {
            // What the step below does cannot fail.
            let _ = self.update(address, &mut |node| {
                *node = new.clone();
                Ok(true)
            });
        }
    }

    /// Fetches the blocks that a scan's evidence looks into, so that applying it next does not fail half-way.
    ///
    /// # Errors
    /// When one of them cannot be read.
    pub fn prepare(&self, masks: &LeafMasks) -> Result<(), PageError> {
        for (address, _) in &masks.blocks {
            if self.holds(*address)
                && let Node::Block(PagedBlock::Cell(cell)) = self.node_of(*address)
            {
                cell.get(Access::Fetch)?;
            }
        }
        Ok(())
    }

    /// Holds the blocks of this tree that a commit is about to replace in the store. Called on the published tree.
    ///
    /// # Errors
    /// When one of them cannot be read; none is held then.
    pub fn hold_replaced(&self, changed: &[BlockAddress]) -> Result<Held, PageError> {
        self.hold_readable(changed, |_| false)
    }

    /// As [`PagedTree::hold_replaced`], but passes over blocks that cannot be read because of `passed`: who looks into one
    /// of them in this tree is told of damage then, as before the commit.
    ///
    /// # Errors
    /// When one of them cannot be read for another reason; none is held then.
    pub fn hold_readable(
        &self,
        changed: &[BlockAddress],
        passed: impl Fn(&PageError) -> bool,
    ) -> Result<Held, PageError> {
        let mut held = Held::default();
        for address in changed {
            if self.holds(*address)
                && let Node::Block(PagedBlock::Cell(cell)) = self.node_of(*address)
            {
                match held.add(cell) {
                    Err(error) if passed(&error) => {}
                    other => other?,
                }
            }
        }
        Ok(held)
    }

    /// Makes cells of the blocks at these addresses, whose records the store has since `revision`.
    pub fn settle(&mut self, changed: &[BlockAddress], revision: u64, pager: &Arc<BlockPager>) {
        for address in changed.iter().filter(|address| self.holds(**address)).copied().collect::<Vec<_>>() {
            // What the step below does cannot fail.
            let _ = self.update(address, &mut |node| {
                let Node::Block(slot) = node else { return Ok(false) };
                let PagedBlock::Own(block) = slot else { return Ok(false) };
                let tag = BlockTag { address, revision, max: block.max_at(0, 0, 0) };
                *slot = PagedBlock::Cell(BlockCell::stored(tag, Arc::clone(block), pager));
                Ok(true)
            });
        }
    }

    /// The map as a whole in memory.
    ///
    /// # Errors
    /// When a block cannot be read.
    pub fn try_whole(&self) -> Result<OccupancyTree, PageError> {
        let mut whole = OccupancyTree::new(self.depth(), self.scale());
        self.try_visit_blocks(&mut |address, view| whole.set_block(address, view.clone()))?;
        Ok(whole)
    }
}

/// A map that stays in memory.
impl From<&OccupancyTree> for PagedTree {
    fn from(tree: &OccupancyTree) -> Self {
        Self::from_root(tree.depth(), tree.scale(), owned(tree.root()))
    }
}

fn owned(node: &Node) -> Node<PagedBlock> {
    match node {
        Node::Uniform(class) => Node::Uniform(*class),
        Node::Block(block) => Node::Block(PagedBlock::Own(Arc::clone(block))),
        Node::Inner(inner) => Node::of_children(inner.children().each_ref().map(owned)),
    }
}

//! How a tree holds its blocks of mixed classes: in memory, or somewhere from where they are fetched.

use super::block::Block;
use super::masks::BlockMasks;
use super::{Class, ClassScale};
use std::convert::Infallible;
use std::ops::Deref;
use std::sync::Arc;

/// What stands in a tree for one block of mixed classes.
///
/// A tree is the same over either kind; only what it takes to look into a block differs, and whether that can fail.
pub trait BlockSlot: Clone + From<Arc<Block>> + std::fmt::Debug {
    /// Why a block cannot be read.
    type Error;

    /// How blocks are read; a tree has one value for all of its blocks.
    type Access: Copy + Default + std::fmt::Debug;

    /// A block while it is read.
    type Guard<'a>: Deref<Target = Block>
    where
        Self: 'a;

    /// The maximum class of the block, known without reading it.
    fn max(&self) -> Class;

    /// The block, to look into.
    ///
    /// # Errors
    /// When it has to be fetched and cannot be.
    fn read(&self, access: Self::Access) -> Result<Self::Guard<'_>, Self::Error>;

    /// The block, to keep.
    ///
    /// # Errors
    /// As [`BlockSlot::read`].
    fn share(&self, access: Self::Access) -> Result<Arc<Block>, Self::Error>;

    /// Applies one scan's evidence; the block as it is then, if a class changed. A block that others hold too is copied
    /// first where it would change.
    ///
    /// # Errors
    /// As [`BlockSlot::read`]; nothing has changed then.
    fn step(&mut self, masks: &BlockMasks, scale: ClassScale) -> Result<Option<&Block>, Self::Error>;
}

/// A block in memory for as long as a tree has it.
impl BlockSlot for Arc<Block> {
    type Error = Infallible;
    type Access = ();
    type Guard<'a> = &'a Block;

    fn max(&self) -> Class {
        self.max_at(0, 0, 0)
    }

    fn read(&self, (): ()) -> Result<&Block, Infallible> {
        Ok(self)
    }

    fn share(&self, (): ()) -> Result<Arc<Block>, Infallible> {
        Ok(Self::clone(self))
    }

    fn step(&mut self, masks: &BlockMasks, scale: ClassScale) -> Result<Option<&Block>, Infallible> {
        let changed = match masks {
            BlockMasks::AllEmpty => Self::make_mut(self).apply_all_empty(scale),
            BlockMasks::Some { occupied, empty } => match Self::get_mut(self) {
                Some(own) => own.apply(occupied, empty, scale),
                None => self.would_change(occupied, empty, scale) && Self::make_mut(self).apply(occupied, empty, scale),
            },
        };
        Ok(changed.then_some(&**self))
    }
}

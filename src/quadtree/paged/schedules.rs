//! Blocks that come and go under schedules: every root is its own revision, a block is fetched once, and none is let go
//! that the store does not have.

#![allow(clippy::unwrap_used, clippy::panic, reason = "a test fails by panicking")]

use super::{BlockCache, BlockPager, BlockSource, BlockTag, PagedTree, SourceError};
use crate::quadtree::{Block, BlockAddress, BlockMasks, BlockView, ClassScale, LeafMasks, OccupancyTree, RowMask};
use crate::sync::explore::explore;
use crate::sync::{Mutex, lock, thread};
use std::collections::BTreeMap;
use std::sync::Arc;

/// A map of two by two blocks.
const DEPTH: u8 = 7;

/// The last record of every block, as a store keeps it.
#[derive(Default)]
struct Shelf {
    records: Mutex<BTreeMap<u64, (u64, Arc<Block>)>>,
    fetches: Mutex<u32>,
}

struct Reader(Arc<Shelf>);

impl BlockSource for Reader {
    fn fetch(&self, tag: &BlockTag) -> Result<Arc<Block>, SourceError> {
        *lock(&self.0.fetches) += 1;
        match lock(&self.0.records).get(&tag.address.morton()) {
            Some((revision, block)) if *revision == tag.revision => Ok(Arc::clone(block)),
            other => panic!("{tag:?} was asked for, the shelf has revision {:?}", other.map(|(revision, _)| revision)),
        }
    }
}

/// One revision, paged and as a whole.
#[derive(Clone)]
struct Root {
    paged: PagedTree,
    whole: OccupancyTree,
}

impl Root {
    fn is_itself(&self) {
        assert!(self.paged.try_whole().unwrap() == self.whole, "blocks of another revision");
    }

    /// At once.
    fn is_looked_into_by_three(&self) {
        let look = |root: Self| thread::spawn(move || root.is_itself());
        let readers = [self.clone(), self.clone(), self.clone()].map(look);
        readers.into_iter().for_each(|reader| reader.join().unwrap());
    }

    /// What is there without the shelf is right too.
    fn is_itself_as_far_as_it_is_in_memory(&self) {
        let paged = self.paged.in_memory();
        for address in addresses() {
            if let Ok(BlockView::Mixed(block)) = paged.try_block(address) {
                assert!(BlockView::Mixed(block) == self.whole.block(address), "a block of another revision");
            }
        }
    }
}

struct Desk {
    shelf: Arc<Shelf>,
    cache: Arc<BlockCache>,
    pager: Arc<BlockPager>,
}

fn addresses() -> impl Iterator<Item = BlockAddress> {
    (0..4).map(|at| BlockAddress { x: at % 2, y: at / 2 })
}

fn masks(blocks: impl Iterator<Item = BlockAddress>, row: usize) -> LeafMasks {
    let (mut occupied, empty): (Box<RowMask>, Box<RowMask>) = (Box::new([0; 64]), Box::new([0; 64]));
    occupied[row] = 0b1011;
    let masks = BlockMasks::Some { occupied, empty };
    LeafMasks { blocks: blocks.map(|address| (address, masks.clone())).collect() }
}

impl Desk {
    /// A map at revision 1 as it is found at a start: no block is in memory, and `fit` may be.
    fn open(fit: usize) -> (Self, Root) {
        let (shelf, cache) = (Arc::<Shelf>::default(), Arc::new(BlockCache::new(fit * 5700)));
        let pager = Arc::new(BlockPager::new(Box::new(Reader(Arc::clone(&shelf))), Arc::clone(&cache)));
        let scale = ClassScale::new(20).unwrap();
        let mut root = Root { paged: PagedTree::new(DEPTH, scale), whole: OccupancyTree::new(DEPTH, scale) };
        root.whole.apply(&masks(addresses(), 0), &mut Vec::new());
        for address in addresses() {
            let BlockView::Mixed(block) = root.whole.block(address) else { panic!("a mixed block") };
            lock(&shelf.records).insert(address.morton(), (1, Arc::clone(&block)));
            root.paged.place_stored(BlockTag { address, revision: 1, max: block.max_at(0, 0, 0) }, &pager);
        }
        (Self { shelf, cache, pager }, root)
    }

    /// A commit as a map's writer makes it; one that fails at its end has not happened.
    fn commit(&self, base: &Root, revision: u64, masks: &LeafMasks, fails: bool) -> Root {
        let (mut next, mut changed) = (base.clone(), Vec::new());
        next.paged.prepare(masks).unwrap();
        next.paged.try_apply(masks, &mut changed).unwrap();
        next.whole.apply(masks, &mut Vec::new());
        let held = base.paged.hold_replaced(&changed).unwrap();
        if fails {
            return base.clone();
        }
        for address in &changed {
            let BlockView::Mixed(block) = next.paged.try_block(*address).unwrap() else { panic!("a mixed block") };
            lock(&self.shelf.records).insert(address.morton(), (revision, block));
        }
        held.keep();
        next.paged.settle(&changed, revision, &self.pager);
        next
    }

    /// With the last root the last block goes.
    fn ends_empty(self) {
        assert_eq!(self.cache.statistics().bytes, 0, "blocks are counted that are gone");
    }
}

#[test]
fn every_root_is_its_own_revision_while_blocks_come_and_go() {
    for fit in [0, 1, 8] {
        explore(150, move || {
            let (desk, mut root) = Desk::open(fit);
            let mut readers = Vec::new();
            for revision in 2..=4 {
                let seen = root.clone();
                readers.push(thread::spawn(move || {
                    seen.is_itself_as_far_as_it_is_in_memory();
                    seen.is_itself();
                    seen.is_itself();
                }));
                // Others blocks each time, and one of them twice; the second commit fails.
                let blocks = addresses().filter(|address| u64::from(address.x) != revision % 2 || address.y == 1);
                root = desk.commit(&root, revision, &masks(blocks, revision as usize), revision == 3);
            }
            root.is_itself();
            drop(root);
            readers.into_iter().for_each(|reader| reader.join().unwrap());
            desk.ends_empty();
        });
    }
}

#[test]
fn a_block_that_many_look_into_is_fetched_once() {
    explore(500, || {
        let (desk, root) = Desk::open(8);
        root.is_looked_into_by_three();
        assert_eq!(*lock(&desk.shelf.fetches), 4, "each block once");
        let statistics = desk.cache.statistics();
        assert_eq!((statistics.loads, statistics.evictions), (4, 0));
        drop(root);
        desk.ends_empty();
    });
}

#[test]
fn the_cache_keeps_its_limit_and_its_count_among_many() {
    explore(300, || {
        let (desk, root) = Desk::open(2);
        root.is_looked_into_by_three();
        // Nothing is held here: what was over the limit while somebody looked goes with the next that comes.
        root.is_itself();
        assert!(desk.cache.statistics().bytes <= 2 * 5700, "{:?}", desk.cache.statistics());
        drop(root);
        desk.ends_empty();
    });
}

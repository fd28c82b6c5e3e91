//! A shelf of blocks that keeps the last record of each, as a store does, and a map that is committed to it.
#![allow(clippy::unwrap_used, clippy::panic, reason = "a test fails by panicking")]

use std::collections::BTreeMap;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex};
use ubbmap::quadtree::{
    Block, BlockAddress, BlockCache, BlockPager, BlockSource, BlockTag, BlockView, ClassScale, LeafMasks,
    OccupancyTree, PagedTree, SourceError,
};

/// The last record of every block, by Morton code: the revision that wrote it, and what it holds.
#[derive(Default)]
pub struct Shelf {
    records: Mutex<BTreeMap<u64, (u64, BlockView)>>,
    pub broken: AtomicBool,
    pub fetches: AtomicU64,
}

/// What the map's pager has of the shelf.
struct Reader(Arc<Shelf>);

impl BlockSource for Reader {
    fn fetch(&self, tag: &BlockTag) -> Result<Arc<Block>, SourceError> {
        self.0.fetches.fetch_add(1, Ordering::SeqCst);
        if self.0.broken.load(Ordering::SeqCst) {
            return Err("the shelf is broken".into());
        }
        match self.0.records.lock().unwrap().get(&tag.address.morton()) {
            Some((revision, BlockView::Mixed(block))) if *revision == tag.revision => Ok(Arc::clone(block)),
            other => panic!("{tag:?} was asked for, the shelf has {other:?}"),
        }
    }
}

/// One revision of the map, paged and as a whole.
#[derive(Clone)]
pub struct Root {
    pub paged: PagedTree,
    pub whole: OccupancyTree,
}

/// A map with its writer.
pub struct Desk {
    pub shelf: Arc<Shelf>,
    pub cache: Arc<BlockCache>,
    pub pager: Arc<BlockPager>,
    pub root: Root,
    pub revision: u64,
}

impl Desk {
    pub fn new(depth: u8, cache_bytes: usize) -> Self {
        let shelf = Arc::<Shelf>::default();
        let cache = Arc::new(BlockCache::new(cache_bytes));
        let pager = Arc::new(BlockPager::new(Box::new(Reader(Arc::clone(&shelf))), Arc::clone(&cache)));
        let scale = ClassScale::new(10).unwrap();
        let root = Root { paged: PagedTree::new(depth, scale), whole: OccupancyTree::new(depth, scale) };
        Self { shelf, cache, pager, root, revision: 0 }
    }

    /// A commit of some scans, as a map's writer makes it; where it fails at its end, nothing has happened.
    pub fn commit(&mut self, scans: &[LeafMasks], fails: bool) {
        let (mut next, mut changed) = (self.root.clone(), Vec::new());
        for masks in scans {
            next.paged.prepare(masks).unwrap();
            next.paged.try_apply(masks, &mut changed).unwrap();
            let mut expected = Vec::new();
            next.whole.apply(masks, &mut expected);
            assert!(changed.ends_with(&expected));
        }
        changed.sort_by_key(|address| address.morton());
        changed.dedup();
        let blocks: Vec<_> =
            changed.iter().map(|address| (*address, next.paged.try_block(*address).unwrap())).collect();
        let held = self.root.paged.hold_replaced(&changed).unwrap();
        if fails {
            return;
        }
        self.revision += 1;
        let mut records = self.shelf.records.lock().unwrap();
        records.extend(blocks.iter().map(|(address, view)| (address.morton(), (self.revision, view.clone()))));
        drop(records);
        held.keep();
        next.paged.settle(&changed, self.revision, &self.pager);
        self.root = next;
    }

    /// The map as a server finds it that was started anew.
    pub fn reopened(&self) -> Root {
        let mut paged = PagedTree::new(self.root.paged.depth(), self.root.paged.scale());
        for (morton, (revision, view)) in &*self.shelf.records.lock().unwrap() {
            let address = BlockAddress::from_morton(*morton);
            match view {
                BlockView::Uniform(class) => paged.place_uniform(address, *class),
                BlockView::Mixed(block) => {
                    let tag = BlockTag { address, revision: *revision, max: block.max_at(0, 0, 0) };
                    paged.place_stored(tag, &self.pager);
                }
            }
        }
        Root { paged, whole: self.root.whole.clone() }
    }
}

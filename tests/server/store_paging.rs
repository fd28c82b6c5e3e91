//! Maps opened without reading their blocks: the same maps, also where the groups or the blocks are damaged.

use crate::store_damage::{framed, raw};
use crate::store_support::{Model, config, fill};
use std::path::Path;
use std::sync::Arc;
use ubbmap::quadtree::{BlockAddress, BlockCache, BlockView, LeafRange, NodeAddress, PageError};
use ubbmap::store::{MapId, MapStore, MemoryStore, OpenMap, SledOptions, SledStore, StoreError};

fn sled(directory: &Path) -> SledStore {
    SledStore::open(directory, SledOptions::default()).unwrap()
}

fn opened(store: &dyn MapStore, id: MapId) -> (OpenMap, Arc<BlockCache>) {
    let cache = Arc::new(BlockCache::new(2 * 5600));
    (store.open(id, &cache).unwrap(), cache)
}

fn assert_open(store: &dyn MapStore, id: MapId, model: &Model) {
    let (open, cache) = opened(store, id);
    assert_eq!((open.revision, &open.windows), (model.revision, &model.windows));
    let depth = model.tree.depth();
    if depth > 6 {
        let end = 1 << (depth - 6);
        let range = LeafRange { min_x: 0, min_y: 0, max_x: end, max_y: end };
        assert_eq!(open.tree.try_raster(&range, depth - 6).unwrap(), model.tree.raster(&range, depth - 6));
    }
    assert_eq!(cache.statistics().loads, 0, "maxima are known without a block");
    assert_eq!(open.tree.try_whole().unwrap(), model.tree);
}

fn key(kind: u8, id: MapId, number: u64) -> Vec<u8> {
    [&[kind][..], &id.0.to_be_bytes(), &number.to_be_bytes()].concat()
}

#[test]
fn a_map_opened_without_its_blocks_is_the_map_that_is_loaded() {
    for (depth, classes) in [(10, 10), (9, 40), (12, 4), (6, 10), (3, 10)] {
        let directory = tempfile::tempdir().unwrap();
        for store in [Box::new(MemoryStore::new()) as Box<dyn MapStore>, Box::new(sled(directory.path()))] {
            let (id, mut model) = fill(&*store, "a", config(depth, classes, 1), u64::from(depth), 12);
            assert_open(&*store, id, &model);
            store.commit(id, &model.step(8)).unwrap();
            assert_open(&*store, id, &model);
        }
        let store = sled(directory.path());
        assert_eq!(store.verify().unwrap().problems, Vec::<String>::new());
    }
}

#[test]
fn groups_that_are_damaged_wrong_or_lost_are_made_anew_and_repaired_by_the_next_commit() {
    let directory = tempfile::tempdir().unwrap();
    let (id, mut model) = fill(&sled(directory.path()), "a", config(10, 10, 1), 5, 10);
    let group = key(0x31, id, 0);
    let sound = raw(directory.path(), |db| db.get(&group).unwrap().unwrap().to_vec());
    let revision = model.revision;
    let one_mixed = |max: u8, revision: u64| {
        let bits = 1_u64.to_be_bytes();
        framed(&group, 1, 1, &[&bits[..], &bits, &[max], &revision.to_be_bytes()].concat())
    };
    for (edit, expected) in [
        (Some([&sound[..sound.len() - 1], &[!sound[sound.len() - 1]]].concat()), "checksum"),
        (Some(one_mixed(1, 1)), "other blocks"),
        (Some(one_mixed(200, 1)), "other blocks"),
        (Some(one_mixed(1, revision + 9)), "other blocks"),
        (Some(framed(&group, 1, 1, &[0; 16])), "a group without blocks"),
        (None, "missing"),
    ] {
        raw(directory.path(), |db| match &edit {
            Some(value) => drop(db.insert(&group, value.as_slice()).unwrap()),
            None => drop(db.remove(&group).unwrap()),
        });
        let store = sled(directory.path());
        let problems = store.verify().unwrap().problems;
        assert!(problems.len() == 1 && problems[0].contains(expected), "{expected}: {problems:?}");
        assert_open(&store, id, &model);
        // Every block of the group is written again before this ends.
        while !store.verify().unwrap().problems.is_empty() {
            store.commit(id, &model.step(6)).unwrap();
        }
        assert_open(&store, id, &model);
    }
}

#[test]
fn a_damaged_block_fails_what_looks_into_it_and_not_the_map() {
    let directory = tempfile::tempdir().unwrap();
    let (id, model) = fill(&sled(directory.path()), "a", config(10, 10, 1), 5, 10);
    let mut mixed = Vec::new();
    model.tree.visit_blocks(&mut |at, view| mixed.extend(matches!(view, BlockView::Mixed(_)).then_some(at)));
    let [bad, good] = [mixed[0], mixed[1]];
    let record = key(0x30, id, bad.morton());
    let leaf = |at: BlockAddress| NodeAddress { depth: 10, x: at.x * 64, y: at.y * 64 };
    let plain = framed(&record, 1, 1, &[0b0010_0000]);
    for (value, expected) in [(Some(&b"nonsense"[..]), "bytes"), (None, "missing"), (Some(&plain), "of revision 1")] {
        raw(directory.path(), |db| match value {
            Some(value) => drop(db.insert(&record, value).unwrap()),
            None => drop(db.remove(&record).unwrap()),
        });
        let store = sled(directory.path());
        let (open, _) = opened(&store, id);
        assert_eq!(open.tree.try_max_class(leaf(good)).unwrap(), model.tree.max_class(leaf(good)));
        let error = open.tree.try_max_class(leaf(bad)).unwrap_err();
        assert!(matches!(error, PageError::Source(_)));
        let error = StoreError::from(error).to_string();
        let block = format!("map {}, block ({}, {})", id.0, bad.x, bad.y);
        assert!(error.contains(&block) && error.contains(expected), "{error}");
    }
}

#[test]
fn the_blocks_of_a_deleted_map_are_of_no_map() {
    let directory = tempfile::tempdir().unwrap();
    let store = sled(directory.path());
    for store in [&store as &dyn MapStore, &MemoryStore::new()] {
        let (id, _) = fill(store, "a", config(10, 10, 1), 5, 10);
        let (open, _) = opened(store, id);
        store.delete(id).unwrap();
        let error = StoreError::from(open.tree.try_whole().unwrap_err());
        assert!(matches!(error, StoreError::NoMap(gone) if gone == id), "{error}");
    }
    drop(store);
    let left: Vec<u8> = raw(directory.path(), |db| db.iter().keys().map(|key| key.unwrap()[0]).collect());
    assert!(left.iter().all(|kind| *kind < 0x10), "{left:?}");
}

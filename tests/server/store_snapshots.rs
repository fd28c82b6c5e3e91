//! Snapshots of a store on disk: what they cost, what they survive, and what they leave for a bad day.

use crate::store_support::{Model, assert_same, config, fill, name};
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use ubbmap::quadtree::{Block, BlockAddress, BlockView};
use ubbmap::store::{
    Commit, LoadedMap, MapStore, MemoryStore, SledOptions, SledStore, SnapshotName, StoreError, read_map_file,
};

fn open(directory: &Path) -> SledStore {
    SledStore::open(directory, SledOptions::default()).unwrap()
}

fn named(name: &str) -> SnapshotName {
    SnapshotName::new(name).unwrap()
}

/// One block of mixed classes that differ with `turn`.
fn block(turn: u64) -> BlockView {
    let mut leaves = Box::new([5; 64 * 64]);
    for (at, leaf) in leaves.iter_mut().enumerate() {
        *leaf = 1 + ((at as u64 * 7 + turn) % 9) as u8;
    }
    BlockView::Mixed(std::sync::Arc::new(Block::from_leaves(leaves)))
}

#[test]
fn a_thousand_snapshots_of_a_map_that_barely_changes_cost_about_the_changes() {
    let directory = tempfile::tempdir().unwrap();
    let store = open(directory.path());
    let id = store.create(&name("hall"), &config(12, 10, 1), 0.0).unwrap();
    let all = (0..400).map(|n| (BlockAddress { x: n % 20, y: n / 20 }, block(u64::from(n)))).collect();
    store.commit(id, &Commit { revision: 1, changed: 1.0, blocks: all, windows: Vec::new() }).unwrap();
    let whole = store.verify().unwrap().bytes;
    for revision in 2..1002 {
        store.take_snapshot(id, &named(&format!("s{revision}")), 0.0).unwrap();
        let changed = vec![(BlockAddress { x: 3, y: 4 }, block(revision))];
        store.commit(id, &Commit { revision, changed: 1.0, blocks: changed, windows: Vec::new() }).unwrap();
    }
    let found = store.verify().unwrap();
    assert_eq!(found.problems, Vec::<String>::new());
    // A kept block and a snapshot's record each: a copy of the map for each would be 400 blocks.
    let (each, of_block) = ((found.bytes - whole) / 1000, whole / 400);
    assert!(each < of_block + 150, "{each} bytes a snapshot, a block has {of_block}");
    let LoadedMap { revision, tree, .. } = store.load_snapshot(id, &named("s500")).unwrap();
    assert_eq!((revision, tree.block(BlockAddress { x: 3, y: 4 })), (499, block(499)));
    // What no snapshot needs goes with the last that needed it.
    for revision in 2..1002 {
        store.delete_snapshot(id, &named(&format!("s{revision}"))).unwrap();
    }
    assert_eq!(store.verify().unwrap().bytes, whole);
}

#[test]
fn a_snapshot_is_read_whole_while_commits_replace_its_blocks() {
    let directory = tempfile::tempdir().unwrap();
    let (store, twin) = (open(directory.path()), MemoryStore::new());
    let (id, mut model) = fill(&store, "hall", config(12, 10, 1), 5, 30);
    let expected = model.loaded();
    let of_twin = twin.import(&name("hall"), &model.config, 0.0, &expected).unwrap();
    store.take_snapshot(id, &named("then"), 0.0).unwrap();
    let done = AtomicBool::new(false);
    let reads = std::thread::scope(|scope| {
        let reader = scope.spawn(|| {
            let mut reads = 0;
            while !done.load(Ordering::SeqCst) || reads == 0 {
                assert_same(&store.load_snapshot(id, &named("then")).unwrap(), &expected);
                reads += 1;
            }
            reads
        });
        for _ in 0..150 {
            let commit = model.step(12);
            store.commit(id, &commit).unwrap();
            twin.commit(of_twin, &commit).unwrap();
        }
        done.store(true, Ordering::SeqCst);
        reader.join().unwrap()
    });
    assert!(reads > 0);
    assert_same(&store.load(id).unwrap(), &twin.load(of_twin).unwrap());
    assert_same(&store.load_snapshot(id, &named("then")).unwrap(), &expected);
    assert_eq!(store.verify().unwrap().problems, Vec::<String>::new());
}

#[test]
fn a_store_that_cannot_be_opened_offers_the_copies_of_its_snapshots() {
    let directory = tempfile::tempdir().unwrap();
    let store = open(directory.path());
    let (hall, mut model) = fill(&store, "hall", config(9, 10, 1), 6, 5);
    let (yard, _) = fill(&store, "yard", config(9, 10, 1), 7, 3);
    let (gone, _) = fill(&store, "gone", config(9, 10, 1), 8, 3);
    for id in [hall, yard, gone] {
        store.take_snapshot(id, &named("first"), 0.0).unwrap();
        store.keep_copy(id).unwrap();
    }
    store.commit(hall, &model.step(4)).unwrap();
    store.take_snapshot(hall, &named("second"), 0.0).unwrap();
    store.keep_copy(hall).unwrap();
    let expected = model.loaded();
    store.commit(hall, &model.step(4)).unwrap();
    store.delete(gone).unwrap();
    assert!(matches!(store.keep_copy(gone), Err(StoreError::NoMap(_))));
    drop(store);

    let yard = directory.path().join("copies/yard.ubbmap");
    let mut bytes = std::fs::read(&yard).unwrap();
    let middle = bytes.len() / 2;
    bytes[middle] ^= 1;
    std::fs::write(&yard, bytes).unwrap();
    std::fs::write(directory.path().join("sled/db"), vec![0x5a; 1 << 20]).unwrap();
    let error = SledStore::open(directory.path(), SledOptions::default()).unwrap_err().to_string();
    assert!(error.contains("hall at revision 6") && !error.contains("yard at"), "{error}");
    assert!(error.contains("ubbmap map import"), "{error}");

    let file = std::fs::read(directory.path().join("copies/hall.ubbmap")).unwrap();
    let (found, map) = read_map_file(&mut file.as_slice()).unwrap();
    let fresh = tempfile::tempdir().unwrap();
    let store = open(fresh.path());
    let id = store.import(&name("hall"), &found, 0.0, &map).unwrap();
    assert_same(&store.load(id).unwrap(), &expected);
    // Without the database what is left is not taken for an empty directory.
    std::fs::remove_dir_all(directory.path().join("sled")).unwrap();
    let _ = std::fs::remove_dir_all(directory.path().join("damaged"));
    std::fs::remove_file(directory.path().join("acknowledged")).unwrap();
    let error = SledStore::open(directory.path(), SledOptions::default()).unwrap_err();
    assert!(
        matches!(&error, StoreError::NoStore { .. }) && error.to_string().contains("hall at revision 6"),
        "{error}"
    );
}

#[test]
fn a_lost_or_damaged_record_of_a_snapshot_is_named_and_the_rest_is_served() {
    let directory = tempfile::tempdir().unwrap();
    let store = open(directory.path());
    let (id, mut model) = fill(&store, "hall", config(9, 10, 1), 9, 5);
    store.take_snapshot(id, &named("then"), 0.0).unwrap();
    let then = model.loaded();
    store.commit(id, &model.step(8)).unwrap();
    store.take_snapshot(id, &named("later"), 0.0).unwrap();
    let later = model.loaded();
    store.commit(id, &model.step(8)).unwrap();
    let now = Model::loaded(&model);
    drop(store);
    let raw = |change: &dyn Fn(&sled::Db)| {
        let db = sled::open(directory.path().join("sled")).unwrap();
        change(&db);
        db.flush().unwrap();
        drop(db);
        std::thread::sleep(std::time::Duration::from_millis(100));
    };
    let kept: Vec<(Vec<u8>, Vec<u8>)> = {
        let db = sled::open(directory.path().join("sled")).unwrap();
        let kept = db.scan_prefix([0x41]).map(|record| record.unwrap());
        kept.map(|(key, value)| (key.to_vec(), value.to_vec())).collect()
    };
    std::thread::sleep(std::time::Duration::from_millis(100));
    for (key, value) in &kept {
        for damage in [None, Some(vec![7; value.len()])] {
            raw(&|db| match &damage {
                None => drop(db.remove(key).unwrap()),
                Some(bytes) => drop(db.insert(key.as_slice(), bytes.as_slice()).unwrap()),
            });
            let store = open(directory.path());
            assert_same(&store.load(id).unwrap(), &now);
            let mut wrong = 0;
            for (snapshot, expected) in [("then", &then), ("later", &later)] {
                match store.load_snapshot(id, &named(snapshot)) {
                    Ok(found) => assert_same(&found, expected),
                    Err(StoreError::Damaged { what }) => {
                        wrong += 1;
                        assert!(what.contains("map 1"), "{what}");
                    }
                    Err(other) => panic!("{other}"),
                }
            }
            assert!(wrong > 0, "{key:?}");
            assert!(!store.verify().unwrap().problems.is_empty());
            drop(store);
            raw(&|db| drop(db.insert(key.as_slice(), value.as_slice()).unwrap()));
        }
    }
    assert!(!kept.is_empty());
    assert_eq!(open(directory.path()).verify().unwrap().problems, Vec::<String>::new());
}

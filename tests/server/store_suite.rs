//! What every store does, asked of both.

use crate::store_support::{Model, assert_same, config, fill, name, robot, shapes};
use proptest::prelude::*;
use std::sync::Arc;
use ubbmap::quadtree::{Block, BlockAddress, BlockView};
use ubbmap::store::{Commit, MapId, MapStore, MemoryStore, SequenceWindow, SledOptions, SledStore, StoreError};

fn on_both(check: impl Fn(&dyn MapStore)) {
    check(&MemoryStore::new());
    let directory = tempfile::tempdir().unwrap();
    check(&SledStore::open(directory.path(), SledOptions::default()).unwrap());
}

#[test]
fn an_empty_store_lists_nothing() {
    on_both(|store| {
        assert!(store.list().unwrap().is_empty());
        assert!(store.damaged().is_empty());
        assert!(store.failure().is_none());
        assert!(matches!(store.load(MapId(1)), Err(StoreError::NoMap(MapId(1)))));
        assert!(matches!(store.delete(MapId(1)), Err(StoreError::NoMap(MapId(1)))));
        assert!(matches!(store.update_config(MapId(1), &config(8, 10, 1)), Err(StoreError::NoMap(_))));
        let commit = Commit { revision: 1, changed: 0.0, blocks: Vec::new(), windows: Vec::new() };
        assert!(matches!(store.commit(MapId(1), &commit), Err(StoreError::NoMap(MapId(1)))));
    });
}

#[test]
fn a_created_map_is_listed_by_name_and_empty() {
    on_both(|store| {
        let b = store.create(&name("b"), &config(16, 10, 2), 1_732_233_600.25).unwrap();
        let a = store.create(&name("a"), &config(3, 200, 1), 7.0).unwrap();
        assert!(
            matches!(store.create(&name("b"), &config(3, 4, 1), 0.0), Err(StoreError::Exists(taken)) if taken == name("b"))
        );
        let maps = store.list().unwrap();
        assert_eq!(maps.iter().map(|map| (map.name.as_str(), map.id)).collect::<Vec<_>>(), [("a", a), ("b", b)]);
        assert_eq!((maps[1].created, maps[1].revision, &maps[1].config), (1_732_233_600.25, 0, &config(16, 10, 2)));
        assert_same(&store.load(a).unwrap(), &Model::new(config(3, 200, 1), 0).loaded());
    });
}

#[test]
fn numbers_of_deleted_maps_are_not_used_again() {
    on_both(|store| {
        let first = fill(store, "plant", config(10, 10, 1), 1, 3).0;
        store.delete(first).unwrap();
        assert!(matches!(store.load(first), Err(StoreError::NoMap(_))));
        assert!(matches!(store.delete(first), Err(StoreError::NoMap(_))));
        let (second, model) = fill(store, "plant", config(10, 10, 1), 2, 1);
        assert!(second > first);
        assert_same(&store.load(second).unwrap(), &model.loaded());
    });
}

#[test]
fn only_sensors_of_a_map_change() {
    on_both(|store| {
        let (id, mut model) = fill(store, "plant", config(10, 10, 4), 3, 4);
        // 1 sensor is of the same rule as 4; three are taken away.
        let fewer = config(10, 10, 1);
        store.update_config(id, &fewer).unwrap();
        assert_eq!(store.list().unwrap()[0].config, fewer);
        for other in [config(11, 10, 4), config(10, 12, 4), config(10, 10, 2)] {
            assert!(matches!(store.update_config(id, &other), Err(StoreError::Refused(_))));
        }
        assert_eq!(store.list().unwrap()[0].config, fewer);
        store.commit(id, &model.step(3)).unwrap();
        assert_same(&store.load(id).unwrap(), &model.loaded());
    });
}

#[test]
fn a_commit_that_does_not_fit_is_refused_whole() {
    on_both(|store| {
        let (id, mut model) = fill(store, "plant", config(8, 10, 1), 4, 5);
        let before = model.loaded();
        let good = model.step(4);
        let with = |change: &dyn Fn(&mut Commit)| {
            let mut commit = good.clone();
            change(&mut commit);
            commit
        };
        let block = |x, y, class| (BlockAddress { x, y }, BlockView::Uniform(class));
        let mut leaves = Box::new([5; 64 * 64]);
        leaves[99] = 11;
        let mixed = BlockView::Mixed(Arc::new(Block::from_leaves(leaves)));
        let window = || (robot(9), SequenceWindow::default());
        for (why, commit) in [
            ("revision", with(&|commit| commit.revision = 5)),
            ("revision", with(&|commit| commit.revision = 0)),
            ("outside", with(&|commit| commit.blocks.push(block(4, 0, 1)))),
            ("outside", with(&|commit| commit.blocks.push(block(0, u32::MAX, 1)))),
            ("class 0", with(&|commit| commit.blocks = vec![block(0, 0, 0)])),
            ("class 11", with(&|commit| commit.blocks = vec![block(0, 0, 11)])),
            ("class 11", with(&|commit| commit.blocks = vec![(BlockAddress { x: 1, y: 1 }, mixed.clone())])),
            ("twice", with(&|commit| commit.blocks = vec![block(1, 1, 1), block(1, 1, 2)])),
            ("twice", with(&|commit| commit.windows = vec![window(), window()])),
        ] {
            match store.commit(id, &commit) {
                Err(StoreError::Refused(reason)) => assert!(reason.contains(why), "{reason:?} should tell {why:?}"),
                other => panic!("{why}: {other:?}"),
            }
        }
        assert_same(&store.load(id).unwrap(), &before);
        store.commit(id, &good).unwrap();
        assert_same(&store.load(id).unwrap(), &model.loaded());
    });
}

#[test]
fn maps_do_not_touch_each_other() {
    on_both(|store| {
        let mut maps: Vec<_> =
            (0..4).map(|n| fill(store, &format!("m{n}"), config(9 + n, 10, 1), u64::from(n), 0)).collect();
        std::thread::scope(|scope| {
            for (id, model) in &mut maps {
                scope.spawn(|| {
                    for _ in 0..15 {
                        store.commit(*id, &model.step(4)).unwrap();
                    }
                });
            }
        });
        store.delete(maps[1].0).unwrap();
        for (id, model) in maps.iter().enumerate().filter(|(n, _)| *n != 1).map(|(_, map)| map) {
            assert_same(&store.load(*id).unwrap(), &model.loaded());
        }
    });
}

#[test]
fn the_memory_store_fails_on_request() {
    let store = MemoryStore::new();
    let (id, mut model) = fill(&store, "plant", config(8, 10, 1), 4, 2);
    let before = model.loaded();
    store.fail_next_load("map 1, block (0, 0)");
    assert!(matches!(store.load(id), Err(StoreError::Damaged { .. })));
    store.fail_next_commit("no space");
    let commit = model.step(3);
    assert!(matches!(store.commit(id, &commit), Err(StoreError::FailStop(_))));
    assert!(matches!(store.commit(id, &commit), Err(StoreError::FailStop(_))));
    assert!(matches!(store.create(&name("b"), &config(8, 10, 1), 0.0), Err(StoreError::FailStop(_))));
    assert_eq!((store.failure().as_deref(), store.commits()), (Some("no space"), 2));
    assert_same(&store.load(id).unwrap(), &before);
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]

    #[test]
    fn a_reopened_store_gives_the_same_map((depth, classes) in shapes(), seed: u64, commits in 1_usize..12) {
        let directory = tempfile::tempdir().unwrap();
        let options = SledOptions::default();
        let map_config = config(depth, classes, 1 + (seed % 9) as usize);
        let (id, mut model) = {
            let store = SledStore::open(directory.path(), options).unwrap();
            fill(&store, "plant", map_config.clone(), seed, commits)
        };
        for _ in 0..2 {
            let store = SledStore::open(directory.path(), options).unwrap();
            let maps = store.list().unwrap();
            prop_assert_eq!(&maps[0].config, &map_config);
            prop_assert_eq!((maps[0].revision, maps[0].created), (model.revision, 1.5e9));
            assert_same(&store.load(id).unwrap(), &model.loaded());
            prop_assert_eq!(store.verify().unwrap().problems, Vec::<String>::new());
            store.commit(id, &model.step(3)).unwrap();
        }
    }
}

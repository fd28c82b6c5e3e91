//! The thread that looks at the size of the store: what it counts, and when it has the store rewritten.

use crate::store_rewrite::{databases, open, rewrite, wide};
use crate::store_support::{assert_same, config, fill};
use std::time::{Duration, Instant};
use ubbmap::store::{MapStore, RewriteOptions, SledOptions, SledStore, StoreStatistics};

fn options(factor: f64, least_bytes: u64) -> SledOptions {
    let check = Duration::from_millis(5);
    SledOptions { rewrite: RewriteOptions { factor, least_bytes, check }, ..SledOptions::default() }
}

/// Waits until what the upkeep says is so; `what` and the last of it when that takes for ever.
#[track_caller]
pub fn wait_until(store: &SledStore, what: &str, so: impl Fn(&StoreStatistics) -> bool) {
    let start = Instant::now();
    while !so(&store.statistics().unwrap()) {
        assert!(start.elapsed() < Duration::from_secs(60), "{what}: {:?}", store.statistics());
        std::thread::sleep(Duration::from_millis(2));
    }
}

#[test]
fn live_bytes_are_counted_once_and_kept_up_by_every_kind_of_change() {
    let directory = tempfile::tempdir().unwrap();
    let (id, mut model) = fill(&open(directory.path()), "plant", config(10, 10, 4), 3, 20);
    let store = SledStore::open(directory.path(), options(1e6, 1 << 40)).unwrap();
    let matches = |what: &str| {
        let bytes = store.verify().unwrap().bytes;
        wait_until(&store, what, |seen| seen.live_bytes == Some(bytes));
    };
    matches("counted");
    store.commit(id, &model.step(9)).unwrap();
    matches("a commit");
    store.update_config(id, &config(10, 10, 1)).unwrap();
    matches("fewer sensors");
    let (other, _) = fill(&store, "other", config(11, 200, 3), 4, 9);
    matches("another map");
    store.delete(other).unwrap();
    matches("a deletion");
    rewrite(&store);
    matches("a rewrite");
    store.commit(id, &model.step(9)).unwrap();
    matches("a commit after it");
    let seen = store.statistics().unwrap();
    assert_eq!((seen.rewrites, seen.failed_rewrites), (1, 0));
    assert!(seen.disk_bytes >= store.disk_bytes().unwrap() / 2);
}

#[test]
fn a_store_that_shrank_is_rewritten_by_itself_and_only_once() {
    let directory = tempfile::tempdir().unwrap();
    let store = SledStore::open(directory.path(), options(4.0, 1 << 20)).unwrap();
    let (id, _) = wide(&store);
    let (kept, mut model) = fill(&store, "kept", config(10, 10, 1), 3, 5);
    store.delete(id).unwrap();
    wait_until(&store, "a rewrite", |seen| seen.rewrites >= 1);
    wait_until(&store, "the size after it", |seen| seen.disk_bytes <= 1 << 20);
    let rewrites = store.statistics().unwrap().rewrites;
    for _ in 0..20 {
        store.commit(kept, &model.step(2)).unwrap();
        std::thread::sleep(Duration::from_millis(5));
    }
    assert_eq!(store.statistics().unwrap().rewrites, rewrites, "once it is small it stays as it is");
    assert_same(&store.load(kept).unwrap(), &model.loaded());
}

#[test]
fn a_rewrite_that_does_not_help_is_not_tried_again_and_again() {
    let directory = tempfile::tempdir().unwrap();
    // No database takes less than it holds.
    let store = SledStore::open(directory.path(), options(0.5, 0)).unwrap();
    let (id, model) = wide(&store);
    wait_until(&store, "a rewrite", |seen| seen.rewrites >= 1);
    std::thread::sleep(Duration::from_millis(1500));
    // Waiting for 2, 4, 8, .. checks of 5 ms; on a slow machine it comes to fewer.
    let rewrites = store.statistics().unwrap().rewrites;
    assert!(rewrites <= 8, "{rewrites} rewrites of a store that nobody writes to");
    assert_same(&store.load(id).unwrap(), &model.loaded());
}

#[test]
fn a_store_is_closed_in_the_middle_of_a_rewrite() {
    let directory = tempfile::tempdir().unwrap();
    let id = wide(&open(directory.path())).0;
    for _ in 0..12 {
        // In vain each time, so the thread is at it whenever it is closed.
        let store = SledStore::open(directory.path(), options(0.5, 0)).unwrap();
        store.load(id).unwrap();
        std::thread::sleep(Duration::from_millis(8));
    }
    let store = open(directory.path());
    assert_eq!(databases(directory.path()).len(), 1);
    assert_eq!(store.verify().unwrap().problems, Vec::<String>::new());
}

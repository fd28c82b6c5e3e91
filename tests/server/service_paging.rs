//! The service under a memory limit: the same answers, whatever is in memory, and damage that stays where it is.

#![allow(clippy::unwrap_used, clippy::panic, reason = "tests")]

use super::service_support::{applied, config, counts, leaves, map_name, ring, served, until};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use tokio::task::JoinSet;
use ubbmap::mapping::{Region, guaranteed_free};
use ubbmap::quadtree::LeafRange;
use ubbmap::service::{BoxQuery, ErrorKind, MapService, ScanInput, ServiceSettings};
use ubbmap::store::{MapStore, MemoryStore, SledOptions, SledStore};

/// Two blocks.
fn tiny() -> ServiceSettings {
    ServiceSettings { cache_bytes: 2 * 5600, ..ServiceSettings::default() }
}

fn service(store: &Arc<MemoryStore>, settings: ServiceSettings) -> MapService {
    MapService::open(Arc::clone(store) as Arc<dyn MapStore>, settings).unwrap()
}

/// Scans all over the map of [`config`], the later ones over what the earlier ones saw.
fn tour() -> Vec<ScanInput> {
    (0..60).map(|i| ring("amr-1", Some(i), f64::from(i as u32 * 7 % 19) - 9.0)).collect()
}

#[tokio::test(flavor = "multi_thread")]
async fn under_a_tiny_limit_every_answer_is_that_of_the_whole_map() {
    let store = Arc::new(MemoryStore::new());
    let service = service(&store, tiny());
    let name = map_name("hall");
    service.create_map(&name, config()).await.unwrap();
    let scans = tour();
    for scan in &scans {
        assert_eq!(counts(&service.insert(&name, vec![scan.clone()]).await.unwrap()), (1, 0, 0));
    }
    let (config, whole) = (config(), applied(&config(), &scans));
    assert_eq!(served(&service, &name).await, leaves(&whole));
    let region = |i: i32| Region::disc((f64::from(i) * 0.37 - 11.0, f64::from(i % 7) - 3.0), 0.8).unwrap();
    for i in 0..60 {
        let answer = service.guaranteed_free(&name, &[region(i)], 0).await.unwrap();
        assert_eq!(answer.results[0], guaranteed_free(&whole, config.grid(), &region(i), 0));
    }
    let grid = service.grid(&name, &BoxQuery::default()).await.unwrap();
    let all = LeafRange { min_x: 0, min_y: 0, max_x: 256, max_y: 256 };
    assert_eq!(grid.classes, whole.raster(&all, 8));
    assert_eq!(service.tile(&name, 0, 0, 0).await.unwrap().classes, grid.classes);
    let points: Vec<_> = (0..500).map(|i| (f64::from(i) * 0.05 - 12.5, 0.3)).collect();
    let classes = service.classes(&name, &points, None).await.unwrap().classes;
    let class = |(x, y): &(f64, f64)| whole.max_class(config.grid().leaf_at(*x, *y).unwrap());
    assert_eq!(classes, points.iter().map(class).collect::<Vec<_>>());
    let cache = service.cache();
    assert!(cache.evictions > 50 && cache.loads > 50, "{cache:?}");
    // What the last answers held goes a little after them.
    until("the blocks are let go", || service.cache().bytes <= 2 * 5600).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn readers_see_whole_revisions_while_robots_write_and_blocks_come_and_go() {
    let directory = tempfile::tempdir().unwrap();
    let store = SledStore::open(directory.path(), SledOptions::default()).unwrap();
    read_while_written(Arc::new(store)).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn readers_see_whole_revisions_while_robots_write_and_the_database_is_rewritten() {
    let directory = tempfile::tempdir().unwrap();
    let store = Arc::new(SledStore::open(directory.path(), SledOptions::default()).unwrap());
    let done = Arc::<AtomicBool>::default();
    let (rewritten, ended) = (Arc::clone(&store), Arc::clone(&done));
    let rewriting = std::thread::spawn(move || {
        let mut rewrites = 0;
        while !ended.load(Ordering::SeqCst) {
            rewritten.rewrite(&mut |_| Ok(())).unwrap();
            rewrites += 1;
        }
        rewrites
    });
    read_while_written(store).await;
    done.store(true, Ordering::SeqCst);
    assert!(rewriting.join().unwrap() > 1);
}

/// 60 commits, and readers that hold every revision they see against the map of so many scans.
async fn read_while_written(store: Arc<SledStore>) {
    let service = MapService::open(store, tiny()).unwrap();
    let name = map_name("hall");
    service.create_map(&name, config()).await.unwrap();
    let mut readers = JoinSet::new();
    for _ in 0..3 {
        let (service, name) = (service.clone(), name.clone());
        readers.spawn(async move {
            let mut revisions = Vec::new();
            while revisions.last().is_none_or(|last| *last < 60) {
                let answer = service.region(&name, &BoxQuery::default()).await.unwrap();
                revisions.push(answer.revision);
                // One robot, one scan a commit: the map at a revision is that of so many scans.
                let whole = applied(&config(), &tour()[..answer.revision as usize]);
                assert_eq!(answer.leaves, leaves(&whole), "revision {}", answer.revision);
            }
            revisions.len()
        });
    }
    for scan in tour() {
        service.insert(&name, vec![scan]).await.unwrap();
    }
    let reads: usize = readers.join_all().await.iter().sum();
    let cache = service.cache();
    assert!(reads >= 3 && cache.evictions > 50, "{reads} reads, {cache:?}");
}

#[tokio::test(flavor = "multi_thread")]
async fn scans_and_queries_that_meet_a_damaged_block_are_refused_and_others_go_on() {
    let store = Arc::new(MemoryStore::new());
    let name = map_name("hall");
    let first = service(&store, ServiceSettings::default());
    first.create_map(&name, config()).await.unwrap();
    first.insert(&name, vec![ring("amr-1", Some(1), 0.0)]).await.unwrap();
    let drawn = served(&first, &name).await;
    first.drain().await;

    // Started anew, nothing is in memory.
    let service = service(&store, ServiceSettings::default());
    let coarse = BoxQuery { depth: Some(2), ..BoxQuery::default() };
    store.fail_fetches(Some("planted"));
    let error = service.region(&name, &BoxQuery::default()).await.unwrap_err();
    assert_eq!(error.kind, ErrorKind::MapDamaged);
    assert!(error.detail.contains("planted") && error.detail.contains("block"), "{error}");
    let disc = Region::disc((2.9, 0.0), 0.3).unwrap();
    assert_eq!(service.guaranteed_free(&name, &[disc], 0).await.unwrap_err().kind, ErrorKind::MapDamaged);
    assert_eq!(service.tile(&name, 0, 0, 0).await.unwrap_err().kind, ErrorKind::MapDamaged);
    // What the maxima answer is answered.
    assert_eq!(service.grid(&name, &coarse).await.unwrap().classes.len(), 16);
    let answer = service.insert(&name, vec![ring("amr-1", Some(2), 0.0)]).await.unwrap();
    assert_eq!((answer.revision, counts(&answer)), (1, (0, 0, 1)));
    assert_eq!(answer.rejected[0].code, "MAP_DAMAGED");
    assert!(answer.rejected[0].detail.contains("planted"), "{answer:?}");

    // The scan was not counted as applied: sent again it is applied when the block can be read.
    store.fail_fetches(None);
    assert_eq!(served(&service, &name).await, drawn);
    let answer = service.insert(&name, vec![ring("amr-1", Some(2), 0.0)]).await.unwrap();
    assert_eq!((answer.revision, counts(&answer)), (2, (1, 0, 0)));
}

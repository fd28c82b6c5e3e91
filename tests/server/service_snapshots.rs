//! Snapshots through the service: taken beside the scans, restored as a commit, and what that does to scans on their way.

#![allow(clippy::unwrap_used, clippy::panic, reason = "tests")]

use super::service_support::{
    Keeping, TestStore, Writes, applied, config, counts, hall, leaves, map_name, ring, served, snapshot_name, until,
};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::collections::BTreeMap;
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::Duration;
use ubbmap::quadtree::Leaf;
use ubbmap::service::{ChangesQuery, ErrorKind, MapService, RobotDescription, ServiceSettings};
use ubbmap::store::{MapName, MapStore, MemoryStore};

/// Two blocks of memory: what is restored is read from the store.
fn tiny() -> ServiceSettings {
    ServiceSettings { cache_bytes: 2 * 5600, ..ServiceSettings::default() }
}

/// What a reader sees of a map.
async fn seen(service: &MapService, name: &MapName) -> (Vec<Leaf>, Vec<RobotDescription>) {
    (served(service, name).await, service.map(name).await.unwrap().robots)
}

#[tokio::test(flavor = "multi_thread")]
async fn any_order_of_scans_snapshots_restores_and_deletions_is_that_of_a_model() {
    for keeping in Keeping::all() {
        for seed in 0..6 {
            let mut rng = ChaCha8Rng::seed_from_u64(seed);
            let mut service = keeping.service(tiny());
            let name = map_name(&format!("hall-{seed}"));
            service.create_map(&name, config()).await.unwrap();
            let mut kept = BTreeMap::new();
            let (mut revision, mut now, mut next) = (0, seen(&service, &name).await, 0_u64);
            for step in 0..60 {
                let snapshot = snapshot_name(&format!("s{}", rng.random_range(0..6)));
                match rng.random_range(0..10) {
                    0..5 => {
                        let robot = format!("r{}", rng.random_range(0..3));
                        let scan = ring(&robot, Some(next), f64::from(rng.random_range(-90..90)) * 0.1);
                        next += 1;
                        let answer = service.insert(&name, vec![scan]).await.unwrap();
                        revision += 1;
                        assert_eq!((counts(&answer), answer.revision), ((1, 0, 0), revision));
                        now = seen(&service, &name).await;
                    }
                    5 | 6 => match service.take_snapshot(&name, &snapshot).await {
                        Ok(taken) => {
                            assert_eq!((&taken.name, taken.revision), (&snapshot, revision));
                            assert!(kept.insert(snapshot, (revision, now.clone())).is_none());
                        }
                        Err(error) => {
                            assert_eq!(error.kind, ErrorKind::SnapshotExists);
                            assert!(kept.contains_key(&snapshot));
                        }
                    },
                    7 | 8 => match (service.restore_snapshot(&name, &snapshot).await, kept.get(&snapshot)) {
                        (Ok(restored), Some((_, then))) => {
                            revision += 1;
                            assert_eq!(restored, revision, "also when nothing differs");
                            now = then.clone();
                        }
                        (Err(error), None) => assert_eq!(error.kind, ErrorKind::SnapshotNotFound),
                        other => panic!("{other:?}"),
                    },
                    _ => match service.delete_snapshot(&name, &snapshot).await {
                        Ok(()) => assert!(kept.remove(&snapshot).is_some()),
                        Err(error) => {
                            assert_eq!((error.kind, kept.get(&snapshot)), (ErrorKind::SnapshotNotFound, None));
                        }
                    },
                }
                if rng.random_range(0..8) == 0 {
                    service.drain().await;
                    service = keeping.service(tiny());
                }
                let what = format!("{} {seed} at step {step}", keeping.what);
                assert!(seen(&service, &name).await == now, "{what}");
                assert_eq!(service.map(&name).await.unwrap().revision, revision, "{what}");
                let listed = service.snapshots(&name).await.unwrap().into_iter().map(|s| (s.name, s.revision));
                let expected = kept.iter().map(|(name, (revision, _))| (name.clone(), *revision));
                assert_eq!(listed.collect::<Vec<_>>(), expected.collect::<Vec<_>>(), "{what}");
            }
            assert!(now.1.len() < 4 && kept.len() > 1, "something of everything happened");
        }
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn snapshots_taken_while_scans_come_in_are_each_the_map_of_its_revision() {
    for keeping in Keeping::all() {
        let service = keeping.service(tiny());
        let name = map_name("hall");
        service.create_map(&name, config()).await.unwrap();
        let scans: Vec<_> = (0..120).map(|i| ring("a", Some(i), f64::from(i as u32 * 7 % 19) - 9.0)).collect();
        let taking = tokio::spawn({
            let (service, name) = (service.clone(), name.clone());
            async move {
                let mut taken = Vec::new();
                for number in 0.. {
                    let snapshot = service.take_snapshot(&name, &snapshot_name(&format!("s{number}"))).await.unwrap();
                    if taken.last().is_none_or(|last| *last < snapshot.revision) {
                        taken.push(snapshot.revision);
                    }
                    if snapshot.revision == 120 {
                        return taken;
                    }
                    tokio::time::sleep(Duration::from_millis(1)).await;
                }
                unreachable!()
            }
        });
        for scan in &scans {
            assert_eq!(counts(&service.insert(&name, vec![scan.clone()]).await.unwrap()), (1, 0, 0));
        }
        let taken = taking.await.unwrap();
        assert!(taken.len() > 3, "{}: only at {taken:?}", keeping.what);
        let id = keeping.store.list().unwrap()[0].id;
        for snapshot in service.snapshots(&name).await.unwrap() {
            let loaded = keeping.store.load_snapshot(id, &snapshot.name).unwrap();
            let expected = applied(&config(), &scans[..snapshot.revision as usize]);
            assert!(loaded.tree == expected, "{} at {}", keeping.what, snapshot.revision);
            assert_eq!(loaded.windows.values().map(|window| window.count()).sum::<u64>(), snapshot.revision);
        }
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn scans_that_a_restore_took_back_can_be_sent_again_and_end_in_the_same_map() {
    for keeping in Keeping::all() {
        let service = keeping.service(ServiceSettings::default());
        let name = map_name("hall");
        service.create_map(&name, config()).await.unwrap();
        let scan = |robot: &str, i: u64| ring(robot, Some(i), 0.4 * i as f64 - 3.0);
        let all: Vec<_> = (0..6).map(|i| scan("a", i)).chain((0..3).map(|i| scan("b", i))).collect();
        service.insert(&name, all[..4].to_vec()).await.unwrap();
        service.take_snapshot(&name, &snapshot_name("early")).await.unwrap();
        assert_eq!(counts(&service.insert(&name, all[4..].to_vec()).await.unwrap()), (5, 0, 0));
        let full = served(&service, &name).await;
        assert_eq!(service.restore_snapshot(&name, &snapshot_name("early")).await.unwrap(), 3);
        assert_eq!(served(&service, &name).await, leaves(&applied(&config(), &all[..4])));
        let robots = service.map(&name).await.unwrap().robots;
        assert_eq!(robots.iter().map(|r| (r.name.as_str(), r.applied)).collect::<Vec<_>>(), [("a", 4)]);
        let again = service.insert(&name, all.clone()).await.unwrap();
        assert_eq!((counts(&again), again.revision), ((5, 4, 0), 4), "{}", keeping.what);
        assert_eq!(served(&service, &name).await, full);
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_duplicate_that_a_restore_takes_back_on_its_way_is_not_called_one() {
    let store = TestStore::new();
    let (service, name) = hall(&store, ServiceSettings::default()).await;
    service.insert(&name, vec![ring("a", Some(1), 0.0)]).await.unwrap();
    service.take_snapshot(&name, &snapshot_name("one")).await.unwrap();
    service.insert(&name, vec![ring("a", Some(2), 0.5)]).await.unwrap();
    store.hold();
    let under_way = tokio::spawn({
        let (service, name) = (service.clone(), name.clone());
        async move { service.insert(&name, vec![ring("b", Some(1), 1.0)]).await }
    });
    until("a commit hangs", || store.waiting.load(Ordering::SeqCst) == 1).await;
    let restoring = tokio::spawn({
        let (service, name) = (service.clone(), name.clone());
        async move { service.restore_snapshot(&name, &snapshot_name("one")).await }
    });
    tokio::time::sleep(Duration::from_millis(100)).await;
    // Computed against the root before the restore: 1 and 2 are duplicates there. Only 3 goes to the writer.
    let late = tokio::spawn({
        let (service, name) = (service.clone(), name.clone());
        let scans = (1..4).map(|i| ring("a", Some(i), 0.1 * i as f64)).collect();
        async move { service.insert(&name, scans).await }
    });
    tokio::time::sleep(Duration::from_millis(300)).await;
    // One of nothing but duplicates is answered at once, by the revision before the restore.
    let early = service.insert(&name, vec![ring("a", Some(2), 0.5)]).await.unwrap();
    assert_eq!((counts(&early), early.revision), ((0, 1, 0), 2));
    store.release();
    assert_eq!(under_way.await.unwrap().unwrap().revision, 3);
    assert_eq!(restoring.await.unwrap().unwrap(), 4);
    let late = late.await.unwrap().unwrap();
    assert_eq!((counts(&late), late.revision), ((1, 1, 1), 5), "{late:?}");
    assert_eq!((late.rejected[0].index, late.rejected[0].code), (1, "MAP_RESTORED"));
    let again = service.insert(&name, vec![ring("a", Some(2), 0.5)]).await.unwrap();
    assert_eq!((counts(&again), again.revision), ((1, 0, 0), 6));
    let state: Vec<_> = service.map(&name).await.unwrap().robots.into_iter().map(|r| (r.name, r.applied)).collect();
    assert_eq!(state, [("a".to_owned(), 3)], "b was not known to the snapshot");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_restore_that_fails_leaves_everything_as_it_was() {
    let store = TestStore::new();
    let (service, name) = hall(&store, ServiceSettings::default()).await;
    service.insert(&name, vec![ring("a", Some(1), 0.0)]).await.unwrap();
    service.take_snapshot(&name, &snapshot_name("one")).await.unwrap();
    service.insert(&name, vec![ring("a", Some(2), 1.5)]).await.unwrap();
    let (before, told) = (seen(&service, &name).await, service.map(&name).await.unwrap());
    let mut watch = service.watch(&name, None, ChangesQuery::default()).await.unwrap();
    watch.next().await.unwrap();
    for (writes, kind) in [(Writes::FailOnce, ErrorKind::StoreFailed), (Writes::PanicOnce, ErrorKind::Internal)] {
        store.set_writes(writes);
        assert_eq!(service.restore_snapshot(&name, &snapshot_name("one")).await.unwrap_err().kind, kind);
        store.set_writes(writes);
        assert_eq!(service.take_snapshot(&name, &snapshot_name("two")).await.unwrap_err().kind, kind);
    }
    assert_eq!((seen(&service, &name).await, service.map(&name).await.unwrap()), (before, told));
    assert!(tokio::time::timeout(Duration::from_millis(200), watch.next()).await.is_err(), "nobody is told of it");
    assert_eq!(service.snapshots(&name).await.unwrap().len(), 1);
    assert_eq!(counts(&service.insert(&name, vec![ring("a", Some(2), 1.5)]).await.unwrap()), (0, 1, 0));
    assert_eq!(service.restore_snapshot(&name, &snapshot_name("one")).await.unwrap(), 3);
    service.drain().await;
    let refused = service.take_snapshot(&name, &snapshot_name("late")).await.unwrap_err();
    assert_eq!(refused.kind, ErrorKind::ShuttingDown);
    assert_eq!(service.delete_snapshot(&name, &snapshot_name("one")).await.unwrap_err().kind, ErrorKind::ShuttingDown);
}

#[tokio::test(flavor = "multi_thread")]
async fn names_and_numbers_of_snapshots_have_their_limits() {
    for keeping in Keeping::all() {
        let service = keeping.service(ServiceSettings { max_snapshots: 2, ..ServiceSettings::default() });
        let name = map_name("hall");
        let nowhere = service.take_snapshot(&name, &snapshot_name("a")).await.unwrap_err();
        assert_eq!((nowhere.kind, nowhere.field.as_deref()), (ErrorKind::MapNotFound, Some("map")));
        service.create_map(&name, config()).await.unwrap();
        assert_eq!(service.take_snapshot(&name, &snapshot_name("a")).await.unwrap().revision, 0);
        let again = service.take_snapshot(&name, &snapshot_name("a")).await.unwrap_err();
        assert_eq!((again.kind, again.field.as_deref()), (ErrorKind::SnapshotExists, Some("name")));
        service.take_snapshot(&name, &snapshot_name("b.2_-")).await.unwrap();
        let third = service.take_snapshot(&name, &snapshot_name("c")).await.unwrap_err();
        assert_eq!(third.kind, ErrorKind::TooManySnapshots);
        assert!(third.detail.contains('2'), "{}", third.detail);
        let missing = service.restore_snapshot(&name, &snapshot_name("c")).await.unwrap_err();
        assert_eq!((missing.kind, missing.field.as_deref()), (ErrorKind::SnapshotNotFound, Some("name")));
        assert_eq!(service.map(&name).await.unwrap().revision, 0);
        service.delete_snapshot(&name, &snapshot_name("a")).await.unwrap();
        service.take_snapshot(&name, &snapshot_name("c")).await.unwrap();
        service.delete_map(&name).await.unwrap();
        service.create_map(&name, config()).await.unwrap();
        assert!(service.snapshots(&name).await.unwrap().is_empty(), "they go with their map");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_restore_behind_a_deletion_finds_no_map() {
    let store = TestStore::new();
    let (service, name) = hall(&store, ServiceSettings::default()).await;
    service.insert(&name, vec![ring("a", Some(1), 0.0)]).await.unwrap();
    service.take_snapshot(&name, &snapshot_name("one")).await.unwrap();
    store.hold();
    let held = tokio::spawn({
        let (service, name) = (service.clone(), name.clone());
        async move { service.insert(&name, vec![ring("a", Some(2), 0.5)]).await }
    });
    until("a commit hangs", || store.waiting.load(Ordering::SeqCst) == 1).await;
    let restoring = tokio::spawn({
        let (service, name) = (service.clone(), name.clone());
        async move { service.restore_snapshot(&name, &snapshot_name("one")).await }
    });
    tokio::time::sleep(Duration::from_millis(100)).await;
    let deletion = tokio::spawn({
        let (service, name) = (service.clone(), name.clone());
        async move { service.delete_map(&name).await }
    });
    tokio::time::sleep(Duration::from_millis(100)).await;
    store.release();
    held.await.unwrap().unwrap();
    deletion.await.unwrap().unwrap();
    assert_eq!(restoring.await.unwrap().unwrap_err().kind, ErrorKind::MapNotFound);
}

/// A map with a snapshot of one scan, more scans since, and none of its blocks in memory.
async fn damaged() -> (Arc<MemoryStore>, MapService, MapName) {
    let store = Arc::new(MemoryStore::new());
    let name = map_name("hall");
    let service = MapService::open(Arc::clone(&store) as Arc<dyn MapStore>, ServiceSettings::default()).unwrap();
    service.create_map(&name, config()).await.unwrap();
    service.take_snapshot(&name, &snapshot_name("empty")).await.unwrap();
    service.insert(&name, vec![ring("a", Some(0), 0.0)]).await.unwrap();
    service.take_snapshot(&name, &snapshot_name("one")).await.unwrap();
    service.insert(&name, (1..9).map(|i| ring("a", Some(i), i as f64 - 5.0)).collect()).await.unwrap();
    service.drain().await;
    let service = MapService::open(Arc::clone(&store) as Arc<dyn MapStore>, ServiceSettings::default()).unwrap();
    (store, service, name)
}

#[tokio::test(flavor = "multi_thread")]
async fn a_damaged_map_names_the_newest_snapshot_that_is_left() {
    let (store, service, name) = damaged().await;
    store.fail_next_load("block (1, 2) of map hall");
    let error = service.map(&name).await.unwrap_err();
    assert_eq!(error.kind, ErrorKind::MapDamaged);
    assert!(error.detail.ends_with("; its snapshot \"one\" of revision 1 can be exported"), "{}", error.detail);
    // A block that is read later.
    store.fail_fetches(Some("planted"));
    let error = service.grid(&name, &Default::default()).await.unwrap_err();
    assert!(error.detail.contains("snapshot \"one\" of revision 1"), "{}", error.detail);
    service.delete_snapshot(&name, &snapshot_name("one")).await.unwrap();
    let error = service.grid(&name, &Default::default()).await.unwrap_err();
    assert!(error.detail.contains("snapshot \"empty\" of revision 0"), "{}", error.detail);
    service.delete_snapshot(&name, &snapshot_name("empty")).await.unwrap();
    let error = service.grid(&name, &Default::default()).await.unwrap_err();
    assert!(!error.detail.contains("snapshot"), "{}", error.detail);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_restore_mends_blocks_that_are_damaged_since_its_snapshot() {
    let (store, service, name) = damaged().await;
    service.map(&name).await.unwrap();
    store.fail_fetches(Some("planted"));
    assert_eq!(service.grid(&name, &Default::default()).await.unwrap_err().kind, ErrorKind::MapDamaged);
    let scan = service.insert(&name, vec![ring("a", Some(20), 0.0)]).await.unwrap();
    assert_eq!(scan.rejected[0].code, "MAP_DAMAGED");
    assert_eq!(service.restore_snapshot(&name, &snapshot_name("one")).await.unwrap(), 3);
    // What was restored is in memory.
    assert_eq!(served(&service, &name).await, leaves(&applied(&config(), &[ring("a", Some(0), 0.0)])));
}

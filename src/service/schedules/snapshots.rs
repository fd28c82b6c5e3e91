//! Snapshots and restores among insertions: what an answer counts is in the map of its revision, and what a snapshot keeps
//! is what it was.

#![allow(clippy::unwrap_used, reason = "a test fails by panicking")]

use super::scene::{Expected, Scene, count, has, scan};
use crate::quadtree::LeafRange;
use crate::service::{BoxQuery, ErrorKind, MapView};
use crate::store::SnapshotName;
use crate::sync::explore::explore;
use shuttle::future::{JoinHandle, block_on, spawn};
use std::sync::Arc;

fn snapshot() -> SnapshotName {
    SnapshotName::new("before").unwrap()
}

/// A map with a scan, and a snapshot of it.
async fn with_snapshot(expected: &Arc<Expected>) -> Scene {
    let scene = Scene::new(expected, Scene::tight()).await;
    scene.send("a", &[1]).await;
    scene.service.take_snapshot(&scene.name, &snapshot()).await.unwrap();
    scene
}

/// Sends scans until all of a request are in the map of the answer's revision.
fn robot(scene: &Scene, name: &'static str, requests: &'static [&'static [u64]]) -> JoinHandle<()> {
    let scene = scene.clone();
    spawn(async move {
        for sequences in requests {
            let answer = scene.send(name, sequences).await;
            assert!(answer.rejected.iter().all(|rejection| rejection.code == "MAP_RESTORED"), "{answer:?}");
            scene.check_answer(name, sequences, &answer).await;
        }
    })
}

#[test]
fn what_an_answer_counts_is_in_the_map_of_its_revision_whatever_is_restored() {
    let expected = Expected::new(8);
    explore(200, move || {
        block_on(async {
            let scene = Scene::new(&expected, Scene::tight()).await;
            scene.insert(vec![scan("a", 1)]).await.unwrap();
            let taken = scene.service.take_snapshot(&scene.name, &snapshot()).await.unwrap();
            // The second request finds scans of the first one in the map, or taken back.
            let first = robot(&scene, "a", &[&[2], &[1, 2, 3]]);
            let second = robot(&scene, "a", &[&[2, 4]]);
            let restored = scene.service.restore_snapshot(&scene.name, &snapshot()).await.unwrap();
            assert!(scene.read().await.revision >= restored);
            assert_eq!(scene.store.windows(scene.id, restored), scene.store.windows(scene.id, taken.revision));
            first.await.unwrap();
            second.await.unwrap();
            assert!(has(&scene.read().await.windows, "a", 1), "what the snapshot keeps");
            scene.all_is_given_back().await;
        });
    });
}

#[test]
fn a_snapshot_among_insertions_keeps_one_revision_whole() {
    let expected = Expected::new(8);
    explore(150, move || {
        block_on(async {
            let scene = Scene::new(&expected, Scene::tight()).await;
            let robots = [robot(&scene, "a", &[&[1], &[2]]), robot(&scene, "b", &[&[1, 2]])];
            let taken = scene.service.take_snapshot(&scene.name, &snapshot()).await.unwrap();
            let there = scene.service.view(&scene.name, Some(&snapshot())).await.unwrap();
            assert_eq!(there.revision(), taken.revision);
            for robot in robots {
                robot.await.unwrap();
            }
            let scans = count(&scene.store.windows(scene.id, taken.revision));
            is_the_map_after(there, &expected, scans).await;
            let restored = scene.service.restore_snapshot(&scene.name, &snapshot()).await.unwrap();
            let root = scene.read().await;
            assert_eq!((root.revision, count(&root.windows)), (restored, scans));
            scene.all_is_given_back().await;
        });
    });
}

/// Every leaf of a snapshot is as it was after so many scans.
async fn is_the_map_after(view: MapView, expected: &Expected, scans: u64) {
    let tree = expected.after(scans);
    let everything = LeafRange { min_x: 0, min_y: 0, max_x: 1 << tree.depth(), max_y: 1 << tree.depth() };
    let raster = view.grid(&BoxQuery::default()).await.unwrap();
    assert!(raster.classes == tree.raster(&everything, tree.depth()), "the snapshot has another content");
}

/// Asks the snapshot; the content must be that of the revision that it names.
fn viewer(scene: &Scene, expected: &Arc<Expected>) -> JoinHandle<bool> {
    let (scene, expected) = (scene.clone(), Arc::clone(expected));
    spawn(async move {
        match scene.service.view(&scene.name, Some(&snapshot())).await {
            Ok(view) => {
                let scans = count(&scene.store.windows(scene.id, view.revision()));
                is_the_map_after(view, &expected, scans).await;
                true
            }
            Err(error) => {
                assert_eq!(error.kind, ErrorKind::SnapshotNotFound, "{error:?}");
                false
            }
        }
    })
}

#[test]
fn a_snapshot_that_many_ask_is_read_once() {
    let expected = Expected::new(4);
    explore(200, move || {
        block_on(async {
            let scene = with_snapshot(&expected).await;
            let viewers = [viewer(&scene, &expected), viewer(&scene, &expected), viewer(&scene, &expected)];
            scene.insert(vec![scan("a", 2)]).await.unwrap();
            for viewer in viewers {
                assert!(viewer.await.unwrap());
            }
            assert_eq!(scene.store.snapshots_read(), 1);
            scene.all_is_given_back().await;
        });
    });
}

#[test]
fn a_name_that_is_given_anew_is_never_answered_with_what_it_kept_before() {
    let expected = Expected::new(4);
    explore(200, move || {
        block_on(async {
            let scene = with_snapshot(&expected).await;
            let viewers = [viewer(&scene, &expected), viewer(&scene, &expected)];
            scene.service.delete_snapshot(&scene.name, &snapshot()).await.unwrap();
            scene.insert(vec![scan("a", 2)]).await.unwrap();
            scene.service.take_snapshot(&scene.name, &snapshot()).await.unwrap();
            for viewer in viewers {
                viewer.await.unwrap();
            }
            let now = scene.service.view(&scene.name, Some(&snapshot())).await.unwrap();
            assert_eq!(now.revision(), 2);
            is_the_map_after(now, &expected, 2).await;
            scene.all_is_given_back().await;
        });
    });
}

#[test]
fn a_snapshot_that_was_read_while_its_map_was_deleted_stayed_in_memory() {
    let expected = Expected::new(4);
    explore(300, move || {
        block_on(async {
            let scene = with_snapshot(&expected).await;
            let viewer = {
                let scene = scene.clone();
                spawn(async move {
                    match scene.service.view(&scene.name, Some(&snapshot())).await {
                        Ok(view) => assert_eq!(view.revision(), 1),
                        Err(error) => {
                            let gone = [ErrorKind::MapNotFound, ErrorKind::SnapshotNotFound];
                            assert!(gone.contains(&error.kind), "{error:?}");
                        }
                    }
                })
            };
            scene.service.delete_map(&scene.name).await.unwrap();
            viewer.await.unwrap();
            assert_eq!(scene.service.registry.snapshots.bytes(), 0, "a snapshot of a map that is gone");
            scene.all_is_given_back().await;
        });
    });
}

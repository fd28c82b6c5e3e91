//! The end of a map and of the service: who was taken is finished, nobody is forgotten, and nothing is written behind it.

#![allow(clippy::unwrap_used, reason = "a test fails by panicking")]

use super::scene::{Expected, Scene, count, has, scan};
use crate::service::{ErrorKind, InsertAnswer, ServiceError};
use crate::store::{MapStore, SnapshotName};
use crate::sync::explore::explore;
use shuttle::future::{JoinHandle, block_on, spawn};

fn send(scene: &Scene, name: &'static str, sequence: u64) -> JoinHandle<Result<InsertAnswer, ServiceError>> {
    let scene = scene.clone();
    spawn(async move { scene.insert(vec![scan(name, sequence)]).await })
}

#[test]
fn a_map_that_is_deleted_among_insertions_answers_all_and_is_not_written_again() {
    let expected = Expected::new(4);
    explore(200, move || {
        block_on(async {
            let scene = Scene::new(&expected, Scene::tight()).await;
            // The first of them loads the map, or finds it deleted.
            let sent = [send(&scene, "a", 1), send(&scene, "b", 1), send(&scene, "a", 2)];
            scene.service.delete_map(&scene.name).await.unwrap();
            assert_eq!(scene.service.map(&scene.name).await.unwrap_err().kind, ErrorKind::MapNotFound);
            for one in sent {
                match one.await.unwrap() {
                    Ok(answer) => assert!(answer.revision <= scene.store.durable(scene.id)),
                    Err(error) => assert_eq!(error.kind, ErrorKind::MapNotFound, "{error:?}"),
                }
            }
            // The name is free for another map, which has nothing of the first.
            scene.create_again().await;
            let answer = scene.insert(vec![scan("a", 1)]).await.unwrap();
            assert_eq!((answer.revision, answer.applied), (1, 1));
            scene.all_is_given_back().await;
        });
    });
}

#[test]
fn a_map_that_is_deleted_while_it_is_loaded_is_not_written_again() {
    let expected = Expected::new(4);
    // The way into it is narrow: the writer has looked at the order to end and not yet into its queue, and who deletes
    // found no writer there yet.
    explore(3000, move || {
        block_on(async {
            let scene = Scene::new(&expected, Scene::tight()).await;
            let snapshot = SnapshotName::new("empty").unwrap();
            scene.store.take_snapshot(scene.id, &snapshot, 0.0).unwrap();
            let restoring = {
                let scene = scene.clone();
                spawn(async move { scene.service.restore_snapshot(&scene.name, &snapshot).await })
            };
            scene.service.delete_map(&scene.name).await.unwrap();
            if let Err(error) = restoring.await.unwrap() {
                assert_eq!(error.kind, ErrorKind::MapNotFound, "{error:?}");
            }
            scene.all_is_given_back().await;
        });
    });
}

#[test]
fn a_map_that_could_not_be_deleted_goes_on_where_it_was() {
    let expected = Expected::new(4);
    explore(150, move || {
        block_on(async {
            let scene = Scene::new(&expected, Scene::tight()).await;
            scene.store.fail_next_deletion();
            let sent = [send(&scene, "a", 1), send(&scene, "b", 1)];
            let refused = scene.service.delete_map(&scene.name).await.unwrap_err();
            assert_eq!(refused.kind, ErrorKind::StoreFailed, "{refused:?}");
            let mut applied = 0;
            for one in sent {
                match one.await.unwrap() {
                    Ok(answer) => applied += answer.applied,
                    Err(error) => assert_eq!(error.kind, ErrorKind::MapNotFound, "{error:?}"),
                }
            }
            let root = scene.read().await;
            assert_eq!(count(&root.windows), applied, "what was acknowledged is there, and nothing else");
            scene.insert(vec![scan("a", 1), scan("b", 1)]).await.unwrap();
            let root = scene.read().await;
            assert!(has(&root.windows, "a", 1) && has(&root.windows, "b", 1));
            scene.all_is_given_back().await;
        });
    });
}

#[test]
fn watches_of_a_map_that_is_deleted_end() {
    let expected = Expected::new(4);
    explore(150, move || {
        block_on(async {
            let scene = Scene::new(&expected, Scene::tight()).await;
            let mut watch = scene.service.watch(&scene.name, None, Default::default()).await.unwrap();
            let watcher = spawn(async move {
                loop {
                    if let Err(error) = watch.next().await {
                        return error;
                    }
                }
            });
            let sent = send(&scene, "a", 1);
            scene.service.delete_map(&scene.name).await.unwrap();
            assert_eq!(watcher.await.unwrap().kind, ErrorKind::MapNotFound);
            let _ = sent.await.unwrap();
            scene.all_is_given_back().await;
        });
    });
}

#[test]
fn the_end_of_the_service_waits_for_what_was_taken_and_nothing_is_written_behind_it() {
    let expected = Expected::new(8);
    explore(200, move || {
        block_on(async {
            let scene = Scene::new(&expected, Scene::tight()).await;
            let sent = [send(&scene, "a", 1), send(&scene, "b", 1), send(&scene, "a", 2)];
            scene.service.drain().await;
            scene.store.end();
            let durable = scene.store.durable(scene.id);
            for one in sent {
                match one.await.unwrap() {
                    Ok(answer) => assert!(answer.applied == 1 && answer.revision <= durable),
                    Err(error) => assert_eq!(error.kind, ErrorKind::ShuttingDown, "{error:?}"),
                }
            }
            assert!(!scene.service.is_ready());
            assert_eq!(scene.insert(vec![scan("c", 1)]).await.unwrap_err().kind, ErrorKind::ShuttingDown);
            scene.all_is_given_back().await;
        });
    });
}

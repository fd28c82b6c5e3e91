//! Commits: what is acknowledged is stored and read, a root is its revision, and a commit that fails is none.

#![allow(clippy::unwrap_used, reason = "a test fails by panicking")]

use super::scene::{Expected, Scene, count, has, scan};
use crate::service::{ErrorKind, ServiceSettings};
use crate::sync::explore::explore;
use shuttle::future::{JoinHandle, block_on, spawn, yield_now};

/// Reads a few times: revisions never go back, and each root is right, also when it has become an old one.
fn reader(scene: &Scene, reads: usize) -> JoinHandle<()> {
    let scene = scene.clone();
    spawn(async move {
        let first = scene.read().await;
        let mut last = first.revision;
        for _ in 1..reads {
            let root = scene.read().await;
            assert!(root.revision >= last, "{} was read after {last}", root.revision);
            last = root.revision;
        }
        scene.check(&first);
    })
}

/// Sends scans in requests of their own and looks at each answer.
fn robot(scene: &Scene, name: &'static str, requests: &'static [&'static [u64]]) -> JoinHandle<()> {
    let scene = scene.clone();
    spawn(async move {
        for sequences in requests {
            let answer = scene.send(name, sequences).await;
            assert!(answer.rejected.is_empty(), "{answer:?}");
            scene.check_answer(name, sequences, &answer).await;
            let root = scene.read().await;
            assert!(
                sequences.iter().all(|sequence| has(&root.windows, name, *sequence)),
                "an acknowledged scan is lost"
            );
        }
    })
}

async fn all(tasks: Vec<JoinHandle<()>>) {
    for task in tasks {
        task.await.unwrap();
    }
}

#[test]
fn what_is_acknowledged_is_stored_and_read_and_a_root_is_its_revision() {
    let expected = Expected::new(8);
    explore(150, move || {
        block_on(async {
            let scene = Scene::new(&expected, Scene::tight()).await;
            let tasks = vec![
                robot(&scene, "a", &[&[1], &[2, 3]]),
                robot(&scene, "b", &[&[7, 8]]),
                // The same scans on another way, as after a reply that was lost.
                robot(&scene, "a", &[&[1, 2]]),
                reader(&scene, 3),
            ];
            all(tasks).await;
            assert_eq!(count(&scene.read().await.windows), 5, "each scan once");
            scene.all_is_given_back().await;
        });
    });
}

#[test]
fn a_map_that_is_first_used_by_many_is_loaded_once() {
    let expected = Expected::new(4);
    explore(150, move || {
        block_on(async {
            let scene = Scene::new(&expected, Scene::tight()).await;
            let tasks = vec![reader(&scene, 1), robot(&scene, "a", &[&[1]]), robot(&scene, "b", &[&[1]])];
            all(tasks).await;
            // Two writers of one map would each begin at revision 0: the store would refuse one of them.
            assert_eq!(count(&scene.read().await.windows), 2);
            scene.all_is_given_back().await;
        });
    });
}

#[test]
fn a_commit_that_fails_leaves_no_trace_and_its_scans_are_told_so() {
    let expected = Expected::new(8);
    explore(150, move || {
        block_on(async {
            let scene = Scene::new(&expected, Scene::tight()).await;
            scene.store.fates(&[true, false, true, false]);
            let send = |name: &'static str| {
                let scene = scene.clone();
                spawn(async move {
                    for sequence in [1, 2] {
                        while let Err(error) = scene.insert(vec![scan(name, sequence)]).await {
                            assert_eq!(error.kind, ErrorKind::StoreFailed, "{error:?}");
                            // It may be in the map by now only if it was sent twice, and it was not.
                            assert!(!has(&scene.read().await.windows, name, sequence), "a failed scan was applied");
                        }
                        assert!(has(&scene.read().await.windows, name, sequence));
                    }
                })
            };
            all(vec![send("a"), send("b"), reader(&scene, 3)]).await;
            assert_eq!(count(&scene.read().await.windows), 4, "each scan once");
            scene.all_is_given_back().await;
        });
    });
}

#[test]
fn robots_that_wait_for_places_and_memory_are_all_served() {
    let expected = Expected::new(8);
    explore(100, move || {
        block_on(async {
            // One place, and memory for one request.
            let settings = ServiceSettings { queue_length: 1, max_bytes_in_flight: 9000, ..Scene::tight() };
            let scene = Scene::new(&expected, settings).await;
            let send = |name: &'static str| {
                let scene = scene.clone();
                spawn(async move {
                    for sequence in [1, 2] {
                        let answer = loop {
                            match scene.service.insert_when_free(&scene.name, vec![scan(name, sequence)]).await {
                                Ok(answer) => break answer,
                                // There was memory for the scan and none for its evidence.
                                Err(error) => assert_eq!(error.kind, ErrorKind::Busy, "{error:?}"),
                            }
                            yield_now().await;
                        };
                        scene.check_answer(name, &[sequence], &answer).await;
                    }
                })
            };
            all(vec![send("a"), send("b"), send("a")]).await;
            assert_eq!(count(&scene.read().await.windows), 4, "each scan once");
            scene.all_is_given_back().await;
        });
    });
}

#[test]
fn who_is_answered_finds_its_place_and_its_memory_free() {
    let expected = Expected::new(4);
    explore(200, move || {
        block_on(async {
            // One place, and memory for one request with its evidence.
            let settings = ServiceSettings { queue_length: 1, max_bytes_in_flight: 6000, ..Scene::tight() };
            let scene = Scene::new(&expected, settings).await;
            for (sequence, applied) in [(1, 1), (1, 0), (2, 1)] {
                let answer = scene.insert(vec![scan("a", sequence)]).await.unwrap();
                assert_eq!(answer.applied, applied);
            }
            scene.all_is_given_back().await;
        });
    });
}

#[test]
fn clients_that_leave_take_nothing_along() {
    let expected = Expected::new(8);
    explore(150, move || {
        block_on(async {
            let settings = ServiceSettings { queue_length: 1, ..Scene::tight() };
            let scene = Scene::new(&expected, settings).await;
            let sent: Vec<_> = ["a", "b"]
                .into_iter()
                .map(|name| {
                    let scene = scene.clone();
                    spawn(async move {
                        let _ = scene.service.insert_when_free(&scene.name, vec![scan(name, 1)]).await;
                    })
                })
                .collect();
            let stays = robot_that_waits(&scene);
            // Wherever they are: before the queue, in it, or at the store.
            sent.iter().for_each(JoinHandle::abort);
            for task in sent {
                let _ = task.await;
            }
            stays.await.unwrap();
            let root = scene.read().await;
            assert!(has(&root.windows, "c", 1));
            scene.all_is_given_back().await;
        });
    });
}

fn robot_that_waits(scene: &Scene) -> JoinHandle<()> {
    let scene = scene.clone();
    spawn(async move {
        let answer = scene.service.insert_when_free(&scene.name, vec![scan("c", 1)]).await.unwrap();
        scene.check_answer("c", &[1], &answer).await;
    })
}

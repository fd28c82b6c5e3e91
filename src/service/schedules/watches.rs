//! Watches: a copy that takes over what a watch tells is after every message the map of that revision, whenever the watch
//! begins and however slow it is; and every commit is told once, in order.

#![allow(clippy::unwrap_used, reason = "a test fails by panicking")]

use super::scene::{Expected, Scene, count, scan};
use crate::quadtree::{Class, LeafRange, NodeAddress, OccupancyTree};
use crate::service::{Changes, ChangesQuery, RobotPose, ServiceSettings};
use crate::sync::explore::explore;
use shuttle::future::{JoinHandle, block_on, spawn, yield_now};
use std::collections::BTreeMap;
use std::sync::Arc;

/// Scans that are sent in all.
const SCANS: u64 = 4;

const QUERY: ChangesQuery = ChangesQuery {
    area: crate::service::BoxQuery { min_x: None, min_y: None, max_x: None, max_y: None, depth: None },
    contents: true,
    robots: true,
};

/// A client's copy of the map.
#[derive(Default)]
struct Copy {
    revision: u64,
    blocks: BTreeMap<(u32, u32), Vec<Class>>,
    robots: BTreeMap<String, RobotPose>,
}

fn cells(tree: &OccupancyTree, x: u32, y: u32) -> Vec<Class> {
    let range = LeafRange { min_x: 64 * x, min_y: 64 * y, max_x: 64 * (x + 1), max_y: 64 * (y + 1) };
    tree.raster(&range, tree.depth())
}

impl Copy {
    /// The map as it is in the first root that is read.
    async fn of(scene: &Scene) -> Self {
        let root = scene.read().await;
        let tree = root.tree.try_whole().unwrap();
        let block = |at: u32| ((at % 2, at / 2), cells(&tree, at % 2, at / 2));
        Self { revision: root.revision, blocks: (0..4).map(block).collect(), robots: BTreeMap::new() }
    }

    fn take_over(&mut self, scene: &Scene, expected: &Expected, changes: Changes) {
        assert_eq!(changes.since, self.revision, "told of changes since another revision");
        assert!(changes.revision >= self.revision, "told of {} after {}", changes.revision, self.revision);
        assert!(!changes.everything, "the stamps reach back to the beginning");
        assert!(changes.revision <= scene.store.durable(scene.id), "told of what is not stored");
        for block in changes.blocks {
            assert!(block.revision > changes.since && block.revision <= changes.revision, "told twice, or too early");
            let NodeAddress { x, y, .. } = block.node;
            self.blocks.insert((x, y), block.classes);
        }
        for robot in changes.robots {
            assert!(robot.revision <= changes.revision, "a robot of a later revision");
            self.robots.insert(robot.robot.as_str().to_owned(), robot);
        }
        self.revision = changes.revision;
        let tree = expected.after(count(&scene.store.windows(scene.id, self.revision)));
        for (x, y) in [(0, 0), (1, 0), (0, 1), (1, 1)] {
            let mine = self.blocks.get(&(x, y)).cloned().unwrap_or_else(|| vec![tree.scale().unknown(); 64 * 64]);
            assert!(mine == cells(tree, x, y), "the copy is not the map of revision {}", self.revision);
        }
    }

    fn is_complete(&self, scene: &Scene) -> bool {
        count(&scene.store.windows(scene.id, self.revision)) == SCANS
    }
}

/// Follows a watch until it has told everything: one that misses the last commit waits for ever.
fn follow(scene: &Scene, expected: &Arc<Expected>, from_root: bool) -> JoinHandle<()> {
    let (scene, expected) = (scene.clone(), Arc::clone(expected));
    spawn(async move {
        let mut copy = if from_root { Copy::of(&scene).await } else { Copy::default() };
        let mut watch = scene.service.watch(&scene.name, Some(copy.revision), QUERY).await.unwrap();
        let mut messages = 0;
        while messages == 0 || !copy.is_complete(&scene) {
            let changes = watch.next().await.unwrap();
            copy.take_over(&scene, &expected, changes);
            messages += 1;
            assert!(messages <= 1 + SCANS, "told more often than there were commits");
        }
        let robots = scene.service.robots(&scene.name).await.unwrap().robots;
        assert!(copy.robots.into_values().eq(robots), "the copy of the robots is not theirs");
    })
}

fn send(scene: &Scene, name: &'static str) -> JoinHandle<()> {
    let scene = scene.clone();
    spawn(async move {
        for sequence in 1..=SCANS / 2 {
            scene.insert(vec![scan(name, sequence)]).await.unwrap();
        }
    })
}

async fn watched(scene: &Scene, expected: &Arc<Expected>) {
    let tasks = [send(scene, "a"), follow(scene, expected, false), send(scene, "b"), follow(scene, expected, true)];
    for task in tasks {
        task.await.unwrap();
    }
}

#[test]
fn a_copy_that_follows_is_the_map_of_every_revision_that_it_is_told() {
    let expected = Expected::new(8);
    explore(150, move || {
        block_on(async {
            let scene = Scene::new(&expected, Scene::tight()).await;
            watched(&scene, &expected).await;
            scene.all_is_given_back().await;
        });
    });
}

#[test]
fn a_copy_that_the_log_has_left_behind_is_told_by_the_stamps() {
    let expected = Expected::new(8);
    explore(100, move || {
        block_on(async {
            // No commit fits into the log.
            let settings = ServiceSettings { max_changes: 2, ..Scene::tight() };
            let scene = Scene::new(&expected, settings).await;
            watched(&scene, &expected).await;
            scene.all_is_given_back().await;
        });
    });
}

#[test]
fn who_asks_what_changed_is_told_all_of_it_whatever_is_just_committed() {
    let expected = Expected::new(8);
    explore(400, move || {
        block_on(async {
            let scene = Scene::new(&expected, Scene::tight()).await;
            let sender = send(&scene, "a");
            let mut copy = Copy::default();
            while count(&scene.store.windows(scene.id, copy.revision)) < SCANS / 2 {
                let changes = scene.service.changes(&scene.name, copy.revision, &QUERY).await.unwrap();
                copy.take_over(&scene, &expected, changes);
                yield_now().await;
            }
            sender.await.unwrap();
            scene.all_is_given_back().await;
        });
    });
}

#[test]
fn every_commit_is_told_once_in_order_when_its_root_can_be_read() {
    let expected = Expected::new(8);
    explore(150, move || {
        block_on(async {
            let scene = Scene::new(&expected, Scene::tight()).await;
            let mut commits = scene.service.commits();
            let senders = [send(&scene, "a"), send(&scene, "b")];
            let listener = {
                let scene = scene.clone();
                spawn(async move {
                    let mut last = 0;
                    while count(&scene.store.windows(scene.id, last)) < SCANS {
                        let notice = commits.recv().await.unwrap();
                        assert_eq!(notice.revision, last + 1);
                        last = notice.revision;
                        assert!(scene.read().await.revision >= last, "told of {last} before it can be read");
                    }
                })
            };
            for task in senders {
                task.await.unwrap();
            }
            listener.await.unwrap();
            scene.all_is_given_back().await;
        });
    });
}

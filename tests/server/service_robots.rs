//! Where robots are: held to the scans that were acknowledged, in the order of their arrival.

#![allow(clippy::unwrap_used, clippy::panic, reason = "tests")]

use super::service_support::{TestStore, Writes, hall, map_name, open, ring, snapshot_name};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::collections::BTreeMap;
use std::time::Duration;
use ubbmap::service::{
    BoxQuery, Changes, ChangesQuery, ErrorKind, MapService, RobotPose, ScanInput, ServiceSettings, Watch,
};
use ubbmap::store::MapName;

/// A scan of a robot that stands at `place`.
fn scan(robot: &str, sequence: Option<u64>, place: f64) -> ScanInput {
    ScanInput { stamp: 100.0 + place, ..ring(robot, sequence, place) }
}

async fn insert(service: &MapService, name: &MapName, scans: Vec<ScanInput>) -> u64 {
    service.insert(name, scans).await.unwrap().revision
}

/// What is known of robots: name, number, place and revision.
fn known(robots: &[RobotPose]) -> Vec<(String, Option<u64>, f64, u64)> {
    let one = |robot: &RobotPose| {
        let x = robot.pose.x();
        assert_eq!((x.lo(), robot.stamp), (x.hi(), 100.0 + x.lo()));
        assert!(robot.received > 1e9);
        assert_eq!(robot.sensor, "default");
        (robot.robot.to_string(), robot.sequence, x.lo(), robot.revision)
    };
    robots.iter().map(one).collect()
}

async fn robots(service: &MapService, name: &MapName) -> Vec<(String, Option<u64>, f64, u64)> {
    known(&service.robots(name).await.unwrap().robots)
}

async fn next(watch: &mut Watch) -> Changes {
    tokio::time::timeout(Duration::from_secs(20), watch.next()).await.unwrap().unwrap()
}

#[tokio::test(flavor = "multi_thread")]
async fn a_robot_is_where_its_last_applied_scan_was() {
    let store = TestStore::new();
    let (service, name) = hall(&store, ServiceSettings::default()).await;
    assert!(robots(&service, &name).await.is_empty());
    insert(&service, &name, vec![scan("b", Some(1), 0.1), scan("a", Some(7), 0.2), scan("b", Some(2), 0.3)]).await;
    let both = [("a".to_owned(), Some(7), 0.2, 1), ("b".to_owned(), Some(2), 0.3, 1)];
    assert_eq!(robots(&service, &name).await, both);

    // A duplicate, a refused scan and one without a name say nothing of where a robot is.
    let mut far = scan("a", Some(9), 0.9);
    far.sensor = "nowhere".to_owned();
    let answer = service.insert(&name, vec![scan("b", Some(1), 0.9), far, scan("", None, 0.9)]).await.unwrap();
    assert_eq!((answer.applied, answer.duplicates, answer.rejected.len()), (1, 1, 1));
    assert_eq!(robots(&service, &name).await, both);

    // The last by arrival counts, not by number; a scan needs none.
    insert(&service, &name, vec![scan("a", Some(6), 0.4)]).await;
    let revision = insert(&service, &name, vec![scan("b", None, 0.5)]).await;
    let moved = [("a".to_owned(), Some(6), 0.4, 3), ("b".to_owned(), None, 0.5, 4)];
    assert_eq!((robots(&service, &name).await, revision), (moved.to_vec(), 4));
    assert_eq!(service.robots(&name).await.unwrap().revision, 4);

    // Restoring a snapshot takes back scans, and moves nobody.
    service.take_snapshot(&name, &snapshot_name("s")).await.unwrap();
    service.restore_snapshot(&name, &snapshot_name("s")).await.unwrap();
    assert_eq!(robots(&service, &name).await, moved);

    // In memory alone, and with its map.
    let again = open(&store, ServiceSettings::default());
    assert!(robots(&again, &name).await.is_empty());
    service.delete_map(&name).await.unwrap();
    assert_eq!(service.robots(&name).await.unwrap_err().kind, ErrorKind::MapNotFound);
    assert_eq!(service.robots(&map_name("other")).await.unwrap_err().kind, ErrorKind::MapNotFound);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_scan_that_is_not_stored_moves_no_robot() {
    let store = TestStore::new();
    let (service, name) = hall(&store, ServiceSettings::default()).await;
    insert(&service, &name, vec![scan("a", Some(1), 0.1)]).await;
    store.set_writes(Writes::FailStop);
    service.insert(&name, vec![scan("a", Some(2), 0.2)]).await.unwrap_err();
    assert_eq!(robots(&service, &name).await, [("a".to_owned(), Some(1), 0.1, 1)]);
}

#[tokio::test(flavor = "multi_thread")]
async fn of_too_many_robots_the_one_that_was_silent_for_longest_is_forgotten() {
    let store = TestStore::new();
    let (service, name) = hall(&store, ServiceSettings { max_robots: 3, ..ServiceSettings::default() }).await;
    for (robot, place) in [("a", 0.1), ("b", 0.2), ("c", 0.3), ("a", 0.4), ("d", 0.5)] {
        insert(&service, &name, vec![scan(robot, None, place)]).await;
    }
    let names: Vec<_> = robots(&service, &name).await.into_iter().map(|(robot, ..)| robot).collect();
    assert_eq!(names, ["a", "c", "d"]);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_copy_kept_by_a_watch_is_the_list_of_robots() {
    let store = TestStore::new();
    let (service, name) = hall(&store, ServiceSettings::default()).await;
    let query = ChangesQuery { robots: true, ..ChangesQuery::default() };
    insert(&service, &name, vec![scan("r0", Some(0), 0.0)]).await;
    // It begins at an old revision and hears of everyone.
    let mut watch = service.watch(&name, Some(1), query).await.unwrap();
    let mut copy = BTreeMap::new();
    let mut rng = ChaCha8Rng::seed_from_u64(3);
    for step in 1..200_u64 {
        let take = |copy: &mut BTreeMap<_, _>, changes: Changes| {
            copy.extend(changes.robots.into_iter().map(|robot| (robot.robot.clone(), robot)));
        };
        if step == 1 || rng.random_bool(0.5) {
            take(&mut copy, next(&mut watch).await);
            let list = service.robots(&name).await.unwrap();
            assert_eq!(copy.values().cloned().collect::<Vec<_>>(), list.robots, "at {step}");
        }
        let scans: Vec<_> = (0..rng.random_range(1..4))
            .map(|at| scan(&format!("r{}", rng.random_range(0..9)), Some(10 * step + at), step as f64 * 0.01))
            .collect();
        insert(&service, &name, scans).await;
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn robots_are_told_where_no_block_changed_and_only_to_those_who_ask() {
    let store = TestStore::new();
    let (service, name) = hall(&store, ServiceSettings::default()).await;
    let corner = BoxQuery { min_x: Some(9.0), min_y: Some(9.0), ..BoxQuery::default() };
    let quiet = ChangesQuery { area: corner, ..ChangesQuery::default() };
    let mut asked = service.watch(&name, None, ChangesQuery { robots: true, ..quiet }).await.unwrap();
    let mut silent = service.watch(&name, None, quiet).await.unwrap();
    assert!(next(&mut asked).await.robots.is_empty());
    assert!(next(&mut silent).await.robots.is_empty());
    insert(&service, &name, vec![scan("a", Some(1), 0.0)]).await;
    let told = next(&mut asked).await;
    assert_eq!((told.since, told.revision, told.blocks.len()), (0, 1, 0));
    assert_eq!(known(&told.robots), [("a".to_owned(), Some(1), 0.0, 1)]);
    let nothing = tokio::time::timeout(Duration::from_millis(300), silent.next()).await;
    assert!(nothing.is_err(), "{nothing:?}");
    // Those of some commits.
    insert(&service, &name, vec![scan("b", Some(1), 0.0)]).await;
    let query = ChangesQuery { robots: true, ..ChangesQuery::default() };
    let last = service.changes(&name, 1, &query).await.unwrap();
    assert_eq!(known(&last.robots), [("b".to_owned(), Some(1), 0.0, 2)]);
    assert_eq!(service.changes(&name, 0, &query).await.unwrap().robots.len(), 2);
    assert!(service.changes(&name, 2, &query).await.unwrap().robots.is_empty());
}

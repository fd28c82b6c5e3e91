//! Named maps: creation and its repetition, sensors, lists, loading, deletion.

#![allow(clippy::unwrap_used, reason = "tests")]

use super::service_support::{
    TestStore, Writes, config, config_of, counts, hall, map_name, open, ring, sensor, served, until,
};
use std::collections::BTreeMap;
use std::sync::atomic::Ordering;
use std::time::Duration;
use tokio::task::JoinSet;
use ubbmap::mapping::{EvidenceRule, MapConfig};
use ubbmap::quadtree::{ClassScale, Grid};
use ubbmap::sensor::{SensorModel, SensorSpec};
use ubbmap::service::{ErrorKind, ServiceSettings};

#[tokio::test(flavor = "multi_thread")]
async fn the_same_configuration_again_finds_the_map() {
    let store = TestStore::new();
    let service = open(&store, ServiceSettings::default());
    let name = map_name("hall");
    let first = service.create_map(&name, config()).await.unwrap();
    assert!(first.created && first.map.revision == 0 && first.map.config == config());
    assert!(first.map.created > 1.6e9, "seconds since 1970");
    service.insert(&name, vec![ring("amr-1", Some(0), 0.0)]).await.unwrap();
    let again = service.create_map(&name, config()).await.unwrap();
    assert!(!again.created && again.map.revision == 1);
    assert_eq!(again.map, service.map(&name).await.unwrap());
}

#[tokio::test(flavor = "multi_thread")]
async fn another_configuration_is_refused_by_its_first_field() {
    let store = TestStore::new();
    let (service, name) = hall(&store, ServiceSettings::default()).await;
    let shifted = MapConfig::new(
        Grid::new(0.1, 8, Some((0.0, 0.0))).unwrap(),
        ClassScale::new(10).unwrap(),
        EvidenceRule::Guaranteed,
        0.02,
        config().sensors().clone(),
    );
    let wider =
        MapConfig::new(*config().grid(), config().scale(), EvidenceRule::Guaranteed, 0.05, config().sensors().clone());
    let without_default = config().with_sensors(BTreeMap::from([("front".to_owned(), sensor())]));
    for (other, field) in [
        (config_of(0.05, 8, 10, EvidenceRule::Guaranteed), "config.resolution"),
        (config_of(0.1, 9, 10, EvidenceRule::Guaranteed), "config.depth"),
        (shifted.unwrap(), "config.origin"),
        (config_of(0.1, 8, 12, EvidenceRule::Inner), "config.classes"),
        (config_of(0.1, 8, 10, EvidenceRule::Outer), "config.evidence"),
        (wider.unwrap(), "config.min_obstacle_width"),
        (without_default.unwrap(), "config.sensors.default"),
    ] {
        let error = service.create_map(&name, other).await.unwrap_err();
        assert_eq!((error.kind, error.field.as_deref()), (ErrorKind::MapExists, Some(field)));
    }
    assert_eq!(service.map(&name).await.unwrap().config, config());
}

#[tokio::test(flavor = "multi_thread")]
async fn sensors_are_added_and_replaced_for_scans_to_come() {
    let store = TestStore::new();
    let (service, name) = hall(&store, ServiceSettings::default()).await;
    let mut scan = ring("amr-1", Some(0), 0.0);
    scan.sensor = "rear".to_owned();
    assert_eq!(counts(&service.insert(&name, vec![scan.clone()]).await.unwrap()), (0, 0, 1));
    let short = SensorModel::new(SensorSpec { range_max: 2.0, ..SensorSpec::default() }).unwrap();
    let sensors = BTreeMap::from([("default".to_owned(), short), ("rear".to_owned(), sensor())]);
    let more = config().with_sensors(sensors).unwrap();
    let answer = service.create_map(&name, more.clone()).await.unwrap();
    assert!(!answer.created && answer.map.config == more);
    assert_eq!(counts(&service.insert(&name, vec![scan]).await.unwrap()), (1, 0, 0));
    assert_eq!(open(&store, ServiceSettings::default()).map(&name).await.unwrap().config, more, "durable");
    // A store that fails leaves the sensors as they were.
    store.set_writes(Writes::FailOnce);
    let mut sensors = more.sensors().clone();
    sensors.insert("side".to_owned(), sensor());
    let error = service.create_map(&name, more.with_sensors(sensors).unwrap()).await.unwrap_err();
    assert_eq!(error.kind, ErrorKind::StoreFailed);
    assert_eq!(service.map(&name).await.unwrap().config, more);
}

#[tokio::test(flavor = "multi_thread")]
async fn unknown_maps_and_too_many_maps_are_refused() {
    let store = TestStore::new();
    let service = open(&store, ServiceSettings { max_maps: 2, ..ServiceSettings::default() });
    let nowhere = map_name("nowhere");
    for error in [
        service.map(&nowhere).await.unwrap_err(),
        service.delete_map(&nowhere).await.unwrap_err(),
        service.insert(&nowhere, vec![ring("", None, 0.0)]).await.unwrap_err(),
        service.tile(&nowhere, 0, 0, 0).await.unwrap_err(),
        service.version(&nowhere).await.unwrap_err(),
    ] {
        assert_eq!(error.kind, ErrorKind::MapNotFound);
        assert!(error.detail.contains("nowhere"));
    }
    service.create_map(&map_name("b"), config()).await.unwrap();
    service.create_map(&map_name("a"), config()).await.unwrap();
    assert_eq!(service.create_map(&map_name("c"), config()).await.unwrap_err().kind, ErrorKind::TooManyMaps);
    assert!(!service.create_map(&map_name("a"), config()).await.unwrap().created, "what is there may be found");
    let names: Vec<String> = service.maps().await.unwrap().iter().map(|map| map.name.to_string()).collect();
    assert_eq!(names, ["a", "b"]);
    service.delete_map(&map_name("a")).await.unwrap();
    assert!(service.create_map(&map_name("c"), config()).await.unwrap().created);
}

#[tokio::test(flavor = "multi_thread")]
async fn concurrent_creations_make_one_map() {
    let store = TestStore::new();
    let service = open(&store, ServiceSettings::default());
    let mut requests = JoinSet::new();
    for _ in 0..16 {
        let service = service.clone();
        requests.spawn(async move { service.create_map(&map_name("hall"), config()).await.unwrap().created });
    }
    assert_eq!(requests.join_all().await.iter().filter(|created| **created).count(), 1);
    assert_eq!(service.maps().await.unwrap().len(), 1);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_map_is_loaded_once_and_only_when_it_is_used() {
    let store = TestStore::new();
    let (service, name) = hall(&store, ServiceSettings::default()).await;
    service.create_map(&map_name("yard"), config()).await.unwrap();
    service.insert(&name, vec![ring("amr-1", Some(0), 0.0)]).await.unwrap();
    drop(service);
    store.loads.store(0, Ordering::SeqCst);
    store.hold();
    let service = open(&store, ServiceSettings::default());
    let maps = service.maps().await.unwrap();
    assert_eq!((maps[0].revision, maps[1].revision), (1, 0), "known without loading");
    assert_eq!(store.loads.load(Ordering::SeqCst), 0);
    let mut requests = JoinSet::new();
    for _ in 0..20 {
        let (service, name) = (service.clone(), name.clone());
        requests.spawn(async move { service.map(&name).await.unwrap().revision });
    }
    until("the load hangs", || store.waiting.load(Ordering::SeqCst) == 1).await;
    tokio::time::sleep(Duration::from_millis(100)).await;
    store.release();
    assert_eq!(requests.join_all().await, [1; 20]);
    assert_eq!(store.loads.load(Ordering::SeqCst), 1);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_deleted_map_is_gone_for_good_and_its_name_starts_anew() {
    let store = TestStore::new();
    let (service, name) = hall(&store, ServiceSettings::default()).await;
    service.insert(&name, vec![ring("amr-1", Some(0), 0.0)]).await.unwrap();
    let old = service.version(&name).await.unwrap();
    service.delete_map(&name).await.unwrap();
    assert_eq!(service.map(&name).await.unwrap_err().kind, ErrorKind::MapNotFound);
    assert_eq!(store.revision(&name), None);
    assert!(service.create_map(&name, config_of(0.1, 8, 8, EvidenceRule::Outer)).await.unwrap().created);
    assert_eq!(served(&service, &name).await.len(), 1, "empty: one leaf, unknown");
    let answer = service.insert(&name, vec![ring("amr-1", Some(0), 0.0)]).await.unwrap();
    assert_eq!((counts(&answer), answer.revision), ((1, 0, 0), 1), "no window is left");
    let new = service.version(&name).await.unwrap();
    assert!(new.revision == old.revision && new != old, "an entity tag of the old map does not name the new one");
    assert_eq!(service.tile(&name, 0, 0, 0).await.unwrap().map_id, new.map_id);
}

#[tokio::test(flavor = "multi_thread")]
async fn deleting_refuses_what_waits_at_the_writer() {
    let store = TestStore::new();
    let (service, name) = hall(&store, ServiceSettings::default()).await;
    service.insert(&name, vec![ring("amr-1", Some(0), 0.0)]).await.unwrap();
    store.hold();
    let mut requests = JoinSet::new();
    for robot in 0..10 {
        let (service, name) = (service.clone(), name.clone());
        requests.spawn(async move { service.insert(&name, vec![ring(&format!("r{robot}"), Some(0), 0.5)]).await });
        if robot == 0 {
            until("a commit hangs", || store.waiting.load(Ordering::SeqCst) == 1).await;
        }
    }
    tokio::time::sleep(Duration::from_millis(200)).await;
    let deletion = tokio::spawn({
        let (service, name) = (service.clone(), name.clone());
        async move { service.delete_map(&name).await }
    });
    tokio::time::sleep(Duration::from_millis(100)).await;
    assert!(!deletion.is_finished(), "the commit under way ends first");
    store.release();
    deletion.await.unwrap().unwrap();
    let answers = requests.join_all().await;
    assert_eq!(answers.iter().filter(|answer| answer.is_ok()).count(), 1, "the one that was being committed");
    for answer in answers {
        assert!(answer.map_or_else(|error| error.kind == ErrorKind::MapNotFound, |answer| answer.revision == 2));
    }
    assert_eq!(store.commits().last().unwrap().revision, 2, "nothing is committed after a deletion");
    service.drain().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_deletion_goes_on_when_its_client_leaves() {
    let store = TestStore::new();
    let (service, name) = hall(&store, ServiceSettings::default()).await;
    service.insert(&name, vec![ring("amr-1", Some(0), 0.0)]).await.unwrap();
    store.hold();
    let held = tokio::spawn({
        let (service, name) = (service.clone(), name.clone());
        async move { service.insert(&name, vec![ring("amr-1", Some(1), 0.5)]).await }
    });
    until("a commit hangs", || store.waiting.load(Ordering::SeqCst) == 1).await;
    let deletion = tokio::spawn({
        let (service, name) = (service.clone(), name.clone());
        async move { service.delete_map(&name).await }
    });
    tokio::time::sleep(Duration::from_millis(100)).await;
    deletion.abort();
    store.release();
    held.await.unwrap().unwrap();
    until("deleted", || store.revision(&name).is_none()).await;
    service.drain().await;
    assert!(service.maps().await.unwrap().is_empty());
}

#[tokio::test(flavor = "multi_thread")]
async fn a_damaged_map_is_named_keeps_its_name_and_hurts_no_other() {
    let store = TestStore::new();
    let (service, name) = hall(&store, ServiceSettings::default()).await;
    let yard = map_name("yard");
    service.create_map(&yard, config()).await.unwrap();
    drop(service);
    store.damage(&name);
    let service = open(&store, ServiceSettings::default());
    for error in [
        service.map(&name).await.unwrap_err(),
        service.insert(&name, vec![ring("", None, 0.0)]).await.unwrap_err(),
        service.create_map(&name, config()).await.unwrap_err(),
    ] {
        assert_eq!(error.kind, ErrorKind::MapDamaged);
        assert!(error.detail.contains("hall") && error.detail.contains("planted"), "{}", error.detail);
    }
    assert_eq!(counts(&service.insert(&yard, vec![ring("", None, 0.0)]).await.unwrap()), (1, 0, 0));
    service.delete_map(&name).await.unwrap();
    assert!(service.create_map(&name, config()).await.unwrap().created);
}

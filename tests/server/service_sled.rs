//! The service over the store on disk: what was acknowledged is there after a restart.

#![allow(clippy::unwrap_used, clippy::panic, reason = "tests")]

use super::service_support::{applied, config, counts, leaves, map_name, ring, served};
use std::path::Path;
use std::sync::Arc;
use std::time::Duration;
use tokio::task::JoinSet;
use ubbmap::service::{MapService, ScanInput, ServiceSettings};
use ubbmap::store::{MapStore, RewriteOptions, SledOptions, SledStore, StoreError};

/// Opens the store; the service before may need a moment to let go of it.
async fn open(directory: &Path) -> MapService {
    for _ in 0..1000 {
        match SledStore::open(directory, SledOptions::default()) {
            Ok(store) => return MapService::open(Arc::new(store), ServiceSettings::default()).unwrap(),
            Err(StoreError::Locked { .. }) => tokio::time::sleep(Duration::from_millis(10)).await,
            Err(error) => panic!("{error}"),
        }
    }
    panic!("the store stays locked");
}

#[tokio::test(flavor = "multi_thread")]
async fn robots_resume_after_a_restart_and_nothing_is_applied_twice() {
    let directory = tempfile::tempdir().unwrap();
    let name = map_name("hall");
    let scans = |robot: u64| -> Vec<ScanInput> {
        let scan = |i: u64| ring(&format!("amr-{robot}"), Some(i), 0.1 * (robot + i) as f64);
        (0..20).map(scan).collect()
    };
    let service = open(directory.path()).await;
    service.create_map(&name, config()).await.unwrap();
    let mut robots = JoinSet::new();
    for robot in 0..8 {
        let (service, name, scans) = (service.clone(), name.clone(), scans(robot));
        robots.spawn(async move {
            // Robot `n` gets as far as its scan `n + 5` before the server stops.
            for scan in scans.chunks(1).take(robot as usize + 5) {
                assert_eq!(counts(&service.insert(&name, scan.to_vec()).await.unwrap()), (1, 0, 0));
            }
        });
    }
    robots.join_all().await;
    service.drain().await;
    let (before, drawn) = (service.map(&name).await.unwrap(), served(&service, &name).await);
    drop(service);
    let service = open(directory.path()).await;
    assert_eq!(service.maps().await.unwrap()[0].revision, before.revision);
    assert_eq!(service.map(&name).await.unwrap(), before);
    assert_eq!(served(&service, &name).await, drawn);
    for robot in 0..8 {
        let answer = service.insert(&name, scans(robot)).await.unwrap();
        assert_eq!(counts(&answer), (15 - robot, robot + 5, 0));
    }
    assert!(service.map(&name).await.unwrap().robots.iter().all(|robot| robot.applied == 20));
    // A class is held to 1..=k, so the order of scans matters; one robot after the other is one that the first
    // insertions did not have, therefore only a map of its own is compared leaf for leaf.
    let other = map_name("yard");
    service.create_map(&other, config()).await.unwrap();
    let all: Vec<ScanInput> = (0..8).flat_map(scans).collect();
    for request in all.chunks(33) {
        service.insert(&other, request.to_vec()).await.unwrap();
    }
    drop(service);
    assert_eq!(served(&open(directory.path()).await, &other).await, leaves(&applied(&config(), &all)));
}

#[tokio::test(flavor = "multi_thread")]
async fn the_size_of_the_store_is_among_the_metrics() {
    let directory = tempfile::tempdir().unwrap();
    let rewrite = RewriteOptions { check: Duration::from_millis(5), ..RewriteOptions::default() };
    let store = SledStore::open(directory.path(), SledOptions { rewrite, ..SledOptions::default() }).unwrap();
    let store = Arc::new(store);
    let service = MapService::open(Arc::clone(&store) as _, ServiceSettings::default()).unwrap();
    store.rewrite(&mut |_| Ok(())).unwrap();
    while store.statistics().unwrap().live_bytes.is_none() {
        tokio::time::sleep(Duration::from_millis(2)).await;
    }
    let recorder = metrics_exporter_prometheus::PrometheusBuilder::new().build_recorder();
    metrics::with_local_recorder(&recorder, || service.note_metrics());
    let text = recorder.handle().render();
    let held = store.verify().unwrap().bytes;
    for line in [&format!("ubbmap_store_live_bytes {held}"), "ubbmap_store_rewrites_total{outcome=\"done\"} 1"] {
        assert!(text.contains(line), "{line} is not in\n{text}");
    }
    assert!(text.contains("ubbmap_store_disk_bytes "), "{text}");
}

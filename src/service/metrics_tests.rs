//! The names that dashboards are built on.

#![allow(clippy::unwrap_used, reason = "a test fails by panicking")]

use super::metrics::{
    Loaded, Outcome, Queued, beams_failed, commit, describe_metrics, evidence, query, robot_scan, scans, store,
};
use crate::store::{RobotName, StoreStatistics};
use metrics_exporter_prometheus::PrometheusBuilder;
use std::time::Duration;

#[test]
fn metrics_keep_their_names() {
    let recorder = PrometheusBuilder::new().build_recorder();
    let handle = recorder.handle();
    let held = metrics::with_local_recorder(&recorder, || {
        describe_metrics();
        scans(Outcome::Applied, 3);
        scans(Outcome::Duplicate, 2);
        scans(Outcome::Rejected, 1);
        scans(Outcome::Failed, 0);
        beams_failed(5);
        commit(true, 3, Duration::from_millis(2));
        evidence(Duration::from_millis(1));
        assert_eq!(query("grid", || 8), 8);
        drop(Queued::new());
        store(&StoreStatistics { disk_bytes: 900, live_bytes: Some(300), rewrites: 2, failed_rewrites: 1 });
        (Loaded::new(), Queued::new())
    });
    let text = handle.render();
    for line in [
        "ubbmap_scans_total{outcome=\"applied\"} 3",
        "ubbmap_scans_total{outcome=\"duplicate\"} 2",
        "ubbmap_scans_total{outcome=\"rejected\"} 1",
        "ubbmap_beams_failed_total 5",
        "ubbmap_commits_total{outcome=\"stored\"} 1",
        "ubbmap_commit_seconds_count 1",
        "ubbmap_commit_scans_count 1",
        "ubbmap_evidence_seconds_count 1",
        "ubbmap_query_seconds_count{kind=\"grid\"} 1",
        "ubbmap_queue_depth 1",
        "ubbmap_maps_open 1",
        "ubbmap_store_disk_bytes 900",
        "ubbmap_store_live_bytes 300",
        "ubbmap_store_rewrites_total{outcome=\"done\"} 2",
        "ubbmap_store_rewrites_total{outcome=\"failed\"} 1",
        "# HELP ubbmap_queue_depth ",
    ] {
        assert!(text.contains(line), "{line} is not in\n{text}");
    }
    assert!(!text.contains("scans_total{outcome=\"failed\""));
    metrics::with_local_recorder(&recorder, || drop(held));
    assert!(handle.render().contains("ubbmap_maps_open 0"));
}

/// Names come from outside: were there a series for each, a robot that changes its name would fill the memory.
#[test]
fn a_robot_is_counted_by_name_up_to_the_first_thousand() {
    let recorder = PrometheusBuilder::new().build_recorder();
    let handle = recorder.handle();
    metrics::with_local_recorder(&recorder, || {
        for i in 0..1200 {
            let robot = RobotName::new(&format!("counted-{i}")).unwrap();
            robot_scan(Some(&robot), Outcome::Applied);
            robot_scan(Some(&robot), Outcome::Rejected);
        }
        robot_scan(None, Outcome::Rejected);
    });
    let text = handle.render();
    assert!(text.contains("ubbmap_robot_scans_total{robot=\"counted-0\",outcome=\"applied\"} 1"), "{text}");
    assert!(text.contains("ubbmap_robot_scans_total{robot=\"\",outcome=\"rejected\"} 1"), "{text}");
    // Other tests of this process may have named robots before.
    let named = text.matches("{robot=\"counted-").count();
    assert!((2..=2000).contains(&named), "{named}");
    let others = text.lines().find(|line| line.contains("{robot=\"(other)\",outcome=\"applied\"}")).unwrap();
    let others: usize = others.rsplit(' ').next().unwrap().parse().unwrap();
    assert_eq!(others, 1200 - named / 2);
}

//! Insertions: exactly once by robot and sequence, order, refusals by scan, restarts.

#![allow(clippy::unwrap_used, reason = "tests")]

use super::service_support::{TestStore, applied, config, counts, hall, leaves, open, ring, served};
use std::f64::consts::TAU;
use ubbmap::sensor::{Angles, PoseLimits};
use ubbmap::service::{ErrorKind, RawPose, ScanInput, ServiceSettings};

#[tokio::test(flavor = "multi_thread")]
async fn what_is_applied_is_what_the_engine_alone_makes_of_it() {
    let store = TestStore::new();
    let (service, name) = hall(&store, ServiceSettings::default()).await;
    let scans: Vec<ScanInput> = (0..20).map(|i| ring("amr-1", Some(i), 0.2 * i as f64)).collect();
    for request in scans.chunks(7) {
        let answer = service.insert(&name, request.to_vec()).await.unwrap();
        assert_eq!(counts(&answer), (request.len() as u64, 0, 0));
        assert_eq!(store.revision(&name), Some(answer.revision));
    }
    let expected = leaves(&applied(&config(), &scans));
    assert!(expected.len() > 100, "the scans draw something");
    assert_eq!(served(&service, &name).await, expected);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_scan_is_applied_once_in_whatever_order_it_comes() {
    let store = TestStore::new();
    let (service, name) = hall(&store, ServiceSettings::default()).await;
    for (sequences, expected) in [
        (vec![5, 3, 9], (3, 0)),
        (vec![3], (0, 1)),
        (vec![9, 4, 5, 4], (1, 3)),
        (vec![0, 1, 2, 3, 4, 5, 6, 7, 8, 9], (6, 4)),
    ] {
        let scans = sequences.iter().map(|n| ring("amr-1", Some(*n), 0.0)).collect();
        let answer = service.insert(&name, scans).await.unwrap();
        assert_eq!((answer.applied, answer.duplicates), expected, "{sequences:?}");
    }
    // Another robot's numbers are its own.
    assert_eq!(counts(&service.insert(&name, vec![ring("amr-2", Some(5), 0.0)]).await.unwrap()), (1, 0, 0));
    let all: Vec<ScanInput> = (0..11).map(|_| ring("", None, 0.0)).collect();
    // Ten of the first robot and one of the second; on a scale of ten classes the eleventh changes nothing.
    assert_eq!(served(&service, &name).await, leaves(&applied(&config(), &all)));
    let robots = service.map(&name).await.unwrap().robots;
    let seen: Vec<_> = robots.iter().map(|r| (r.name.as_str(), r.highest_sequence, r.applied)).collect();
    assert_eq!(seen, [("amr-1", Some(9), 10), ("amr-2", Some(5), 1)]);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_sequence_behind_the_window_is_refused_and_not_applied() {
    let store = TestStore::new();
    let (service, name) = hall(&store, ServiceSettings::default()).await;
    service.insert(&name, vec![ring("amr-1", Some(5000), 0.0)]).await.unwrap();
    let before = service.map(&name).await.unwrap();
    let answer =
        service.insert(&name, vec![ring("amr-1", Some(3976), 1.0), ring("amr-1", Some(3977), 1.0)]).await.unwrap();
    assert_eq!(counts(&answer), (1, 0, 1));
    assert_eq!((answer.rejected[0].index, answer.rejected[0].code), (0, "SEQUENCE_TOO_OLD"));
    assert_eq!(answer.revision, before.revision + 1);
    // The same inside one request, where only the writer can know.
    let answer =
        service.insert(&name, vec![ring("amr-3", Some(2000), 0.0), ring("amr-3", Some(10), 0.0)]).await.unwrap();
    assert_eq!((counts(&answer), answer.rejected[0].index), ((1, 0, 1), 1));
    assert_eq!(answer.rejected[0].code, "SEQUENCE_TOO_OLD");
}

#[tokio::test(flavor = "multi_thread")]
async fn scans_without_a_sequence_are_always_applied() {
    let store = TestStore::new();
    let (service, name) = hall(&store, ServiceSettings::default()).await;
    let answer = service.insert(&name, vec![ring("", None, 0.0), ring("amr-1", None, 0.0)]).await.unwrap();
    assert_eq!(counts(&answer), (2, 0, 0));
    assert_eq!(counts(&service.insert(&name, vec![ring("amr-1", None, 0.0)]).await.unwrap()), (1, 0, 0));
    assert!(service.map(&name).await.unwrap().robots.is_empty(), "they leave no window");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_restart_knows_what_was_applied() {
    let store = TestStore::new();
    let (service, name) = hall(&store, ServiceSettings::default()).await;
    let scans: Vec<ScanInput> = (0..30).map(|i| ring("amr-1", Some(i), 0.1 * i as f64)).collect();
    let first = service.insert(&name, scans[..20].to_vec()).await.unwrap();
    let (map, drawn) = (service.map(&name).await.unwrap(), served(&service, &name).await);
    drop(service);
    let service = open(&store, ServiceSettings::default());
    assert_eq!(service.map(&name).await.unwrap(), map);
    assert_eq!(served(&service, &name).await, drawn);
    let again = service.insert(&name, scans.clone()).await.unwrap();
    assert_eq!((counts(&again), again.revision), ((10, 20, 0), first.revision + 1));
    assert_eq!(served(&service, &name).await, leaves(&applied(&config(), &scans)));
}

#[tokio::test(flavor = "multi_thread")]
async fn duplicates_alone_make_no_commit() {
    let store = TestStore::new();
    let (service, name) = hall(&store, ServiceSettings::default()).await;
    let scans = vec![ring("amr-1", Some(1), 0.0), ring("amr-1", Some(2), 0.0)];
    let first = service.insert(&name, scans.clone()).await.unwrap();
    let again = service.insert(&name, scans).await.unwrap();
    assert_eq!((counts(&again), again.revision), ((0, 2, 0), first.revision));
    let none = service.insert(&name, Vec::new()).await.unwrap();
    assert_eq!((counts(&none), none.revision), ((0, 0, 0), first.revision));
    assert_eq!(store.commits().len(), 1);
}

#[tokio::test(flavor = "multi_thread")]
async fn bad_scans_are_named_and_good_ones_applied() {
    let store = TestStore::new();
    let (service, name) = hall(&store, ServiceSettings::default()).await;
    let good = || ring("amr-1", None, 0.0);
    let pose = |x, theta| Some(RawPose { x, y: (0.0, 0.0), theta });
    let bad: Vec<(&str, ScanInput)> = vec![
        ("UNKNOWN_SENSOR", ScanInput { sensor: "rear".to_owned(), ..good() }),
        ("INVALID_ROBOT", ScanInput { robot: "a/b".to_owned(), ..good() }),
        ("INVALID_ROBOT", ScanInput { robot: String::new(), sequence: Some(1), ..good() }),
        ("POSE_MISSING", ScanInput { pose: None, ..good() }),
        ("POSE_INVERTED", ScanInput { pose: pose((1.0, 0.0), (0.0, 0.0)), ..good() }),
        ("POSE_NOT_FINITE", ScanInput { pose: pose((0.0, f64::NAN), (0.0, 0.0)), ..good() }),
        ("POSE_NOT_FINITE", ScanInput { pose: pose((0.0, 0.0), (0.0, f64::INFINITY)), ..good() }),
        ("POSE_TOO_WIDE", ScanInput { pose: pose((0.0, 2.5), (0.0, 0.0)), ..good() }),
        ("POSE_OUTSIDE_MAP", ScanInput { pose: pose((500.0, 500.0), (0.0, 0.0)), ..good() }),
        ("NO_BEAMS", ScanInput { ranges: Vec::new(), ..good() }),
        ("TOO_MANY_BEAMS", ScanInput { ranges: vec![1.0; 20_001], ..good() }),
        ("LENGTH_MISMATCH", ScanInput { angles: Angles::Listed(vec![0.0; 3]), ..good() }),
        ("SPAN_TOO_WIDE", ScanInput { angles: Angles::Uniform { min: 0.0, increment: TAU }, ..good() }),
        ("OUT_OF_RANGE", ScanInput { footprint_radius: -1.0, ..good() }),
        ("OUT_OF_RANGE", ScanInput { sweep_rotation: f64::NAN, ..good() }),
    ];
    let mut request = vec![good()];
    for (_, scan) in &bad {
        request.extend([scan.clone(), good()]);
    }
    let answer = service.insert(&name, request).await.unwrap();
    assert_eq!(counts(&answer), (bad.len() as u64 + 1, 0, bad.len()));
    for (i, ((code, _), rejection)) in bad.iter().zip(&answer.rejected).enumerate() {
        assert_eq!((rejection.code, rejection.index), (*code, 2 * i + 1), "{}", rejection.detail);
        let field = ["sensor", "robot", "pose", "ranges", "angle", "footprint", "sweep"];
        assert!(field.iter().any(|word| rejection.detail.contains(word)), "names the field: {}", rejection.detail);
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_pose_box_of_more_leaves_than_a_scan_may_cost_is_named_whatever_the_limit_in_metres() {
    let store = TestStore::new();
    let pose = PoseLimits { max_position_width: 1e6, ..PoseLimits::default() };
    let (service, name) = hall(&store, ServiceSettings { pose, ..ServiceSettings::default() }).await;
    let wide = RawPose { x: (-4e5, 4e5), y: (0.0, 0.0), theta: (0.0, 0.0) };
    let answer = service.insert(&name, vec![ScanInput { pose: Some(wide), ..ring("amr-1", None, 0.0) }]).await.unwrap();
    assert_eq!(counts(&answer), (0, 0, 1));
    let rejection = &answer.rejected[0];
    assert_eq!(rejection.code, "TOO_MANY_LEAVES");
    assert!(rejection.detail.contains("pose"), "names the field: {}", rejection.detail);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_request_of_bad_scans_alone_changes_nothing() {
    let store = TestStore::new();
    let (service, name) = hall(&store, ServiceSettings::default()).await;
    let answer = service.insert(&name, vec![ScanInput { pose: None, ..ring("amr-1", Some(7), 0.0) }]).await.unwrap();
    assert_eq!((counts(&answer), answer.revision), ((0, 0, 1), 0));
    assert!(store.commits().is_empty());
    // The refused scan's number is free still.
    assert_eq!(counts(&service.insert(&name, vec![ring("amr-1", Some(7), 0.0)]).await.unwrap()), (1, 0, 0));
}

#[tokio::test(flavor = "multi_thread")]
async fn limits_on_scans_and_robots_are_named() {
    let store = TestStore::new();
    let settings = ServiceSettings { max_scans_per_request: 4, max_robots: 2, ..ServiceSettings::default() };
    let (service, name) = hall(&store, settings).await;
    let error = service.insert(&name, vec![ring("", None, 0.0); 5]).await.unwrap_err();
    assert_eq!((error.kind, error.field.as_deref()), (ErrorKind::TooManyScans, Some("scans")));
    assert!(error.detail.contains('4') && error.detail.contains('5'), "{}", error.detail);
    let scans = ["a", "b", "c", "a"].map(|robot| ring(robot, Some(u64::from(robot == "a")), 0.0)).to_vec();
    let answer = service.insert(&name, scans).await.unwrap();
    assert_eq!(counts(&answer), (2, 1, 1));
    assert_eq!((answer.rejected[0].index, answer.rejected[0].code), (2, "TOO_MANY_ROBOTS"));
}

#[tokio::test(flavor = "multi_thread")]
async fn a_request_that_never_fits_the_memory_is_told_so() {
    let store = TestStore::new();
    let settings = ServiceSettings { max_bytes_in_flight: 20_000, ..ServiceSettings::default() };
    let (service, name) = hall(&store, settings).await;
    let error = service.insert(&name, vec![ring("", None, 0.0); 8]).await.unwrap_err();
    assert_eq!(error.kind, ErrorKind::TooManyScans);
    assert!(error.detail.contains("20000"), "{}", error.detail);
    // What was taken for it is given back.
    let one = ScanInput {
        ranges: vec![0.2; 4],
        angles: Angles::Uniform { min: 0.0, increment: 0.01 },
        ..ring("", None, 0.0)
    };
    for _ in 0..20 {
        assert_eq!(counts(&service.insert(&name, vec![one.clone()]).await.unwrap()), (1, 0, 0));
    }
}

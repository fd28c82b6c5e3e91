//! Streams of gRPC: scans that are acknowledged when durable, and watches.

#![allow(clippy::unwrap_used, reason = "a test may end where its ground is not as it should be")]

use crate::grpc_support::{message, refused, ring};
use crate::http_support::Site;
use crate::service_support::map_name;
use std::sync::atomic::Ordering;
use std::time::Duration;
use tokio::sync::mpsc;
use tokio_stream::StreamExt;
use tokio_stream::wrappers::ReceiverStream;
use tonic::{Code, Streaming};
use ubbmap::wire::v1;

/// A ring of the robot at another place for each number, so that each changes the map.
fn scan(robot: &str, sequence: u64) -> v1::Scan {
    let mut scan = ring(robot, Some(sequence));
    let place = 0.01 * sequence as f64;
    scan.pose.as_mut().unwrap().x = Some(v1::Interval { min: Some(place), max: Some(place) });
    scan
}

type Sender = mpsc::Sender<v1::StreamScansRequest>;

async fn open(site: &Site, client: &mut crate::grpc_support::Client) -> (Sender, Streaming<v1::StreamScansResponse>) {
    let _ = site;
    let (sender, receiver) = mpsc::channel(1024);
    let answers = client.stream_scans(ReceiverStream::new(receiver)).await.unwrap().into_inner();
    (sender, answers)
}

#[test]
fn scans_are_acknowledged_in_order_when_they_are_durable() {
    let site = Site::hall();
    let mut client = site.rpc();
    site.run(async {
        let (sender, mut answers) = open(&site, &mut client).await;
        // All are sent before any answer is read. The map is named once.
        for sequence in 0..200 {
            let map = if sequence == 0 { "hall" } else { "" };
            sender.send(message(map, scan("a", sequence))).await.unwrap();
        }
        for sequence in 0..200 {
            let answer = answers.next().await.unwrap().unwrap();
            assert_eq!((answer.robot.as_str(), answer.sequence, answer.index), ("a", Some(sequence), sequence));
            assert!(!answer.duplicate && answer.rejected.is_none());
            assert!(site.store.revision(&map_name("hall")).unwrap() >= answer.revision, "not durable");
        }
        // Again, and in another order; a bad one between good ones.
        let mut wide = scan("a", 999);
        wide.pose.as_mut().unwrap().y = Some(v1::Interval { min: Some(0.0), max: Some(9.0) });
        for scan in [scan("a", 150), scan("a", 205), wide, scan("a", 203)] {
            sender.send(message("hall", scan)).await.unwrap();
        }
        drop(sender);
        let rest: Vec<_> = answers.map(Result::unwrap).collect().await;
        let told: Vec<_> =
            rest.iter().map(|r| (r.sequence, r.duplicate, r.rejected.as_ref().map(|r| r.code.as_str()))).collect();
        let expected = [
            (Some(150), true, None),
            (Some(205), false, None),
            (Some(999), false, Some("POSE_TOO_WIDE")),
            (Some(203), false, None),
        ];
        assert_eq!(told, expected);
        assert_eq!(rest[2].rejected.as_ref().unwrap().index, 202);
    });
    assert_eq!(site.get("/v1/maps/hall").json()["robots"][0]["applied"], "202");
}

#[test]
fn a_stream_has_so_many_scans_under_way_and_no_more() {
    let site = Site::with(|config| config.limits.scans_per_stream = 4);
    site.make_hall();
    let mut client = site.rpc();
    site.run(async {
        let (sender, answers) = open(&site, &mut client).await;
        for sequence in 0..40 {
            sender.send(message("hall", scan("a", sequence))).await.unwrap();
        }
        drop(sender);
        assert_eq!(answers.map(Result::unwrap).collect::<Vec<_>>().await.len(), 40);
    });
    // A commit holds what is under way.
    assert!(site.store.commits().len() >= 10, "{} commits", site.store.commits().len());
}

#[test]
fn a_full_queue_holds_a_stream_up_and_loses_nothing() {
    let site = Site::with(|config| config.writer.queue = 1);
    site.make_hall();
    site.run(async {
        let mut streams = tokio::task::JoinSet::new();
        for robot in 0..8 {
            let mut client = crate::grpc_support::Client::connect(site.url()).await.unwrap();
            streams.spawn(async move {
                let scans = (0..25).map(move |sequence| message("hall", scan(&format!("r{robot}"), sequence)));
                let answers = client.stream_scans(tokio_stream::iter(scans)).await.unwrap().into_inner();
                answers.map(Result::unwrap).filter(|answer| answer.rejected.is_none()).collect::<Vec<_>>().await.len()
            });
        }
        assert_eq!(streams.join_all().await, [25; 8]);
    });
}

#[test]
fn a_client_that_is_killed_midway_sends_again_and_nothing_is_applied_twice() {
    let site = Site::hall();
    let acknowledged = site.run(async {
        // A connection of its own, so that it can be cut.
        let mut client = crate::grpc_support::Client::connect(site.url()).await.unwrap();
        let (sender, mut answers) = open(&site, &mut client).await;
        for sequence in 0..300 {
            sender.send(message("hall", scan("a", sequence))).await.unwrap();
        }
        let mut acknowledged = 0;
        while acknowledged < 20 {
            answers.next().await.unwrap().unwrap();
            acknowledged += 1;
        }
        acknowledged
    });
    let mut client = site.rpc();
    let fates = site.run(async {
        let scans = (0..300).map(|sequence| message("hall", scan("a", sequence)));
        let answers = client.stream_scans(tokio_stream::iter(scans)).await.unwrap().into_inner();
        answers.map(Result::unwrap).collect::<Vec<_>>().await
    });
    assert_eq!(fates.len(), 300);
    assert!(fates.iter().all(|fate| fate.rejected.is_none()));
    assert!(fates[..acknowledged].iter().all(|fate| fate.duplicate), "what was acknowledged was there");
    let map = site.get("/v1/maps/hall").json();
    assert_eq!((&map["robots"][0]["applied"], &map["robots"][0]["highest_sequence"]), (&"300".into(), &"299".into()));
}

#[test]
fn a_stream_ends_by_what_it_cannot_take_after_what_it_took() {
    let site = Site::hall();
    let mut client = site.rpc();
    let end = |client: &mut crate::grpc_support::Client, scans: Vec<v1::StreamScansRequest>| {
        site.run(async {
            let answers = client.stream_scans(tokio_stream::iter(scans)).await.unwrap().into_inner();
            let mut answers: Vec<_> = answers.collect().await;
            (answers.pop().unwrap(), answers.into_iter().map(Result::unwrap).count())
        })
    };
    let good = || message("hall", scan("a", 1));
    let (last, taken) = end(&mut client, vec![good(), message("other", scan("a", 2)), good()]);
    assert_eq!((refused(last, Code::InvalidArgument, "INVALID_REQUEST").0.as_str(), taken), ("map", 1));
    let (last, taken) = end(&mut client, vec![good(), v1::StreamScansRequest { map: String::new(), scan: None }]);
    assert_eq!((refused(last, Code::InvalidArgument, "INVALID_REQUEST").0.as_str(), taken), ("scan", 1));
    let (last, taken) = end(&mut client, vec![message("", scan("a", 2))]);
    assert_eq!((refused(last, Code::InvalidArgument, "INVALID_NAME").0.as_str(), taken), ("map", 0));
    let (last, _) = end(&mut client, vec![message("nowhere", scan("a", 2))]);
    refused(last, Code::NotFound, "MAP_NOT_FOUND");
    let mut long = scan("a", 3);
    long.ranges = vec![1.0; 5_000_000];
    let (last, taken) = end(&mut client, vec![good(), message("", long)]);
    assert_eq!((refused(last, Code::ResourceExhausted, "BODY_TOO_LARGE").0.as_str(), taken), ("body", 1));
}

#[test]
fn at_the_servers_end_a_stream_gets_what_it_sent_acknowledged_and_a_word() {
    let mut site = Site::hall();
    let mut client = site.rpc();
    let server = site.server.take().unwrap();
    site.run(async {
        let (sender, mut answers) = open(&site, &mut client).await;
        sender.send(message("hall", scan("a", 0))).await.unwrap();
        answers.next().await.unwrap().unwrap();
        let mut watch = client.watch_map(watch("hall", None)).await.unwrap().into_inner();
        watch.next().await.unwrap().unwrap();
        site.store.hold();
        sender.send(message("hall", scan("a", 1))).await.unwrap();
        while site.store.waiting.load(Ordering::SeqCst) == 0 {
            tokio::time::sleep(Duration::from_millis(5)).await;
        }
        let end = tokio::spawn(server.shutdown());
        refused(watch.next().await.unwrap(), Code::Unavailable, "SHUTTING_DOWN");
        site.store.release();
        assert_eq!(answers.next().await.unwrap().unwrap().sequence, Some(1));
        refused(answers.next().await.unwrap(), Code::Unavailable, "SHUTTING_DOWN");
        end.await.unwrap().unwrap();
    });
    assert_eq!(site.store.revision(&map_name("hall")), Some(2));
}

#[test]
fn a_robot_whose_clock_is_far_off_is_mapped_like_any_other() {
    let site = Site::hall();
    let mut client = site.rpc();
    let fates = site.run(async {
        let stamps = [0.0, -1e18, 1e300, f64::NAN, f64::INFINITY, 4e9, 1.0];
        let scans = stamps
            .into_iter()
            .zip(0..)
            .map(|(stamp, sequence)| message("hall", v1::Scan { stamp, ..scan("a", sequence) }));
        let answers = client.stream_scans(tokio_stream::iter(scans.collect::<Vec<_>>())).await.unwrap().into_inner();
        answers.map(Result::unwrap).collect::<Vec<_>>().await
    });
    assert!(fates.len() == 7 && fates.iter().all(|fate| fate.rejected.is_none() && !fate.duplicate), "{fates:?}");
    let other = Site::hall();
    let mut client = other.rpc();
    other.run(async {
        let scans: Vec<_> = (0..7).map(|sequence| message("hall", scan("a", sequence))).collect();
        let answers = client.stream_scans(tokio_stream::iter(scans)).await.unwrap().into_inner();
        assert_eq!(answers.map(Result::unwrap).collect::<Vec<_>>().await.len(), 7);
    });
    let leaves = |site: &Site| site.get("/v1/maps/hall/region").json()["leaves"].clone();
    assert_eq!(leaves(&site), leaves(&other));
}

fn watch(map: &str, since: Option<u64>) -> v1::WatchMapRequest {
    v1::WatchMapRequest { map: map.to_owned(), since, ..v1::WatchMapRequest::default() }
}

#[test]
fn a_watch_tells_every_commit_and_resumes() {
    let site = Site::hall();
    let mut client = site.rpc();
    let inserter = client.clone();
    let insert = |sequence: u64| {
        let mut client = inserter.clone();
        async move {
            let request = v1::InsertScansRequest { map: "hall".to_owned(), scans: vec![scan("a", 20 * sequence)] };
            client.insert_scans(request).await.unwrap().into_inner().revision
        }
    };
    site.run(async {
        let mut changes = client.clone().watch_map(watch("hall", None)).await.unwrap().into_inner();
        assert_eq!(changes.next().await.unwrap().unwrap().revision, 0);
        for step in 1..=5 {
            assert_eq!(insert(step).await, step);
            let change = changes.next().await.unwrap().unwrap();
            assert_eq!((change.since, change.revision, change.everything), (step - 1, step, false));
            assert!(!change.blocks.is_empty());
        }
        let mut resumed = client.clone().watch_map(watch("hall", Some(2))).await.unwrap().into_inner();
        let change = resumed.next().await.unwrap().unwrap();
        assert_eq!((change.since, change.revision, change.everything), (2, 5, false));
        client.delete_map(v1::DeleteMapRequest { map: "hall".to_owned() }).await.unwrap();
        refused(resumed.next().await.unwrap(), Code::NotFound, "MAP_NOT_FOUND");
        refused(client.watch_map(watch("hall", None)).await, Code::NotFound, "MAP_NOT_FOUND");
        let deep = v1::WatchMapRequest { depth: Some(25), ..watch("hall", None) };
        client.create_map(v1::CreateMapRequest { map: "hall".to_owned(), config: None }).await.unwrap();
        assert_eq!(refused(client.watch_map(deep).await, Code::OutOfRange, "DEPTH_OUT_OF_RANGE").0, "depth");
    });
}

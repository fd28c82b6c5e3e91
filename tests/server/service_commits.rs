//! The writer: many requests a commit, nothing acknowledged that is not durable, readers that never wait.

#![allow(clippy::unwrap_used, reason = "tests")]

use super::service_support::{TestStore, Writes, applied, config, counts, hall, leaves, open, ring, served, until};
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::Duration;
use tokio::task::{JoinHandle, JoinSet};
use ubbmap::service::{BoxQuery, ErrorKind, InsertAnswer, MapService, ScanInput, ServiceError, ServiceSettings};
use ubbmap::store::MapName;

/// An insertion on a task of its own.
fn insertion(
    service: &MapService,
    name: &MapName,
    scans: Vec<ScanInput>,
) -> JoinHandle<Result<InsertAnswer, ServiceError>> {
    let (service, name) = (service.clone(), name.clone());
    tokio::spawn(async move { service.insert(&name, scans).await })
}

/// A map whose writer hangs in the commit of one scan of `holder`.
async fn held_in_a_commit(
    store: &Arc<TestStore>,
    settings: ServiceSettings,
) -> (MapService, MapName, JoinHandle<Result<InsertAnswer, ServiceError>>) {
    let (service, name) = hall(store, settings).await;
    service.insert(&name, vec![ring("holder", Some(0), 0.0)]).await.unwrap();
    store.hold();
    let holding = insertion(&service, &name, vec![ring("holder", Some(1), 1.0)]);
    until("the commit hangs", || store.waiting.load(Ordering::SeqCst) == 1).await;
    (service, name, holding)
}

#[tokio::test(flavor = "multi_thread")]
async fn many_requests_share_commits_and_each_is_durable_when_acknowledged() {
    let store = TestStore::new();
    let (service, name, holding) = held_in_a_commit(&store, ServiceSettings::default()).await;
    let mut requests = JoinSet::new();
    for robot in 0..60_u64 {
        let (service, name, store) = (service.clone(), name.clone(), Arc::clone(&store));
        requests.spawn(async move {
            let scan = ring(&format!("amr-{robot}"), Some(robot), 0.05 * robot as f64);
            let answer = service.insert(&name, vec![scan]).await.unwrap();
            // At the moment of the acknowledgement the store must have it.
            assert!(store.revision(&name).unwrap() >= answer.revision);
            assert_eq!(counts(&answer), (1, 0, 0));
            answer.revision
        });
    }
    // While one commit hangs, the others gather behind it.
    tokio::time::sleep(Duration::from_millis(200)).await;
    store.release();
    assert_eq!(holding.await.unwrap().unwrap().revision, 2);
    let revisions: Vec<u64> = requests.join_all().await;
    let commits = store.commits();
    assert!(commits.len() < 30, "{} commits for 62 requests", commits.len());
    assert_eq!(commits.last().unwrap().revision, *revisions.iter().max().unwrap());
    for commit in &commits {
        let mut blocks: Vec<u64> = commit.blocks.iter().map(|b| b.morton()).collect();
        blocks.dedup();
        assert_eq!(blocks.len(), commit.blocks.len(), "each block once");
    }
    let robots: usize = commits.iter().map(|commit| commit.windows.len()).sum();
    assert_eq!(robots, 62, "each window in the commit that changed it");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_commit_holds_no_more_scans_than_the_limit() {
    let store = TestStore::new();
    let settings = ServiceSettings { max_scans_per_commit: 10, ..ServiceSettings::default() };
    let (service, name, holding) = held_in_a_commit(&store, settings).await;
    let waiting: Vec<_> = (0..12)
        .map(|_| insertion(&service, &name, vec![ring("", None, 0.0), ring("", None, 2.0), ring("", None, 4.0)]))
        .collect();
    let large = insertion(&service, &name, vec![ring("", None, 3.0); 15]);
    tokio::time::sleep(Duration::from_millis(200)).await;
    store.release();
    holding.await.unwrap().unwrap();
    for request in waiting {
        assert_eq!(request.await.unwrap().unwrap().applied, 3);
    }
    assert_eq!(large.await.unwrap().unwrap().applied, 15);
    // Three requests of three scans fit a commit; the large one is a commit of its own.
    assert!(store.commits().len() > 2 + 4, "{} commits", store.commits().len());
}

#[tokio::test(flavor = "multi_thread")]
async fn readers_see_one_revision_and_do_not_wait_for_a_commit() {
    let store = TestStore::new();
    let (service, name, holding) = held_in_a_commit(&store, ServiceSettings::default()).await;
    let before = leaves(&applied(&config(), &[ring("", None, 0.0)]));
    let after = leaves(&applied(&config(), &[ring("", None, 0.0), ring("", None, 1.0)]));
    let answered = tokio::time::timeout(Duration::from_secs(5), async {
        assert_eq!(service.map(&name).await.unwrap().revision, 1);
        assert_eq!(service.maps().await.unwrap()[0].revision, 1);
        assert_eq!(served(&service, &name).await, before);
        assert_eq!(service.tile(&name, 0, 0, 0).await.unwrap().revision, 1);
        assert_eq!(service.classes(&name, &[(0.0, 0.0)], None).await.unwrap().revision, 1);
        assert_eq!(service.version(&name).await.unwrap().revision, 1);
    });
    answered.await.unwrap();
    assert!(!holding.is_finished(), "not acknowledged while it is not durable");
    store.release();
    assert_eq!(holding.await.unwrap().unwrap().revision, 2);
    assert_eq!(served(&service, &name).await, after);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_failed_commit_leaves_no_trace_and_the_next_one_works() {
    let store = TestStore::new();
    let (service, name) = hall(&store, ServiceSettings::default()).await;
    service.insert(&name, vec![ring("amr-1", Some(0), 0.0)]).await.unwrap();
    let (map, drawn) = (service.map(&name).await.unwrap(), served(&service, &name).await);
    store.set_writes(Writes::FailOnce);
    let scans: Vec<ScanInput> = (0..5).map(|i| ring("amr-1", Some(i), 0.3 * i as f64)).collect();
    let error = service.insert(&name, scans.clone()).await.unwrap_err();
    assert_eq!(error.kind, ErrorKind::StoreFailed);
    assert!(!error.detail.contains("no space"), "what the disk says is for the log: {}", error.detail);
    assert_eq!(service.map(&name).await.unwrap(), map);
    assert_eq!(served(&service, &name).await, drawn);
    let again = service.insert(&name, scans.clone()).await.unwrap();
    assert_eq!((counts(&again), again.revision), ((4, 1, 0), 2));
    assert_eq!(served(&service, &name).await, leaves(&applied(&config(), &scans)));
}

#[tokio::test(flavor = "multi_thread")]
async fn a_store_that_stopped_refuses_writes_and_serves_reads() {
    let store = TestStore::new();
    let (service, name) = hall(&store, ServiceSettings::default()).await;
    service.insert(&name, vec![ring("amr-1", Some(0), 0.0)]).await.unwrap();
    let drawn = served(&service, &name).await;
    store.set_writes(Writes::FailStop);
    for sequence in 1..4 {
        let error = service.insert(&name, vec![ring("amr-1", Some(sequence), 1.0)]).await.unwrap_err();
        assert_eq!(error.kind, ErrorKind::StoreFailed);
        assert!(!service.is_ready());
    }
    assert_eq!(
        service.create_map(&super::service_support::map_name("yard"), config()).await.unwrap_err().kind,
        ErrorKind::StoreFailed
    );
    assert_eq!(service.delete_map(&name).await.unwrap_err().kind, ErrorKind::StoreFailed);
    // What could not be deleted is there and takes writes when the store does.
    assert_eq!(served(&service, &name).await, drawn);
    store.set_writes(Writes::Work);
    assert_eq!(counts(&service.insert(&name, vec![ring("amr-1", Some(1), 1.0)]).await.unwrap()), (1, 0, 0));
    assert!(service.is_ready());
}

#[tokio::test(flavor = "multi_thread")]
async fn a_panic_in_a_commit_is_one_request_s_failure() {
    let store = TestStore::new();
    let (service, name) = hall(&store, ServiceSettings::default()).await;
    store.set_writes(Writes::PanicOnce);
    let error = service.insert(&name, vec![ring("amr-1", Some(0), 0.0)]).await.unwrap_err();
    assert_eq!(error.kind, ErrorKind::Internal);
    let answer = service.insert(&name, vec![ring("amr-1", Some(0), 0.0)]).await.unwrap();
    assert_eq!((counts(&answer), answer.revision), ((1, 0, 0), 1));
}

#[tokio::test(flavor = "multi_thread")]
async fn a_full_queue_is_said_at_once() {
    let store = TestStore::new();
    let settings = ServiceSettings { queue_length: 3, ..ServiceSettings::default() };
    let (service, name, holding) = held_in_a_commit(&store, settings).await;
    let mut waiting = Vec::new();
    for i in 0..3 {
        waiting.push(insertion(&service, &name, vec![ring("amr-1", Some(i), 0.0)]));
    }
    tokio::time::sleep(Duration::from_millis(200)).await;
    let refused =
        tokio::time::timeout(Duration::from_secs(5), service.insert(&name, vec![ring("amr-1", Some(9), 0.0)]));
    assert_eq!(refused.await.unwrap().unwrap_err().kind, ErrorKind::Busy);
    store.release();
    holding.await.unwrap().unwrap();
    for request in waiting {
        assert_eq!(counts(&request.await.unwrap().unwrap()), (1, 0, 0));
    }
    // What was refused was not taken: the number is new still.
    assert_eq!(counts(&service.insert(&name, vec![ring("amr-1", Some(9), 0.0)]).await.unwrap()), (1, 0, 0));
}

#[tokio::test(flavor = "multi_thread")]
async fn a_duplicate_of_what_is_not_durable_yet_waits_for_it() {
    let store = TestStore::new();
    let (service, name, holding) = held_in_a_commit(&store, ServiceSettings::default()).await;
    // The client of the held scan lost patience and sends it again.
    holding.abort();
    let again = insertion(&service, &name, vec![ring("holder", Some(1), 1.0)]);
    tokio::time::sleep(Duration::from_millis(200)).await;
    assert!(!again.is_finished(), "a duplicate is acknowledged only when the scan is durable");
    store.release();
    let answer = again.await.unwrap().unwrap();
    assert_eq!((counts(&answer), answer.revision), ((0, 1, 0), 2));
}

#[tokio::test(flavor = "multi_thread")]
async fn draining_finishes_what_was_taken_and_takes_no_more() {
    let store = TestStore::new();
    let (service, name, holding) = held_in_a_commit(&store, ServiceSettings::default()).await;
    let waiting: Vec<_> = (0..5).map(|i| insertion(&service, &name, vec![ring("amr-1", Some(i), 0.0)])).collect();
    tokio::time::sleep(Duration::from_millis(200)).await;
    let draining = tokio::spawn({
        let service = service.clone();
        async move { service.drain().await }
    });
    until("not ready", || !service.is_ready()).await;
    for refused in [
        service.insert(&name, vec![ring("amr-1", Some(9), 0.0)]).await.map(|_| ()),
        service.create_map(&name, config()).await.map(|_| ()),
        service.delete_map(&name).await,
    ] {
        assert_eq!(refused.unwrap_err().kind, ErrorKind::ShuttingDown);
    }
    assert!(!draining.is_finished(), "waits for the commits");
    assert_eq!(service.map(&name).await.unwrap().revision, 1, "reads go on");
    store.release();
    draining.await.unwrap();
    let durable = store.revision(&name).unwrap();
    assert_eq!(holding.await.unwrap().unwrap().revision, 2);
    for request in waiting {
        let answer = request.await.unwrap().unwrap();
        assert!(answer.applied == 1 && answer.revision <= durable);
    }
    service.drain().await;
    let restarted = open(&store, ServiceSettings::default());
    assert_eq!(restarted.map(&name).await.unwrap().robots[0].applied, 5);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_client_that_leaves_holds_up_nobody() {
    let store = TestStore::new();
    let settings = ServiceSettings { queue_length: 4, ..ServiceSettings::default() };
    let (service, name, holding) = held_in_a_commit(&store, settings).await;
    for i in 0..3 {
        let leaving = insertion(&service, &name, vec![ring("leaver", Some(i), 0.0)]);
        tokio::time::sleep(Duration::from_millis(30)).await;
        leaving.abort();
    }
    store.release();
    holding.await.unwrap().unwrap();
    assert_eq!(counts(&service.insert(&name, vec![ring("amr-1", Some(0), 0.0)]).await.unwrap()), (1, 0, 0));
    service.drain().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn every_answer_is_of_one_revision_while_scans_come_in() {
    let store = TestStore::new();
    let (service, name) = hall(&store, ServiceSettings::default()).await;
    let scans: Vec<ScanInput> = (0..60).map(|i| ring("amr-1", Some(i), 0.1 * i as f64 - 3.0)).collect();
    // One scan a commit, so revision `n` is the tree of the first `n` scans.
    let expected: Arc<Vec<_>> = Arc::new((0..=60).map(|n| leaves(&applied(&config(), &scans[..n]))).collect());
    let mut readers = JoinSet::new();
    for _ in 0..3 {
        let (service, name, expected) = (service.clone(), name.clone(), Arc::clone(&expected));
        readers.spawn(async move {
            let mut last = 0;
            let mut seen = 0;
            while last < 60 {
                let answer = service.region(&name, &BoxQuery::default()).await.unwrap();
                assert!(answer.revision >= last, "revisions only grow");
                seen += usize::from(answer.revision != last);
                last = answer.revision;
                assert_eq!(answer.leaves, expected[last as usize]);
            }
            seen
        });
    }
    for scan in scans {
        service.insert(&name, vec![scan]).await.unwrap();
    }
    assert!(readers.join_all().await.iter().all(|seen| *seen > 1));
}

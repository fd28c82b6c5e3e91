//! Queries of a snapshot: what they answer is what the map answered when it was taken.

#![allow(clippy::unwrap_used, clippy::panic, reason = "tests")]

use super::service_support::{Keeping, config, map_name, ring, snapshot_name};
use ubbmap::mapping::Region;
use ubbmap::service::{
    BoxQuery, ClassesAnswer, ErrorKind, FreeAnswers, MapService, Raster, RegionAnswer, ServiceSettings,
};
use ubbmap::store::{MapName, SnapshotName};

/// The answers to one question of each kind.
#[derive(Debug, Clone, PartialEq)]
struct Answers {
    classes: ClassesAnswer,
    region: RegionAnswer,
    grid: Raster,
    tile: Raster,
    free: FreeAnswers,
}

async fn ask(service: &MapService, name: &MapName, snapshot: Option<&SnapshotName>) -> Answers {
    let view = || async { service.view(name, snapshot).await.unwrap() };
    let points: Vec<_> = (-20..20).map(|step| (0.2 * f64::from(step), 0.3)).collect();
    let regions = [Region::disc((0.0, 0.0), 0.5).unwrap(), Region::rectangle((-3.0, -1.0), (4.0, 1.0)).unwrap()];
    let area = BoxQuery { min_x: Some(-5.0), depth: Some(7), ..BoxQuery::default() };
    let mut region = view().await.region(&BoxQuery::default(), false).await.unwrap();
    // When blocks changed is not in a snapshot.
    region.last_change = None;
    Answers {
        classes: view().await.classes(&points, None).await.unwrap(),
        region,
        grid: view().await.grid(&area).await.unwrap(),
        tile: view().await.tile(1, 0, 1).await.unwrap(),
        free: view().await.guaranteed_free(&regions, 0).await.unwrap(),
    }
}

async fn insert(service: &MapService, name: &MapName, at: u64) {
    let answer = service.insert(name, vec![ring("a", Some(at), 0.4 * at as f64 - 2.0)]).await.unwrap();
    assert_eq!((answer.applied, answer.revision), (1, at + 1));
}

#[tokio::test(flavor = "multi_thread")]
async fn a_snapshot_answers_what_the_map_did_when_it_was_taken() {
    for keeping in Keeping::all() {
        // Room for all of them, for about one, and for none: the answers are the same.
        for room in [256 << 20, 30_000, 0] {
            let settings =
                ServiceSettings { cache_bytes: 2 * 5600, snapshot_cache_bytes: room, ..ServiceSettings::default() };
            let service = keeping.service(settings);
            let name = map_name(&format!("hall-{room}"));
            service.create_map(&name, config()).await.unwrap();
            let mut taken = Vec::new();
            for step in 0..6 {
                let snapshot = snapshot_name(&format!("s{step}"));
                service.take_snapshot(&name, &snapshot).await.unwrap();
                taken.push((snapshot, ask(&service, &name, None).await));
                insert(&service, &name, step).await;
                for (snapshot, then) in &taken {
                    assert_eq!(&ask(&service, &name, Some(snapshot)).await, then, "{} {snapshot}", keeping.what);
                }
            }
            let contents: Vec<_> = taken.iter().map(|(_, then)| &then.grid.classes).collect();
            assert!(contents.windows(2).all(|pair| pair[0] != pair[1]), "nothing happened");
            assert_eq!(taken[3].1.grid.revision, 3);
        }
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_name_that_is_given_anew_answers_what_it_names_now() {
    for keeping in Keeping::all() {
        let service = keeping.service(ServiceSettings::default());
        let (name, snapshot) = (map_name("hall"), snapshot_name("s"));
        service.create_map(&name, config()).await.unwrap();
        insert(&service, &name, 0).await;
        service.take_snapshot(&name, &snapshot).await.unwrap();
        let first = ask(&service, &name, Some(&snapshot)).await;
        insert(&service, &name, 1).await;
        let now = ask(&service, &name, None).await;
        service.delete_snapshot(&name, &snapshot).await.unwrap();
        let gone = service.view(&name, Some(&snapshot)).await.err().unwrap();
        assert_eq!((gone.kind, gone.field.as_deref()), (ErrorKind::SnapshotNotFound, Some("snapshot")));
        service.take_snapshot(&name, &snapshot).await.unwrap();
        assert_eq!(ask(&service, &name, Some(&snapshot)).await, now);

        // And a map of the same name with a snapshot of the same name, at the same revision.
        service.delete_map(&name).await.unwrap();
        service.create_map(&name, config()).await.unwrap();
        let answer = service.insert(&name, vec![ring("a", Some(0), 1.7)]).await.unwrap();
        assert_eq!(answer.revision, first.grid.revision);
        service.take_snapshot(&name, &snapshot).await.unwrap();
        let other = ask(&service, &name, Some(&snapshot)).await;
        assert_ne!(other.grid.classes, first.grid.classes);
        assert_eq!(other, ask(&service, &name, None).await);
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn many_who_ask_a_snapshot_at_once_are_answered_alike() {
    let keeping = Keeping::all().pop().unwrap();
    let service = keeping.service(ServiceSettings { snapshot_cache_bytes: 30_000, ..ServiceSettings::default() });
    let name = map_name("hall");
    service.create_map(&name, config()).await.unwrap();
    let mut taken = Vec::new();
    for step in 0..4 {
        insert(&service, &name, step).await;
        let snapshot = snapshot_name(&format!("s{step}"));
        service.take_snapshot(&name, &snapshot).await.unwrap();
        taken.push((snapshot, service.grid(&name, &BoxQuery::default()).await.unwrap()));
    }
    let mut asked = Vec::new();
    for at in 0..40 {
        let (service, name, (snapshot, then)) = (service.clone(), name.clone(), taken[at % 4].clone());
        asked.push(tokio::spawn(async move {
            let grid = service.view(&name, Some(&snapshot)).await.unwrap().grid(&BoxQuery::default()).await.unwrap();
            assert_eq!(grid, then);
        }));
    }
    for one in asked {
        one.await.unwrap();
    }
}

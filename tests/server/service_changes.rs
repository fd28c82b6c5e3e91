//! The changes feed: what it names is held to the store's commits, and a copy kept by it to the whole map.

#![allow(clippy::unwrap_used, clippy::panic, clippy::print_stderr, reason = "tests")]

use super::logs_real::data;
use super::service_support::{Keeping, TestStore, config, hall, map_name, open, ring, snapshot_name};
use std::collections::BTreeMap;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use ubbmap::logs::{LogPose, LogReader};
use ubbmap::sensor::ScanLimits;
use ubbmap::service::{
    BoxQuery, Changes, ChangesQuery, ErrorKind, ExportForm, MapService, Raster, RawPose, ScanInput, ServiceSettings,
    Watch,
};
use ubbmap::store::MapName;

/// A planner's copy of a box at a depth: all cells unknown, then what changes say.
struct Copy {
    raster: Raster,
    revision: u64,
}

impl Copy {
    async fn of(service: &MapService, name: &MapName, area: &BoxQuery) -> Self {
        let raster = service.grid(name, area).await.unwrap();
        Self { revision: raster.revision, raster }
    }

    fn take(&mut self, changes: &Changes) {
        assert!(!changes.everything);
        assert!(changes.since <= self.revision && self.revision <= changes.revision, "a gap");
        for block in &changes.blocks {
            assert!(block.revision > changes.since && block.revision <= changes.revision);
            let side = 1_usize << (changes.depth - block.node.depth);
            assert_eq!(block.classes.len(), side * side);
            for (at, class) in block.classes.iter().enumerate() {
                let x = (block.node.x as usize * side + at % side).wrapping_sub(self.raster.x as usize);
                let y = (block.node.y as usize * side + at / side).wrapping_sub(self.raster.y as usize);
                let (width, height) = (self.raster.width as usize, self.raster.height as usize);
                if x < width && y < height {
                    self.raster.classes[y * width + x] = *class;
                }
            }
        }
        self.revision = changes.revision;
        self.raster.revision = changes.revision;
    }
}

fn contents(area: BoxQuery) -> ChangesQuery {
    ChangesQuery { area, contents: true, robots: false }
}

async fn insert(service: &MapService, name: &MapName, scan: ScanInput) -> u64 {
    let answer = service.insert(name, vec![scan]).await.unwrap();
    assert_eq!((answer.applied, answer.rejected.len()), (1, 0), "{answer:?}");
    answer.revision
}

#[tokio::test(flavor = "multi_thread")]
async fn changes_name_the_blocks_that_the_store_was_given_since() {
    let store = TestStore::new();
    let (service, name) = hall(&store, ServiceSettings::default()).await;
    for step in 0..12 {
        insert(&service, &name, ring("a", Some(step), 0.7 * step as f64 - 4.0)).await;
    }
    let commits = store.commits();
    for since in 0..=12 {
        let changes = service.changes(&name, since, &ChangesQuery::default()).await.unwrap();
        let mut expected = BTreeMap::new();
        for commit in commits.iter().filter(|commit| commit.revision > since) {
            expected.extend(commit.blocks.iter().map(|block| (block.morton(), (block.x, block.y, commit.revision))));
        }
        let named: Vec<_> = changes.blocks.iter().map(|b| (b.node.x, b.node.y, b.revision)).collect();
        assert_eq!(named, expected.into_values().collect::<Vec<_>>(), "since {since}");
        assert_eq!((changes.since, changes.revision, changes.everything), (since, 12, false));
        assert!(changes.blocks.iter().all(|block| block.node.depth == 2 && block.classes.is_empty()));
    }
    // Of a revision that is yet to come nothing can be told.
    assert!(service.changes(&name, 13, &ChangesQuery::default()).await.unwrap().everything);
    let missing = service.changes(&map_name("nowhere"), 0, &ChangesQuery::default()).await.unwrap_err();
    assert_eq!(missing.kind, ErrorKind::MapNotFound);
    let area = BoxQuery { depth: Some(9), ..BoxQuery::default() };
    let deep = ChangesQuery { area, ..ChangesQuery::default() };
    assert_eq!(service.changes(&name, 0, &deep).await.unwrap_err().kind, ErrorKind::DepthOutOfRange);
}

#[tokio::test(flavor = "multi_thread")]
async fn what_the_log_has_forgotten_is_told_all_the_same_also_after_a_restart() {
    let store = TestStore::new();
    // Four commits or so.
    let settings = ServiceSettings { max_changes: 40, ..ServiceSettings::default() };
    let (service, name) = hall(&store, settings.clone()).await;
    for step in 0..20 {
        insert(&service, &name, ring("a", Some(step), 0.3 * step as f64 - 3.0)).await;
    }
    service.take_snapshot(&name, &snapshot_name("then")).await.unwrap();
    insert(&service, &name, ring("b", Some(0), 5.0)).await;
    service.restore_snapshot(&name, &snapshot_name("then")).await.unwrap();
    let commits = store.commits();
    let restarted = open(&store, settings);
    for since in 0..=22 {
        let mut expected = BTreeMap::new();
        for commit in commits.iter().filter(|commit| commit.revision > since) {
            expected.extend(commit.blocks.iter().map(|block| (block.morton(), (block.x, block.y, commit.revision))));
        }
        let expected: Vec<_> = expected.into_values().collect();
        let mut told = Vec::new();
        for service in [&service, &restarted] {
            let changes = service.changes(&name, since, &contents(BoxQuery::default())).await.unwrap();
            let named: Vec<_> = changes.blocks.iter().map(|b| (b.node.x, b.node.y, b.revision)).collect();
            assert_eq!((named, changes.everything), (expected.clone(), false), "since {since}");
            assert!(changes.blocks.iter().all(|block| block.changed.is_some()));
            told.push(changes);
        }
        assert_eq!(told[0], told[1], "the same times and contents, since {since}");
    }
    // Of a revision that is yet to come nothing can be told.
    assert!(restarted.changes(&name, 23, &ChangesQuery::default()).await.unwrap().everything);
    // What a watch missed while the server was away.
    let mut watch = restarted.watch(&name, Some(3), ChangesQuery::default()).await.unwrap();
    let missed = next(&mut watch).await;
    assert_eq!((missed.since, missed.revision, missed.everything), (3, 22, false));
}

#[tokio::test(flavor = "multi_thread")]
async fn blocks_tell_the_revision_and_the_time_of_their_last_change() {
    let now = || std::time::SystemTime::now().duration_since(std::time::UNIX_EPOCH).unwrap().as_secs_f64();
    for keeping in Keeping::all() {
        let service = keeping.service(ServiceSettings::default());
        let name = map_name("hall");
        service.create_map(&name, config()).await.unwrap();
        let whole = BoxQuery::default();
        let empty = service.view(&name, None).await.unwrap().region(&whole, true).await.unwrap();
        assert_eq!((empty.last_change, empty.blocks.len()), (None, 0));
        assert_eq!(service.map(&name).await.unwrap().last_change, None);
        let mut times = vec![now()];
        for step in 0..5 {
            insert(&service, &name, ring("a", Some(step), 2.0 * step as f64 - 4.0)).await;
            times.push(now());
        }
        for (at, service) in [&service, &keeping.service(ServiceSettings::default())].into_iter().enumerate() {
            for depth in [8, 3, 2, 1, 0] {
                let area = BoxQuery { depth: Some(depth), ..whole };
                let region = service.view(&name, None).await.unwrap().region(&area, true).await.unwrap();
                let query = ChangesQuery { area, ..ChangesQuery::default() };
                let changes = service.changes(&name, 0, &query).await.unwrap();
                assert_eq!(region.blocks, changes.blocks, "{} {at} at depth {depth}", keeping.what);
                assert!(!region.blocks.is_empty());
                for block in &region.blocks {
                    let (time, revision) = (block.changed.unwrap(), block.revision as usize);
                    assert!(times[revision - 1] <= time && time <= times[revision], "{block:?}");
                }
                let newest = region.blocks.iter().max_by_key(|block| block.revision).unwrap().changed;
                assert_eq!((region.last_change, service.map(&name).await.unwrap().last_change), (newest, newest));
                let plain = service.region(&name, &area).await.unwrap();
                assert_eq!((plain.last_change, plain.blocks.len()), (newest, 0));
            }
            // The first scan alone reaches so far to the left; no scan into the corner.
            let left = BoxQuery { max_x: Some(-6.5), min_y: Some(-1.0), max_y: Some(1.0), ..whole };
            let region = service.view(&name, None).await.unwrap().region(&left, true).await.unwrap();
            assert!(region.last_change.unwrap() <= times[2], "{region:?}");
            let corner = BoxQuery { min_x: Some(9.0), min_y: Some(9.0), ..whole };
            let region = service.view(&name, None).await.unwrap().region(&corner, true).await.unwrap();
            assert_eq!((region.last_change, region.blocks.len()), (None, 0));
        }
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_copy_kept_by_changes_is_the_map_at_every_depth_and_in_every_box() {
    let store = TestStore::new();
    let (service, name) = hall(&store, ServiceSettings::default()).await;
    let part = BoxQuery { min_x: Some(-3.05), min_y: Some(-12.0), max_x: Some(2.0), max_y: Some(1.23), depth: None };
    let mut copies = Vec::new();
    for depth in 0..=8 {
        for area in [BoxQuery { depth: Some(depth), ..BoxQuery::default() }, BoxQuery { depth: Some(depth), ..part }] {
            let copy = Copy::of(&service, &name, &area).await;
            let watch = service.watch(&name, Some(copy.revision), contents(area)).await.unwrap();
            copies.push((area, copy, watch));
        }
    }
    for step in 0..30 {
        insert(&service, &name, ring("a", Some(step), 0.3 * step as f64 - 4.0)).await;
        // Now and then the map goes back by some scans, or to the beginning.
        match step {
            4 | 20 => drop(service.take_snapshot(&name, &snapshot_name(&format!("s{step}"))).await.unwrap()),
            9 | 13 | 25 => drop(service.restore_snapshot(&name, &snapshot_name("s4")).await.unwrap()),
            26 => drop(service.restore_snapshot(&name, &snapshot_name("s20")).await.unwrap()),
            _ => {}
        }
        for (at, (area, copy, watch)) in copies.iter_mut().enumerate() {
            // Some look seldom: they find several commits put together.
            if step % (1 + at as u64 % 4) == 0 || step == 29 {
                copy.take(&next(watch).await);
                assert_eq!(copy.raster, service.grid(&name, area).await.unwrap(), "{area:?} at {step}");
            }
        }
    }
    // A map made of a file goes on in the same way from the revision of the file.
    let file = service.export(&name, None, ExportForm::Ubbmap).await.unwrap();
    let twin = map_name("twin");
    service.import(&twin, file.bytes).await.unwrap();
    let area = BoxQuery { depth: Some(6), ..BoxQuery::default() };
    let mut copy = Copy::of(&service, &twin, &area).await;
    assert_eq!(copy.raster.classes, service.grid(&name, &area).await.unwrap().classes);
    let mut watch = service.watch(&twin, Some(file.revision), contents(area)).await.unwrap();
    for step in 40..50 {
        insert(&service, &twin, ring("a", Some(step), 0.7 * step as f64 - 32.0)).await;
        copy.take(&next(&mut watch).await);
        assert_eq!(copy.raster, service.grid(&twin, &area).await.unwrap(), "the twin at {step}");
    }
}

async fn next(watch: &mut Watch) -> Changes {
    tokio::time::timeout(std::time::Duration::from_secs(20), watch.next()).await.unwrap().unwrap()
}

#[tokio::test(flavor = "multi_thread")]
async fn a_box_in_which_nothing_changes_is_quiet() {
    let store = TestStore::new();
    let (service, name) = hall(&store, ServiceSettings::default()).await;
    // The scans below reach 3 m about the middle; this corner lies beyond.
    let corner = BoxQuery { min_x: Some(9.0), min_y: Some(9.0), ..BoxQuery::default() };
    let mut watch = service.watch(&name, None, ChangesQuery { area: corner, ..ChangesQuery::default() }).await.unwrap();
    let first = next(&mut watch).await;
    assert_eq!((first.since, first.revision, first.blocks.len()), (0, 0, 0));
    for step in 0..255 {
        insert(&service, &name, ring("a", Some(step), 0.0)).await;
    }
    let quiet = tokio::time::timeout(std::time::Duration::from_millis(300), watch.next()).await;
    assert!(quiet.is_err(), "{quiet:?}");
    // Now and then it is told where the map stands, so that it can resume there.
    insert(&service, &name, ring("a", Some(255), 0.0)).await;
    let told = next(&mut watch).await;
    assert_eq!((told.since, told.revision, told.blocks.len(), told.everything), (0, 256, 0, false));
}

#[tokio::test(flavor = "multi_thread")]
async fn a_watch_that_nobody_reads_holds_up_nobody_and_is_told_what_it_missed() {
    let store = TestStore::new();
    let settings = ServiceSettings { max_changes: 60, ..ServiceSettings::default() };
    let (service, name) = hall(&store, settings).await;
    let mut slow = service.watch(&name, Some(0), ChangesQuery::default()).await.unwrap();
    assert_eq!(next(&mut slow).await.revision, 0);
    let place = |step: u64| 0.1 * step as f64 - 3.0;
    for step in 0..10 {
        insert(&service, &name, ring("a", Some(step), place(step))).await;
    }
    let together = next(&mut slow).await;
    assert_eq!((together.since, together.revision, together.everything), (0, 10, false));
    for step in 10..60 {
        insert(&service, &name, ring("a", Some(step), place(step))).await;
    }
    // The log has forgotten most of it.
    let missed = next(&mut slow).await;
    assert_eq!((missed.since, missed.revision, missed.everything), (10, 60, false));
    assert_eq!(missed.blocks, service.changes(&name, 10, &ChangesQuery::default()).await.unwrap().blocks);
    insert(&service, &name, ring("a", Some(60), place(60))).await;
    let after = next(&mut slow).await;
    assert_eq!((after.since, after.revision, after.everything), (60, 61, false));
}

#[tokio::test(flavor = "multi_thread")]
async fn a_watch_ends_with_its_map() {
    let store = TestStore::new();
    let (service, name) = hall(&store, ServiceSettings::default()).await;
    let mut watch = service.watch(&name, None, ChangesQuery::default()).await.unwrap();
    next(&mut watch).await;
    let ended = tokio::spawn(async move { watch.next().await });
    service.delete_map(&name).await.unwrap();
    assert_eq!(ended.await.unwrap().unwrap_err().kind, ErrorKind::MapNotFound);
    service.create_map(&name, config()).await.unwrap();
    assert!(service.changes(&name, 5, &ChangesQuery::default()).await.unwrap().everything);
}

/// The scans of a recorded log, numbered.
fn recorded(scans: usize) -> Option<Vec<ScanInput>> {
    let log = data()?.join("intel/intel-corrected.log.gz");
    let reader = LogReader::open(&log, ScanLimits::default()).unwrap();
    let input = |(index, scan): (usize, ubbmap::logs::LogScan)| {
        let LogPose::Point { x, y, theta } = scan.pose else { panic!("a pose without bounds") };
        ScanInput {
            robot: "intel".to_owned(),
            sequence: Some(index as u64),
            stamp: 0.0,
            sensor: String::new(),
            pose: Some(RawPose { x: (x, x), y: (y, y), theta: (theta, theta) }),
            angles: scan.angles,
            ranges: scan.ranges,
            footprint_radius: 0.0,
            sweep_rotation: 0.0,
            sweep_translation: 0.0,
        }
    };
    Some(reader.map(Result::unwrap).take(scans).enumerate().map(input).collect())
}

#[tokio::test(flavor = "multi_thread")]
async fn over_a_whole_replay_a_copy_is_after_every_message_the_map_of_its_revision() {
    let Some(scans) = recorded(usize::MAX) else { return };
    let store = TestStore::new();
    let service = open(&store, ServiceSettings::default());
    let name = map_name("intel");
    let config = super::service_support::config_of(0.1, 10, 10, ubbmap::mapping::EvidenceRule::Guaranteed);
    service.create_map(&name, config).await.unwrap();
    let areas = [
        BoxQuery { depth: Some(8), ..BoxQuery::default() },
        BoxQuery { min_x: Some(-10.0), max_x: Some(5.0), min_y: Some(-8.0), max_y: Some(9.0), depth: Some(10) },
    ];
    let done = Arc::new(AtomicBool::new(false));
    let mut watchers = Vec::new();
    for (at, area) in areas.into_iter().enumerate() {
        let (service, name, done) = (service.clone(), name.clone(), Arc::clone(&done));
        let mut copy = Copy::of(&service, &name, &area).await;
        let mut watch = service.watch(&name, Some(0), contents(area)).await.unwrap();
        watchers.push(tokio::spawn(async move {
            let mut states = BTreeMap::new();
            while !done.load(Ordering::SeqCst) || copy.revision < 800 {
                match tokio::time::timeout(std::time::Duration::from_millis(200), watch.next()).await {
                    Ok(changes) => copy.take(&changes.unwrap()),
                    Err(_) => continue,
                }
                states.insert(copy.revision, copy.raster.classes.clone());
                // One reads as fast as it can, one is slow.
                tokio::time::sleep(std::time::Duration::from_millis(at as u64 * 5)).await;
            }
            states
        }));
    }
    // The only writer: what the map is at each revision is what is read behind it.
    let mut full: Vec<BTreeMap<u64, Vec<u8>>> = vec![BTreeMap::new(); areas.len()];
    let total = scans.len() as u64;
    for (at, area) in areas.iter().enumerate() {
        full[at].insert(0, service.grid(&name, area).await.unwrap().classes);
    }
    for scan in scans {
        let revision = insert(&service, &name, scan).await;
        for (at, area) in areas.iter().enumerate() {
            let raster = service.grid(&name, area).await.unwrap();
            assert_eq!(raster.revision, revision);
            full[at].insert(revision, raster.classes);
        }
    }
    done.store(true, Ordering::SeqCst);
    for (watcher, full) in watchers.into_iter().zip(&full) {
        let states = watcher.await.unwrap();
        assert!(states.len() > 5, "only {} messages", states.len());
        for (revision, classes) in &states {
            assert!(full[revision] == *classes, "the copy of revision {revision} differs");
        }
        eprintln!("{} messages over {total} revisions, each the map of its revision", states.len());
    }
}

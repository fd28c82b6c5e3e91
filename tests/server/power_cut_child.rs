//! The process whose files are cut off: a service at work on a store, which tells what it has acknowledged.
//!
//! Each line goes to the file `acks` by one call of its own, after the acknowledgement, so that the recording has it at
//! the place where a client could have read it.

use crate::crash_support::{Bulk, Course, courses, find, named};
use std::fs::File;
use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};
use tokio::task::JoinSet;
use ubbmap::service::{ErrorKind, MapService, ScanInput, ServiceSettings};
use ubbmap::store::{MapName, MapStore, SledOptions, SledStore, SnapshotName, StoreError, Syncer};

/// Robots, each with a map of its own.
pub const ROBOTS: usize = 4;

/// Requests of a robot, and commits of the large map, in one life of the process.
const QUOTA: (u64, u64) = (50, 8);

/// Maps made beside, half of which are deleted, in one life.
const EXTRA: u64 = 8;

/// After so many requests of a robot its map is kept as a snapshot.
pub const SNAPSHOT_EVERY: u64 = 6;

/// Lives of the process on one directory.
pub const LIVES: u64 = 2;

/// What the robots of a series of lives send.
pub fn courses_of(seed: u64) -> Vec<Course> {
    courses(seed, ROBOTS, usize::try_from(LIVES * QUOTA.0).unwrap() + 5)
}

/// What a child is to do.
#[derive(Debug, Clone)]
pub struct Task {
    /// Has the data directory `data` and the file `acks`.
    pub root: PathBuf,
    pub seed: u64,
    pub life: u64,
    /// False: the sync of the data file is left out.
    pub syncs: bool,
}

const VARIABLE: &str = "UBBMAP_TEST_POWER_CUT";

impl Task {
    pub fn to_variable(&self) -> (&'static str, String) {
        (VARIABLE, format!("{} {} {} {}", self.seed, self.life, self.syncs, self.root.display()))
    }

    fn from_variable() -> Option<Self> {
        let text = std::env::var(VARIABLE).ok()?;
        let parts: Vec<&str> = text.splitn(4, ' ').collect();
        let number = |text: &str| text.parse().unwrap();
        Some(Self { root: parts[3].into(), seed: number(parts[0]), life: number(parts[1]), syncs: parts[2] == "true" })
    }
}

/// A sync that does nothing and says that it did.
struct NoSync;

impl Syncer for NoSync {
    fn sync(&self) -> io::Result<()> {
        Ok(())
    }
}

#[derive(Clone)]
struct Acks(Arc<Mutex<File>>);

impl Acks {
    fn tell(&self, line: &str) {
        self.0.lock().unwrap().write_all(format!("{line}\n").as_bytes()).unwrap();
    }
}

#[test]
#[ignore = "run by the tests of power cuts, in a process that is watched"]
fn power_cut_child() {
    let Some(task) = Task::from_variable() else { return };
    let acks = Acks(Arc::new(Mutex::new(File::create(task.root.join("acks")).unwrap())));
    let courses = courses_of(task.seed);
    // The second half of a life begins with a store that was closed in order.
    for half in 0..2 {
        let store = Arc::new(open(&task.root.join("data"), task.syncs));
        acks.tell("open");
        let runtime = tokio::runtime::Builder::new_multi_thread().worker_threads(2).enable_all().build().unwrap();
        let bulk = std::thread::spawn({
            let (store, acks) = (Arc::clone(&store), acks.clone());
            move || grow_bulk(&store, &acks)
        });
        let service = MapService::open(store, ServiceSettings::default()).unwrap();
        runtime.block_on(work(&service, &courses, &format!("{}-{half}", task.life), &acks));
        bulk.join().unwrap();
    }
}

fn open(directory: &Path, syncs: bool) -> SledStore {
    let begun = Instant::now();
    loop {
        let wrap = move |syncer| if syncs { syncer } else { Box::new(NoSync) as Box<dyn Syncer> };
        match SledStore::open_with(directory, SledOptions::default(), wrap) {
            // The writers of the first half let go of their store a little after its end.
            Err(StoreError::Locked { .. }) if begun.elapsed().as_secs() < 20 => {
                std::thread::sleep(Duration::from_millis(5));
            }
            opened => return opened.unwrap(),
        }
    }
}

async fn work(service: &MapService, courses: &[Course], life: &str, acks: &Acks) {
    let mut robots = JoinSet::new();
    for (number, course) in courses.iter().cloned().enumerate() {
        let (service, acks) = (service.clone(), acks.clone());
        robots.spawn(
            async move { drive(&service, &named(&format!("hall-{number}")), &course, QUOTA.0 / 2, &acks).await },
        );
    }
    for number in 0..EXTRA / 2 {
        let name = named(&format!("extra-{life}-{number}"));
        drive(service, &name, &courses[0], 2, acks).await;
        if number % 2 == 0 {
            acks.tell(&format!("deleting {name}"));
            service.delete_map(&name).await.unwrap();
            acks.tell(&format!("deleted {name}"));
        }
    }
    robots.join_all().await;
    service.drain().await;
}

/// Sends the next requests of a course to a map, which is made where there is none.
async fn drive(service: &MapService, name: &MapName, course: &Course, count: u64, acks: &Acks) {
    service.create_map(name, course.config.clone()).await.unwrap();
    acks.tell(&format!("created {name}"));
    let first = service.map(name).await.unwrap().revision;
    for revision in first..(first + count).min(course.last()) {
        send(service, name, &course.requests[revision as usize], revision + 1).await;
        acks.tell(&format!("applied {name} {}", revision + 1));
        if (revision + 1).is_multiple_of(SNAPSHOT_EVERY) {
            let snapshot = format!("r{}", revision + 1);
            let taken = service.take_snapshot(name, &SnapshotName::new(&snapshot).unwrap()).await;
            // One whose answer was cut off before is there.
            assert!(taken.map_or_else(|e| e.kind == ErrorKind::SnapshotExists, |taken| taken.revision == revision + 1));
            acks.tell(&format!("kept {name} {}", revision + 1));
        }
    }
}

/// Sends one request, which must lead to this revision.
pub async fn send(service: &MapService, name: &MapName, request: &[ScanInput], revision: u64) {
    let answer = service.insert(name, request.to_vec()).await.unwrap();
    assert_eq!((answer.revision, answer.rejected.len()), (revision, 0), "{answer:?}");
}

fn grow_bulk(store: &SledStore, acks: &Acks) {
    let bulk = Bulk::new();
    let (id, first) = find(store, "bulk").unwrap_or_else(|| {
        let id = store.create(&named("bulk"), &bulk.config, 0.0).unwrap();
        acks.tell("created bulk");
        (id, 0)
    });
    for revision in first + 1..=first + QUOTA.1 / 2 {
        store.commit(id, &bulk.commit(revision)).unwrap();
        acks.tell(&format!("applied bulk {revision}"));
    }
}

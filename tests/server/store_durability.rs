//! What is acknowledged is on the disk, what fails stops the store, and a store is one process's.

use crate::store_support::{Model, assert_same, config, fill, name};
use std::fs;
use std::io;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex};
use std::time::Duration;
use ubbmap::quadtree::{BlockAddress, BlockView};
use ubbmap::store::{Commit, LoadedMap, MapId, MapStore, SledOptions, SledStore, StoreError, Syncer};

fn open(directory: &Path) -> Result<SledStore, StoreError> {
    SledStore::open(directory, SledOptions::default())
}

fn copy_store(from: &Path, to: &Path) {
    fs::create_dir_all(to).unwrap();
    for entry in fs::read_dir(from).unwrap().map(Result::unwrap) {
        let target = to.join(entry.file_name());
        if entry.file_type().unwrap().is_dir() {
            copy_store(&entry.path(), &target);
        } else {
            fs::copy(entry.path(), target).unwrap();
        }
    }
}

/// A sync that does what it is told besides.
struct Probe {
    inner: Box<dyn Syncer>,
    control: Arc<Control>,
}

#[derive(Default)]
struct Control {
    syncs: AtomicU64,
    fail: AtomicBool,
    delay: Mutex<Duration>,
    /// At every sync the store is copied from the first to a directory in the second: what a power cut right after it
    /// must leave, for the files are read before the sync has a chance to write anything.
    copies: Mutex<Option<(PathBuf, PathBuf)>>,
}

impl Syncer for Probe {
    fn sync(&self) -> io::Result<()> {
        let count = self.control.syncs.fetch_add(1, Ordering::SeqCst) + 1;
        if let Some((from, to)) = &*self.control.copies.lock().unwrap() {
            copy_store(&from.join("sled"), &to.join(count.to_string()).join("sled"));
        }
        std::thread::sleep(*self.control.delay.lock().unwrap());
        if self.control.fail.load(Ordering::SeqCst) {
            return Err(io::Error::other("the disk is gone"));
        }
        self.inner.sync()
    }
}

fn probed(directory: &Path) -> (SledStore, Arc<Control>) {
    let control = Arc::<Control>::default();
    let of_probe = Arc::clone(&control);
    let wrap = move |inner| Box::new(Probe { inner, control: Arc::clone(&of_probe) }) as Box<dyn Syncer>;
    (SledStore::open_with(directory, SledOptions::default(), wrap).unwrap(), control)
}

#[test]
fn every_change_is_flushed_and_then_synced_before_it_is_acknowledged() {
    let (directory, copies) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    let (store, control) = probed(directory.path());
    *control.copies.lock().unwrap() = Some((directory.path().into(), copies.path().into()));
    // What the copy of the last sync holds.
    let synced = || {
        let last = control.syncs.load(Ordering::SeqCst).to_string();
        open(&copies.path().join(last)).unwrap()
    };
    let mut before = 0;
    let mut went_on = |what: &str| {
        let now = control.syncs.load(Ordering::SeqCst);
        assert!(now > before, "{what} was not synced");
        before = now;
    };
    let (id, mut model) = fill(&store, "plant", config(11, 10, 4), 3, 0);
    went_on("a creation");
    assert_same(&synced().load(id).unwrap(), &model.loaded());
    for _ in 0..12 {
        store.commit(id, &model.step(5)).unwrap();
        went_on("a commit");
        assert_same(&synced().load(id).unwrap(), &model.loaded());
    }
    store.update_config(id, &config(11, 10, 1)).unwrap();
    went_on("a configuration");
    assert_eq!(synced().list().unwrap()[0].config, config(11, 10, 1));
    store.delete(id).unwrap();
    went_on("a deletion");
    assert!(synced().list().unwrap().is_empty());
    // Larger pages would go to files that sled does not sync.
    assert_eq!(fs::read_dir(directory.path().join("sled/blobs")).unwrap().count(), 0);
}

#[test]
fn the_largest_records_stay_out_of_unsynced_files() {
    let directory = tempfile::tempdir().unwrap();
    let store = open(directory.path()).unwrap();
    let id = store.create(&name("plant"), &config(12, 255, 64), 0.0).unwrap();
    let mut leaves = Box::new([1; 64 * 64]);
    for (index, class) in leaves.iter_mut().enumerate() {
        *class = (index % 255) as u8 + 1;
    }
    let full = BlockView::Mixed(Arc::new(ubbmap::quadtree::Block::from_leaves(leaves)));
    for revision in 1..=8 {
        let blocks = (0..400).map(|n| (BlockAddress { x: n % 20, y: n / 20 }, full.clone())).collect();
        store.commit(id, &Commit { revision, changed: 0.0, blocks, windows: Vec::new() }).unwrap();
    }
    assert_eq!(fs::read_dir(directory.path().join("sled/blobs")).unwrap().count(), 0);
    drop(store);
    let store = open(directory.path()).unwrap();
    assert_eq!(fs::read_dir(directory.path().join("sled/blobs")).unwrap().count(), 0);
    let tree = store.load(id).unwrap().tree;
    assert!((0..400).all(|n| tree.block(BlockAddress { x: n % 20, y: n / 20 }) == full));
}

#[test]
fn a_power_cut_at_any_sync_of_a_deletion_leaves_the_whole_map_or_none() {
    let (directory, copies) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    let (store, control) = probed(directory.path());
    let (kept, of_kept) = fill(&store, "kept", config(10, 10, 1), 8, 5);
    let id = store.create(&name("plant"), &config(13, 10, 3), 0.0).unwrap();
    // More records than are removed in one batch.
    let blocks: Vec<_> = (0..2500).map(|n| (BlockAddress { x: n % 60, y: n / 60 }, BlockView::Uniform(1))).collect();
    store.commit(id, &Commit { revision: 1, changed: 0.0, blocks, windows: Vec::new() }).unwrap();
    let whole = store.load(id).unwrap();
    let start = control.syncs.load(Ordering::SeqCst);
    *control.copies.lock().unwrap() = Some((directory.path().into(), copies.path().into()));
    store.commit(id, &Commit { revision: 2, changed: 0.0, blocks: Vec::new(), windows: Vec::new() }).unwrap();
    store.delete(id).unwrap();
    let end = control.syncs.load(Ordering::SeqCst);
    assert!(end - start >= 4, "{} syncs", end - start);
    let mut seen = Vec::new();
    for sync in start + 1..=end {
        let store = open(&copies.path().join(sync.to_string())).unwrap();
        let names: Vec<_> = store.list().unwrap().iter().map(|map| map.name.to_string()).collect();
        if names.contains(&"plant".to_owned()) {
            assert_same(&store.load(id).unwrap(), &LoadedMap { revision: 2, ..whole.clone() });
        } else {
            assert!(matches!(store.load(id), Err(StoreError::NoMap(_))));
            let records = store.verify().unwrap().records;
            // The header, the counter and the other map: nothing of the deleted one.
            assert!(records < 60, "{records} records are left");
        }
        assert_same(&store.load(kept).unwrap(), &of_kept.loaded());
        assert_eq!(store.verify().unwrap().problems, Vec::<String>::new());
        seen.push(names.len());
    }
    assert!(seen.starts_with(&[2]) && seen.ends_with(&[1]), "{seen:?}");
}

#[test]
fn after_a_failed_sync_writes_are_refused_and_reads_show_what_was_durable() {
    let directory = tempfile::tempdir().unwrap();
    let (store, control) = probed(directory.path());
    let (id, mut model) = fill(&store, "plant", config(10, 10, 1), 3, 6);
    let (other, of_other) = fill(&store, "other", config(10, 10, 1), 4, 2);
    let durable = model.loaded();
    control.fail.store(true, Ordering::SeqCst);
    let error = store.commit(id, &model.step(5)).unwrap_err();
    assert!(
        matches!(&error, StoreError::FailStop(why) if why.contains("the disk is gone") && why.contains("sled/db")),
        "{error}"
    );
    // The disk is back, but what it has of that commit is not known.
    control.fail.store(false, Ordering::SeqCst);
    let syncs = control.syncs.load(Ordering::SeqCst);
    let later = Commit { revision: model.revision + 1, changed: 0.0, blocks: Vec::new(), windows: Vec::new() };
    assert!(matches!(store.commit(id, &later), Err(StoreError::FailStop(_))));
    assert!(matches!(store.commit(other, &later), Err(StoreError::FailStop(_))));
    assert!(matches!(store.create(&name("new"), &config(8, 10, 1), 0.0), Err(StoreError::FailStop(_))));
    assert!(matches!(store.delete(id), Err(StoreError::FailStop(_))));
    assert!(matches!(store.update_config(id, &config(10, 10, 1)), Err(StoreError::FailStop(_))));
    assert!(store.failure().is_some());
    assert_eq!(control.syncs.load(Ordering::SeqCst), syncs, "nothing is synced after a failure");
    assert_same(&store.load(id).unwrap(), &durable);
    assert_same(&store.load(other).unwrap(), &of_other.loaded());
    assert_eq!(store.list().unwrap()[1].revision, durable.revision);
    drop(store);
    // Opened again it has that commit, or does not.
    let store = open(directory.path()).unwrap();
    let found = store.load(id).unwrap();
    assert_same(&found, &if found.revision == durable.revision { durable } else { model.loaded() });
}

#[test]
fn a_creation_or_deletion_that_fails_is_not_seen() {
    for deletion in [false, true] {
        let directory = tempfile::tempdir().unwrap();
        let (store, control) = probed(directory.path());
        let (id, model) = fill(&store, "plant", config(10, 10, 1), 3, 6);
        control.fail.store(true, Ordering::SeqCst);
        if deletion {
            assert!(matches!(store.delete(id), Err(StoreError::FailStop(_))));
        } else {
            let created = store.create(&name("new"), &config(8, 10, 1), 0.0);
            assert!(matches!(created, Err(StoreError::FailStop(_))));
        }
        assert_eq!(store.list().unwrap().iter().map(|map| map.id).collect::<Vec<_>>(), [id]);
        assert_same(&store.load(id).unwrap(), &model.loaded());
    }
}

#[test]
fn commits_that_wait_together_share_syncs() {
    let directory = tempfile::tempdir().unwrap();
    let (store, control) = probed(directory.path());
    let mut maps: Vec<(MapId, Model)> =
        (0..8).map(|n| fill(&store, &format!("m{n}"), config(9, 10, 1), n, 0)).collect();
    *control.delay.lock().unwrap() = Duration::from_millis(10);
    let start = control.syncs.load(Ordering::SeqCst);
    std::thread::scope(|scope| {
        for (id, model) in &mut maps {
            scope.spawn(|| {
                for _ in 0..10 {
                    store.commit(*id, &model.step(3)).unwrap();
                }
            });
        }
    });
    let syncs = control.syncs.load(Ordering::SeqCst) - start;
    assert!((10..40).contains(&syncs), "{syncs} syncs for 80 commits of 8 maps");
    for (id, model) in &maps {
        assert_same(&store.load(*id).unwrap(), &model.loaded());
    }
}

#[test]
fn a_store_is_open_once() {
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("made/on/the/way");
    let store = open(&path).unwrap();
    match open(&path) {
        Err(StoreError::Locked { directory }) => assert_eq!(directory, path.display().to_string()),
        other => panic!("{other:?}"),
    }
    drop(store);
    open(&path).unwrap();
}

/// Between its start and its own program a child holds what its parent had open, locks too.
#[test]
fn a_child_that_was_being_started_kept_a_closed_store_locked() {
    let directory = tempfile::tempdir().unwrap();
    let done = std::sync::atomic::AtomicBool::new(false);
    std::thread::scope(|scope| {
        for _ in 0..2 {
            scope.spawn(|| {
                while !done.load(Ordering::SeqCst) {
                    assert!(std::process::Command::new("true").status().unwrap().success());
                }
            });
        }
        let refused: Vec<String> =
            (0..200).filter_map(|_| open(directory.path()).err().map(|error| error.to_string())).collect();
        done.store(true, Ordering::SeqCst);
        assert_eq!(refused, Vec::<String>::new());
    });
}

#[test]
fn a_creation_that_was_cut_off_starts_again() {
    let directory = tempfile::tempdir().unwrap();
    let creating = directory.path().join("sled.creating");
    fs::create_dir_all(creating.join("blobs")).unwrap();
    fs::write(creating.join("conf"), b"half").unwrap();
    fs::create_dir(directory.path().join("lost+found")).unwrap();
    let store = open(directory.path()).unwrap();
    assert!(store.list().unwrap().is_empty() && !creating.exists());
}

/// Run by the test below in a process of its own whose files may not grow beyond a few megabytes.
#[test]
#[ignore = "run by a_full_disk_stops_writes_and_reads_go_on"]
fn full_disk_child() {
    let Ok(directory) = std::env::var("UBBMAP_TEST_FULL_DISK") else { return };
    let store = open(Path::new(&directory)).unwrap();
    let (id, mut model) = fill(&store, "plant", config(12, 255, 1), 3, 1);
    let mut durable = model.loaded();
    let error = loop {
        assert!(model.revision < 10_000, "the files never reached the limit");
        match store.commit(id, &model.step(60)) {
            Ok(()) => durable = model.loaded(),
            Err(error) => break error,
        }
    };
    assert!(matches!(error, StoreError::FailStop(_)), "{error}");
    assert!(matches!(store.commit(id, &model.step(1)), Err(StoreError::FailStop(_))));
    assert_same(&store.load(id).unwrap(), &durable);
    fs::write(Path::new(&directory).join("acknowledged"), durable.revision.to_string()).unwrap();
    drop(store);
}

#[test]
#[cfg(target_os = "linux")]
fn a_full_disk_stops_writes_and_reads_go_on() {
    let directory = tempfile::tempdir().unwrap();
    let mut child = std::process::Command::new("sh")
        // Blocks of 512 bytes: 1.5 MiB; without the trap the signal would end the process.
        .args(["-c", "trap '' XFSZ; ulimit -f 3072; exec \"$0\" --exact store_durability::full_disk_child --ignored"])
        .arg(std::env::current_exe().unwrap())
        .env("UBBMAP_TEST_FULL_DISK", directory.path())
        .spawn()
        .unwrap();
    let start = std::time::Instant::now();
    let status = loop {
        if let Some(status) = child.try_wait().unwrap() {
            break status;
        }
        if start.elapsed() > Duration::from_secs(60) {
            child.kill().unwrap();
            panic!("a full disk hangs the store");
        }
        std::thread::sleep(Duration::from_millis(20));
    };
    assert!(status.success());
    let acknowledged: u64 = fs::read_to_string(directory.path().join("acknowledged")).unwrap().parse().unwrap();
    let store = open(directory.path()).unwrap();
    let maps = store.list().unwrap();
    assert!(acknowledged > 3 && maps[0].revision >= acknowledged, "{acknowledged}, {}", maps[0].revision);
    store.load(maps[0].id).unwrap();
}

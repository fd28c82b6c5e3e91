//! The database rewritten while it is in use: nothing is lost at any step, whatever fails, and whoever reads or writes.

pub use crate::crash_support::copy_directory;
use crate::store_support::{Model, assert_same, config, fill, name};
use std::fs;
use std::io;
use std::path::Path;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};
use ubbmap::quadtree::{Block, BlockAddress, BlockCache, BlockView};
use ubbmap::store::{Commit, MapId, MapStore, RewriteStep, SledOptions, SledStore, StoreError, Syncer};

pub fn open(directory: &Path) -> SledStore {
    SledStore::open(directory, SledOptions::default()).unwrap()
}

pub fn rewrite(store: &SledStore) {
    store.rewrite(&mut |_| Ok(())).unwrap();
}

/// What stands in a data directory.
pub fn entries(directory: &Path) -> Vec<String> {
    let mut names: Vec<_> =
        fs::read_dir(directory).unwrap().map(|entry| entry.unwrap().file_name().into_string().unwrap()).collect();
    names.sort();
    names
}

/// The databases in a data directory.
pub fn databases(directory: &Path) -> Vec<String> {
    entries(directory).into_iter().filter(|name| name.starts_with("sled")).collect()
}

/// A map that is worth several batches: 900 records, 1.9 MB.
pub fn wide(store: &SledStore) -> (MapId, Model) {
    wide_as(store, "wide")
}

fn wide_as(store: &SledStore, map: &str) -> (MapId, Model) {
    let id = store.create(&name(map), &config(12, 255, 1), 1.5e9).unwrap();
    let mut model = Model::new(config(12, 255, 1), 0);
    let mixed = |n: u32| {
        let mut leaves = Box::new([1; 64 * 64]);
        for (index, class) in leaves.iter_mut().enumerate() {
            *class = ((index as u32 * 7 + n) % 255) as u8 + 1;
        }
        BlockView::Mixed(Arc::new(Block::from_leaves(leaves)))
    };
    let blocks: Vec<_> = (0..900)
        .map(|n| {
            let view = if n % 2 == 0 { mixed(n) } else { BlockView::Uniform((n % 100) as u8 + 1) };
            (BlockAddress { x: n % 30, y: n / 30 }, view)
        })
        .collect();
    for (address, view) in &blocks {
        model.tree.set_block(*address, view.clone());
    }
    model.revision = 1;
    store.commit(id, &Commit { revision: 1, changed: 0.0, blocks, windows: Vec::new() }).unwrap();
    (id, model)
}

/// True of the steps after which the new database is the store.
fn is_past(step: RewriteStep) -> bool {
    matches!(step, RewriteStep::Pointed | RewriteStep::Switched | RewriteStep::Removed)
}

/// Steps by their names: those of one kind count as one.
pub fn kind(step: RewriteStep) -> String {
    format!("{step:?}").split('(').next().unwrap().to_owned()
}

/// The steps in their order.
pub const STEPS: [&str; 11] = [
    "Created",
    "Copying",
    "Copied",
    "Reopened",
    "Comparing",
    "Compared",
    "Held",
    "Whole",
    "Pointed",
    "Switched",
    "Removed",
];

#[test]
fn a_rewritten_store_is_smaller_and_holds_the_same() {
    let directory = tempfile::tempdir().unwrap();
    let store = open(directory.path());
    let (kept, mut model) = wide(&store);
    let gone: Vec<_> = (0..4).map(|n| wide_as(&store, &format!("gone-{n}")).0).collect();
    gone.into_iter().for_each(|id| store.delete(id).unwrap());
    let (other, of_other) = fill(&store, "other", config(10, 10, 3), 9, 10);
    let mut seen = Vec::new();
    let done = store
        .rewrite(&mut |step| {
            seen.push(kind(step));
            Ok(())
        })
        .unwrap();
    seen.dedup();
    assert_eq!(seen, STEPS);
    assert!(done.after_bytes * 2 < done.before_bytes, "{done:?}");
    let found = store.verify().unwrap();
    assert_eq!((found.problems.len(), found.records), (0, done.records + 1), "all but the header is counted");
    assert_eq!(databases(directory.path()), ["sled-2"]);
    assert_same(&store.load(kept).unwrap(), &model.loaded());
    store.commit(kept, &model.step(5)).unwrap();
    // What is acknowledged is in the new database's files, not only in memory.
    let copy = tempfile::tempdir().unwrap();
    copy_directory(directory.path(), copy.path());
    assert_same(&open(copy.path()).load(kept).unwrap(), &model.loaded());
    drop(store);
    for generation in 3..=4 {
        let store = open(directory.path());
        assert_eq!(store.verify().unwrap().problems, Vec::<String>::new());
        assert_same(&store.load(kept).unwrap(), &model.loaded());
        assert_same(&store.load(other).unwrap(), &of_other.loaded());
        rewrite(&store);
        assert_eq!(databases(directory.path()), [format!("sled-{generation}")]);
        store.commit(kept, &model.step(5)).unwrap();
        assert!(store.create(&name(&format!("new-{generation}")), &config(8, 10, 1), 0.0).unwrap() > other);
    }
}

#[test]
fn a_rewrite_that_is_given_up_at_any_step_leaves_the_old_database_in_use() {
    let directory = tempfile::tempdir().unwrap();
    let store = open(directory.path());
    let (id, mut model) = wide(&store);
    for (generation, stop_at) in STEPS.into_iter().enumerate() {
        let before = databases(directory.path());
        let mut last = None;
        let outcome = store.rewrite(&mut |step| {
            last = Some(step);
            if kind(step) == stop_at { Err(StoreError::Refused("planted".to_owned())) } else { Ok(()) }
        });
        let past = is_past(last.unwrap());
        match outcome {
            Err(StoreError::Refused(why)) => assert!(why == "planted" && !past, "{stop_at}"),
            Ok(_) => assert!(past, "{stop_at}"),
            other => panic!("{stop_at}: {other:?}"),
        }
        assert_eq!(databases(directory.path()) == before, !past, "{stop_at}, {generation}");
        assert!(store.failure().is_none());
        store.commit(id, &model.step(4)).unwrap();
        assert_same(&store.load(id).unwrap(), &model.loaded());
    }
    drop(store);
    assert_same(&open(directory.path()).load(id).unwrap(), &model.loaded());
}

#[test]
fn a_copy_that_is_not_the_same_never_becomes_the_store() {
    let directory = tempfile::tempdir().unwrap();
    let store = open(directory.path());
    let (id, mut model) = wide(&store);
    let key = |x, y| [&[0x30][..], &id.0.to_be_bytes(), &BlockAddress { x, y }.morton().to_be_bytes()].concat();
    type Edit<'a> = &'a dyn Fn(&sled::Db);
    let edits: [(Edit<'_>, &str); 4] = [
        (&|db| drop(db.remove(key(3, 4)).unwrap().unwrap()), "block (3, 4)"),
        (&|db| drop(db.insert(key(5, 6), b"nonsense").unwrap().unwrap()), "block (5, 6)"),
        (&|db| assert!(db.insert(key(60, 60), b"stray").unwrap().is_none()), "block (60, 60)"),
        (&|db| assert!(db.insert([0xFF], b"stray").unwrap().is_none()), "unknown key ff"),
    ];
    for (edit, what) in edits {
        let outcome = store.rewrite(&mut |step| {
            if step == RewriteStep::Copied {
                edited(&directory.path().join("sled-2"), edit);
            }
            Ok(())
        });
        let error = outcome.unwrap_err().to_string();
        assert!(error.contains(what) && error.contains("not the same"), "{error}");
        assert_eq!(databases(directory.path()), ["sled"]);
        store.commit(id, &model.step(4)).unwrap();
    }
    assert_same(&store.load(id).unwrap(), &model.loaded());
    // What is written again meanwhile is copied again, so a fault in it is gone.
    store
        .rewrite(&mut |step| {
            if step == RewriteStep::Copied {
                edited(&directory.path().join("sled-2"), &|db| drop(db.insert(key(0, 0), b"nonsense").unwrap()));
                let blocks = vec![(BlockAddress { x: 0, y: 0 }, BlockView::Uniform(7))];
                model.tree.set_block(BlockAddress { x: 0, y: 0 }, BlockView::Uniform(7));
                model.revision += 1;
                store
                    .commit(id, &Commit { revision: model.revision, changed: 0.0, blocks, windows: Vec::new() })
                    .unwrap();
            }
            Ok(())
        })
        .unwrap();
    assert_same(&store.load(id).unwrap(), &model.loaded());
}

/// A database changed behind the store's back, while the store has it closed.
fn edited(path: &Path, edit: &dyn Fn(&sled::Db)) {
    let start = Instant::now();
    let db = loop {
        match sled::Config::new().path(path).flush_every_ms(None).open() {
            Ok(db) => break db,
            // sled's own threads let go of the file a little after it is dropped.
            Err(_) if start.elapsed() < Duration::from_secs(10) => std::thread::sleep(Duration::from_millis(5)),
            Err(error) => panic!("{error}"),
        }
    };
    edit(&db);
    db.flush().unwrap();
}

/// A sync that does as it is told, one for each database.
struct Probe {
    inner: Box<dyn Syncer>,
    fail: Arc<AtomicBool>,
    syncs: Arc<AtomicU64>,
}

impl Syncer for Probe {
    fn sync(&self) -> io::Result<()> {
        self.syncs.fetch_add(1, Ordering::SeqCst);
        if self.fail.load(Ordering::SeqCst) {
            return Err(io::Error::other("the disk is gone"));
        }
        self.inner.sync()
    }
}

/// What each database's sync is told, and how often it was asked.
type Probes = Arc<Mutex<Vec<(Arc<AtomicBool>, Arc<AtomicU64>)>>>;

fn probed(directory: &Path, fail_next: &Arc<AtomicBool>) -> (SledStore, Probes) {
    let probes = Probes::default();
    let (of_wrap, fail_next) = (Arc::clone(&probes), Arc::clone(fail_next));
    let wrap = move |inner| {
        let fail = Arc::new(AtomicBool::new(fail_next.load(Ordering::SeqCst)));
        let syncs = Arc::<AtomicU64>::default();
        of_wrap.lock().unwrap().push((Arc::clone(&fail), Arc::clone(&syncs)));
        Box::new(Probe { inner, fail, syncs }) as Box<dyn Syncer>
    };
    (SledStore::open_with(directory, SledOptions::default(), wrap).unwrap(), probes)
}

#[test]
fn a_rewrite_whose_disk_fails_leaves_the_old_database_in_use() {
    let directory = tempfile::tempdir().unwrap();
    let fail_next = Arc::new(AtomicBool::new(false));
    let (store, probes) = probed(directory.path(), &fail_next);
    let (id, mut model) = wide(&store);
    let mut goes_on = |what: &str, prepare: &dyn Fn(RewriteStep)| {
        let outcome = store.rewrite(&mut |step| {
            prepare(step);
            Ok(())
        });
        assert!(matches!(&outcome, Err(StoreError::Io { .. })), "{what}: {outcome:?}");
        assert!(store.failure().is_none());
        store.commit(id, &model.step(4)).unwrap();
        assert_same(&store.load(id).unwrap(), &model.loaded());
        outcome.unwrap_err().to_string()
    };
    fail_next.store(true, Ordering::SeqCst);
    assert!(goes_on("the new data file cannot be synced", &|_| ()).contains("the disk is gone"));
    assert_eq!(databases(directory.path()), ["sled"]);
    fail_next.store(false, Ordering::SeqCst);

    let writing = directory.path().join("current.writing");
    for at in ["Held", "Nowhere"] {
        // At the last moment, and (left there) before the first.
        let prepare = |step| {
            if kind(step) == at {
                fs::create_dir_all(writing.join("x")).unwrap();
            }
        };
        assert!(goes_on("`current` cannot be written", &prepare).contains("current.writing"));
        assert_eq!(databases(directory.path()), ["sled"]);
    }
    fs::remove_dir_all(&writing).unwrap();

    fs::write(directory.path().join("sled-2"), b"in the way").unwrap();
    assert!(goes_on("the directory cannot be made", &|_| ()).contains("sled-2"));
    fs::remove_file(directory.path().join("sled-2")).unwrap();

    rewrite(&store);
    assert_eq!(databases(directory.path()), ["sled-2"]);
    // What is acknowledged is synced in the new one from now on.
    let asked = || probes.lock().unwrap().iter().map(|probe| probe.1.load(Ordering::SeqCst)).collect::<Vec<_>>();
    let before = asked();
    store.commit(id, &model.step(4)).unwrap();
    let after = asked();
    assert_eq!(after[..3], before[..3]);
    assert!(after[3] > before[3], "{before:?}, {after:?}");
    let durable = model.loaded();
    probes.lock().unwrap()[3].0.store(true, Ordering::SeqCst);
    let error = store.commit(id, &model.step(4)).unwrap_err().to_string();
    assert!(error.contains("the disk is gone") && error.contains("sled-2/db"), "{error}");
    assert!(matches!(store.rewrite(&mut |_| Ok(())), Err(StoreError::FailStop(_))));
    assert_same(&store.load(id).unwrap(), &durable);
}

#[test]
fn blocks_are_fetched_and_checked_while_the_database_is_replaced() {
    let directory = tempfile::tempdir().unwrap();
    let store = open(directory.path());
    let (id, model) = wide(&store);
    let whole = model.loaded().tree;
    let done = AtomicBool::new(false);
    std::thread::scope(|scope| {
        let fetch = || {
            let cache = Arc::new(BlockCache::new(2 * 5600));
            let opened = store.open(id, &cache).unwrap();
            let mut rounds = 0;
            while !done.load(Ordering::SeqCst) {
                assert_eq!(opened.tree.try_whole().unwrap(), whole);
                rounds += 1;
            }
            assert!(cache.statistics().loads > 400 * rounds);
            rounds
        };
        let readers = [scope.spawn(fetch), scope.spawn(fetch)];
        let check = scope.spawn(|| {
            while !done.load(Ordering::SeqCst) {
                assert_eq!(store.verify().unwrap().problems, Vec::<String>::new());
            }
        });
        for _ in 0..6 {
            rewrite(&store);
        }
        done.store(true, Ordering::SeqCst);
        check.join().unwrap();
        assert!(readers.into_iter().map(|reader| reader.join().unwrap()).sum::<u64>() > 2);
    });
    rewrite(&store);
    assert_eq!(databases(directory.path()), ["sled-8"], "the last reader of each is gone");
}

#[test]
fn the_old_database_stays_until_its_last_reader_has_let_go() {
    let directory = tempfile::tempdir().unwrap();
    let store = open(directory.path());
    let (id, mut model) = wide(&store);
    let mut left = Vec::new();
    let found = store
        .verify_with(&mut |records| {
            // In the middle of a walk through all records.
            if records == 100 {
                rewrite(&store);
                left = databases(directory.path());
                store.commit(id, &model.step(3)).unwrap();
            }
        })
        .unwrap();
    assert_eq!(left, ["sled", "sled-2"]);
    assert_eq!(found.problems, Vec::<String>::new());
    rewrite(&store);
    assert_eq!(databases(directory.path()), ["sled-3"]);
    assert_same(&store.load(id).unwrap(), &model.loaded());
}

#[test]
fn two_rewrites_at_once_are_two_in_turn() {
    let directory = tempfile::tempdir().unwrap();
    let store = open(directory.path());
    let (id, model) = wide(&store);
    std::thread::scope(|scope| {
        for _ in 0..3 {
            scope.spawn(|| rewrite(&store));
        }
    });
    assert_eq!(databases(directory.path()), ["sled-4"]);
    assert_same(&store.load(id).unwrap(), &model.loaded());
}

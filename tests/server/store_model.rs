//! Random operations on both stores against a plain model in memory: what was acknowledged is there after every reboot and
//! crash, and what failed is there whole or not at all.

use crate::crash_support::copy_directory;
use crate::store_support::{config, robot};
use proptest::prelude::*;
use std::collections::BTreeMap;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use tempfile::TempDir;
use ubbmap::mapping::MapConfig;
use ubbmap::quadtree::{Block, BlockAddress, BlockCache, BlockView, OccupancyTree};
use ubbmap::store::{
    BlockStamp, Commit, LoadedMap, MapId, MapName, MapStore, MemoryStore, RobotName, SequenceWindow, SledOptions,
    SledStore, SnapshotName, StoreError, Syncer, read_map_file, write_map_file,
};

type Blocks = BTreeMap<(u32, u32), BlockView>;

/// What a revision holds, as plain lists.
#[derive(Debug, Clone, PartialEq, Default)]
struct Contents {
    revision: u64,
    /// Blocks that are not unknown throughout.
    blocks: Blocks,
    windows: BTreeMap<RobotName, SequenceWindow>,
}

#[derive(Debug, Clone, PartialEq, Default)]
struct ModelMap {
    now: Contents,
    stamps: BTreeMap<(u32, u32), (u64, u64)>,
    snapshots: BTreeMap<SnapshotName, Contents>,
}

type Model = BTreeMap<MapName, ModelMap>;

#[derive(Debug, Clone)]
enum Op {
    Create(u8),
    Commit(u8, Vec<(u8, u8)>, Option<u8>),
    Snapshot(u8, u8),
    Restore(u8, u8),
    DeleteSnapshot(u8, u8),
    DeleteMap(u8),
    /// A map, or one of its snapshots, becomes another map by way of a file.
    Copy(u8, u8, Option<u8>),
    Reboot,
    Crash,
    /// The database is written anew.
    Rewrite,
    /// The next operation meets a disk that does not sync.
    Fail,
}

fn ops() -> impl Strategy<Value = Vec<Op>> {
    let map = || 0..3_u8;
    let commit = (map(), prop::collection::vec((0..5_u8, 0..9_u8), 0..5), prop::option::of(0..3_u8));
    let op = prop_oneof![
        2 => map().prop_map(Op::Create),
        10 => commit.prop_map(|(map, blocks, robot)| Op::Commit(map, blocks, robot)),
        5 => (map(), 0..4_u8).prop_map(|(map, name)| Op::Snapshot(map, name)),
        4 => (map(), 0..4_u8).prop_map(|(map, name)| Op::Restore(map, name)),
        3 => (map(), 0..4_u8).prop_map(|(map, name)| Op::DeleteSnapshot(map, name)),
        1 => map().prop_map(Op::DeleteMap),
        2 => (map(), map(), prop::option::of(0..4_u8)).prop_map(|(from, to, name)| Op::Copy(from, to, name)),
        1 => Just(Op::Reboot),
        1 => Just(Op::Crash),
        1 => Just(Op::Rewrite),
        1 => Just(Op::Fail),
    ];
    prop::collection::vec(op, 1..60)
}

fn config_of_all() -> MapConfig {
    config(9, 10, 1)
}

fn map_name(number: u8) -> MapName {
    MapName::new(&format!("map-{number}")).unwrap()
}

fn snapshot_name(number: u8) -> SnapshotName {
    // One is the beginning of another.
    SnapshotName::new(&"s.".repeat(usize::from(number) + 1)).unwrap()
}

/// A block by a number: some are of one class, one is unknown.
fn view(kind: u8) -> BlockView {
    let scale = config_of_all().scale();
    match kind {
        0 => BlockView::Uniform(scale.unknown()),
        1 => BlockView::Uniform(scale.free()),
        2 => BlockView::Uniform(scale.occupied()),
        kind => {
            let mut leaves = Box::new([scale.unknown(); 64 * 64]);
            leaves[usize::from(kind) * 97] = scale.free();
            leaves[usize::from(kind) * 131] = scale.occupied();
            BlockView::Mixed(Arc::new(Block::from_leaves(leaves)))
        }
    }
}

impl Contents {
    fn set(&mut self, at: (u32, u32), view: BlockView) {
        if view == BlockView::Uniform(config_of_all().scale().unknown()) {
            self.blocks.remove(&at);
        } else {
            self.blocks.insert(at, view);
        }
    }

    fn of(map: &LoadedMap) -> Self {
        Self { revision: map.revision, blocks: blocks(&map.tree), windows: map.windows.clone() }
    }
}

fn blocks(tree: &OccupancyTree) -> Blocks {
    let mut blocks = Blocks::new();
    tree.visit_blocks(&mut |address, view| {
        blocks.insert((address.x, address.y), view.clone());
    });
    blocks
}

/// The commit that an operation makes of a map.
fn commit(now: &Contents, changed: &[(u8, u8)], by: Option<u8>) -> Commit {
    let revision = now.revision + 1;
    let changed: BTreeMap<u8, u8> = changed.iter().copied().collect();
    let at = |at: u8| BlockAddress { x: u32::from(at % 3), y: u32::from(at / 3) };
    let blocks = changed.into_iter().map(|(place, kind)| (at(place), view(kind))).collect();
    let windows = by.map(|number| {
        let robot = robot(u64::from(number));
        let mut window = now.windows.get(&robot).cloned().unwrap_or_default();
        window.record(revision);
        (robot, window)
    });
    Commit { revision, changed: time(revision), blocks, windows: windows.into_iter().collect() }
}

fn time(revision: u64) -> f64 {
    1.7e9 + revision as f64
}

/// What an operation is to do to the model; `None` when it is to be refused.
fn expected(model: &Model, op: &Op) -> Option<Model> {
    let mut model = model.clone();
    match op {
        Op::Create(map) => {
            let fresh = model.insert(map_name(*map), ModelMap::default()).is_none();
            return fresh.then_some(model);
        }
        Op::Commit(map, changed, by) => {
            let map = model.get_mut(&map_name(*map))?;
            let commit = commit(&map.now, changed, *by);
            apply(map, &commit.blocks, commit.windows);
        }
        Op::Snapshot(map, name) => {
            let map = model.get_mut(&map_name(*map))?;
            let fresh = map.snapshots.insert(snapshot_name(*name), map.now.clone()).is_none();
            return fresh.then_some(model);
        }
        Op::Restore(map, name) => {
            let map = model.get_mut(&map_name(*map))?;
            let then = map.snapshots.get(&snapshot_name(*name))?.clone();
            let later = |(at, (revision, _)): (&(u32, u32), &(u64, u64))| (*revision > then.revision).then_some(*at);
            let changed: Vec<(u32, u32)> = map.stamps.iter().filter_map(later).collect();
            let unknown = BlockView::Uniform(config_of_all().scale().unknown());
            let before =
                |(x, y)| (BlockAddress { x, y }, then.blocks.get(&(x, y)).cloned().unwrap_or_else(|| unknown.clone()));
            let blocks: Vec<_> = changed.into_iter().map(before).collect();
            apply(map, &blocks, Vec::new());
            map.now.windows = then.windows;
        }
        Op::DeleteSnapshot(map, name) => {
            model.get_mut(&map_name(*map))?.snapshots.remove(&snapshot_name(*name))?;
        }
        Op::DeleteMap(map) => {
            model.remove(&map_name(*map))?;
        }
        Op::Copy(from, to, name) => {
            let from = model.get(&map_name(*from))?;
            let now = match name {
                Some(name) => from.snapshots.get(&snapshot_name(*name))?,
                None => &from.now,
            };
            let stamps = now.blocks.keys().map(|at| (*at, (now.revision, 0))).collect();
            let copy = ModelMap { now: now.clone(), stamps, snapshots: BTreeMap::new() };
            let fresh = model.insert(map_name(*to), copy).is_none();
            return fresh.then_some(model);
        }
        Op::Reboot | Op::Crash | Op::Rewrite | Op::Fail => {}
    }
    Some(model)
}

fn apply(map: &mut ModelMap, blocks: &[(BlockAddress, BlockView)], windows: Vec<(RobotName, SequenceWindow)>) {
    map.now.revision += 1;
    for (BlockAddress { x, y }, view) in blocks {
        map.now.set((*x, *y), view.clone());
        map.stamps.insert((*x, *y), (map.now.revision, time(map.now.revision) as u64));
    }
    map.now.windows.extend(windows);
}

fn id_of(store: &dyn MapStore, map: u8) -> Option<MapId> {
    store.list().unwrap().iter().find(|stored| stored.name == map_name(map)).map(|stored| stored.id)
}

/// Does an operation; `false` when there is nothing to do it on.
fn perform(store: &dyn MapStore, model: &Model, op: &Op) -> Result<bool, StoreError> {
    let found = |map: &u8| id_of(store, *map);
    match op {
        Op::Create(map) => store.create(&map_name(*map), &config_of_all(), 0.0).map(|_| true),
        Op::Commit(map, changed, by) => {
            let Some(id) = found(map) else { return Ok(false) };
            store.commit(id, &commit(&model[&map_name(*map)].now, changed, *by)).map(|()| true)
        }
        Op::Snapshot(map, name) => {
            let Some(id) = found(map) else { return Ok(false) };
            store.take_snapshot(id, &snapshot_name(*name), 7.5).map(|_| true)
        }
        Op::Restore(map, name) => {
            let Some(id) = found(map) else { return Ok(false) };
            let difference = store.difference(id, &snapshot_name(*name))?;
            let revision = model[&map_name(*map)].now.revision + 1;
            let ubbmap::store::Difference { blocks, windows, .. } = difference;
            store.commit(id, &Commit { revision, changed: time(revision), blocks, windows }).map(|()| true)
        }
        Op::DeleteSnapshot(map, name) => {
            let Some(id) = found(map) else { return Ok(false) };
            store.delete_snapshot(id, &snapshot_name(*name)).map(|()| true)
        }
        Op::DeleteMap(map) => {
            let Some(id) = found(map) else { return Ok(false) };
            store.delete(id).map(|()| true)
        }
        Op::Copy(from, to, name) => {
            let Some(id) = found(from) else { return Ok(false) };
            let map = match name {
                Some(name) => store.load_snapshot(id, &snapshot_name(*name))?,
                None => store.load(id)?,
            };
            let mut file = Vec::new();
            write_map_file(&mut file, &config_of_all(), &map).unwrap();
            let (config, map) = read_map_file(&mut file.as_slice()).unwrap();
            store.import(&map_name(*to), &config, 0.0, &map).map(|_| true)
        }
        Op::Reboot | Op::Crash | Op::Rewrite | Op::Fail => Ok(true),
    }
}

/// What a store shows, read in every way that there is.
fn shown(store: &dyn MapStore) -> Model {
    let mut model = Model::new();
    for map in store.list().unwrap() {
        let now = Contents::of(&store.load(map.id).unwrap());
        assert_eq!(now.revision, map.revision);
        let open = store.open(map.id, &Arc::new(BlockCache::new(1))).unwrap();
        assert_eq!((open.revision, &open.windows), (now.revision, &now.windows));
        assert_eq!(blocks(&open.tree.try_whole().unwrap()), now.blocks);
        let stamp = |BlockStamp { revision, changed }| (revision, changed as u64);
        let stamps = open.stamps.all().map(|(at, of)| ((at.x, at.y), stamp(of))).collect();
        assert!(open.stamps.since(0).all(|(at, stamp)| open.stamps.get(at) == Some(stamp)));
        let snapshots = store.snapshots(map.id).unwrap().into_iter().map(|stored| {
            let kept = Contents::of(&store.load_snapshot(map.id, &stored.name).unwrap());
            assert_eq!((stored.revision, stored.created), (kept.revision, 7.5));
            (stored.name, kept)
        });
        model.insert(map.name, ModelMap { now, stamps, snapshots: snapshots.collect() });
    }
    model
}

/// Syncs while it is let.
struct Unsteady {
    inner: Box<dyn Syncer>,
    fails: Arc<AtomicBool>,
}

impl Syncer for Unsteady {
    fn sync(&self) -> std::io::Result<()> {
        if self.fails.load(Ordering::SeqCst) { Err(std::io::Error::other("planted")) } else { self.inner.sync() }
    }
}

fn open(directory: &Path, fails: &Arc<AtomicBool>) -> SledStore {
    let fails = Arc::clone(fails);
    SledStore::open_with(directory, SledOptions::default(), move |inner| {
        Box::new(Unsteady { inner, fails: Arc::clone(&fails) })
    })
    .unwrap()
}

/// A copy of the files as they are: what a killed process leaves.
fn copied(from: &Path) -> TempDir {
    let to = tempfile::tempdir().unwrap();
    copy_directory(from, to.path());
    to
}

fn assert_shows(store: &dyn MapStore, model: &Model, after: &Op) {
    assert_eq!(&shown(store), model, "after {after:?}");
}

/// So many runs, or `PROPTEST_CASES`.
fn cases(usual: u32) -> ProptestConfig {
    let config = ProptestConfig::default();
    let cases = if std::env::var_os("PROPTEST_CASES").is_some() { config.cases } else { usual };
    ProptestConfig { cases, ..config }
}

fn run(store: &dyn MapStore, model: &mut Model, op: &Op) {
    let outcome = perform(store, model, op);
    match expected(model, op) {
        Some(next) => {
            assert!(matches!(outcome, Ok(true)), "{op:?}: {outcome:?}");
            *model = next;
        }
        None => assert!(!matches!(outcome, Ok(true)), "{op:?} was not refused"),
    }
}

proptest! {
    #![proptest_config(cases(128))]

    #[test]
    fn the_store_in_memory_does_what_the_model_does(ops in ops()) {
        let (store, mut model) = (MemoryStore::new(), Model::new());
        for op in &ops {
            run(&store, &mut model, op);
            assert_shows(&store, &model, op);
        }
    }
}

proptest! {
    #![proptest_config(cases(32))]

    #[test]
    fn the_store_on_disk_does_what_the_model_does_through_reboots_crashes_and_failures(ops in ops()) {
        let mut directory = tempfile::tempdir().unwrap();
        let fails = Arc::new(AtomicBool::new(false));
        let mut store = open(directory.path(), &fails);
        let (mut model, mut failing) = (Model::new(), false);
        for op in &ops {
            match op {
                Op::Fail => failing = true,
                Op::Rewrite => {
                    let live = store.rewrite(&mut |_| Ok(())).unwrap().live_bytes;
                    prop_assert!(live > 0);
                }
                Op::Reboot => {
                    drop(store);
                    store = open(directory.path(), &fails);
                }
                Op::Crash => {
                    let copy = copied(directory.path());
                    drop(store);
                    directory = copy;
                    store = open(directory.path(), &fails);
                }
                op if failing => {
                    failing = false;
                    fails.store(true, Ordering::SeqCst);
                    let outcome = perform(&store, &model, op);
                    let wanted = expected(&model, op);
                    prop_assert!(wanted.is_none() || outcome.is_err(), "{:?} was acknowledged", op);
                    // Reads go on, and show what is durable.
                    assert_shows(&store, &model, op);
                    drop(store);
                    fails.store(false, Ordering::SeqCst);
                    store = open(directory.path(), &fails);
                    // Whole or not at all.
                    if let Some(wanted) = wanted.filter(|wanted| shown(&store) == *wanted) {
                        model = wanted;
                    }
                }
                op => run(&store, &mut model, op),
            }
            assert_shows(&store, &model, op);
        }
        prop_assert_eq!(store.verify().unwrap().problems, Vec::<String>::new());
    }
}

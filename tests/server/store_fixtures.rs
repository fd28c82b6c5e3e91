//! Stores and map files written by each format version open for ever.
//!
//! `tests/fixtures/store-vN/` holds the files of a data directory written by version N, each compressed with zstd
//! (`dir__file.zst` for `dir/file`), and `tests/fixtures/map-vN.ubbmap` a map file. They are never written again: a new
//! version adds its own. To write the fixtures of a new version: `cargo test --release --test server
//! write_fixtures -- --ignored`.

use crate::store_support::{Model, assert_same, config, name};
use std::fs;
use std::path::{Path, PathBuf};
use ubbmap::quadtree::{BlockAddress, BlockCache, BlockView, ClassScale, OccupancyTree};
use ubbmap::store::{
    BlockStamp, Commit, LoadedMap, MapStore, RobotName, STORE_FORMAT, SequenceWindow, SledOptions, SledStore,
    SnapshotName, read_map_file, write_map_file,
};

fn fixtures() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/fixtures")
}

/// What the fixtures hold, by plain rules that hang on no random numbers.
fn contents(depth: u8, classes: u32) -> (LoadedMap, Commit) {
    let scale = ClassScale::new(classes).unwrap();
    let side = 1_u32 << depth.saturating_sub(6).min(2);
    let mut tree = OccupancyTree::new(depth, scale);
    let mut blocks = Vec::new();
    for (x, y) in (0..side).flat_map(|y| (0..side).map(move |x| (x, y))) {
        let mut leaves = Box::new([scale.unknown(); 64 * 64]);
        for (index, leaf) in leaves.iter_mut().enumerate() {
            let (column, row) = ((index % 64) as u32, (index / 64) as u32);
            // Stripes of free squares of eight leaves, and a slanted wall.
            if (column / 8 + row / 8 + x) % 3 == 0 {
                *leaf = 1 + ((column / 8) % 3) as u8;
            }
            if column.abs_diff(row / 2 + 7 * y) < 2 {
                *leaf = scale.occupied() - (row % 2) as u8;
            }
        }
        let view = match (x, y) {
            (1, 1) => BlockView::Uniform(1),
            (2, 1) => BlockView::Uniform(scale.occupied()),
            _ => BlockView::Mixed(std::sync::Arc::new(ubbmap::quadtree::Block::from_leaves(leaves))),
        };
        let address = BlockAddress { x, y };
        tree.set_block(address, view);
        blocks.push((address, tree.block(address)));
    }
    let mut windows = Vec::new();
    for (robot, first, step, count) in
        [("amr-7", 0, 1, 2000), ("AMR_8.b", 5_000_000_000, 3, 100), ("z", u64::MAX, 1, 1)]
    {
        let mut window = SequenceWindow::default();
        for n in 0..count {
            window.record(first + n * step);
        }
        windows.push((RobotName::new(robot).unwrap(), window));
    }
    let map = LoadedMap { revision: 3, tree, windows: windows.iter().cloned().collect() };
    (map, Commit { revision: 3, changed: 0.0, blocks, windows })
}

/// The version of map files, which is not the store's.
const MAP_FILE_FORMAT: u32 = 1;

const MAPS: [(&str, u8, u32, usize); 4] =
    [("plant-1", 16, 10, 2), ("wide", 9, 40, 1), ("small", 3, 10, 3), ("z_", 8, 4, 1)];

#[test]
#[ignore = "writes the fixtures of a new format version"]
fn write_fixtures() {
    let target = fixtures().join(format!("store-v{STORE_FORMAT}"));
    assert!(!target.exists(), "fixtures are never written again");
    let directory = tempfile::tempdir().unwrap();
    let store = SledStore::open(directory.path(), SledOptions::default()).unwrap();
    let gone = store.create(&name("gone"), &config(9, 10, 1), 1.0).unwrap();
    for (map, depth, classes, sensors) in MAPS {
        let id = store.create(&name(map), &config(u32::from(depth), classes, sensors), 1_732_233_600.25).unwrap();
        store.commit(id, &Commit { changed: 1_732_233_650.5, ..contents(depth, classes).1 }).unwrap();
    }
    store.delete(gone).unwrap();
    let kept = store.create(&name(KEPT), &config(9, 40, 1), 1_732_233_600.25).unwrap();
    for (commit, snapshot) in kept_commits().into_iter().zip(["first", "Second.one"]) {
        store.commit(kept, &commit).unwrap();
        store.take_snapshot(kept, &SnapshotName::new(snapshot).unwrap(), 1_732_233_800.5).unwrap();
    }
    drop(store);
    // The last of sled's threads writes a moment longer.
    std::thread::sleep(std::time::Duration::from_millis(200));
    fs::create_dir_all(&target).unwrap();
    for (prefix, folder) in [("", directory.path().to_path_buf()), ("sled__", directory.path().join("sled"))] {
        for file in fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path()) {
            let stored = file.file_name().unwrap().to_str().unwrap();
            if file.is_file() && stored != "lock" {
                let compressed = zstd::encode_all(fs::read(&file).unwrap().as_slice(), 19).unwrap();
                fs::write(target.join(format!("{prefix}{stored}.zst")), compressed).unwrap();
            }
        }
    }
    let target = fixtures().join(format!("map-v{MAP_FILE_FORMAT}.ubbmap"));
    if !target.exists() {
        let mut file = Vec::new();
        write_map_file(&mut file, &config(16, 10, 2), &contents(16, 10).0).unwrap();
        fs::write(target, file).unwrap();
    }
}

/// A map with snapshots, from version 3 on.
const KEPT: &str = "kept";

/// Two commits of which the second replaces two blocks and a window.
fn kept_commits() -> [Commit; 2] {
    let (_, first) = contents(9, 40);
    let mut window = first.windows[0].1.clone();
    window.record(2001);
    let second = Commit {
        revision: 4,
        changed: 1_732_233_700.75,
        blocks: vec![
            (first.blocks[0].0, BlockView::Uniform(ClassScale::new(40).unwrap().unknown())),
            (first.blocks[1].0, BlockView::Uniform(1)),
        ],
        windows: vec![(first.windows[0].0.clone(), window)],
    };
    [Commit { changed: 1_732_233_650.5, ..first }, second]
}

fn has_snapshots(store: &SledStore) {
    let id = store.list().unwrap().iter().find(|stored| stored.name == name(KEPT)).unwrap().id;
    let [first, second] = kept_commits();
    let mut expected = contents(9, 40).0;
    let named = |name| SnapshotName::new(name).unwrap();
    assert_same(&store.load_snapshot(id, &named("first")).unwrap(), &expected);
    for (address, view) in &second.blocks {
        expected.tree.set_block(*address, view.clone());
    }
    expected.windows.extend(second.windows.iter().cloned());
    expected.revision = 4;
    assert_same(&store.load_snapshot(id, &named("Second.one")).unwrap(), &expected);
    assert_same(&store.load(id).unwrap(), &expected);
    let snapshots = store.snapshots(id).unwrap();
    let told: Vec<_> = snapshots.iter().map(|s| (s.name.as_str(), s.revision, s.created)).collect();
    assert_eq!(told, [("Second.one", 4, 1_732_233_800.5), ("first", 3, 1_732_233_800.5)]);
    let stamps = store.open(id, &std::sync::Arc::new(BlockCache::new(1))).unwrap().stamps;
    assert_eq!(stamps.get(first.blocks[0].0), Some(BlockStamp { revision: 4, changed: second.changed }));
    assert_eq!(stamps.get(first.blocks[2].0), Some(BlockStamp { revision: 3, changed: first.changed }));
    store.delete_snapshot(id, &named("first")).unwrap();
}

pub fn unpacked(fixture: &str) -> tempfile::TempDir {
    let directory = tempfile::tempdir().unwrap();
    for file in fs::read_dir(fixtures().join(fixture)).unwrap().map(|entry| entry.unwrap().path()) {
        let stored = file.file_name().unwrap().to_str().unwrap().trim_end_matches(".zst").replace("__", "/");
        let target = directory.path().join(stored);
        fs::create_dir_all(target.parent().unwrap()).unwrap();
        fs::write(target, zstd::decode_all(fs::read(&file).unwrap().as_slice()).unwrap()).unwrap();
    }
    directory
}

#[test]
fn a_store_of_every_version_opens() {
    for version in 1..=STORE_FORMAT {
        opens(version);
    }
}

fn opens(version: u32) {
    let directory = unpacked(&format!("store-v{version}"));
    let store = SledStore::open(directory.path(), SledOptions::default()).unwrap();
    assert_eq!(store.verify().unwrap().problems, Vec::<String>::new());
    let maps = store.list().unwrap();
    let with_snapshots = version >= 3;
    assert_eq!(maps.len(), MAPS.len() + usize::from(with_snapshots));
    if with_snapshots {
        has_snapshots(&store);
    }
    for (map, depth, classes, sensors) in MAPS {
        let stored = maps.iter().find(|stored| stored.name == name(map)).unwrap();
        assert_eq!(stored.config, config(u32::from(depth), classes, sensors));
        assert_eq!((stored.created, stored.revision), (1_732_233_600.25, 3));
        assert_same(&store.load(stored.id).unwrap(), &contents(depth, classes).0);
        let cache = std::sync::Arc::new(BlockCache::new(1));
        let open = store.open(stored.id, &cache).unwrap();
        assert_eq!(open.tree.try_whole().unwrap(), contents(depth, classes).0.tree);
        // Before version 3 no times were kept, and a block that became unknown lost its record.
        let newest = open.stamps.newest().unwrap();
        assert_eq!((newest.revision, newest.changed), (3, if version >= 3 { 1_732_233_650.5 } else { 0.0 }));
        assert_eq!(open.stamps.complete_from(), if version >= 3 { 0 } else { 3 });
    }
    // It is written to as well, and the number of the deleted map is not used again.
    let new = store.create(&name("gone"), &config(9, 10, 1), 1.0).unwrap();
    assert_eq!(new.0, if with_snapshots { 7 } else { 6 });
    let mut model = Model::new(config(9, 10, 1), 1);
    store.commit(new, &model.step(4)).unwrap();
    assert_same(&store.load(new).unwrap(), &model.loaded());
}

#[test]
fn a_map_file_of_version_1_opens() {
    let file = fs::read(fixtures().join("map-v1.ubbmap")).unwrap();
    let (found, map) = read_map_file(&mut file.as_slice()).unwrap();
    assert_eq!(found, config(16, 10, 2));
    assert_same(&map, &contents(16, 10).0);
}

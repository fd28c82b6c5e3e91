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
    Commit, LoadedMap, MapStore, RobotName, STORE_FORMAT, SequenceWindow, SledOptions, SledStore, read_map_file,
    write_map_file,
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
        store.commit(id, &contents(depth, classes).1).unwrap();
    }
    store.delete(gone).unwrap();
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

fn unpacked(fixture: &str) -> tempfile::TempDir {
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
        opens(&format!("store-v{version}"));
    }
}

fn opens(fixture: &str) {
    let directory = unpacked(fixture);
    let store = SledStore::open(directory.path(), SledOptions::default()).unwrap();
    assert_eq!(store.verify().unwrap().problems, Vec::<String>::new());
    let maps = store.list().unwrap();
    assert_eq!(maps.len(), MAPS.len());
    for (map, depth, classes, sensors) in MAPS {
        let stored = maps.iter().find(|stored| stored.name == name(map)).unwrap();
        assert_eq!(stored.config, config(u32::from(depth), classes, sensors));
        assert_eq!((stored.created, stored.revision), (1_732_233_600.25, 3));
        assert_same(&store.load(stored.id).unwrap(), &contents(depth, classes).0);
        let cache = std::sync::Arc::new(BlockCache::new(1));
        let open = store.open(stored.id, &cache).unwrap();
        assert_eq!(open.tree.try_whole().unwrap(), contents(depth, classes).0.tree);
    }
    // It is written to as well, and the number of the deleted map is not used again.
    let new = store.create(&name("gone"), &config(9, 10, 1), 1.0).unwrap();
    assert_eq!(new.0, 6);
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

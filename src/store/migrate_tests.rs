//! A migration that stops anywhere goes on where it stopped.

#![allow(clippy::unwrap_used, clippy::panic, reason = "a test fails by panicking")]

use super::{SledOptions, SledStore, StoreError, migrate_times};
use std::collections::BTreeMap;
use std::fs;
use std::path::Path;

/// A data directory of version 2.
fn version_2() -> tempfile::TempDir {
    let directory = tempfile::tempdir().unwrap();
    let fixture = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/fixtures/store-v2");
    for file in fs::read_dir(fixture).unwrap().map(|entry| entry.unwrap().path()) {
        let stored = file.file_name().unwrap().to_str().unwrap().trim_end_matches(".zst").replace("__", "/");
        let target = directory.path().join(stored);
        fs::create_dir_all(target.parent().unwrap()).unwrap();
        fs::write(target, zstd::decode_all(fs::read(&file).unwrap().as_slice()).unwrap()).unwrap();
    }
    directory
}

fn records(directory: &Path) -> BTreeMap<Vec<u8>, Vec<u8>> {
    let db = sled::open(directory.join("sled")).unwrap();
    db.iter().map(|record| record.unwrap()).map(|(key, value)| (key.to_vec(), value.to_vec())).collect()
}

/// Opens the store, which finishes the migration, and gives its records.
fn finished(directory: &Path) -> BTreeMap<Vec<u8>, Vec<u8>> {
    let store = SledStore::open(directory, SledOptions::default()).unwrap();
    assert_eq!(store.verify().unwrap().problems, Vec::<String>::new());
    drop(store);
    // The last of sled's threads lets go of the files a moment later.
    std::thread::sleep(std::time::Duration::from_millis(100));
    records(directory)
}

#[test]
fn a_migration_that_was_stopped_after_any_batch_goes_on_there() {
    let whole = version_2();
    let expected = finished(whole.path());
    assert!(expected.iter().filter(|(key, _)| [0x13, 0x30, 0x31].contains(&key[0])).all(|(_, value)| value[0] == 2));
    for batches in 0.. {
        let directory = version_2();
        let db = sled::open(directory.path().join("sled")).unwrap();
        let mut done = 0;
        let stopped = migrate_times::rewrite(&db, 5, &mut || {
            done += 1;
            if done > batches { Err(StoreError::Refused("stopped".to_owned())) } else { Ok(()) }
        });
        db.flush().unwrap();
        drop(db);
        std::thread::sleep(std::time::Duration::from_millis(100));
        let halfway = records(directory.path());
        assert!(halfway != expected, "the header still says version 2");
        assert_eq!(finished(directory.path()), expected, "stopped after {batches}");
        if stopped.is_ok() {
            assert!(batches > 5, "stopped {batches} times only");
            return;
        }
    }
}

//! Damage of every kind is seen, named and kept to the map that it is in.

use crate::store_support::{assert_same, config, fill, name};
use proptest::prelude::*;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::path::Path;
use ubbmap::quadtree::BlockAddress;
use ubbmap::store::{MapId, MapStore, STORE_FORMAT, SledOptions, SledStore, StoreError};

fn open(directory: &Path) -> Result<SledStore, StoreError> {
    SledStore::open(directory, SledOptions::default())
}

/// The records as they are on disk, through sled alone.
pub fn raw<T>(directory: &Path, edit: impl FnOnce(&sled::Db) -> T) -> T {
    for _ in 0..1000 {
        // sled's own threads let go of the file a little after the store is dropped.
        if let Ok(db) = sled::Config::new().path(directory.join("sled")).flush_every_ms(None).open() {
            let value = edit(&db);
            db.flush().unwrap();
            return value;
        }
        std::thread::sleep(std::time::Duration::from_millis(5));
    }
    panic!("the database stays locked");
}

/// A record framed as `docs/store-format.md` says, by hand.
pub fn framed(key: &[u8], version: u8, revision: u64, content: &[u8]) -> Vec<u8> {
    let mut value = vec![version, key[0]];
    value.extend_from_slice(&revision.to_be_bytes());
    value.extend_from_slice(&(content.len() as u32).to_be_bytes());
    value.extend_from_slice(content);
    let sum = crc32c::crc32c(&[&(key.len() as u32).to_be_bytes()[..], key, &value].concat());
    value.extend_from_slice(&sum.to_be_bytes());
    value
}

fn block_key(map: u32, x: u32, y: u32) -> Vec<u8> {
    let morton = BlockAddress { x, y }.morton();
    [&[0x30][..], &map.to_be_bytes(), &morton.to_be_bytes()].concat()
}

/// Two maps, `a` (1) and `b` (2).
fn two_maps(directory: &Path) -> (MapId, MapId, ubbmap::store::LoadedMap) {
    let store = open(directory).unwrap();
    let (a, _) = fill(&store, "a", config(10, 10, 2), 1, 8);
    let (b, model) = fill(&store, "b", config(9, 40, 1), 2, 8);
    (a, b, model.loaded())
}

/// What opening and reading everything says.
fn complaints(directory: &Path) -> String {
    match open(directory) {
        Err(error) => error.to_string(),
        Ok(store) => {
            let maps = store.list().unwrap();
            let loads = maps.iter().filter_map(|map| store.load(map.id).err().map(|error| error.to_string()));
            let left_out = store.damaged().into_iter().map(|map| map.what);
            left_out.chain(loads).collect::<Vec<_>>().join("; ")
        }
    }
}

#[test]
fn a_flipped_bit_in_any_record_is_named_and_stays_in_its_map() {
    let directory = tempfile::tempdir().unwrap();
    let (a, b, of_b) = two_maps(directory.path());
    assert_eq!(complaints(directory.path()), "");
    let records: Vec<_> = raw(directory.path(), |db| db.iter().map(Result::unwrap).collect());
    assert!(records.len() > 40, "{} records", records.len());
    let mut random = ChaCha8Rng::seed_from_u64(5);
    for (key, value) in &records {
        let bit = random.random_range(0..value.len() * 8);
        let mut changed = value.to_vec();
        changed[bit / 8] ^= 1 << (bit % 8);
        raw(directory.path(), |db| db.insert(key, changed).unwrap());

        let found = complaints(directory.path());
        let expected = match key[0] {
            0x01 => "the store's header".to_owned(),
            0x02 => "the counter of map numbers".to_owned(),
            0x03 => "the number of the last write".to_owned(),
            0x10 => format!("the name \"{}\"", std::str::from_utf8(&key[1..]).unwrap()),
            _ => format!("map {}", u32::from_be_bytes(key[1..5].try_into().unwrap())),
        };
        assert!(found.contains("damaged record") && found.contains(&expected), "{key:?}, bit {bit}: {found:?}");
        assert!(found.contains("checksum"), "{key:?}, bit {bit}: {found:?}");
        if key[0] == 0x30 {
            let code = u64::from_be_bytes(key[5..].try_into().unwrap());
            let BlockAddress { x, y } = BlockAddress::from_morton(code);
            assert!(found.contains(&format!("block ({x}, {y})")), "{found:?}");
        }
        let of_a = key[0] == 0x10 && &key[1..] == b"a" || key[0] > 0x10 && key[1..5] == a.0.to_be_bytes();
        if of_a {
            let store = open(directory.path()).unwrap();
            assert_same(&store.load(b).unwrap(), &of_b);
            let problems = store.verify().unwrap().problems;
            assert!(problems.len() == 1 && problems[0].contains(&expected), "{problems:?}");
        }
        raw(directory.path(), |db| db.insert(key, value).unwrap());
    }
    assert_eq!(complaints(directory.path()), "");
}

#[test]
fn the_name_of_a_damaged_map_stays_taken_and_the_map_can_be_deleted() {
    let directory = tempfile::tempdir().unwrap();
    let (a, b, of_b) = two_maps(directory.path());
    let key = [&[0x11][..], &a.0.to_be_bytes()].concat();
    raw(directory.path(), |db| db.insert(&key, framed(&key, 1, 0, b"nonsense")).unwrap());
    let store = open(directory.path()).unwrap();
    assert_eq!(store.list().unwrap().iter().map(|map| map.id).collect::<Vec<_>>(), [b]);
    let damaged = store.damaged();
    assert_eq!((damaged.len(), damaged[0].id, damaged[0].name.as_ref()), (1, Some(a), Some(&name("a"))));
    assert!(matches!(store.load(a), Err(StoreError::Damaged { .. })));
    assert!(matches!(store.create(&name("a"), &config(8, 10, 1), 0.0), Err(StoreError::Damaged { .. })));
    store.delete(a).unwrap();
    assert!(store.damaged().is_empty());
    let again = store.create(&name("a"), &config(8, 10, 1), 0.0).unwrap();
    assert!(again > b);
    assert_same(&store.load(b).unwrap(), &of_b);
    assert_eq!(store.verify().unwrap().problems, Vec::<String>::new());
}

#[test]
fn a_lost_moved_late_or_stray_record_is_seen() {
    let directory = tempfile::tempdir().unwrap();
    let (a, ..) = two_maps(directory.path());
    let prefix = [&[0x30][..], &a.0.to_be_bytes()].concat();
    let (key, value) = raw(directory.path(), |db| db.scan_prefix(&prefix).next().unwrap().unwrap());
    let other = raw(directory.path(), |db| db.scan_prefix(&prefix).nth(1).unwrap().unwrap().0);
    let window =
        raw(directory.path(), |db| db.scan_prefix([&[0x20][..], &a.0.to_be_bytes()].concat()).next().unwrap().unwrap());
    let outside = block_key(a.0, 16, 0);
    let plain = |key: &[u8], revision| framed(key, 1, revision, &[0b0010_0000]);
    for (edits, expected) in [
        (vec![(key.to_vec(), None)], "blocks found of"),
        (vec![(window.0.to_vec(), None)], "windows found of"),
        (vec![(other.to_vec(), Some(value.to_vec()))], "checksum"),
        (vec![(key.to_vec(), Some(plain(&key, 99)))], "of revision 99, but the map's is 8"),
        (vec![(outside.clone(), Some(plain(&outside, 1)))], "outside the map"),
        (vec![(key.to_vec(), Some(framed(&key, 1, 1, &[0b0101_0000])))], "class 11"),
        (vec![(key.to_vec(), Some(framed(&key, 2, 1, &[0])))], "8 bytes wanted"),
        (vec![(key.to_vec(), Some(framed(&key, 3, 1, &[0])))], "format version 3"),
        (vec![(key.to_vec(), Some(Vec::new()))], "0 bytes"),
    ] {
        let before: Vec<_> =
            raw(directory.path(), |db| edits.iter().map(|(key, _)| (key.clone(), db.get(key).unwrap())).collect());
        let put = |db: &sled::Db, key: &[u8], value: Option<&[u8]>| match value {
            Some(value) => db.insert(key, value).unwrap(),
            None => db.remove(key).unwrap(),
        };
        raw(directory.path(), |db| {
            for (key, value) in &edits {
                put(db, key, value.as_deref());
            }
        });
        let found = complaints(directory.path());
        assert!(found.contains(expected) && found.contains("map 1"), "{expected}: {found:?}");
        raw(directory.path(), |db| {
            for (key, value) in &before {
                put(db, key, value.as_deref());
            }
        });
        assert_eq!(complaints(directory.path()), "", "after {expected}");
    }
}

#[test]
fn a_newer_store_is_refused_as_newer() {
    let directory = tempfile::tempdir().unwrap();
    two_maps(directory.path());
    raw(directory.path(), |db| {
        let content = [&7_u32.to_be_bytes()[..], b"whatever version 7 holds"].concat();
        db.insert([0x01], framed(&[0x01], 1, 0, &content)).unwrap()
    });
    match open(directory.path()) {
        Err(StoreError::NewerFormat { found: 7, supported: STORE_FORMAT, .. }) => {}
        other => panic!("{other:?}"),
    }
}

#[test]
fn a_directory_that_has_lost_its_store_is_not_taken_for_an_empty_one() {
    let error = |prepare: &dyn Fn(&Path)| {
        let directory = tempfile::tempdir().unwrap();
        two_maps(directory.path());
        prepare(directory.path());
        let error = open(directory.path()).unwrap_err().to_string();
        assert!(error.contains(directory.path().to_str().unwrap()), "{error}");
        error
    };
    let no_header = error(&|path| {
        raw(path, |db| db.remove([0x01]).unwrap());
    });
    assert!(no_header.contains("no header"), "{no_header}");
    let no_data = error(&|path| std::fs::remove_file(path.join("sled/db")).unwrap());
    assert!(no_data.contains("lost its data file"), "{no_data}");
    let without_mark = |path: &Path| std::fs::remove_file(path.join("acknowledged")).unwrap();
    let gone = error(&|path| std::fs::remove_dir_all(path.join("sled")).unwrap());
    assert!(gone.contains("\"acknowledged\""), "{gone}");
    let moved = error(&|path| {
        without_mark(path);
        std::fs::rename(path.join("sled"), path.join("sled.before")).unwrap();
    });
    assert!(moved.contains("sled.before"), "{moved}");
    let foreign = error(&|path| {
        without_mark(path);
        std::fs::rename(path.join("sled/db"), path.join("db")).unwrap();
        std::fs::remove_dir_all(path.join("sled")).unwrap();
    });
    assert!(foreign.contains("\"db\""), "{foreign}");
    let emptied = error(&|path| {
        std::fs::write(path.join("sled/db"), []).unwrap();
        for entry in std::fs::read_dir(path.join("sled")).unwrap() {
            let path = entry.unwrap().path();
            if path.file_name().unwrap().to_str().unwrap().starts_with("snap.") {
                std::fs::remove_file(path).unwrap();
            }
        }
    });
    assert!(emptied.contains("no header"), "{emptied}");
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(40))]

    /// sled's own files changed at random: an error, or maps that say what is wrong, or (where the change hit nothing
    /// that counts) the maps as they were; never a panic, never an empty store.
    #[test]
    fn changed_files_never_panic_and_never_open_empty(
        file in prop::sample::select(vec!["db", "conf", "snap"]), at in 0.0..1.0, cut: bool, byte: u8,
    ) {
        let directory = tempfile::tempdir().unwrap();
        two_maps(directory.path());
        let entries = std::fs::read_dir(directory.path().join("sled")).unwrap().map(|entry| entry.unwrap().path());
        for path in entries.filter(|path| path.file_name().unwrap().to_str().unwrap().starts_with(file)) {
            let mut bytes = std::fs::read(&path).unwrap();
            let used = bytes.iter().rposition(|byte| *byte != 0).map_or(0, |last| last + 1);
            let place = (at * used as f64) as usize;
            if cut {
                bytes.truncate(place);
            } else if let Some(old) = bytes.get_mut(place) {
                *old = byte;
            }
            std::fs::write(&path, bytes).unwrap();
        }
        match open(directory.path()) {
            Err(error) => prop_assert!(error.to_string().contains(directory.path().to_str().unwrap()), "{error}"),
            Ok(store) => {
                for map in store.list().unwrap() {
                    let _ = store.load(map.id);
                }
                let _ = store.verify();
            }
        }
    }
}

/// sled opens a database with a bit flipped in the last segment of its log, and leaves out all that follows.
#[test]
fn writes_that_sled_drops_in_silence_are_missed() {
    let (directory, copy) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    two_maps(directory.path());
    let files: Vec<_> = ["acknowledged", "sled/db", "sled/conf"]
        .into_iter()
        .map(|file| (file, std::fs::read(directory.path().join(file)).unwrap()))
        .collect();
    let used = files[1].1.iter().rposition(|byte| *byte != 0).unwrap();
    let mut random = ChaCha8Rng::seed_from_u64(5);
    let mut missed = 0;
    for _ in 0..60 {
        let path = copy.path().join(random.random::<u64>().to_string());
        std::fs::create_dir_all(path.join("sled")).unwrap();
        for (file, bytes) in &files {
            let mut bytes = bytes.clone();
            if *file == "sled/db" {
                bytes[random.random_range(0..used)] ^= 1 << random.random_range(0..8);
            }
            std::fs::write(path.join(file), bytes).unwrap();
        }
        match open(&path) {
            Err(error) => {
                let error = error.to_string();
                assert!(error.contains(path.to_str().unwrap()) || error.contains("damaged"), "{error}");
                if error.contains("acknowledged") {
                    missed += 1;
                    // It stays so until someone decides to go on with what is left.
                    let again = open(&path).unwrap_err().to_string();
                    assert!(again.contains("remove the file"), "{again}");
                    std::fs::remove_file(path.join("acknowledged")).unwrap();
                    open(&path).unwrap().list().unwrap();
                }
            }
            Ok(store) => {
                let maps = store.list().unwrap();
                assert_eq!(maps.iter().map(|map| map.revision).collect::<Vec<_>>(), [8, 8]);
                maps.iter().for_each(|map| drop(store.load(map.id).unwrap()));
            }
        }
    }
    assert!(missed > 20, "{missed} losses of 60 flips were seen as losses");
}

/// sled takes the newest of its files `snap.*` for its snapshot, also one that it had only begun to write.
#[test]
fn an_opening_that_was_cut_off_while_sled_wrote_a_snapshot_kept_the_store_shut() {
    for left in [&b""[..], b"half of one"] {
        let directory = tempfile::tempdir().unwrap();
        let (_, b, of_b) = two_maps(directory.path());
        let unfinished = directory.path().join("sled/snap.00000000FFFFFFFF.generating");
        std::fs::write(&unfinished, left).unwrap();
        let store = open(directory.path()).unwrap();
        assert_same(&store.load(b).unwrap(), &of_b);
        assert!(!unfinished.exists());
    }
}

/// sled goes on behind a damaged message in its log with the next segment; what the pages had been before is then sound in itself.
#[test]
fn records_of_an_earlier_time_in_the_middle_of_the_log_were_served() {
    let directory = tempfile::tempdir().unwrap();
    let (a, mut model) = fill(&open(directory.path()).unwrap(), "a", config(10, 10, 2), 1, 8);
    let records = || -> std::collections::BTreeMap<Vec<u8>, Vec<u8>> {
        let own = |key: &[u8]| key[0] >= 0x13 && key[1..5] == a.0.to_be_bytes();
        let all = |db: &sled::Db| db.iter().map(Result::unwrap).collect::<Vec<_>>();
        let all = raw(directory.path(), all).into_iter().map(|(key, value)| (key.to_vec(), value.to_vec()));
        all.filter(|(key, _)| own(key)).collect()
    };
    let earlier = records();
    let store = open(directory.path()).unwrap();
    for _ in 0..6 {
        store.commit(a, &model.step(6)).unwrap();
    }
    drop(store);
    let later = records();
    let replaced: Vec<_> = earlier.iter().filter(|(key, value)| later[*key] != **value).collect();
    let put = |records: &[(&Vec<u8>, &Vec<u8>)]| {
        raw(directory.path(), |db| {
            for (key, value) in records {
                db.insert(key.as_slice(), value.as_slice()).unwrap();
            }
        });
    };
    let mut kinds = std::collections::BTreeSet::new();
    let check = |what: &[u8], set: &[(&Vec<u8>, &Vec<u8>)]| {
        put(set);
        let found = complaints(directory.path());
        assert!(found.contains("map 1") || found.contains("gone back"), "{what:?}: {found:?}");
        put(&later.iter().collect::<Vec<_>>());
        assert_eq!(complaints(directory.path()), "");
    };
    for (key, value) in &replaced {
        kinds.insert(key[0]);
        check(key, &[(*key, *value)]);
    }
    assert_eq!(kinds.into_iter().collect::<Vec<_>>(), [0x13, 0x20, 0x30, 0x31]);
    // All blocks with their groups, all windows, and the whole map.
    let of = |kinds: &[u8]| replaced.iter().filter(|(key, _)| kinds.contains(&key[0])).copied().collect::<Vec<_>>();
    for set in [&[0x30, 0x31][..], &[0x20], &[0x20, 0x30, 0x31], &[0x13, 0x20, 0x30, 0x31]] {
        check(set, &of(set));
    }
    // What the operator may do: go on with what is left.
    put(&of(&[0x13, 0x20, 0x30, 0x31]));
    let error = open(directory.path()).unwrap_err().to_string();
    assert!(error.contains("gone back to an earlier revision") && error.contains("acknowledged"), "{error}");
}

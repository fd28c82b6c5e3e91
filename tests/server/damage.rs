//! Random damage to the files of a data directory: it is named, or nothing that is served is wrong.
//!
//! `UBBMAP_DAMAGES` says how many are tried (200). `store_damage.rs` has damage to single records.

use crate::crash_support::{Bulk, compare, copy_directory, named, say, scratch, setting};
use crate::store_support::{Model, config, fill};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::collections::BTreeMap;
use std::fs;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::{Path, PathBuf};
use tempfile::TempDir;
use ubbmap::mapping::MapConfig;
use ubbmap::store::{LoadedMap, MapId, MapStore, SledOptions, SledStore, StoreError};

/// A sound directory, and what is in it.
struct Sound {
    directory: TempDir,
    /// The same at an earlier time.
    earlier: TempDir,
    maps: Vec<Kept>,
}

/// A map as it must be read.
struct Kept {
    id: MapId,
    name: &'static str,
    config: MapConfig,
    loaded: LoadedMap,
}

/// Four maps that grow together, and one whose blocks are most of what is alive in the files. `closed`: as a store leaves its files when it is closed, else as they are while it is
/// open.
fn sound(closed: bool) -> Sound {
    let (directory, earlier, working) = (scratch(), scratch(), scratch());
    let (mut maps, mut large, bulk) = (Vec::new(), None, Bulk::new());
    for begun in [true, false] {
        // Opened twice, so that there is a snapshot of sled's and a log behind it.
        let store = SledStore::open(working.path(), SledOptions::default()).unwrap();
        if begun {
            for (name, depth, classes) in [("a", 10, 10), ("b", 9, 40), ("c", 12, 255), ("d", 7, 4)] {
                let (id, model) = fill(&store, name, config(depth, classes, 1), u64::from(depth), 0);
                maps.push((id, name, model));
            }
            large = Some(store.create(&named("large"), &bulk.config, 0.0).unwrap());
        }
        store.commit(large.unwrap(), &bulk.commit(if begun { 1 } else { 2 })).unwrap();
        for _ in 0..30 {
            for (id, _, model) in &mut maps {
                store.commit(*id, &model.step(8)).unwrap();
            }
        }
        if begun {
            drop(store);
            copy_directory(working.path(), earlier.path());
        } else if closed {
            drop(store);
            copy_directory(working.path(), directory.path());
        } else {
            copy_directory(working.path(), directory.path());
        }
    }
    let kept = |(id, name, model): (MapId, &'static str, Model)| Kept {
        id,
        name,
        config: model.config.clone(),
        loaded: model.loaded(),
    };
    let mut maps: Vec<Kept> = maps.into_iter().map(kept).collect();
    maps.push(Kept { id: large.unwrap(), name: "large", config: bulk.config.clone(), loaded: bulk.at(2) });
    Sound { directory, earlier, maps }
}

fn files(directory: &Path) -> BTreeMap<PathBuf, Vec<u8>> {
    let mut found = BTreeMap::new();
    for entry in fs::read_dir(directory).unwrap().map(|entry| entry.unwrap().path()) {
        if entry.is_dir() {
            found.extend(files(&entry));
        } else {
            let bytes = fs::read(&entry).unwrap();
            found.insert(entry, bytes);
        }
    }
    found
}

/// Damages a copy of the directory in one way; says how.
fn damage(directory: &Path, sound: &Sound, random: &mut ChaCha8Rng) -> String {
    let files = files(directory);
    let paths: Vec<&PathBuf> = files.keys().collect();
    let db = directory.join("sled/db");
    let path = if random.random_bool(0.6) { &db } else { paths[random.random_range(0..paths.len())] };
    let mut bytes = files[path].clone();
    // Mostly where something is written.
    let used = bytes.iter().rposition(|byte| *byte != 0).map_or(0, |last| last + 1);
    let end = if random.random_bool(0.9) { used } else { bytes.len() };
    let place = |random: &mut ChaCha8Rng| if end == 0 { 0 } else { random.random_range(0..end) };
    let at = place(random);
    let page = |at: usize| at / 4096 * 4096..(at / 4096 * 4096 + 4096).min(files[path].len());
    let how = match random.random_range(0..11) {
        0..4 => {
            if let Some(byte) = bytes.get_mut(at) {
                *byte ^= 1 << random.random_range(0..8);
            }
            format!("a bit at {at} flipped")
        }
        4 => {
            bytes.truncate(at);
            format!("cut at {at}")
        }
        5 => {
            bytes[page(at)].fill(0);
            format!("a page at {at} zeroed")
        }
        6 => {
            let (from, to) = (page(place(random)), page(at));
            let length = from.len().min(to.len());
            let copy = bytes[from.start..from.start + length].to_vec();
            bytes[to.start..to.start + length].copy_from_slice(&copy);
            format!("a page of {} written over the one at {at}", from.start)
        }
        7 => {
            bytes.extend((0..random.random_range(1..9000)).map(|_| random.random::<u8>()));
            "grown by random bytes".to_owned()
        }
        8 => {
            fs::remove_file(path).unwrap();
            return format!("{} missing", path.display());
        }
        9 => {
            let other = paths[random.random_range(0..paths.len())];
            fs::write(path, &files[other]).unwrap();
            fs::write(other, &bytes).unwrap();
            return format!("{} and {} swapped", path.display(), other.display());
        }
        _ => {
            let name = path.strip_prefix(directory).unwrap();
            let Ok(earlier) = fs::read(sound.earlier.path().join(name)) else { return "nothing".to_owned() };
            bytes = earlier;
            "as it was earlier".to_owned()
        }
    };
    fs::write(path, bytes).unwrap();
    format!("{}: {how}", path.display())
}

/// What came of one damage.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
enum Came {
    /// The store is not opened, with the reason.
    Refused,
    /// Opened, with damage named in some maps; the others are right.
    Named,
    /// Everything is there.
    Whole,
}

/// Opens a damaged directory. The error is what must not be.
fn look(directory: &Path, sound: &Sound) -> Result<Came, String> {
    let store = match SledStore::open(directory, SledOptions::default()) {
        Ok(store) => store,
        Err(error) => return refused(directory, &error),
    };
    let (listed, damaged) = (store.list().map_err(|error| error.to_string())?, store.damaged());
    let mut came = Came::Whole;
    for Kept { id, name, config, loaded } in &sound.maps {
        let Some(map) = listed.iter().find(|map| map.id == *id) else {
            let named = damaged.iter().find(|map| map.name.as_ref().is_some_and(|found| found.as_str() == *name));
            let what = &named.ok_or_else(|| format!("map {name} is gone without a word"))?.what;
            if !what.contains("map") && !what.contains("name") {
                return Err(format!("map {name}: {what:?} does not say what is damaged"));
            }
            came = Came::Named;
            continue;
        };
        if map.name.as_str() != *name || map.config != *config {
            return Err(format!("map {name} is another: {map:?}"));
        }
        if let Err(why) = compare(&store, *id, loaded) {
            let of_map = why.contains(&format!("map {}", id.0));
            let failed = ["loading: ", "opening: ", "reading a block: "].iter().any(|start| why.starts_with(start));
            if !of_map || !failed {
                return Err(format!("map {name}: {why}"));
            }
            if why.starts_with("reading a block: ") && !why.contains("block (") {
                return Err(format!("map {name}: {why}: the block is not named"));
            }
            came = Came::Named;
            check_on_demand(&store, *id, loaded).map_err(|why| format!("map {name}: {why}"))?;
        }
    }
    if came == Came::Named {
        drop(store);
        without_the_damaged(directory, sound)?;
        return Ok(came);
    }
    if listed.len() + damaged.len() > sound.maps.len() {
        return Err(format!("maps that never were: {listed:?}, {damaged:?}"));
    }
    Ok(came)
}

/// Deletes what is damaged, as an operator would: what cannot be removed must not keep the rest from being served.
fn without_the_damaged(directory: &Path, sound: &Sound) -> Result<(), String> {
    let whole = |store: &SledStore, kept: &&Kept| compare(store, kept.id, &kept.loaded).is_ok();
    let store = SledStore::open(directory, SledOptions::default()).map_err(|e| format!("opened once only: {e}"))?;
    let (served, lost): (Vec<&Kept>, Vec<&Kept>) = sound.maps.iter().partition(|kept| whole(&store, kept));
    for Kept { id, .. } in lost {
        // A write that meets the damage is refused, and all that follow.
        let _ = store.delete(*id);
    }
    drop(store);
    let store = SledStore::open(directory, SledOptions::default());
    let store = store.map_err(|error| format!("after the damaged maps were deleted: {error}"))?;
    match served.iter().find(|kept| !whole(&store, kept)) {
        Some(kept) => Err(format!("map {} went with the damaged ones", kept.name)),
        None => Ok(()),
    }
}

/// A map of which not everything can be read: each of its blocks is right, or refused by itself.
fn check_on_demand(store: &SledStore, id: MapId, loaded: &LoadedMap) -> Result<(), String> {
    let cache = std::sync::Arc::new(ubbmap::quadtree::BlockCache::new(1 << 20));
    let Ok(open) = store.open(id, &cache) else { return Ok(()) };
    let mut wrong = None;
    loaded.tree.visit_blocks(&mut |address, view| match open.tree.try_block(address) {
        Ok(found) if found != *view => wrong = Some(format!("block {address:?} is wrong")),
        Ok(_) => {}
        Err(error) if error.to_string().contains(&format!("block ({}, {})", address.x, address.y)) => {}
        Err(error) => wrong = Some(format!("block {address:?} is not named: {error}")),
    });
    wrong.map_or(Ok(()), Err)
}

fn refused(directory: &Path, error: &StoreError) -> Result<Came, String> {
    let text = error.to_string();
    let named = text.contains(directory.to_str().unwrap())
        || ["the store's header", "the counter of map numbers", "the number of the last write", "the names of maps"]
            .iter()
            .any(|what| text.contains(what));
    if named { Ok(Came::Refused) } else { Err(format!("refused without saying what is wrong: {text}")) }
}

/// A database that is not opened is there as it was: in its place, or beside it.
fn not_kept(directory: &Path, before: &BTreeMap<PathBuf, Vec<u8>>) -> Option<String> {
    let database = directory.join("sled");
    let kept = |path: &Path, bytes: &Vec<u8>| {
        let beside = directory.join("damaged").join(path.strip_prefix(&database).unwrap());
        [path, &beside].iter().any(|path| fs::read(path).is_ok_and(|found| found == *bytes))
    };
    let of_database = before.iter().filter(|(path, _)| path.starts_with(&database));
    let lost = of_database.filter(|(path, bytes)| !kept(path, bytes)).map(|(path, _)| path);
    let lost: Vec<_> = lost.collect();
    (!lost.is_empty()).then(|| format!("not kept as they were: {lost:?}"))
}

#[test]
fn no_damage_to_the_files_panics_starts_empty_or_serves_a_wrong_class() {
    let (count, seed) = (setting("UBBMAP_DAMAGES", 200), setting("UBBMAP_DAMAGE_SEED", 1));
    let grounds = [sound(true), sound(false)];
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let mut came = BTreeMap::new();
    let mut wrong = Vec::new();
    for number in 0..count {
        let sound = &grounds[random.random_range(0..grounds.len())];
        let directory = scratch();
        copy_directory(sound.directory.path(), directory.path());
        let how = damage(directory.path(), sound, &mut random);
        let before = files(directory.path());
        match catch_unwind(AssertUnwindSafe(|| look(directory.path(), sound))) {
            Ok(Ok(found)) => {
                *came.entry(found).or_insert(0) += 1;
                if found == Came::Refused {
                    wrong.extend(
                        not_kept(directory.path(), &before).map(|why| format!("damage {number}: {how}: {why}")),
                    );
                }
            }
            Ok(Err(why)) => wrong.push(format!("damage {number}: {how}: {why}")),
            Err(_) => wrong.push(format!("damage {number}: {how}: panicked")),
        }
    }
    let line = format!("damage: {count} from seed {seed}: {came:?}");
    say(&line);
    assert!(wrong.is_empty(), "{line}; {} wrong: {wrong:#?}", wrong.len());
    // How often damage is named hangs on how the pages came to lie; single records are in `store_damage.rs`.
    let often = |came_to: Came| came.get(&came_to).is_some_and(|times| *times > count / 100);
    assert!(often(Came::Refused) && often(Came::Whole), "{line}");
}

/// In a database that was just rewritten pages lie close: a flipped bit is in a page that is read.
#[test]
fn a_deleted_map_with_a_page_that_cannot_be_read_kept_the_store_from_opening() {
    let sound = sound(true);
    let rewritten = scratch();
    copy_directory(sound.directory.path(), rewritten.path());
    SledStore::open(rewritten.path(), SledOptions::default()).unwrap().rewrite(&mut |_| Ok(())).unwrap();
    let bytes = fs::read(rewritten.path().join("sled-2/db")).unwrap();
    let used: Vec<usize> = (0..bytes.len()).filter(|at| bytes[*at] != 0).collect();
    let mut random = ChaCha8Rng::seed_from_u64(11);
    let mut met = 0;
    for _ in 0..300 {
        let directory = scratch();
        copy_directory(rewritten.path(), directory.path());
        let mut changed = bytes.clone();
        changed[used[random.random_range(0..used.len())]] ^= 1 << random.random_range(0..8);
        fs::write(directory.path().join("sled-2/db"), changed).unwrap();
        let Ok(Ok(store)) =
            catch_unwind(AssertUnwindSafe(|| SledStore::open(directory.path(), SledOptions::default())))
        else {
            continue;
        };
        let lost = sound.maps.iter().any(|kept| compare(&store, kept.id, &kept.loaded).is_err());
        drop(store);
        if lost {
            met += 1;
            without_the_damaged(directory.path(), &sound).unwrap();
        }
        if met == 8 {
            return;
        }
    }
    assert!(met > 0, "no flipped bit left a store that opens with a damaged map");
}

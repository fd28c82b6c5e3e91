//! Power cuts: a process at work is recorded, its files are rebuilt as of random instants, and what was acknowledged
//! must be in them.
//!
//! `UBBMAP_POWER_CUTS` says how many instants are tried (50). The first half of the instants of a series is in the
//! process that made the directory, the second in one that went on with a directory that had been cut.

use crate::crash_support::{Bulk, Course, compare, copy_directory, find, named, same, say, scratch, setting};
use crate::power_cut_child::{LIVES, Task, courses_of, send};
use crate::power_cut_disk::Recording;
use crate::power_cut_trace::{obstacle, watched};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::Path;
use std::sync::Arc;
use tempfile::TempDir;
use ubbmap::service::{MapService, ServiceSettings};
use ubbmap::store::{LoadedMap, MapStore, SledOptions, SledStore};

/// Instants tried in one recording.
const CUTS_OF_A_LIFE: u64 = 25;

/// Directories kept of those in which something is lost.
const KEPT: usize = 3;

/// What was acknowledged of one map.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Promise {
    /// It is there, with this revision or the next, whose acknowledgement was not given yet.
    There(u64),
    /// A deletion was under way: it is there as it was, or gone.
    Going(u64),
    Gone,
}

/// What was acknowledged by the directory's process and those before it.
#[derive(Debug, Clone, Default)]
struct Promises {
    opened: bool,
    maps: BTreeMap<String, Promise>,
    /// Map and revision.
    snapshots: BTreeSet<(String, u64)>,
}

impl Promises {
    fn keep(&mut self, line: &str) {
        let words: Vec<&str> = line.split(' ').collect();
        let name = words.get(1).copied().unwrap_or_default().to_owned();
        match words[0] {
            "open" => self.opened = true,
            "created" => drop(self.maps.entry(name).or_insert(Promise::There(0))),
            "applied" => drop(self.maps.insert(name, Promise::There(words[2].parse().unwrap()))),
            "kept" => drop(self.snapshots.insert((name, words[2].parse().unwrap()))),
            "deleting" => {
                let Some(Promise::There(revision)) = self.maps.get(&name).copied() else { panic!("{line}") };
                self.maps.insert(name, Promise::Going(revision));
            }
            "deleted" => drop(self.maps.insert(name, Promise::Gone)),
            _ => panic!("{line}"),
        }
    }
}

/// What the maps of a series must be.
struct Expected {
    courses: Vec<Course>,
    bulk: Bulk,
}

impl Expected {
    fn at(&self, name: &str, revision: u64) -> Option<LoadedMap> {
        if name == "bulk" {
            return Some(self.bulk.at(revision));
        }
        let number = name.strip_prefix("hall-").map_or(0, |number| number.parse().unwrap());
        self.courses[number].at(revision)
    }
}

/// What a rebuilt directory is: the maps in it, or nothing where nothing was acknowledged.
#[derive(Debug, Default)]
struct Found {
    revisions: BTreeMap<String, u64>,
    snapshots: BTreeSet<(String, u64)>,
    refused: bool,
}

/// Opens a rebuilt directory and holds it against the promises. The error says what is lost or wrong.
fn check(data: &Path, promises: &Promises, expected: &Expected) -> Result<Found, String> {
    let store = match SledStore::open(data, SledOptions::default()) {
        Ok(store) => store,
        Err(_) if !promises.opened => return Ok(Found { refused: true, ..Found::default() }),
        Err(error) => return Err(format!("it does not open: {error}")),
    };
    if !store.damaged().is_empty() {
        return Err(format!("damaged maps: {:?}", store.damaged()));
    }
    let mut found = Found::default();
    for map in store.list().unwrap() {
        let (name, revision) = (map.name.to_string(), map.revision);
        match promises.maps.get(&name) {
            Some(Promise::Gone) => return Err(format!("{name} was deleted and is there")),
            Some(Promise::There(least)) if !(*least..=least + 1).contains(&revision) => {
                return Err(format!("{name} is at revision {revision}, {least} was acknowledged"));
            }
            Some(Promise::Going(least)) if revision != *least => {
                return Err(format!("{name} is at revision {revision}, {least} was to be deleted"));
            }
            None if revision > 0 => return Err(format!("{name} has a commit before its creation was acknowledged")),
            _ => {}
        }
        let sought =
            expected.at(&name, revision).ok_or_else(|| format!("{name} has an unknown revision {revision}"))?;
        compare(&store, map.id, &sought).map_err(|why| format!("{name}: {why}"))?;
        for snapshot in store.snapshots(map.id).unwrap() {
            let kept = store.load_snapshot(map.id, &snapshot.name).map_err(|why| format!("{name}: {why}"))?;
            let sought = expected.at(&name, snapshot.revision).ok_or_else(|| format!("{name}: {snapshot:?}"))?;
            same(&kept, &sought).map_err(|why| format!("{name}, snapshot {}: {why}", snapshot.name))?;
            if snapshot.name.as_str() != format!("r{}", kept.revision) {
                return Err(format!("{name}: {snapshot:?} is of another revision"));
            }
            found.snapshots.insert((name.clone(), snapshot.revision));
        }
        found.revisions.insert(name, revision);
    }
    if let Some((name, revision)) = promises.snapshots.difference(&found.snapshots).next() {
        return Err(format!("the snapshot of {name} at {revision} is gone"));
    }
    let lost = promises
        .maps
        .iter()
        .find(|(name, promise)| matches!(promise, Promise::There(_)) && !found.revisions.contains_key(*name));
    if let Some((name, promise)) = lost {
        return Err(format!("{name} is gone, {promise:?} was acknowledged"));
    }
    let problems = store.verify().unwrap().problems;
    if problems.is_empty() { Ok(found) } else { Err(format!("records are wrong: {problems:?}")) }
}

/// The robots go on where their maps are.
fn go_on(data: &Path, expected: &Expected) {
    let runtime = tokio::runtime::Runtime::new().unwrap();
    let store = Arc::new(SledStore::open(data, SledOptions::default()).unwrap());
    let service = MapService::open(Arc::clone(&store) as Arc<dyn MapStore>, ServiceSettings::default()).unwrap();
    for (number, course) in expected.courses.iter().enumerate() {
        let name = named(&format!("hall-{number}"));
        runtime.block_on(async {
            service.create_map(&name, course.config.clone()).await.unwrap();
            let revision = service.map(&name).await.unwrap().revision;
            send(&service, &name, &course.requests[revision as usize], revision + 1).await;
        });
        let (id, revision) = find(&*store, name.as_str()).unwrap();
        compare(&*store, id, &course.at(revision).unwrap()).unwrap();
    }
}

/// Runs a child that goes on with `root/data`, and what it did.
fn record(task: &Task, before: &Path) -> Recording {
    let log = task.root.join("strace.log");
    let program = std::env::current_exe().unwrap();
    let (variable, value) = task.to_variable();
    let output = watched(&program, &log)
        .args(["--exact", "power_cut_child::power_cut_child", "--ignored", "--nocapture"])
        .env(variable, value)
        .output()
        .unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let recording = Recording::read(&log, &task.root, before, "acks");
    fs::remove_file(&log).unwrap();
    recording
}

/// An instant: right after an acknowledgement, while the store is being made, or any.
fn instant(recording: &Recording, random: &mut ChaCha8Rng) -> usize {
    let opened = recording.told[0].0;
    match random.random_range(0..10) {
        0..4 => recording.told[random.random_range(0..recording.told.len())].0 + 1,
        4 => random.random_range(0..=opened),
        _ => recording.moments[random.random_range(0..recording.moments.len())] + random.random_range(0..2),
    }
}

/// What a series of cuts came to.
#[derive(Debug, Default)]
struct Outcome {
    cuts: u64,
    /// Cuts after the first acknowledgement.
    promised: u64,
    /// Directories that were cut while they were made and are not opened.
    refused: u64,
    lost: Vec<String>,
}

/// Cuts the power of a recorded life at so many instants. Returns a directory that was cut and what it holds.
fn cut(
    recording: &Recording,
    kept: &Promises,
    expected: &Expected,
    cuts: u64,
    random: &mut ChaCha8Rng,
    outcome: &mut Outcome,
) -> Option<(TempDir, Found)> {
    let mut last = None;
    for number in 0..cuts {
        let at = instant(recording, random);
        let mut promises = kept.clone();
        recording.told.iter().filter(|(line, _)| *line < at).for_each(|(_, line)| promises.keep(line));
        let rebuilt = scratch();
        recording.rebuild(at, random, rebuilt.path());
        let spare = scratch();
        copy_directory(rebuilt.path(), spare.path());
        let data = rebuilt.path().join("data");
        outcome.cuts += 1;
        outcome.promised += u64::from(promises.opened);
        match check(&data, &promises, expected) {
            Ok(found) => {
                outcome.refused += u64::from(found.refused);
                if number % 8 == 0 && !found.refused {
                    go_on(&data, expected);
                } else if promises.opened {
                    last = Some((rebuilt, found));
                }
            }
            Err(why) => {
                // The first ones are kept to be looked into.
                let files = if outcome.lost.len() < KEPT { spare.keep().display().to_string() } else { String::new() };
                outcome.lost.push(format!("cut at line {at} of {}: {why} (files: {files})", recording.lines));
            }
        }
    }
    last
}

/// One directory through several lives, each cut and gone on with.
fn series(seed: u64, mut cuts: u64, outcome: &mut Outcome) {
    let expected = Expected { courses: courses_of(seed), bulk: Bulk::new() };
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let mut promises = Promises::default();
    let mut cut_directory: Option<(TempDir, Found)> = None;
    for life in 0..LIVES {
        let root = tempfile::tempdir().unwrap();
        if let Some((directory, found)) = cut_directory.take() {
            copy_directory(&directory.path().join("data"), &root.path().join("data"));
            // What was found after the cut was shown to clients, so it must stay.
            let kept = found.revisions.into_iter().map(|(name, revision)| (name, Promise::There(revision)));
            promises = Promises { opened: true, maps: kept.collect(), snapshots: found.snapshots };
        }
        let before = tempfile::tempdir().unwrap();
        copy_directory(root.path(), before.path());
        let task = Task { root: root.path().into(), seed, life, syncs: true };
        let recording = record(&task, before.path());
        assert_end_is_as_left(&recording, root.path(), &mut random);
        let now = cuts.min(CUTS_OF_A_LIFE);
        cuts -= now;
        cut_directory = cut(&recording, &promises, &expected, now, &mut random, outcome);
        if cuts == 0 || cut_directory.is_none() {
            return;
        }
    }
}

/// Nothing that the process did to its files is missing from the recording.
fn assert_end_is_as_left(recording: &Recording, root: &Path, random: &mut ChaCha8Rng) {
    let mut left = BTreeMap::new();
    read_all(&root.join("data"), &mut left);
    assert!(left.len() >= 4, "{:?}", left.keys());
    // What the process was at when it ended may have been done or not. sled shortens its file by several threads at the
    // same time, so the length may be that of any of them; what is beyond the shortest is zeros.
    let differing = [true, false].map(|unfinished| {
        let rebuilt = scratch();
        recording.rebuild_end(unfinished, random, rebuilt.path());
        let mut found = BTreeMap::new();
        read_all(&rebuilt.path().join("data"), &mut found);
        assert!(found.keys().eq(left.keys()), "{:?} instead of {:?}", found.keys(), left.keys());
        let differing = found.iter().filter(|(name, bytes)| !same_but_for_zeros(bytes, &left[*name]));
        differing.map(|(name, bytes)| (name.clone(), bytes.len(), left[name].len())).collect::<Vec<_>>()
    });
    assert!(differing.iter().any(Vec::is_empty), "files, their lengths replayed and left: {differing:?}");
}

fn same_but_for_zeros(one: &[u8], other: &[u8]) -> bool {
    let shorter = one.len().min(other.len());
    one[..shorter] == other[..shorter] && one[shorter..].iter().chain(&other[shorter..]).all(|byte| *byte == 0)
}

fn read_all(directory: &Path, into: &mut BTreeMap<String, Vec<u8>>) {
    for entry in fs::read_dir(directory).unwrap().map(Result::unwrap) {
        let name = entry.file_name().into_string().unwrap();
        if entry.file_type().unwrap().is_dir() {
            read_all(&entry.path(), into);
        } else {
            into.insert(name, fs::read(entry.path()).unwrap());
        }
    }
}

#[test]
fn what_was_acknowledged_survives_a_power_cut_at_any_instant() {
    if let Some(why) = obstacle() {
        say(&format!("left out: power cuts, {why}"));
        return;
    }
    let (total, seed) = (setting("UBBMAP_POWER_CUTS", 50), setting("UBBMAP_POWER_CUT_SEED", 1));
    let mut outcome = Outcome::default();
    for number in 0.. {
        let left = total - outcome.cuts;
        if left == 0 {
            break;
        }
        series(seed + number, left, &mut outcome);
    }
    let Outcome { cuts, promised, refused, lost } = &outcome;
    let line =
        format!("power cuts: {cuts} from seed {seed}, {promised} after the store was open, {refused} not opened");
    say(&line);
    assert!(lost.is_empty(), "{line}; {} lost: {lost:#?}", lost.len());
    assert!(*promised > cuts / 3, "{line}");
}

/// The same without the one sync that counts: the replay finds what is lost then.
#[test]
fn without_the_sync_of_the_data_file_power_cuts_lose_what_was_acknowledged() {
    if let Some(why) = obstacle() {
        say(&format!("left out: power cuts without a sync, {why}"));
        return;
    }
    let (root, before) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    let task = Task { root: root.path().into(), seed: 7, life: 0, syncs: false };
    let recording = record(&task, before.path());
    let expected = Expected { courses: courses_of(7), bulk: Bulk::new() };
    let mut outcome = Outcome::default();
    cut(&recording, &Promises::default(), &expected, 12, &mut ChaCha8Rng::seed_from_u64(7), &mut outcome);
    for lost in &outcome.lost {
        let path = lost.rsplit_once("(files: ").unwrap().1.trim_end_matches(')');
        if !path.is_empty() {
            fs::remove_dir_all(path).unwrap();
        }
    }
    assert!(outcome.lost.len() > 2, "{outcome:?}");
}

//! A long run of updates: the size stays in proportion to what is held, and what is held is right.
//!
//! `UBBMAP_SOAK_SECONDS=3600 cargo test --release --test server long_soak -- --ignored --nocapture` prints a line a minute.

use crate::store_support::{Model, assert_same, config, name};
use crate::store_upkeep::wait_until;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::{Duration, Instant};
use ubbmap::quadtree::{Block, BlockAddress, BlockView};
use ubbmap::store::{Commit, MapId, MapStore, MemoryStore, RewriteOptions, SledOptions, SledStore, StoreStatistics};

/// Threads that write, each to maps of its own.
const WRITERS: u64 = 3;

/// One writer's maps: most live on, one is made, filled and deleted over and over.
struct Writer {
    number: u64,
    kept: Vec<(MapId, MapId, Model)>,
    rounds: u64,
    /// The longest commit since it was last asked for, microseconds.
    longest: u64,
}

impl Writer {
    fn new(number: u64, maps: u64, store: &SledStore, twin: &MemoryStore) -> Self {
        let make = |n: u64| {
            let map_config = config(12, if n.is_multiple_of(2) { 10 } else { 200 }, 1);
            let label = format!("w{number}-{n}");
            let id = store.create(&name(&label), &map_config, 1.5e9).unwrap();
            let of_twin = twin.create(&name(&label), &map_config, 1.5e9).unwrap();
            (id, of_twin, Model::new(map_config, number * 1000 + n))
        };
        Self { number, kept: (0..maps).map(make).collect(), rounds: 0, longest: 0 }
    }

    /// A commit to every map, the same to the twin, and now and then a map that comes and goes; how many commits.
    fn round(&mut self, store: &SledStore, twin: &MemoryStore, gone: Gone) -> u64 {
        for (id, of_twin, model) in &mut self.kept {
            let commit = model.step(8);
            let start = Instant::now();
            store.commit(*id, &commit).unwrap();
            self.longest = self.longest.max(start.elapsed().as_micros() as u64);
            twin.commit(*of_twin, &commit).unwrap();
        }
        self.rounds += 1;
        let mut commits = self.kept.len() as u64;
        if self.rounds.is_multiple_of(gone.every) {
            commits += gone.come_and_go(&format!("gone-{}", self.number), store);
        }
        commits
    }

    fn compare(&self, store: &SledStore, twin: &MemoryStore) {
        for (id, of_twin, model) in &self.kept {
            let found = store.load(*id).unwrap();
            assert_same(&found, &twin.load(*of_twin).unwrap());
            assert_same(&found, &model.loaded());
        }
    }
}

/// Maps that come and go.
#[derive(Clone, Copy)]
struct Gone {
    /// One a writer after so many of its rounds.
    every: u64,
    /// Of so many blocks, 4 KB each.
    blocks: u32,
}

impl Gone {
    /// Makes a map, fills it and deletes it; how many commits that took.
    fn come_and_go(self, map: &str, store: &SledStore) -> u64 {
        let id = store.create(&name(map), &config(12, 255, 1), 1.5e9).unwrap();
        let mut leaves = Box::new([1; 64 * 64]);
        for (index, class) in leaves.iter_mut().enumerate() {
            *class = (index % 255) as u8 + 1;
        }
        let full = BlockView::Mixed(Arc::new(Block::from_leaves(leaves)));
        let blocks: Vec<_> = (0..self.blocks).map(|n| (BlockAddress { x: n % 64, y: n / 64 }, full.clone())).collect();
        let mut revision = 0;
        for blocks in blocks.chunks(60) {
            revision += 1;
            store.commit(id, &Commit { revision, changed: 0.0, blocks: blocks.to_vec(), windows: Vec::new() }).unwrap();
        }
        store.delete(id).unwrap();
        revision
    }
}

/// What a soak saw.
struct Soaked {
    commits: u64,
    highest_bytes: u64,
    last: StoreStatistics,
}

/// Writes and reads until it is enough, and compares everything at the end, also after opening it anew.
fn soak(
    directory: &Path,
    options: SledOptions,
    (maps, gone): (u64, Gone),
    enough: &(dyn Fn(u64, &StoreStatistics) -> bool + Sync),
    told: &mut dyn FnMut(u64, u64, &AtomicU64, &StoreStatistics),
) -> Soaked {
    let (store, twin) = (SledStore::open(directory, options).unwrap(), MemoryStore::new());
    let mut writers: Vec<_> = (0..WRITERS).map(|number| Writer::new(number, maps, &store, &twin)).collect();
    let (commits, longest, done) = (AtomicU64::new(0), AtomicU64::new(0), AtomicBool::new(false));
    let mut highest_bytes = 0;
    std::thread::scope(|scope| {
        for writer in &mut writers {
            scope.spawn(|| {
                while !done.load(Ordering::SeqCst) {
                    commits.fetch_add(writer.round(&store, &twin, gone), Ordering::SeqCst);
                    longest.fetch_max(std::mem::take(&mut writer.longest), Ordering::SeqCst);
                }
            });
        }
        scope.spawn(|| {
            while !done.load(Ordering::SeqCst) {
                for map in store.list().unwrap() {
                    // A map that is gone meanwhile.
                    let _ = store.load(map.id);
                }
                std::thread::sleep(Duration::from_millis(20));
            }
        });
        loop {
            std::thread::sleep(Duration::from_millis(10));
            highest_bytes = highest_bytes.max(store.disk_bytes().unwrap());
            let (commits, seen) = (commits.load(Ordering::SeqCst), store.statistics().unwrap());
            told(commits, highest_bytes, &longest, &seen);
            if enough(commits, &seen) {
                break done.store(true, Ordering::SeqCst);
            }
        }
    });
    let limit = |seen: &StoreStatistics| seen.live_bytes.map(|live| options.rewrite.limit(live));
    wait_until(&store, "the size is brought below its limit", |seen| {
        limit(seen).is_some_and(|limit| seen.disk_bytes <= limit + (64 << 10))
    });
    assert_eq!(store.verify().unwrap().problems, Vec::<String>::new());
    writers.iter().for_each(|writer| writer.compare(&store, &twin));
    let last = store.statistics().unwrap();
    drop(store);
    let store = SledStore::open(directory, options).unwrap();
    writers.iter().for_each(|writer| writer.compare(&store, &twin));
    Soaked { commits: commits.into_inner(), highest_bytes, last }
}

#[test]
fn a_store_that_is_rewritten_again_and_again_while_it_is_written_to_holds_what_its_twin_does() {
    let directory = tempfile::tempdir().unwrap();
    let rewrite = RewriteOptions { factor: 2.5, least_bytes: 1 << 20, check: Duration::from_millis(5) };
    let options = SledOptions { rewrite, ..SledOptions::default() };
    let soaked = soak(
        directory.path(),
        options,
        (2, Gone { every: 25, blocks: 150 }),
        &|commits, seen| commits >= 3000 && seen.rewrites >= 5 || seen.failed_rewrites > 0,
        &mut |_, _, _, _| (),
    );
    assert_eq!(soaked.last.failed_rewrites, 0);
    assert!(soaked.commits >= 3000 && soaked.last.rewrites >= 5);
    assert!(soaked.highest_bytes > soaked.last.disk_bytes);
}

#[test]
#[ignore = "runs for UBBMAP_SOAK_SECONDS and prints figures"]
#[allow(clippy::print_stdout, reason = "the figures are for whoever runs it")]
fn long_soak() {
    let number = |variable: &str, default: f64| {
        std::env::var(variable).map_or(default, |text| text.parse().unwrap_or_else(|_| panic!("{variable}={text:?}")))
    };
    let length = Duration::from_secs_f64(number("UBBMAP_SOAK_SECONDS", 60.0));
    let every = Duration::from_secs_f64(number("UBBMAP_SOAK_EVERY", 60.0));
    let rewrite = RewriteOptions {
        factor: number("UBBMAP_SOAK_FACTOR", RewriteOptions::default().factor),
        ..RewriteOptions::default()
    };
    let options = SledOptions { rewrite, ..SledOptions::default() };
    let directory = tempfile::tempdir().unwrap();
    let start = Instant::now();
    let mut next = every;
    let mut before = 0;
    println!(
        "| minute | commits | commits/s | longest, ms | held, MB | on disk, MB | factor | most on disk, MB | rewrites |"
    );
    println!("| ---: | ---: | ---: | ---: | ---: | ---: | ---: | ---: | ---: |");
    let mut told = |commits: u64, highest: u64, longest: &AtomicU64, seen: &StoreStatistics| {
        if start.elapsed() < next {
            return;
        }
        let live = seen.live_bytes.unwrap_or(0) as f64;
        println!(
            "| {:.1} | {commits} | {:.0} | {:.0} | {:.1} | {:.1} | {:.2} | {:.1} | {} |",
            start.elapsed().as_secs_f64() / 60.0,
            (commits - before) as f64 / every.as_secs_f64(),
            longest.swap(0, Ordering::SeqCst) as f64 / 1e3,
            live / 1e6,
            seen.disk_bytes as f64 / 1e6,
            seen.disk_bytes as f64 / live,
            highest as f64 / 1e6,
            seen.rewrites,
        );
        before = commits;
        next += every;
    };
    let soaked = soak(
        directory.path(),
        options,
        (60, Gone { every: 300, blocks: 3000 }),
        &|_, _| start.elapsed() >= length,
        &mut told,
    );
    println!(
        "{} commits, at most {:.1} MB on disk, {:?}",
        soaked.commits,
        soaked.highest_bytes as f64 / 1e6,
        soaked.last
    );
}

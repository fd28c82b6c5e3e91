//! An hour at half load: robots over every transport, planners and watchers, while the server is ended and started again,
//! snapshots are taken, restored and deleted. At the end nothing has grown beyond its bounds, the log has no error, and the
//! map is the one that is built offline from the scans that were acknowledged.
//!
//! `cargo bench --bench load -- soak [--minutes 60] [--robots 24]`. The capacity is measured first, with the same robots without
//! pauses. It ends with an error where anything was wrong. What it wrote stays in the folder that it names.

mod judge;
mod ledger;
mod process;
mod robots;
mod samples;
mod watchers;

use crate::figures::{Latencies, percentile};
use crate::robots::Fleet;
use crate::server::map_config;
use ledger::{Ledger, Restored, Span};
use process::{Ending, Process};
use samples::{Bounds, Sample, metric};
use std::collections::BTreeMap;
use std::path::Path;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};
use tokio::task::JoinSet;
use ubbmap::wire::v1;

/// Scans of each robot that are simulated.
const SCANS: usize = 300;

/// How many parts the time is cut into; each begins with a snapshot.
const TICKS: u32 = 60;

/// Ticks at which the server is ended and started again, by a signal and by a kill in turns. Between the third and the fourth
/// it runs for half of the time, so that what grows slowly is seen.
const RESTARTS: [u32; 6] = [5, 10, 15, 45, 50, 55];

/// One tick of so many restores a snapshot.
const RESTORES: u32 = 7;

/// Snapshots that are kept.
const KEPT: usize = 5;

/// What may go wrong so long after the server was started again, since clients find out late.
const UNREST: Duration = Duration::from_secs(15);

/// How long it is looked how much the server carries.
const CAPACITY: Duration = Duration::from_secs(20);

/// What all who take part share.
#[derive(Clone)]
pub struct Shared {
    url: String,
    zenoh: String,
    robots: usize,
    fleet: Arc<Fleet>,
    ledger: Arc<Ledger>,
    acknowledged: Latencies,
    asked: Latencies,
    over: Arc<AtomicBool>,
    /// The revision at the end; 0 until then.
    last_revision: Arc<AtomicU64>,
    events: Arc<AtomicU64>,
    changes: Arc<AtomicU64>,
    anew: Arc<AtomicU64>,
    /// From when on nothing may fail.
    calm: Arc<Mutex<Option<Instant>>>,
    trouble: Arc<Mutex<BTreeMap<(bool, String), u64>>>,
    wrong: Arc<Mutex<Vec<String>>>,
}

impl Shared {
    fn new(process: &Process, robots: usize, fleet: &Arc<Fleet>) -> Self {
        Self {
            url: process.url(),
            zenoh: process.zenoh.clone(),
            robots,
            fleet: Arc::clone(fleet),
            ledger: Arc::new(Ledger::new(robots)),
            acknowledged: Latencies::default(),
            asked: Latencies::default(),
            over: Arc::default(),
            last_revision: Arc::default(),
            events: Arc::default(),
            changes: Arc::default(),
            anew: Arc::default(),
            calm: Arc::new(Mutex::new(Some(Instant::now() + UNREST))),
            trouble: Arc::default(),
            wrong: Arc::default(),
        }
    }

    pub fn is_over(&self) -> bool {
        self.over.load(Ordering::Relaxed)
    }

    fn set_calm(&self, from: Option<Instant>) {
        *self.calm.lock().unwrap_or_else(PoisonError::into_inner) = from;
    }

    /// Something failed that may fail while the server is away.
    pub fn trouble(&self, what: &str) {
        let calm = self.calm.lock().unwrap_or_else(PoisonError::into_inner).is_some_and(|from| Instant::now() >= from);
        // Revisions and ports would make each one its own.
        let what: String = what.chars().filter(|letter| !letter.is_ascii_digit()).take(160).collect();
        let mut trouble = self.trouble.lock().unwrap_or_else(PoisonError::into_inner);
        let count = trouble.entry((calm, what.clone())).or_default();
        *count += 1;
        if calm && *count == 1 {
            println!("while nothing was restarted: {what}");
        }
    }

    /// Something that must never be.
    pub fn wrong(&self, what: &str) {
        println!("WRONG: {what}");
        self.wrong.lock().unwrap_or_else(PoisonError::into_inner).push(what.to_owned());
    }
}

/// A snapshot that was taken.
struct Kept {
    name: String,
    revision: u64,
    taken: Span,
}

/// Runs it and prints its figures.
///
/// # Panics
/// Where anything was wrong.
pub async fn run(minutes: f64, robots: usize) {
    let directory = tempfile::tempdir_in(env!("CARGO_TARGET_TMPDIR")).unwrap().keep();
    println!("soak: {minutes} minutes, {robots} robots, in {}", directory.display());
    let fleet = Arc::new(Fleet::with_scans(robots, SCANS));
    let capacity = capacity(&directory.join("capacity"), robots, &fleet).await;
    println!("carries {capacity:.0} scans/s; half of it is sent");
    let mut soak = Soak::start(&directory.join("soak"), robots, &fleet, capacity / 2.0).await;
    soak.pass(Duration::from_secs_f64(60.0 * minutes)).await;
    soak.finish().await;
    let wrong = soak.tell();
    assert!(wrong.is_empty(), "{} things are wrong:\n{}", wrong.len(), wrong.join("\n"));
    println!("\nnothing wrong");
}

async fn create_map(url: &str) {
    let request = v1::CreateMapRequest { map: "hall".to_owned(), config: Some(map_config()) };
    robots::lazy(url).create_map(request).await.unwrap();
}

/// Scans a second that are acknowledged when no robot pauses.
async fn capacity(directory: &Path, robots: usize, fleet: &Arc<Fleet>) -> f64 {
    std::fs::create_dir_all(directory).unwrap();
    let mut process = Process::new(directory);
    process.start(false);
    create_map(&process.url()).await;
    let shared = Shared::new(&process, robots, fleet);
    let mut work = JoinSet::new();
    for robot in 0..robots {
        work.spawn(robots::drive(shared.clone(), robot, Duration::ZERO));
    }
    tokio::time::sleep(Duration::from_secs(3)).await;
    let before = shared.ledger.counts().0;
    tokio::time::sleep(CAPACITY).await;
    let rate = (shared.ledger.counts().0 - before) as f64 / CAPACITY.as_secs_f64();
    shared.over.store(true, Ordering::Relaxed);
    while let Some(ended) = work.join_next().await {
        ended.unwrap();
    }
    process.end(Ending::Term);
    rate
}

struct Soak {
    process: Process,
    shared: Shared,
    work: JoinSet<()>,
    copy: Option<tokio::task::JoinHandle<watchers::Copy>>,
    bounds: Bounds,
    begun: Instant,
    restarts: usize,
    kept: Vec<Kept>,
    restored: Vec<Restored>,
    samples: Vec<Sample>,
    notes: Vec<String>,
}

impl Soak {
    async fn start(directory: &Path, robots: usize, fleet: &Arc<Fleet>, rate: f64) -> Self {
        std::fs::create_dir_all(directory).unwrap();
        let mut process = Process::new(directory);
        process.start(false);
        create_map(&process.url()).await;
        let shared = Shared::new(&process, robots, fleet);
        let period = Duration::from_secs_f64(robots as f64 * robots::SCANS as f64 / rate);
        let mut work = JoinSet::new();
        for robot in 0..robots {
            work.spawn(robots::drive(shared.clone(), robot, period));
        }
        work.spawn(watchers::plan(shared.clone()));
        let watcher = shared.clone();
        std::thread::spawn(move || watchers::server_sent(&watcher));
        let copy = Some(tokio::spawn(watchers::copy(shared.clone())));
        let bounds = Bounds::new(robots + 8);
        let (kept, restored, samples, notes) = (Vec::new(), Vec::new(), Vec::new(), Vec::new());
        let begun = Instant::now();
        Self { process, shared, work, copy, bounds, begun, restarts: 0, kept, restored, samples, notes }
    }

    fn minute(&self) -> f64 {
        self.begun.elapsed().as_secs_f64() / 60.0
    }

    fn note(&mut self, what: String) {
        println!("{:6.1}  {what}", self.minute());
        self.notes.push(what);
    }

    /// Everything that happens, one after the other.
    async fn pass(&mut self, time: Duration) {
        let tick = time / TICKS;
        for turn in 1..=TICKS {
            let end = self.begun + tick * turn;
            self.snapshot(turn).await;
            if turn.is_multiple_of(RESTORES) {
                self.restore().await;
            }
            while Instant::now() < end {
                self.sample().await;
                let next = (Instant::now() + Duration::from_secs(10).min(tick / 4)).min(end);
                tokio::time::sleep_until(next.into()).await;
            }
            if RESTARTS.contains(&turn) {
                self.restart().await;
            }
        }
        self.sample().await;
    }

    async fn metrics(&self) -> String {
        let url = format!("{}/metrics", self.process.url());
        let text = tokio::task::spawn_blocking(move || robots::agent().get(url).call()?.body_mut().read_to_string());
        text.await.unwrap().unwrap_or_default()
    }

    async fn sample(&mut self) {
        let (metrics, minute) = (self.metrics().await, self.minute());
        let sample = self.process.id().and_then(|id| Sample::of(id, &self.process.data(), &metrics));
        match sample {
            Some(sample) if !metrics.is_empty() => self.samples.push(Sample { minute, start: self.restarts, ..sample }),
            _ => self.shared.wrong("the server could not be looked at"),
        }
    }

    async fn snapshot(&mut self, turn: u32) {
        let (name, begin) = (format!("s{turn}"), Instant::now());
        let request = v1::CreateSnapshotRequest { map: "hall".to_owned(), name: name.clone() };
        match robots::lazy(&self.shared.url).create_snapshot(request).await {
            Ok(answer) => {
                let (revision, taken) = (answer.into_inner().revision, Span { begin, end: Instant::now() });
                self.kept.push(Kept { name, revision, taken });
            }
            Err(status) => self.shared.wrong(&format!("no snapshot: {status:?}")),
        }
        while self.kept.len() > KEPT {
            let Kept { name, .. } = self.kept.remove(0);
            let request = v1::DeleteSnapshotRequest { map: "hall".to_owned(), name };
            if let Err(status) = robots::lazy(&self.shared.url).delete_snapshot(request).await {
                self.shared.wrong(&format!("a snapshot is not deleted: {status:?}"));
            }
        }
    }

    /// One of those of which it is known what they hold, the newest but one where there is one.
    async fn restore(&mut self) {
        let certain: Vec<&Kept> = self.kept.iter().filter(|kept| self.shared.ledger.is_certain(kept.taken)).collect();
        let Some(chosen) = certain.iter().rev().nth(1).or_else(|| certain.last()) else {
            return self.note("no snapshot that is certain: none restored".to_owned());
        };
        let (name, from) = (chosen.name.clone(), chosen.revision);
        let request = v1::RestoreSnapshotRequest { map: "hall".to_owned(), name: name.clone() };
        let begun = Instant::now();
        match robots::lazy(&self.shared.url).restore_snapshot(request).await {
            Ok(answer) => {
                let revision = answer.into_inner().revision;
                self.restored.push(Restored { from, revision });
                self.note(format!(
                    "restored {name}: revision {from} is {revision} now, {:.2} s",
                    begun.elapsed().as_secs_f64()
                ));
            }
            Err(status) => self.shared.wrong(&format!("{name} is not restored: {status:?}")),
        }
    }

    async fn restart(&mut self) {
        self.shared.set_calm(None);
        let how = if self.restarts.is_multiple_of(2) { Ending::Term } else { Ending::Kill };
        let before = self.shared.ledger.counts();
        let ended = self.process.end(how);
        let started = self.process.start(how == Ending::Kill);
        self.shared.set_calm(Some(Instant::now() + UNREST));
        self.restarts += 1;
        let again = self.shared.ledger.counts().1 - before.1;
        self.note(format!(
            "{how:?}: gone after {:.2} s, there again after {:.2} s; {} scans so far ({again} requests in doubt by then)",
            ended.as_secs_f64(),
            started.as_secs_f64(),
            before.0
        ));
    }

    /// The last acknowledgements, then what the map is.
    async fn finish(&mut self) {
        self.shared.over.store(true, Ordering::Relaxed);
        while let Some(ended) = self.work.join_next().await {
            ended.unwrap();
        }
        let file = watchers::export(&self.shared, "").await.unwrap();
        let revision = ubbmap::store::read_map_file(&mut &*file).unwrap().1.revision;
        self.shared.last_revision.store(revision, Ordering::Relaxed);
        let copy = self.copy.take().unwrap();
        match tokio::time::timeout(Duration::from_secs(60), copy).await {
            Ok(copy) => match copy.unwrap().compare(&file) {
                Ok(blocks) => self.note(format!("the watcher's copy of {blocks} blocks is the map")),
                Err(what) => self.shared.wrong(&what),
            },
            Err(_) => self.shared.wrong("the watcher's copy does not come to the map's revision"),
        }
        self.judge("the map at the end", &file);
        let certain = self.kept.iter().rev().find(|kept| self.shared.ledger.is_certain(kept.taken));
        if let Some(name) = certain.map(|kept| kept.name.clone()) {
            match watchers::export(&self.shared, &name).await {
                Ok(file) => self.judge(&format!("snapshot {name}"), &file),
                Err(what) => self.shared.wrong(&format!("{name} is not exported: {what}")),
            }
        }
        self.rest().await;
        self.process.end(Ending::Term);
        let data = self.process.data();
        let verified = tokio::task::spawn_blocking(move || {
            let store = ubbmap::store::SledStore::open(&data, ubbmap::store::SledOptions::default()).unwrap();
            store.verify().unwrap().problems
        });
        for problem in verified.await.unwrap() {
            self.shared.wrong(&format!("the store: {problem}"));
        }
    }

    fn judge(&mut self, what: &str, file: &[u8]) {
        let shared = &self.shared;
        match judge::judge(file, &shared.ledger, &self.restored, &shared.fleet, shared.robots) {
            Ok(equal) => self.note(format!("{what}: {equal}")),
            Err(differs) => shared.wrong(&format!("{what}: {differs}")),
        }
    }

    /// When all clients have gone, nothing of theirs is left.
    async fn rest(&mut self) {
        const GAUGES: [&str; 5] = [
            "ubbmap_queue_depth",
            "ubbmap_streams_open",
            "ubbmap_watchers",
            "ubbmap_transfers_open",
            "ubbmap_answer_bytes",
        ];
        let mut left = String::new();
        for _ in 0..80 {
            let metrics = self.metrics().await;
            let still = GAUGES.iter().filter(|name| metric(&metrics, name) != 0.0);
            left = still.map(|name| format!("{name} {} ", metric(&metrics, name))).collect();
            if left.is_empty() {
                return;
            }
            tokio::time::sleep(Duration::from_millis(500)).await;
        }
        self.shared.wrong(&format!("left behind by clients that have gone: {left}"));
    }

    /// Prints the figures; what was wrong.
    fn tell(&self) -> Vec<String> {
        let told = Duration::from_secs_f64(60.0 * self.samples.last().map_or(0.0, |sample| sample.minute));
        samples::table(&self.samples, 12, told);
        let mut wrong = self.shared.wrong.lock().unwrap_or_else(PoisonError::into_inner).clone();
        println!(
            "\nbounds: memory {:.0} MB, {:.0} open files, {:.0} threads",
            self.bounds.memory / 1e6,
            self.bounds.files,
            self.bounds.threads
        );
        wrong.extend(self.bounds.judge(&self.samples, 3));
        let (scans, again) = self.shared.ledger.counts();
        let acks = self.shared.acknowledged.take();
        let ms = |times: &[f64], share: f64| 1000.0 * percentile(times, share);
        println!(
            "{scans} scans acknowledged, {:.0} a second; {again} requests were sent more than once",
            scans as f64 / told.as_secs_f64()
        );
        println!("requests of {} p50 {:.1} ms p99 {:.1} ms", robots::SCANS, ms(&acks, 0.5), ms(&acks, 0.99));
        let asked = self.shared.asked.take();
        println!("{} questions p50 {:.1} ms p99 {:.1} ms", asked.len(), ms(&asked, 0.5), ms(&asked, 0.99));
        println!(
            "{} events, {} messages of the watch, which took the whole map {} times",
            self.shared.events.load(Ordering::Relaxed),
            self.shared.changes.load(Ordering::Relaxed),
            self.shared.anew.load(Ordering::Relaxed)
        );
        for ((calm, what), count) in self.shared.trouble.lock().unwrap_or_else(PoisonError::into_inner).iter() {
            println!("{} {count} times: {what}", if *calm { "while nothing was restarted" } else { "around restarts" });
            if *calm {
                wrong.push(format!("{count} times while nothing was restarted: {what}"));
            }
        }
        let (complaints, explained) = self.process.complaints();
        println!("{} warnings of starts after a kill", explained.len());
        explained.iter().for_each(|line| println!("  {line}"));
        wrong.extend(complaints);
        wrong
    }
}

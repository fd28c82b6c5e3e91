//! Robots that send scans: one thread and one request at a time each.

use crate::cli::client::{Client, ClientError};
use crate::cli::output::note;
use crate::store::{MapName, RobotName};
use crate::wire::v1;
use prost::Message;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

/// A request is not made larger than this, bytes: half of what servers take by default.
const MAX_REQUEST_BYTES: usize = 8 << 20;

/// Rejected scans that are named on stderr; the others are counted.
const REJECTIONS_SHOWN: u64 = 10;

/// A server that is away or busy for less is not worth a line.
const WAIT_UNTOLD: Duration = Duration::from_secs(1);

/// How often a line tells of a server that is still away or busy.
const WAIT_TOLD_EVERY: Duration = Duration::from_secs(5);

/// Tells on stderr that a server is waited for: not at once, and not often.
#[derive(Debug)]
pub(in crate::cli) struct Waiting {
    /// When the next line is due; `None` while the server answers.
    due: Mutex<Option<Instant>>,
}

impl Waiting {
    /// Nobody waits yet.
    pub(in crate::cli) fn new() -> Self {
        Self { due: Mutex::new(None) }
    }

    /// An attempt has failed, and another will follow.
    pub(in crate::cli) fn failed(&self, attempt: u32, error: &ClientError) {
        let mut due = self.due.lock().unwrap_or_else(PoisonError::into_inner);
        let now = Instant::now();
        let time = *due.get_or_insert(now + WAIT_UNTOLD);
        if now >= time {
            *due = Some(now + WAIT_TOLD_EVERY);
            drop(due);
            note(&format!("waiting for the server, attempt {}: {error}", attempt.saturating_add(1)));
        }
    }

    /// The server has answered.
    fn over(&self) {
        *self.due.lock().unwrap_or_else(PoisonError::into_inner) = None;
    }
}

/// A scan to send, with its line or number in the log (0 for none).
pub(in crate::cli) struct Numbered {
    pub(in crate::cli) line: u64,
    pub(in crate::cli) scan: v1::Scan,
}

/// What the robots share.
pub(in crate::cli) struct Team {
    pub(in crate::cli) client: Client,
    pub(in crate::cli) map: MapName,
    /// How long a robot goes on trying without success.
    pub(in crate::cli) patience: Duration,
    /// Most scans of one request.
    pub(in crate::cli) batch: usize,
    /// Wait until a request is full; else send what is there.
    pub(in crate::cli) whole: bool,
    /// What [`Numbered::line`] counts.
    pub(in crate::cli) unit: &'static str,
}

/// What came of it.
#[derive(Debug, Default)]
pub(in crate::cli) struct Tally {
    /// Scans that the server answered for.
    pub(in crate::cli) sent: u64,
    /// Scans that were not sent, since the server had them.
    pub(in crate::cli) skipped: u64,
    pub(in crate::cli) applied: u64,
    pub(in crate::cli) duplicates: u64,
    pub(in crate::cli) rejected: u64,
    /// The highest revision that an answer named.
    pub(in crate::cli) revision: u64,
    /// What made the robots stop.
    pub(in crate::cli) failure: Option<ClientError>,
}

/// The counts while the robots are at work.
#[derive(Debug, Default)]
pub(in crate::cli) struct Running {
    pub(in crate::cli) sent: AtomicU64,
    pub(in crate::cli) skipped: AtomicU64,
    applied: AtomicU64,
    duplicates: AtomicU64,
    rejected: AtomicU64,
    revision: AtomicU64,
    stopped: AtomicBool,
    failure: Mutex<Option<ClientError>>,
}

impl Team {
    /// Starts a thread for each robot, lets `feed` hand scans over (its first argument takes the robot's index and a
    /// scan, waits while the robot is busy, and is false once the robots have stopped), and waits for all answers.
    pub(in crate::cli) fn run(
        &self,
        robots: &[RobotName],
        feed: impl FnOnce(&dyn Fn(usize, Numbered) -> bool, &Running),
    ) -> Tally {
        let running = Running::default();
        let waiting = Waiting::new();
        std::thread::scope(|scope| {
            let mut queues: Vec<SyncSender<Numbered>> = Vec::new();
            for _ in robots {
                let (queue, scans) = sync_channel(2 * self.batch);
                let (running, waiting) = (&running, &waiting);
                scope.spawn(move || self.robot(&scans, running, waiting));
                queues.push(queue);
            }
            feed(&|robot, scan| queues[robot].send(scan).is_ok() && !running.stopped.load(Ordering::Relaxed), &running);
            drop(queues);
        });
        running.into_tally()
    }

    fn robot(&self, scans: &Receiver<Numbered>, running: &Running, waiting: &Waiting) {
        let mut left_over = None;
        while !running.stopped.load(Ordering::Relaxed) {
            let Some(batch) = self.next_batch(scans, &mut left_over) else { return };
            let lines: Vec<u64> = batch.iter().map(|numbered| numbered.line).collect();
            let batch: Vec<v1::Scan> = batch.into_iter().map(|numbered| numbered.scan).collect();
            let stopped = || running.stopped.load(Ordering::Relaxed);
            let told = |attempt: u32, error: &ClientError| waiting.failed(attempt, error);
            match Client::patiently(self.patience, stopped, told, || self.client.insert(&self.map, &batch)) {
                Ok(answer) => {
                    waiting.over();
                    running.count(self.unit, &lines, &batch, &answer);
                }
                Err(error) => running.fail(error),
            }
        }
    }

    /// The scans of the next request, `None` when there are no more.
    fn next_batch(&self, scans: &Receiver<Numbered>, left_over: &mut Option<Numbered>) -> Option<Vec<Numbered>> {
        let first = match left_over.take() {
            Some(first) => first,
            None => scans.recv().ok()?,
        };
        let mut bytes = first.scan.encoded_len();
        let mut batch = vec![first];
        while batch.len() < self.batch {
            let next = if self.whole { scans.recv().ok() } else { scans.try_recv().ok() };
            let Some(next) = next else { break };
            bytes += next.scan.encoded_len();
            if bytes > MAX_REQUEST_BYTES {
                *left_over = Some(next);
                break;
            }
            batch.push(next);
        }
        Some(batch)
    }
}

impl Running {
    fn count(&self, unit: &str, lines: &[u64], scans: &[v1::Scan], answer: &v1::InsertScansResponse) {
        let add = |counter: &AtomicU64, count: u64| counter.fetch_add(count, Ordering::Relaxed);
        add(&self.sent, scans.len() as u64);
        add(&self.applied, u64::from(answer.applied));
        add(&self.duplicates, u64::from(answer.duplicates));
        let before = add(&self.rejected, answer.rejected.len() as u64);
        self.revision.fetch_max(answer.revision, Ordering::Relaxed);
        for (rejected, nth) in answer.rejected.iter().zip(before..REJECTIONS_SHOWN) {
            let line = lines.get(rejected.index as usize).map(|line| format!("{unit} {line}: ")).unwrap_or_default();
            note(&format!("{line}rejected: {} ({})", rejected.detail, rejected.code));
            if nth + 1 == REJECTIONS_SHOWN {
                note("further rejected scans are counted, not shown");
            }
        }
    }

    /// Keeps the first failure and stops all robots.
    fn fail(&self, error: ClientError) {
        let mut failure = self.failure.lock().unwrap_or_else(PoisonError::into_inner);
        failure.get_or_insert(error);
        self.stopped.store(true, Ordering::Relaxed);
    }

    fn into_tally(self) -> Tally {
        Tally {
            sent: self.sent.into_inner(),
            skipped: self.skipped.into_inner(),
            applied: self.applied.into_inner(),
            duplicates: self.duplicates.into_inner(),
            rejected: self.rejected.into_inner(),
            revision: self.revision.into_inner(),
            failure: self.failure.into_inner().unwrap_or_else(PoisonError::into_inner),
        }
    }
}

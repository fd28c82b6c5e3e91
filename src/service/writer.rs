//! The one writer of a map: drain, apply, commit, publish, acknowledge.
//!
//! A round takes what has arrived, in the order of arrival, and is one commit of the store. Readers hold published
//! roots, so they see what is durable and wait for nothing.

use super::budget::Reservation;
use super::changes::ChangeLog;
use super::evidence::too_old;
use super::failures::{map_not_found, store_failure};
use super::fair::Place;
use super::gate::Inside;
use super::limits::over;
use super::metrics;
use super::registry::now;
use super::robots::{Robots, Sighting};
use super::snapshots::Errand;
use super::tasks::{CancellationToken, mpsc, oneshot, spawn_blocking};
use super::{ErrorKind, InsertAnswer, Rejection, ServiceError, setting};
use crate::quadtree::{BlockAddress, BlockPager, Held, LeafMasks, PageError, PagedTree};
use crate::store::{
    BlockStamp, BlockStamps, Commit, MapId, MapName, MapStore, RobotName, SequenceVerdict, SequenceWindow, StoreError,
    StoredSnapshot,
};
use crate::sync::ArcSwap;
use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::Instant;

/// A map at one revision, all of it durable.
#[derive(Debug)]
pub(super) struct Published {
    pub(super) revision: u64,
    pub(super) tree: PagedTree,
    pub(super) windows: Arc<BTreeMap<RobotName, SequenceWindow>>,
    /// When each block last changed.
    pub(super) stamps: BlockStamps,
    /// The revision of the last restoring of a snapshot since the map was loaded; 0 before the first. Between two roots
    /// with the same one, nothing that was applied was taken back.
    pub(super) restored: u64,
}

/// What comes to a map's writer, done in the order of arrival.
#[cfg_attr(feature = "shuttle", expect(clippy::large_enum_variant, reason = "atomics of shuttle are large"))]
pub(super) enum Request {
    /// Several of them are one round.
    Scans(Job),
    /// Keeps the last revision under a name.
    Snapshot(Errand<StoredSnapshot>),
    /// Commits what a snapshot keeps; answered with the new revision.
    Restore(Errand<u64>),
}

/// A robot's own number of a scan.
#[derive(Debug, Clone)]
pub(super) struct Numbered {
    pub(super) robot: RobotName,
    pub(super) sequence: u64,
}

/// A good scan, computed.
#[derive(Debug)]
pub(super) struct ScanEvidence {
    /// Its index in the request.
    pub(super) index: usize,
    /// `None` is always applied.
    pub(super) numbered: Option<Numbered>,
    /// Where its robot was; `None` where it names none.
    pub(super) sighting: Option<Sighting>,
    pub(super) masks: LeafMasks,
}

/// An insertion at the writer.
pub(super) struct Job {
    pub(super) scans: Vec<ScanEvidence>,
    /// The duplicates among those that were found before the writer, by their index in the request.
    pub(super) known: Vec<(usize, Numbered)>,
    /// [`Published::restored`] of the root in which they were found.
    pub(super) restored: u64,
    /// What is known of the answer so far: refusals and duplicates found before the writer.
    pub(super) answer: InsertAnswer,
    pub(super) reply: oneshot::Sender<Result<InsertAnswer, ServiceError>>,
    pub(super) reservation: Reservation,
    pub(super) queued: metrics::Queued,
    pub(super) inside: Inside,
    /// Given back when the job's round begins.
    pub(super) place: Option<Place>,
}

impl Job {
    /// Answers the client, if it is still there; what was applied stays applied if it is not. What the request held
    /// is given back first, so that its sender's next request finds it free.
    fn reply(self, answer: Result<InsertAnswer, ServiceError>) {
        let Self { scans, reply, reservation, queued, inside, .. } = self;
        drop((scans, reservation, queued));
        let _ = reply.send(answer);
        drop(inside);
    }
}

/// What the writer needs of its map.
pub(super) struct Writer {
    pub(super) name: MapName,
    pub(super) id: MapId,
    pub(super) store: Arc<dyn MapStore>,
    pub(super) published: Arc<ArcSwap<Published>>,
    /// Where the map's blocks are read from; `None` when they stay in memory.
    pub(super) pager: Option<Arc<BlockPager>>,
    pub(super) changes: Arc<ChangeLog>,
    pub(super) robots: Arc<Robots>,
    pub(super) max_scans_per_commit: usize,
    pub(super) max_robots: usize,
    pub(super) max_name_bytes: usize,
    pub(super) max_snapshots: usize,
}

/// One round's changes on top of a published root; dropped without a trace when the commit fails.
struct Round<'a> {
    base: &'a Published,
    tree: PagedTree,
    changed: Vec<BlockAddress>,
    windows: BTreeMap<RobotName, SequenceWindow>,
    /// Robots that had no window before.
    new_robots: usize,
    applied: u64,
    /// Where robots were, in the order of arrival.
    seen: Vec<&'a Sighting>,
    /// What becomes of each scan, by its robot, once the round is stored.
    outcomes: Vec<(Option<RobotName>, metrics::Outcome)>,
    /// A block could not be read while evidence was applied: the round ends in this.
    broken: Option<PageError>,
}

impl Writer {
    /// Works until the queue's senders are gone or `stop` says that the map is deleted. `stopped` is cancelled as soon
    /// as no further commit can follow.
    pub(super) async fn run(
        self,
        mut queue: mpsc::UnboundedReceiver<Request>,
        stop: CancellationToken,
        stopped: CancellationToken,
    ) {
        let done = stopped.drop_guard();
        let writer = Arc::new(self);
        let mut held = None;
        loop {
            let first = match held.take() {
                Some(request) => request,
                None => tokio::select! {
                    biased;
                    () = stop.cancelled() => break,
                    request = queue.recv() => match request {
                        Some(request) => request,
                        None => return,
                    },
                },
            };
            // Looked at with the request in hand: whoever cancelled before this look may find no writer to wait for,
            // whoever cancels after it finds the map loaded and waits for the round.
            if stop.is_cancelled() {
                held = Some(first);
                break;
            }
            let worker = Arc::clone(&writer);
            let work: Box<dyn FnOnce() + Send> = match first {
                Request::Scans(first) => {
                    let jobs = drain(first, &mut queue, &mut held, writer.max_scans_per_commit);
                    Box::new(move || worker.round(jobs))
                }
                Request::Snapshot(errand) => Box::new(move || errand.run(|name| worker.take_snapshot(name))),
                Request::Restore(errand) => Box::new(move || errand.run(|name| worker.restore(name))),
            };
            if let Err(error) = spawn_blocking(work).await {
                // The requests of the round went with it: their clients are told that the server failed.
                tracing::error!(map = %writer.name, %error, "a commit's thread failed");
            }
        }
        drop(done);
        queue.close();
        if let Some(request) = held {
            request.refuse(map_not_found(&writer.name));
        }
        while let Some(request) = queue.recv().await {
            request.refuse(map_not_found(&writer.name));
        }
    }

    /// Applies the scans of a round, makes them durable, publishes, and acknowledges.
    fn round(&self, mut jobs: Vec<Job>) {
        jobs.iter_mut().for_each(|job| drop(job.place.take()));
        let started = Instant::now();
        let base = self.published.load_full();
        let mut round = Round::new(&base);
        let answers: Vec<InsertAnswer> = jobs.iter().map(|job| round.take(job, self)).collect();
        let outcomes = std::mem::take(&mut round.outcomes);
        let (scans, applied) = (jobs.iter().map(|job| job.scans.len() as u64).sum::<u64>(), round.applied);
        match self.store(round) {
            Ok(revision) => {
                outcomes.iter().for_each(|(robot, outcome)| metrics::robot_scan(robot.as_ref(), *outcome));
                for (job, mut answer) in jobs.into_iter().zip(answers) {
                    answer.revision = revision;
                    metrics::scans(metrics::Outcome::Applied, answer.applied);
                    metrics::scans(metrics::Outcome::Duplicate, answer.duplicates);
                    metrics::scans(metrics::Outcome::Rejected, answer.rejected.len() as u64);
                    job.reply(Ok(answer));
                }
                let seconds = started.elapsed().as_secs_f64();
                tracing::debug!(map = %self.name, revision, scans, applied, seconds, "committed");
            }
            Err(error) => {
                metrics::scans(metrics::Outcome::Failed, scans);
                let failed = metrics::Outcome::Failed;
                outcomes.iter().for_each(|(robot, _)| metrics::robot_scan(robot.as_ref(), failed));
                let error = store_failure(&self.name, "commit to", &error);
                for job in jobs {
                    job.reply(Err(error.clone()));
                }
            }
        }
    }

    /// Stores a round and publishes it; returns the revision that holds it.
    fn store(&self, mut round: Round<'_>) -> Result<u64, StoreError> {
        let (applied, base) = (round.applied, round.base);
        let seen = std::mem::take(&mut round.seen);
        let Some((commit, next)) = round.finish()? else {
            self.robots.note(&seen, base.revision, now());
            return Ok(base.revision);
        };
        // Readers of older roots keep their blocks, whose records go now.
        let replaced = base.tree.hold_replaced(&commit.addresses())?;
        self.publish(&commit, next, replaced, applied, &seen)
    }

    /// Makes a commit durable, then publishes the root that it leads to; returns its revision. A failed one leaves
    /// everything as it was.
    pub(super) fn publish(
        &self,
        commit: &Commit,
        mut next: Published,
        replaced: Held,
        applied: u64,
        seen: &[&Sighting],
    ) -> Result<u64, StoreError> {
        let started = Instant::now();
        let stored = self.store.commit(self.id, commit);
        metrics::commit(stored.is_ok(), applied, started.elapsed());
        stored?;
        replaced.keep();
        let changed = commit.addresses();
        if let Some(pager) = &self.pager {
            next.tree.settle(&changed, commit.revision, pager);
        }
        let stamp = BlockStamp { revision: commit.revision, changed: commit.changed };
        changed.iter().for_each(|address| next.stamps.set(*address, stamp));
        self.changes.record(commit.revision, changed.into_iter());
        self.robots.note(seen, commit.revision, commit.changed);
        self.published.store(Arc::new(next));
        self.changes.announce(commit.revision);
        Ok(commit.revision)
    }
}

impl Request {
    pub(super) fn refuse(self, error: ServiceError) {
        match self {
            Self::Scans(job) => job.reply(Err(error)),
            Self::Snapshot(errand) => errand.refuse(error),
            Self::Restore(errand) => errand.refuse(error),
        }
    }
}

/// The first insertion and those that have arrived behind it, up to `max_scans`; the request that is too many, or none
/// of scans, is held back.
fn drain(
    first: Job,
    queue: &mut mpsc::UnboundedReceiver<Request>,
    held: &mut Option<Request>,
    max_scans: usize,
) -> Vec<Job> {
    let mut scans = first.scans.len();
    let mut jobs = vec![first];
    while scans < max_scans {
        match queue.try_recv() {
            Ok(Request::Scans(job)) if scans + job.scans.len() <= max_scans => {
                scans += job.scans.len();
                jobs.push(job);
            }
            Ok(other) => {
                *held = Some(other);
                break;
            }
            Err(_) => break,
        }
    }
    jobs
}

impl<'a> Round<'a> {
    fn new(base: &'a Published) -> Self {
        Self {
            base,
            tree: base.tree.clone(),
            changed: Vec::new(),
            windows: BTreeMap::new(),
            new_robots: 0,
            applied: 0,
            seen: Vec::new(),
            outcomes: Vec::new(),
            broken: None,
        }
    }

    /// Applies one request's scans in order.
    ///
    /// What a scan looks into is read before it counts as applied: one that meets a damaged block is refused by itself.
    fn take(&mut self, job: &'a Job, limits: &Writer) -> InsertAnswer {
        let mut answer = job.answer.clone();
        if job.restored != self.base.restored {
            self.look_again(&job.known, &mut answer);
        }
        for scan in &job.scans {
            let readable = self.tree.prepare(&scan.masks).map_err(|error| unreadable(error.into()));
            let outcome = match readable.and_then(|()| self.admit(scan.numbered.as_ref(), limits)) {
                Ok(SequenceVerdict::Duplicate) => {
                    answer.duplicates += 1;
                    metrics::Outcome::Duplicate
                }
                Ok(_) => {
                    if let Err(error) = self.tree.try_apply(&scan.masks, &mut self.changed) {
                        self.broken.get_or_insert(error);
                    }
                    self.applied += 1;
                    self.seen.extend(&scan.sighting);
                    answer.applied += 1;
                    metrics::Outcome::Applied
                }
                Err((code, detail)) => {
                    answer.rejected.push(Rejection { index: scan.index, code, detail });
                    metrics::Outcome::Rejected
                }
            };
            self.outcomes.push((scan.sighting.as_ref().map(|seen| seen.robot.clone()), outcome));
        }
        answer.rejected.sort_by_key(|rejection| rejection.index);
        answer
    }

    /// A snapshot was restored since these scans were found to be duplicates: those that it took back are refused, for
    /// what is answered as a duplicate is in the map of the answer's revision. Their evidence was not computed.
    fn look_again(&self, known: &[(usize, Numbered)], answer: &mut InsertAnswer) {
        for (index, Numbered { robot, sequence }) in known {
            let window = self.windows.get(robot).or_else(|| self.base.windows.get(robot));
            if window.is_some_and(|window| window.verdict(*sequence) == SequenceVerdict::Duplicate) {
                continue;
            }
            answer.duplicates -= 1;
            let detail = "a snapshot was restored while this scan was on its way, and took it back: send it again";
            answer.rejected.push(Rejection { index: *index, code: "MAP_RESTORED", detail: detail.to_owned() });
        }
    }

    /// Looks a scan up in its robot's window and records it there if it is new.
    fn admit(
        &mut self,
        numbered: Option<&Numbered>,
        limits: &Writer,
    ) -> Result<SequenceVerdict, (&'static str, String)> {
        let Some(Numbered { robot, sequence }) = numbered else { return Ok(SequenceVerdict::New) };
        if !self.windows.contains_key(robot) {
            let known = self.base.windows.get(robot);
            if known.is_none() {
                let Writer { max_robots, max_name_bytes, .. } = limits;
                if robot.as_str().len() > *max_name_bytes {
                    let detail = format!("robot: the name has more than {max_name_bytes} bytes, the limit");
                    return Err(("INVALID_ROBOT", over(setting::NAME_BYTES, detail)));
                }
                if self.base.windows.len() + self.new_robots >= *max_robots {
                    let detail = format!("robot: the map knows {max_robots} robots, which is the limit");
                    return Err(("TOO_MANY_ROBOTS", over(setting::ROBOTS_PER_MAP, detail)));
                }
                self.new_robots += 1;
            }
            let window = known.cloned().unwrap_or_default();
            self.windows.insert(robot.clone(), window);
        }
        let Some(window) = self.windows.get_mut(robot) else { return Ok(SequenceVerdict::New) };
        match window.record(*sequence) {
            SequenceVerdict::TooOld => Err(too_old(*sequence, window.highest())),
            verdict => Ok(verdict),
        }
    }

    /// The commit and the root that it leads to; `None` when there is nothing to store.
    fn finish(mut self) -> Result<Option<(Commit, Published)>, StoreError> {
        if let Some(error) = self.broken {
            return Err(error.into());
        }
        self.changed.sort_unstable_by_key(|address| address.morton());
        self.changed.dedup();
        self.windows.retain(|robot, window| self.base.windows.get(robot) != Some(window));
        if self.changed.is_empty() && self.windows.is_empty() {
            return Ok(None);
        }
        let revision = self.base.revision + 1;
        let block = |address: &BlockAddress| Ok((*address, self.tree.try_block(*address)?));
        let blocks = self.changed.iter().map(block).collect::<Result<_, PageError>>()?;
        let mut windows = Arc::clone(&self.base.windows);
        if !self.windows.is_empty() {
            Arc::make_mut(&mut windows).extend(self.windows.iter().map(|(r, w)| (r.clone(), w.clone())));
        }
        let changed = now();
        let commit = Commit { revision, changed, blocks, windows: self.windows.into_iter().collect() };
        let (stamps, restored) = (self.base.stamps.clone(), self.base.restored);
        Ok(Some((commit, Published { revision, tree: self.tree, windows, stamps, restored })))
    }
}

/// Why a scan is refused that looks into a block which cannot be read.
fn unreadable(error: StoreError) -> (&'static str, String) {
    tracing::error!(%error, "evidence meets a block that cannot be read");
    match error {
        StoreError::Damaged { what } => {
            (ErrorKind::MapDamaged.code(), format!("a block of the map is damaged: {what}"))
        }
        _ => (ErrorKind::StoreFailed.code(), "the store could not read a block of the map".to_owned()),
    }
}

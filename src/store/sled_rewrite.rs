//! Rewriting the database into a new directory while it is in use: sled's log grows beyond what it holds, and never
//! gives back what a deletion freed.
//!
//! The old database stays the store until the new one is whole, synced and compared with it; then one small file is
//! replaced ([`super::sled_generations`]) and the handle of all readers and writers with it. A crash before that leaves
//! the old one, a crash after it the new one. A failure before it leaves the old one in use.

use super::durability::{FileSyncer, Syncer};
use super::sled_copy::{Amount, Target, compare, copy_all, copy_keys, count, differing_of};
use super::sled_generations::{Generation, Pointing, bytes_in, point_to, remove_directory};
use super::sled_open::{Database, SledOptions, guarded, io, sync_database, sync_directory};
use super::sled_writes::Writes;
use super::{StoreError, StoreStatistics, keys, lock};
use std::collections::BTreeSet;
use std::fs::File;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

/// What was written meanwhile is copied again at most so many times before writers are held off.
const ROUNDS: usize = 20;

/// So few records are left for when writers are held off.
const FEW: usize = 256;

/// After rewrites in vain the next one waits for at most so many checks.
const MOST_CHECKS: u32 = 256;

/// How long a rewrite waits for the last reader of the old database; after that the next check removes it.
const READERS_PATIENCE: Duration = Duration::from_secs(1);

/// How far a rewrite has come.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum RewriteStep {
    /// The new database was made, empty.
    Created,
    /// So many records were copied so far.
    Copying(u64),
    /// All were copied, and most of what was written meanwhile. The new database is closed.
    Copied,
    /// It was opened again, as after a crash.
    Reopened,
    /// So many records were compared so far.
    Comparing(u64),
    /// All were compared.
    Compared,
    /// Writers are held off from here on, and nothing is left to copy.
    Held,
    /// The new database is whole and durable.
    Whole,
    /// It is the one that is opened after a crash from here on.
    Pointed,
    /// Readers and writers have it; writers go on.
    Switched,
    /// The old database was removed, unless it has readers still.
    Removed,
}

/// Is told how far a rewrite has come. An error gives it up, up to [`RewriteStep::Whole`]; from then on it is passed over.
pub type Watch<'a> = dyn FnMut(RewriteStep) -> Result<(), StoreError> + 'a;

/// What a rewrite did.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Rewritten {
    /// Records that the store holds.
    pub records: u64,
    /// Bytes of their keys and values.
    pub live_bytes: u64,
    /// Bytes of the old database's files.
    pub before_bytes: u64,
    /// Bytes of the new one's.
    pub after_bytes: u64,
    /// How long writers were held off.
    pub held: Duration,
}

/// Replaces the sync of a data file, for tests.
pub(super) type Wrap = dyn Fn(Box<dyn Syncer>) -> Box<dyn Syncer> + Send + Sync;

/// A database that is not the store any more.
struct Retired {
    /// Open while a reader may have it.
    db: Option<Arc<Database>>,
    path: PathBuf,
}

impl Retired {
    /// Closes and removes it once nobody reads it.
    fn gone(&mut self) -> bool {
        if self.db.as_ref().is_some_and(|db| Arc::strong_count(db) > 1) {
            return false;
        }
        // Nobody else can have it any more: all come by it through the store, which has another.
        self.db = None;
        match remove_directory(&self.path) {
            Ok(()) => true,
            Err(error) => {
                tracing::warn!("the database before the rewrite is left: {error}");
                false
            }
        }
    }
}

/// What is known of the store's size.
#[derive(Debug, Default)]
struct Known {
    statistics: StoreStatistics,
    /// Bytes of keys and values, less what they had grown by when they were counted.
    base: Option<i64>,
    /// After rewrites that did not bring it below the limit.
    in_vain: Option<InVain>,
}

/// Rewrites in a row that did not bring the size below the limit: the next one waits until the files have grown by half, or
/// for ever more checks.
#[derive(Debug, Clone, Copy)]
struct InVain {
    after_bytes: u64,
    checks: u32,
    wait: u32,
}

impl InVain {
    fn after(before: Option<Self>, after_bytes: u64) -> Self {
        let wait = before.map_or(1, |before| before.wait).saturating_mul(2).min(MOST_CHECKS);
        Self { after_bytes, checks: 0, wait }
    }

    /// True when another rewrite is due; called at each check.
    fn is_over(&mut self, bytes: u64) -> bool {
        self.checks += 1;
        self.checks > self.wait || bytes > self.after_bytes.saturating_add(self.after_bytes / 2)
    }
}

/// The copy, before it becomes the store.
struct Made {
    db: Target,
    held: Amount,
    /// Keys whose records were not the same when they were compared: they must have been written since.
    unsettled: BTreeSet<Vec<u8>>,
}

/// Measures the database and rewrites it.
pub(super) struct Rewriter {
    directory: PathBuf,
    options: SledOptions,
    wrap: Box<Wrap>,
    /// The generation that is the store; held while it is rewritten.
    generation: Mutex<Generation>,
    known: Mutex<Known>,
    retired: Mutex<Vec<Retired>>,
    writes: Arc<Writes>,
}

impl Rewriter {
    pub(super) fn new(
        directory: &Path,
        options: SledOptions,
        wrap: Box<Wrap>,
        generation: Generation,
        writes: Arc<Writes>,
    ) -> Self {
        Self {
            directory: directory.to_owned(),
            options,
            wrap,
            generation: Mutex::new(generation),
            known: Mutex::default(),
            retired: Mutex::default(),
            writes,
        }
    }

    /// Rewrites the database, and returns when the new one is the store.
    pub(super) fn rewrite(&self, watch: &mut Watch<'_>) -> Result<Rewritten, StoreError> {
        let mut generation = lock(&self.generation);
        self.writes.writable()?;
        let next = generation.next().ok_or_else(|| StoreError::Refused("no generation is left".to_owned()))?;
        let (old_path, path) = (generation.path(&self.directory), next.path(&self.directory));
        let before_bytes = self.size(&old_path)?;
        // From now on there is more than one database, and nothing but `current` tells which one counts.
        point_to(&self.directory, *generation).map_err(Pointing::into_error)?;
        let old = self.writes.records.db();
        self.writes.note_keys(true);
        let outcome = self.make(&path, &old, watch).and_then(|made| self.switch(next, made, &old, watch));
        self.writes.note_keys(false);
        let (amount, held) = match outcome {
            Ok(done) => done,
            Err(error) => {
                // After a failed write `current` may name it.
                if self.writes.failure().is_none()
                    && let Err(left) = remove_directory(&path)
                {
                    tracing::warn!("a rewrite was given up, and what it made is left: {left}");
                }
                return Err(error);
            }
        };
        *generation = next;
        lock(&self.known).statistics.rewrites += 1;
        lock(&self.retired).push(Retired { db: Some(old), path: old_path });
        self.remove_retired(READERS_PATIENCE);
        let _ = watch(RewriteStep::Removed);
        let after_bytes = self.size(&path)?;
        let Amount { records, bytes: live_bytes } = amount;
        Ok(Rewritten { records, live_bytes, before_bytes, after_bytes, held })
    }

    fn size(&self, path: &Path) -> Result<u64, StoreError> {
        bytes_in(path).map_err(|source| io(path, "measuring", source))
    }

    /// Makes the copy: all of the old one's records but those that were written last.
    fn make(&self, path: &Path, old: &Database, watch: &mut Watch<'_>) -> Result<Made, StoreError> {
        remove_directory(path)?;
        let new = Target::open(path, self.options)?;
        watch(RewriteStep::Created)?;
        copy_all(old, &new, watch)?;
        self.catch_up(old, &new)?;
        // Closed and opened again: what is compared is what is in its files, and that it opens is known.
        drop(new);
        watch(RewriteStep::Copied)?;
        let new = Target::open(path, self.options)?;
        watch(RewriteStep::Reopened)?;
        let (mut unsettled, held) = compare(old, &new, watch)?;
        let caught = self.catch_up(old, &new)?;
        unsettled.retain(|key| !caught.contains(key));
        unsettled.extend(differing_of(old, &new, &caught)?);
        sync_database(path)?;
        watch(RewriteStep::Compared)?;
        Ok(Made { db: new, held, unsettled })
    }

    /// Copies what was written since the copy was begun or the last call, until few records are left; the keys of all.
    fn catch_up(&self, old: &Database, new: &Database) -> Result<BTreeSet<Vec<u8>>, StoreError> {
        let mut all = BTreeSet::new();
        for _ in 0..ROUNDS {
            let noted = self.writes.take_noted();
            copy_keys(old, new, &noted)?;
            let few = noted.len() <= FEW;
            all.extend(noted);
            if few {
                break;
            }
        }
        Ok(all)
    }

    /// Holds off writers, copies the rest, makes the copy durable and then the store.
    fn switch(
        &self,
        next: Generation,
        made: Made,
        old: &Database,
        watch: &mut Watch<'_>,
    ) -> Result<(Amount, Duration), StoreError> {
        let Made { db: new, held: amount, unsettled } = made;
        let path = next.path(&self.directory);
        let mut held = self.writes.hold();
        let since = Instant::now();
        let rest = held.take_noted();
        copy_keys(old, &new, &rest)?;
        let unlike = |key: &[u8]| StoreError::Damaged {
            what: format!("{}: not the same in the rewritten database; the old one stays in use", keys::describe(key)),
        };
        if let Some(key) = unsettled.difference(&rest).next() {
            return Err(unlike(key));
        }
        if let Some(key) = differing_of(old, &new, &rest)?.first() {
            return Err(unlike(key));
        }
        watch(RewriteStep::Held)?;
        let syncer = self.complete(&path, old, &new)?;
        watch(RewriteStep::Whole)?;
        // No round of the sync thread is under way from here on, and none has failed.
        let mut sink = self.writes.sink();
        self.writes.writable()?;
        match point_to(&self.directory, next) {
            Ok(()) => {}
            Err(Pointing::NotDone(error)) => return Err(error),
            Err(Pointing::InDoubt(error)) => {
                // Both are whole, and stay the same: whichever is opened next has all that was acknowledged.
                self.writes.fail(&format!("after a rewrite: {error}"));
                return Err(error);
            }
        }
        let _ = watch(RewriteStep::Pointed);
        let new = new.into_database();
        self.writes.records.replace(Arc::clone(&new));
        sink.db = new;
        sink.syncer = syncer;
        sink.data = path.join("db").display().to_string();
        drop(sink);
        drop(held);
        let waited = since.elapsed();
        let _ = watch(RewriteStep::Switched);
        Ok((amount, waited))
    }

    /// Writes the header, which makes it a store, and makes all of it durable.
    fn complete(&self, path: &Path, old: &Database, new: &Database) -> Result<Box<dyn Syncer>, StoreError> {
        guarded("copying the store's header", || {
            let header = old.get(keys::HEADER)?.unwrap_or_default();
            new.insert(keys::HEADER, header)?;
            new.flush()
        })?;
        let data = path.join("db");
        let file = File::open(&data).map_err(|source| io(&data, "opening", source))?;
        let syncer = (self.wrap)(Box::new(FileSyncer(file)));
        syncer.sync().map_err(|source| io(&data, "syncing", source))?;
        sync_database(path)?;
        sync_directory(&self.directory)?;
        Ok(syncer)
    }

    /// Removes the databases that were replaced, as soon as nobody reads them; waits for that so long.
    fn remove_retired(&self, patience: Duration) {
        let deadline = Instant::now() + patience;
        let mut retired = lock(&self.retired);
        loop {
            retired.retain_mut(|retired| !retired.gone());
            if retired.is_empty() || Instant::now() >= deadline {
                return;
            }
            std::thread::sleep(Duration::from_millis(2));
        }
    }

    /// What was last measured.
    pub(super) fn statistics(&self) -> StoreStatistics {
        lock(&self.known).statistics
    }

    /// Measures the store; true when it is to be rewritten.
    pub(super) fn measure(&self, watch: &mut Watch<'_>) -> Result<bool, StoreError> {
        self.remove_retired(Duration::ZERO);
        let base = lock(&self.known).base;
        let base = match base {
            Some(base) => base,
            None => {
                // Off by at most what is written while it is counted.
                let grown = self.writes.grown();
                let db = self.writes.records.db();
                i64::try_from(count(&db, watch)?.bytes).unwrap_or(i64::MAX).saturating_sub(grown)
            }
        };
        let live = u64::try_from(base.saturating_add(self.writes.grown())).unwrap_or(0);
        let of_database = self.size(&lock(&self.generation).path(&self.directory))?;
        let mut known = lock(&self.known);
        known.base = Some(base);
        known.statistics.live_bytes = Some(live);
        known.statistics.disk_bytes = self.size(&self.directory)?;
        let over = of_database > self.options.rewrite.limit(live);
        let again = known.in_vain.as_mut().is_none_or(|in_vain| in_vain.is_over(of_database));
        Ok(over && again && self.writes.failure().is_none())
    }

    /// Rewrites the database because it is over its limit.
    pub(super) fn bring_below(&self, watch: &mut Watch<'_>) -> Result<(), StoreError> {
        let started = Instant::now();
        let done = self.rewrite(watch).inspect_err(|_| lock(&self.known).statistics.failed_rewrites += 1)?;
        let mut known = lock(&self.known);
        let limit = self.options.rewrite.limit(done.live_bytes);
        known.in_vain = (done.after_bytes > limit).then(|| InVain::after(known.in_vain, done.after_bytes));
        tracing::info!(
            records = done.records,
            live_bytes = done.live_bytes,
            before_bytes = done.before_bytes,
            after_bytes = done.after_bytes,
            seconds = started.elapsed().as_secs_f64(),
            writers_waited_seconds = done.held.as_secs_f64(),
            "the database was rewritten"
        );
        known.statistics.disk_bytes = self.size(&self.directory)?;
        Ok(())
    }
}

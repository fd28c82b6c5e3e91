//! Writing to the store: batches with ascending numbers, made durable by one thread, noted while the database is copied.

use super::digest::Digest;
use super::durability::{Durability, Syncer, Ticket};
use super::keys::{self, Kind};
use super::mark::Mark;
use super::nudge::Nudge;
use super::record;
use super::sled_open::{Database, guarded, wake};
use super::sled_records::Records;
use super::{StoreError, lock};
use sled::IVec;
use std::collections::BTreeSet;
use std::sync::{Arc, Mutex, MutexGuard};

/// One record to be written (or removed: `None`), and what was there before.
pub(super) struct Change {
    pub(super) key: Vec<u8>,
    pub(super) value: Option<Vec<u8>>,
    pub(super) before: Option<IVec>,
}

/// What the thread that makes writes durable works on.
pub(super) struct Sink {
    /// The database that writes go to.
    pub(super) db: Arc<Database>,
    /// Syncs its data file.
    pub(super) syncer: Box<dyn Syncer>,
    /// The data file's path, for messages.
    pub(super) data: String,
    /// Where the number of the last durable write is noted.
    pub(super) mark: Mark,
}

impl Sink {
    fn make_durable(&mut self, last_write: u64) -> Result<(), String> {
        let data = &self.data;
        self.db.flush().map_err(|error| format!("flushing {data}: {error}"))?;
        self.syncer.sync().map_err(|error| format!("syncing {data}: {error}"))?;
        self.mark.note(last_write).map_err(|error| format!("noting the last write beside {data}: {error}"))
    }
}

/// Held while a batch is applied.
#[derive(Debug)]
pub(super) struct Last {
    /// The number of the last write: numbers are in the order of the log.
    number: u64,
    /// The digest of the states of all maps.
    states: Digest,
    /// While the database is copied: the keys that were written since they were last taken.
    noted: Option<BTreeSet<Vec<u8>>>,
    /// By how many bytes keys and values have grown since the store was opened.
    grown: i64,
}

impl Last {
    /// The keys written since the last call.
    pub(super) fn take_noted(&mut self) -> BTreeSet<Vec<u8>> {
        self.noted.as_mut().map(std::mem::take).unwrap_or_default()
    }
}

/// The record of the last write.
pub(super) fn last_write(number: u64, states: Digest) -> Vec<u8> {
    let content = [number.to_be_bytes(), states.0.to_be_bytes()].concat();
    record::seal(&keys::LAST_WRITE, 0, &content)
}

/// Everything that writes to the database passes here.
pub(super) struct Writes {
    durability: Durability,
    /// Dropped after the thread that may hang.
    _nudge: Nudge,
    sink: Arc<Mutex<Sink>>,
    last: Mutex<Last>,
    /// Dropped last: with it the lock of the directory is let go.
    pub(super) records: Arc<Records>,
}

impl Writes {
    /// Starts the thread that makes writes durable; all up to `last_write` are.
    pub(super) fn start(
        records: Arc<Records>,
        sink: Sink,
        last_write: u64,
        states: Digest,
    ) -> Result<Self, StoreError> {
        let sink = Arc::new(Mutex::new(sink));
        let of_thread = Arc::clone(&sink);
        let make_durable = move |last_write| lock(&of_thread).make_durable(last_write);
        let nudged = Arc::clone(&records);
        // The database is not replaced while a write is under way, so this is the one that hangs.
        let nudge = move || wake(&nudged.db());
        // Those who wait for the thread wake it; who hangs in a batch before that has nobody else.
        let beside = Nudge::start(nudge.clone())?;
        let durability = Durability::start(last_write, make_durable, nudge)
            .map_err(|source| StoreError::Io { what: "starting the sync thread".to_owned(), source })?;
        let last = Last { number: last_write, states, noted: None, grown: 0 };
        Ok(Self { durability, _nudge: beside, sink, last: Mutex::new(last), records })
    }

    /// Why nothing is written any more.
    pub(super) fn failure(&self) -> Option<String> {
        self.durability.failure()
    }

    /// Stops all writing for good.
    pub(super) fn fail(&self, reason: &str) {
        self.durability.fail(reason);
    }

    /// An error when nothing is written any more.
    pub(super) fn writable(&self) -> Result<(), StoreError> {
        self.failure().map_or(Ok(()), |reason| Err(StoreError::FailStop(reason)))
    }

    /// Writes all of the changes or none, and returns when they are durable. The records' map (or the catalogue) must
    /// be held. After an error reads show what was there before.
    pub(super) fn write(&self, changes: Vec<Change>) -> Result<(), StoreError> {
        self.writable()?;
        let mut batch = sled::Batch::default();
        let mut before = Vec::with_capacity(changes.len());
        let (mut grown, mut states) = (0, Digest::default());
        for change in changes {
            if change.key.first() == Some(&(Kind::State as u8)) {
                change.before.iter().for_each(|value| states.toggle_record(value));
                change.value.iter().for_each(|value| states.toggle_record(value));
            }
            let bytes = |length: Option<usize>| length.map_or(0, |length| (change.key.len() + length) as i64);
            grown +=
                bytes(change.value.as_ref().map(Vec::len)) - bytes(change.before.as_ref().map(|value| value.len()));
            match change.value {
                Some(value) => batch.insert(change.key.as_slice(), value),
                None => batch.remove(change.key.as_slice()),
            }
            before.push((change.key, change.before));
        }
        let keys = before.iter().map(|(key, _)| key);
        let applied = self.apply(batch, keys, grown, states).map_err(|error| error.to_string());
        applied.and_then(|ticket| self.durability.wait(ticket)).map_err(|reason| {
            let mut undone = lock(&self.records.undone);
            for (key, value) in before {
                undone.entry(key).or_insert(value);
            }
            StoreError::FailStop(reason)
        })
    }

    /// Applies a batch with the next number; a failure is for good.
    fn apply<'a>(
        &self,
        mut batch: sled::Batch,
        keys: impl Iterator<Item = &'a Vec<u8>>,
        grown: i64,
        states: Digest,
    ) -> Result<Ticket, StoreError> {
        let mut last = lock(&self.last);
        last.number += 1;
        last.grown += grown;
        last.states.0 ^= states.0;
        batch.insert(&keys::LAST_WRITE, last_write(last.number, last.states));
        if let Some(noted) = &mut last.noted {
            noted.extend(keys.cloned());
            noted.insert(keys::LAST_WRITE.to_vec());
        }
        // Under the lock, so that a batch goes to the database that is copied or to the one that replaced it.
        let db = self.records.db();
        match guarded("writing", || db.apply_batch(batch)) {
            Ok(()) => Ok(self.durability.applied()),
            Err(error) => {
                self.durability.fail(&error.to_string());
                Err(error)
            }
        }
    }

    /// From now on the keys of all batches are noted, or no longer.
    pub(super) fn note_keys(&self, on: bool) {
        lock(&self.last).noted = on.then(BTreeSet::new);
    }

    /// The keys written since the last call.
    pub(super) fn take_noted(&self) -> BTreeSet<Vec<u8>> {
        lock(&self.last).take_noted()
    }

    /// By how many bytes keys and values have grown since the store was opened.
    pub(super) fn grown(&self) -> i64 {
        lock(&self.last).grown
    }

    /// Holds off every write until the guard is dropped.
    pub(super) fn hold(&self) -> MutexGuard<'_, Last> {
        lock(&self.last)
    }

    /// The thread's work, while it is not at it. To be taken after [`Writes::hold`].
    pub(super) fn sink(&self) -> MutexGuard<'_, Sink> {
        lock(&self.sink)
    }
}

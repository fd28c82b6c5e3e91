//! Copying a database into another while it is written to: everything first, then again what was written meanwhile.

use super::nudge::Nudge;
use super::sled_open::{Database, SledOptions, guarded, open_database, wake};
use super::sled_rewrite::{RewriteStep, Watch};
use super::{StoreError, keys};
use std::collections::BTreeSet;
use std::ops::{Bound, Deref};
use std::path::Path;
use std::sync::Arc;

/// Bytes of keys and values that are written in one batch.
const BATCH_BYTES: usize = 256 << 10;

/// Records that are compared before the watcher is told.
const TOLD_EVERY: u64 = 500;

/// Records and the bytes of their keys and values.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub(super) struct Amount {
    pub(super) records: u64,
    pub(super) bytes: u64,
}

impl Amount {
    pub(super) fn add(&mut self, key: &[u8], value: &[u8]) {
        self.records += 1;
        self.bytes += (key.len() + value.len()) as u64;
    }
}

/// A database that is being written by a rewrite alone.
pub(super) struct Target {
    nudge: Nudge,
    db: Arc<Database>,
}

impl Target {
    /// Opens the database, or makes it.
    pub(super) fn open(path: &Path, options: SledOptions) -> Result<Self, StoreError> {
        let db = Arc::new(open_database(path, options)?);
        let nudged = Arc::clone(&db);
        let nudge = Nudge::start(move || wake(&nudged))?;
        Ok(Self { nudge, db })
    }

    /// The database, for others to write to.
    pub(super) fn into_database(self) -> Arc<Database> {
        drop(self.nudge);
        self.db
    }
}

impl Deref for Target {
    type Target = Database;

    fn deref(&self) -> &Database {
        &self.db
    }
}

/// All records but the header, in order.
fn records(db: &Database) -> sled::Iter {
    db.range::<&[u8], _>((Bound::Excluded(&keys::HEADER[..]), Bound::Unbounded))
}

fn next(records: &mut sled::Iter) -> Result<Option<(sled::IVec, sled::IVec)>, StoreError> {
    guarded("reading records to copy", || records.next().transpose())
}

fn write(to: &Database, batch: sled::Batch) -> Result<(), StoreError> {
    guarded("writing copied records", || {
        to.apply_batch(batch)?;
        // So that what is not written yet stays little.
        to.flush().map(|_| ())
    })
}

/// Copies all records but the header: that is written last, so that a database without one is known for half a copy.
pub(super) fn copy_all(from: &Database, to: &Database, watch: &mut Watch<'_>) -> Result<(), StoreError> {
    let (mut batch, mut bytes) = (sled::Batch::default(), 0);
    let mut done = Amount::default();
    let mut left = records(from);
    while let Some((key, value)) = next(&mut left)? {
        done.add(&key, &value);
        bytes += key.len() + value.len();
        batch.insert(key, value);
        if bytes >= BATCH_BYTES {
            bytes = 0;
            write(to, std::mem::take(&mut batch))?;
            watch(RewriteStep::Copying(done.records))?;
        }
    }
    write(to, batch)
}

/// Copies single records as they are now; what is not there any more is removed.
pub(super) fn copy_keys(from: &Database, to: &Database, keys: &BTreeSet<Vec<u8>>) -> Result<(), StoreError> {
    let (mut batch, mut bytes) = (sled::Batch::default(), 0);
    for key in keys {
        bytes += key.len();
        match guarded("reading a record to copy", || from.get(key))? {
            Some(value) => {
                bytes += value.len();
                batch.insert(key.as_slice(), value);
            }
            None => batch.remove(key.as_slice()),
        }
        if bytes >= BATCH_BYTES {
            bytes = 0;
            write(to, std::mem::take(&mut batch))?;
        }
    }
    write(to, batch)
}

/// Those of the keys whose records are not the same in both.
pub(super) fn differing_of(
    a: &Database,
    b: &Database,
    keys: &BTreeSet<Vec<u8>>,
) -> Result<BTreeSet<Vec<u8>>, StoreError> {
    let mut differing = BTreeSet::new();
    for key in keys {
        if guarded("comparing copied records", || Ok(a.get(key)? != b.get(key)?))? {
            differing.insert(key.clone());
        }
    }
    Ok(differing)
}

/// Walks both databases, but for their headers: the keys whose records are not the same in both, and what the first holds.
pub(super) fn compare(
    a: &Database,
    b: &Database,
    watch: &mut Watch<'_>,
) -> Result<(BTreeSet<Vec<u8>>, Amount), StoreError> {
    let mut differing = BTreeSet::new();
    let mut seen = Amount::default();
    let (mut of_a, mut of_b) = (records(a), records(b));
    let (mut left, mut right) = (next(&mut of_a)?, next(&mut of_b)?);
    loop {
        let order = match (&left, &right) {
            (None, None) => return Ok((differing, seen)),
            (Some(_), None) => std::cmp::Ordering::Less,
            (None, Some(_)) => std::cmp::Ordering::Greater,
            (Some(left), Some(right)) => left.0.cmp(&right.0),
        };
        // The record of the first where both have the key, else of the one that has it.
        let (one, other) = if order.is_le() { (&left, &right) } else { (&right, &left) };
        if let Some((key, value)) = one {
            if order.is_ne() || other.as_ref().is_none_or(|(_, other)| other != value) {
                differing.insert(key.to_vec());
            }
            if order.is_le() {
                seen.add(key, value);
            }
        }
        if order.is_le() {
            left = next(&mut of_a)?;
        }
        if order.is_ge() {
            right = next(&mut of_b)?;
        }
        if seen.records % TOLD_EVERY == TOLD_EVERY - 1 {
            watch(RewriteStep::Comparing(seen.records))?;
        }
    }
}

/// Counts all records.
pub(super) fn count(db: &Database, watch: &mut Watch<'_>) -> Result<Amount, StoreError> {
    let mut amount = Amount::default();
    let mut left = db.iter();
    while let Some((key, value)) = next(&mut left)? {
        amount.add(&key, &value);
        if amount.records % TOLD_EVERY == 0 {
            watch(RewriteStep::Comparing(amount.records))?;
        }
    }
    Ok(amount)
}

//! Version 2 to 3: blocks and groups gain the time of their last change, and maps the counts of what snapshots keep.
//!
//! Every such record is written again in the new form, some a batch. Those that have it already are passed over, so the
//! step goes on where a crash stopped it. A damaged record stays as it is: reading it tells the damage.

use super::config_record::Counts;
use super::groups::open_group;
use super::keys::{self, Kind};
use super::record::{self, Record};
use super::sled_open::guarded;
use super::{StoreError, config_record};

/// Records that are written in one batch.
const BATCH: usize = 1000;

/// The step.
pub(super) fn add_times(tree: &sled::Tree) -> Result<(), StoreError> {
    rewrite(tree, BATCH, &mut || Ok(()))
}

/// Writes records of the old form in the new one; `between` is called after each batch and can end it.
pub(super) fn rewrite(
    tree: &sled::Tree,
    batch_records: usize,
    between: &mut dyn FnMut() -> Result<(), StoreError>,
) -> Result<(), StoreError> {
    for kind in [Kind::Block, Kind::Group, Kind::State] {
        let mut from = vec![kind as u8];
        loop {
            let (batch, next) = old_records(tree, kind, &from, batch_records)?;
            let done = next.is_none();
            from = next.unwrap_or_default();
            if !batch.is_empty() {
                let mut writes = sled::Batch::default();
                for (key, value) in batch {
                    writes.insert(key, value);
                }
                guarded("writing records of the new version", || tree.apply_batch(writes))?;
                between()?;
            }
            if done {
                break;
            }
        }
    }
    Ok(())
}

/// Keys and new values of records.
type Batch = Vec<(Vec<u8>, Vec<u8>)>;

/// Some records of a kind from a key on that have the old form, in the new one; and the key from which to go on.
fn old_records(
    tree: &sled::Tree,
    kind: Kind,
    from: &[u8],
    most: usize,
) -> Result<(Batch, Option<Vec<u8>>), StoreError> {
    let mut batch = Batch::new();
    let mut records = tree.range(from..);
    while let Some((key, value)) = guarded("reading records of the old version", || records.next().transpose())? {
        if key.first() != Some(&(kind as u8)) {
            break;
        }
        if batch.len() == most {
            return Ok((batch, Some(key.to_vec())));
        }
        match record::open(&key, kind, &value) {
            Ok(record) if record.version < kind.version() => {
                if let Some(content) = in_new_form(kind, &key, &value, &record) {
                    batch.push((key.to_vec(), record::seal(&key, record.revision, &content)));
                }
            }
            Err(newer @ StoreError::NewerFormat { .. }) => return Err(newer),
            _ => {}
        }
    }
    Ok((batch, None))
}

/// A content in the new form; `None` where the old one cannot be read.
fn in_new_form(kind: Kind, key: &[u8], value: &[u8], record: &Record<'_>) -> Option<Vec<u8>> {
    match kind {
        Kind::Group => open_group(key, value).ok().map(|group| group.encode()),
        Kind::State => Counts::decode(record).ok().map(|counts| counts.encode()),
        Kind::Block => Some(config_record::timed(0.0, record.content)),
        _ => {
            debug_assert!(false, "{} has one form", keys::describe(key));
            None
        }
    }
}

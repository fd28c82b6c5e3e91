//! Version 2 to 3: blocks and groups gain the time of their last change, and maps the counts of what snapshots keep.
//!
//! Every such record is written again in the new form, some a batch. Those that have it already are passed over, so the
//! step goes on where a crash stopped it. A damaged record stays as it is: reading it tells the damage.

use super::config_record::Counts;
use super::groups::open_group;
use super::keys::{self, Kind};
use super::record::{self, Record};
use super::sled_open::guarded;
use super::{MapId, StoreError, config_record};

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
                if let Some(content) = in_new_form(tree, kind, &key, &value, &record)? {
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
fn in_new_form(
    tree: &sled::Tree,
    kind: Kind,
    key: &[u8],
    value: &[u8],
    record: &Record<'_>,
) -> Result<Option<Vec<u8>>, StoreError> {
    Ok(match kind {
        Kind::Group => open_group(key, value).ok().map(|group| group.encode()),
        Kind::State => match (Counts::decode(record), keys::map_of(key)) {
            (Ok(counts), Some(id)) => Some(with_digests(tree, id, counts)?.encode()),
            _ => None,
        },
        Kind::Block => Some(config_record::timed(0.0, record.content)),
        _ => {
            debug_assert!(false, "{} has one form", keys::describe(key));
            None
        }
    })
}

/// The digests of a map as its records are now: what was lost before cannot be told.
fn with_digests(tree: &sled::Tree, id: MapId, mut counts: Counts) -> Result<Counts, StoreError> {
    for kind in [Kind::Block, Kind::Window, Kind::Sensor] {
        let mut records = tree.scan_prefix(keys::of_map(kind, id));
        while let Some((key, value)) = guarded("reading records of the old version", || records.next().transpose())? {
            match (kind, keys::block_of(&key)) {
                (Kind::Block, Some(address)) => {
                    counts.block_digest.toggle_block(address, record::revision_of(&value));
                }
                (Kind::Window, _) => counts.window_digest.toggle_record(&value),
                (Kind::Sensor, _) => counts.sensor_digest.toggle_record(&value),
                _ => {}
            }
        }
    }
    Ok(counts)
}

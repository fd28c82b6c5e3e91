//! The records of one commit: new blocks and windows, and the old ones that a snapshot needs.
//!
//! A snapshot copies nothing. Whatever a commit replaces and the last snapshot still shows is kept under its own key with the
//! revision that replaced it: a record of revision `r`, replaced by revision `e`, is what the map had at all revisions
//! in `r..e`. So a map that barely changes between snapshots keeps little.

use super::config_record::{Counts, decode_block, encode_block, encode_window, timed};
use super::groups::{Known, Noted};
use super::keys::{self, Kind};
use super::record;
use super::sled_catalogue::Entry;
use super::sled_store::SledStore;
use super::sled_writes::Change;
use super::{BlockStamp, Commit, StoreError, StoredMap};
use sled::IVec;

/// The changes of a commit as they come together.
struct Changes<'a> {
    store: &'a SledStore,
    entry: &'a Entry,
    /// The revision of the last snapshot.
    newest: Option<u64>,
    revision: u64,
    counts: Counts,
    changes: Vec<Change>,
}

/// A record before and after a commit.
struct Replaced {
    before: Option<IVec>,
    after: Option<Vec<u8>>,
}

impl SledStore {
    /// The records of a checked commit, and the counts after it.
    pub(super) fn commit_changes(&self, entry: &Entry, commit: &Commit) -> Result<(Vec<Change>, Counts), StoreError> {
        let StoredMap { id, .. } = &entry.stored;
        let codec = entry.codec();
        let mut changes = Changes {
            store: self,
            entry,
            newest: entry.newest_snapshot(),
            revision: commit.revision,
            counts: entry.counts,
            changes: Vec::with_capacity(commit.blocks.len() + commit.windows.len() + 1),
        };
        let stamp = BlockStamp { revision: commit.revision, changed: commit.changed };
        let (mut content, mut noted) = (Vec::new(), Vec::with_capacity(commit.blocks.len()));
        for (address, view) in &commit.blocks {
            content.clear();
            encode_block(&codec, commit.changed, view, &mut content)
                .map_err(|why| StoreError::Refused(why.to_string()))?;
            let kept = keys::kept_block(*id, *address, commit.revision);
            let before = changes.replace(keys::block(*id, *address), Kind::Block, Some(&content), kept)?.before;
            if let Some(before) = &before {
                changes.counts.block_digest.toggle_block(*address, record::revision_of(before));
            }
            changes.counts.block_digest.toggle_block(*address, commit.revision);
            changes.counts.blocks += u64::from(before.is_none());
            noted.push(Noted { address: *address, known: Known::of(view, stamp), before: before.is_some() });
        }
        for (key, content) in self.records.groups_after(*id, &noted, &codec)? {
            changes.changes.push(self.put(key, commit.revision, &content)?);
        }
        for (robot, window) in &commit.windows {
            content.clear();
            encode_window(window, &mut content);
            let content = window.highest().is_some().then_some(content.as_slice());
            let key = keys::named(Kind::Window, *id, robot.as_str());
            let kept = keys::kept_window(*id, robot.as_str(), commit.revision);
            let Replaced { before, after } = changes.replace(key, Kind::Window, content, kept)?;
            before.iter().for_each(|value| changes.counts.window_digest.toggle_record(value));
            after.iter().for_each(|value| changes.counts.window_digest.toggle_record(value));
            changes.counts.windows += u64::from(after.is_some());
            changes.counts.windows = changes.counts.windows.saturating_sub(u64::from(before.is_some()));
        }
        let Changes { counts, mut changes, .. } = changes;
        changes.push(self.put(keys::of_map(Kind::State, *id), commit.revision, &counts.encode())?);
        Ok((changes, counts))
    }
}

impl Changes<'_> {
    /// Writes a record (or removes it) and keeps the one before for the snapshots, where they need it.
    fn replace(
        &mut self,
        key: Vec<u8>,
        kind: Kind,
        content: Option<&[u8]>,
        kept: Vec<u8>,
    ) -> Result<Replaced, StoreError> {
        let change = match content {
            Some(content) => self.store.put(key, self.revision, content)?,
            None => self.store.change(key, None)?,
        };
        if let (Some(newest), Some(before)) = (self.newest, &change.before) {
            match record::open(&change.key, kind, before) {
                Ok(record) if record.revision > newest => {}
                Ok(record) => {
                    let content = match kind {
                        Kind::Block => {
                            let decoded = decode_block(&self.entry.codec(), &record);
                            let (changed, _) = decoded.map_err(|why| record::damaged(&change.key, &why.to_string()))?;
                            let bits = if record.version > 1 { &record.content[8..] } else { record.content };
                            timed(changed, bits)
                        }
                        _ => record.content.to_vec(),
                    };
                    self.changes.push(self.store.put(kept, record.revision, &content)?);
                    self.counts.kept += 1;
                }
                // What is damaged is so for the snapshots too; their count tells that it is missing.
                Err(error) => tracing::error!("not kept for a snapshot: {error}"),
            }
        }
        let replaced = Replaced { before: change.before.clone(), after: change.value.clone() };
        self.changes.push(change);
        Ok(replaced)
    }
}

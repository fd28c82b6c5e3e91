//! Snapshots: taken and restored by the map's one writer, in order with the insertions.
//!
//! A snapshot keeps the last committed revision, and takes one small write of the store. To restore one is a commit like
//! any other: the blocks and the robots' windows that were changed since, as they were. Readers see the map before it or
//! after it, and watches are told the changed blocks. Scans that are on their way are applied after it, if its windows
//! do not know them.

use super::failures::{map_not_found, snapshot_exists, store_failure};
use super::gate::Inside;
use super::registry::{blocking, now};
use super::tasks::{oneshot, spawn_blocking};
use super::writer::{Published, Request, Writer};
use super::{ErrorKind, MapService, ServiceError, setting};
use crate::quadtree::PageError;
use crate::store::{Commit, Difference, MapId, MapName, SnapshotName, StoreError, StoredSnapshot};
use std::collections::BTreeMap;
use std::sync::Arc;

/// A request about one snapshot at the writer.
pub(super) struct Errand<T> {
    snapshot: SnapshotName,
    reply: oneshot::Sender<Result<T, ServiceError>>,
    inside: Inside,
}

impl<T> Errand<T> {
    /// Does the work and answers, if the client is still there.
    pub(super) fn run(self, work: impl FnOnce(&SnapshotName) -> Result<T, ServiceError>) {
        let _ = self.reply.send(work(&self.snapshot));
        drop(self.inside);
    }

    pub(super) fn refuse(self, error: ServiceError) {
        self.run(|_| Err(error));
    }
}

impl Writer {
    /// Keeps the last revision. Blocks for one write of the store.
    pub(super) fn take_snapshot(&self, snapshot: &SnapshotName) -> Result<StoredSnapshot, ServiceError> {
        let failed = |error: StoreError| store_failure(&self.name, "take a snapshot of", &error);
        let there = self.store.snapshots(self.id).map_err(failed)?;
        if there.iter().any(|known| known.name == *snapshot) {
            return Err(snapshot_exists(&self.name, snapshot));
        }
        let limit = self.max_snapshots;
        if there.len() >= limit {
            let detail = format!("map {:?} has {limit} snapshots, which is the limit", self.name.as_str());
            return Err(ServiceError::over(ErrorKind::TooManySnapshots, setting::SNAPSHOTS, detail));
        }
        let taken = self.store.take_snapshot(self.id, snapshot, now()).map_err(failed)?;
        tracing::info!(map = %self.name, %snapshot, revision = taken.revision, "snapshot taken");
        Ok(taken)
    }

    /// Commits what a snapshot keeps, and returns the new revision; it is a new one also when nothing differs.
    pub(super) fn restore(&self, snapshot: &SnapshotName) -> Result<u64, ServiceError> {
        let failed = |error: StoreError| store_failure(&self.name, "restore a snapshot of", &error);
        let difference = self.store.difference(self.id, snapshot).map_err(failed)?;
        let (from, blocks) = (difference.revision, difference.blocks.len());
        let base = self.published.load_full();
        let (commit, next) = restored(&base, difference);
        // What is damaged in the map and sound in the snapshot is mended by this commit: it cannot be held for readers of
        // older roots, who could not read it before either.
        let replaced = base.tree.hold_readable(&commit.addresses(), is_damage).map_err(|e| failed(e.into()))?;
        let revision = self.publish(&commit, next, replaced, 0, &[]).map_err(failed)?;
        tracing::info!(map = %self.name, %snapshot, from, revision, blocks, "snapshot restored");
        Ok(revision)
    }
}

/// The commit that leads to a snapshot, and the root behind it.
fn restored(base: &Published, difference: Difference) -> (Commit, Published) {
    let revision = base.revision + 1;
    let mut tree = base.tree.clone();
    for (address, view) in &difference.blocks {
        tree.replace(*address, view.clone());
    }
    let mut windows = BTreeMap::clone(&base.windows);
    for (robot, window) in &difference.windows {
        if window.highest().is_some() {
            windows.insert(robot.clone(), window.clone());
        } else {
            windows.remove(robot);
        }
    }
    let (stamps, windows) = (base.stamps.clone(), Arc::new(windows));
    let next = Published { revision, tree, windows, stamps, restored: revision };
    let commit = Commit { revision, changed: now(), blocks: difference.blocks, windows: difference.windows };
    (commit, next)
}

fn is_damage(error: &PageError) -> bool {
    let PageError::Source(source) = error else { return false };
    matches!(source.downcast_ref::<StoreError>(), Some(StoreError::Damaged { .. }))
}

impl MapService {
    /// Keeps a map's last revision under a name, without holding up scans for longer than one write of the store.
    ///
    /// # Errors
    /// [`ErrorKind::MapNotFound`], [`ErrorKind::SnapshotExists`] (also for the same revision),
    /// [`ErrorKind::TooManySnapshots`], [`ErrorKind::ShuttingDown`], [`ErrorKind::StoreFailed`].
    pub async fn take_snapshot(&self, map: &MapName, snapshot: &SnapshotName) -> Result<StoredSnapshot, ServiceError> {
        self.registry.may_be_named(snapshot.as_str(), "name")?;
        let taken = self.errand(map, snapshot, Request::Snapshot).await;
        if let Ok(entry) = self.registry.find(map) {
            entry.rescue.forget();
            if taken.is_ok() {
                self.keep_copy(map, entry.id);
            }
        }
        taken
    }

    /// Has the store copy the map's last snapshot, behind the answer. The end of the service waits for it.
    fn keep_copy(&self, map: &MapName, id: MapId) {
        let Ok(inside) = self.registry.gate.enter() else { return };
        let (store, map) = (Arc::clone(&self.registry.store), map.clone());
        spawn_blocking(move || {
            let _inside = inside;
            match store.keep_copy(id) {
                // A map or snapshot that was deleted meanwhile needs no copy.
                Ok(()) | Err(StoreError::NoMap(_) | StoreError::NoSnapshot(_)) => {}
                Err(error) => tracing::warn!(%map, "no copy of its last snapshot beside the store: {error}"),
            }
        });
    }

    /// The snapshots of a map, by name. The map itself need not be readable.
    ///
    /// # Errors
    /// [`ErrorKind::MapNotFound`], [`ErrorKind::StoreFailed`].
    pub async fn snapshots(&self, map: &MapName) -> Result<Vec<StoredSnapshot>, ServiceError> {
        let entry = self.registry.find(map)?;
        let (store, id) = (Arc::clone(&self.registry.store), entry.id);
        let listed = blocking(move || store.snapshots(id)).await?;
        listed.map_err(|error| store_failure(map, "list the snapshots of", &error))
    }

    /// Makes a snapshot's content the map's, as a new revision that is returned. Brings back the robots' sequence windows
    /// too, so that scans which were applied after the snapshot can be sent again; the sensors stay. An insertion whose
    /// answer has a revision below the returned one was applied before it.
    ///
    /// # Errors
    /// [`ErrorKind::MapNotFound`], [`ErrorKind::SnapshotNotFound`], [`ErrorKind::ShuttingDown`],
    /// [`ErrorKind::StoreFailed`]; the map is as it was then.
    pub async fn restore_snapshot(&self, map: &MapName, snapshot: &SnapshotName) -> Result<u64, ServiceError> {
        self.errand(map, snapshot, Request::Restore).await
    }

    /// Removes a snapshot. The map itself need not be readable. Goes on when the caller leaves.
    ///
    /// # Errors
    /// [`ErrorKind::MapNotFound`], [`ErrorKind::SnapshotNotFound`], [`ErrorKind::ShuttingDown`],
    /// [`ErrorKind::StoreFailed`].
    pub async fn delete_snapshot(&self, map: &MapName, snapshot: &SnapshotName) -> Result<(), ServiceError> {
        let inside = self.registry.gate.enter()?;
        let entry = self.registry.find(map)?;
        let (store, id, name) = (Arc::clone(&self.registry.store), entry.id, snapshot.clone());
        let deleted = blocking(move || {
            let _inside = inside;
            store.delete_snapshot(id, &name)
        });
        let deleted = deleted.await?.map_err(|error| store_failure(map, "delete a snapshot of", &error));
        entry.rescue.forget();
        if deleted.is_ok() {
            tracing::info!(%map, %snapshot, "snapshot deleted");
        }
        deleted
    }

    /// Has the map's writer do an errand, behind what has arrived there before it.
    async fn errand<T>(
        &self,
        map: &MapName,
        snapshot: &SnapshotName,
        request: impl FnOnce(Errand<T>) -> Request,
    ) -> Result<T, ServiceError> {
        let inside = self.registry.gate.enter()?;
        let entry = self.registry.find(map)?;
        let opened = self.registry.opened(&entry).await?;
        // Errands are few, since each has a place among the operations under way.
        let (reply, answer) = oneshot::channel();
        let errand = request(Errand { snapshot: snapshot.clone(), reply, inside });
        opened.queue.send(errand).map_err(|_| map_not_found(map))?;
        answer.await.unwrap_or_else(|_| {
            Err(ServiceError::new(ErrorKind::Internal, "the server failed while it worked on this snapshot"))
        })
    }
}

//! Snapshots in memory for those who ask them: each as a whole, those that were asked last.

use super::queries::Root;
use super::writer::Published;
use crate::mapping::MapConfig;
use crate::quadtree::PagedTree;
use crate::store::{BlockStamps, LoadedMap, MapId};
use crate::sync::{Mutex, MutexGuard};
use std::collections::VecDeque;
use std::sync::{Arc, PoisonError};
use tokio::sync::Semaphore;

/// The snapshots that were asked last, under a limit in bytes.
pub(super) struct SnapshotCache {
    limit: usize,
    /// The turn of the one that is being read: so that at most one more than the limit allows is in memory, beside those
    /// that answers still hold.
    pub(super) reading: Arc<Semaphore>,
    /// The one asked last stands last. Held for a look, never across a disk access or an await.
    kept: Mutex<VecDeque<Kept>>,
}

struct Kept {
    id: MapId,
    published: Arc<Published>,
    bytes: usize,
}

impl SnapshotCache {
    pub(super) fn new(limit: usize) -> Self {
        Self { limit, reading: Arc::new(Semaphore::new(1)), kept: Mutex::default() }
    }

    fn kept(&self) -> MutexGuard<'_, VecDeque<Kept>> {
        self.kept.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// What a map was at a revision; numbers of maps are never used again, so there is one content to find.
    pub(super) fn find(&self, id: MapId, revision: u64) -> Option<Arc<Published>> {
        let mut kept = self.kept();
        let at = kept.iter().position(|one| one.id == id && one.published.revision == revision)?;
        let found = kept.remove(at)?;
        let published = Arc::clone(&found.published);
        kept.push_back(found);
        Some(published)
    }

    /// Takes in what was read. One that is larger than the limit is handed back and not kept.
    pub(super) fn keep(&self, id: MapId, loaded: LoadedMap) -> Arc<Published> {
        let LoadedMap { revision, tree, .. } = loaded;
        let bytes = usize::try_from(tree.statistics().memory_bytes).unwrap_or(usize::MAX);
        let published = Arc::new(Published {
            revision,
            tree: PagedTree::from(&tree),
            windows: Arc::default(),
            stamps: BlockStamps::default(),
            restored: 0,
        });
        let mut kept = self.kept();
        kept.retain(|one| one.id != id || one.published.revision != revision);
        kept.push_back(Kept { id, published: Arc::clone(&published), bytes });
        while kept.iter().map(|one| one.bytes).fold(0, usize::saturating_add) > self.limit {
            kept.pop_front();
        }
        published
    }

    /// Lets go of a map's snapshots: it is deleted.
    pub(super) fn forget(&self, id: MapId) {
        self.kept().retain(|one| one.id != id);
    }

    /// Bytes of the snapshots that are kept.
    pub(super) fn bytes(&self) -> usize {
        self.kept().iter().map(|one| one.bytes).sum()
    }
}

/// What a query of a snapshot reads.
pub(super) fn loaded_as_root(id: MapId, config: Arc<MapConfig>, published: Arc<Published>) -> Root {
    let tree = published.tree.clone();
    Root { id, config, published, tree }
}

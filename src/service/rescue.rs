//! What is left of a damaged map: the newest snapshot that can be read, named in the error that tells of the damage.

use super::registry::{Entry, Registry, blocking};
use super::tasks::OnceCell;
use super::{ErrorKind, ServiceError};
use crate::store::{MapId, MapStore, StoredSnapshot};
use crate::sync::Mutex;
use std::sync::{Arc, PoisonError};

/// Snapshots that are tried: each is read whole.
const TRIED: usize = 8;

/// What was found for one map, looked for once so that errors stay cheap.
#[derive(Default)]
pub(super) struct Rescue(Mutex<Arc<OnceCell<Found>>>);

type Found = Option<StoredSnapshot>;

impl Rescue {
    /// The map's snapshots have changed.
    pub(super) fn forget(&self) {
        *self.0.lock().unwrap_or_else(PoisonError::into_inner) = Arc::default();
    }

    fn kept(&self) -> Arc<OnceCell<Found>> {
        Arc::clone(&self.0.lock().unwrap_or_else(PoisonError::into_inner))
    }
}

impl Registry {
    /// An error about a map; where the map is damaged, with the snapshot that is left.
    pub(super) async fn with_rescue(&self, entry: &Entry, mut error: ServiceError) -> ServiceError {
        if error.kind != ErrorKind::MapDamaged {
            return error;
        }
        let kept = entry.rescue.kept();
        let found = kept.get_or_try_init(|| async {
            // The semaphore is never closed.
            let permit = Arc::clone(&self.heavy).acquire_owned().await.ok();
            let (store, id) = (Arc::clone(&self.store), entry.id);
            let look = move || {
                let _permit = permit;
                newest_readable(store.as_ref(), id)
            };
            blocking(look).await
        });
        if let Ok(Some(StoredSnapshot { name, revision, .. })) = found.await {
            let hint = format!("; its snapshot {:?} of revision {revision} can be exported", name.as_str());
            error.detail.push_str(&hint);
        }
        error
    }
}

fn newest_readable(store: &dyn MapStore, id: MapId) -> Found {
    let mut snapshots = store.snapshots(id).unwrap_or_default();
    snapshots.sort_by(|a, b| b.revision.cmp(&a.revision).then_with(|| a.name.cmp(&b.name)));
    snapshots.into_iter().take(TRIED).find(|snapshot| store.load_snapshot(id, &snapshot.name).is_ok())
}

//! Publishes what every commit changed under `{prefix}/{map}/changes`.
//!
//! A message can be lost on the way: each says after which revision it begins, so a subscriber sees the gap and asks
//! for the changes since the revision that it has.

use super::reply::encoding;
use crate::service::{ChangesQuery, CommitNotice, ErrorKind, MapService};
use crate::store::{MapId, MapName};
use crate::transport::door::Door;
use crate::wire;
use ::zenoh::Session;
use ::zenoh::qos::CongestionControl;
use metrics::counter;
use prost::Message;
use std::collections::HashMap;
use tokio::sync::broadcast::error::RecvError;

pub(super) const PUBLISHED: &str = "ubbmap_zenoh_changes_published_total";

/// Publishes until the server ends.
pub async fn run(session: Session, service: MapService, door: Door, prefix: String) {
    let mut notices = service.commits();
    // Up to which revision of which map was told.
    let mut told: HashMap<MapName, (MapId, u64)> = HashMap::new();
    loop {
        let notice = tokio::select! {
            () = door.draining() => break,
            notice = notices.recv() => notice,
        };
        let notice = match notice {
            Ok(notice) => notice,
            // The next notice of each map tells what was missed; what is told is put together.
            Err(RecvError::Lagged(_)) => continue,
            Err(RecvError::Closed) => break,
        };
        let CommitNotice { name, id, revision } = notice;
        let since = match told.get(&name) {
            // Told already, together with an earlier one.
            Some((known, told)) if *known == id && *told >= revision => continue,
            Some((known, told)) if *known == id => *told,
            _ => revision - 1,
        };
        match service.changes(&name, since, &ChangesQuery { robots: true, ..ChangesQuery::default() }).await {
            Ok(changes) => {
                told.insert(name.clone(), (id, changes.revision));
                let payload = wire::watch_response(changes).encode_to_vec();
                let put = session
                    .put(format!("{prefix}/{name}/changes"), payload)
                    .encoding(encoding("WatchMapResponse"))
                    // Whoever does not keep up must not hold up the others.
                    .congestion_control(CongestionControl::Drop);
                match put.await {
                    Ok(()) => counter!(PUBLISHED).increment(1),
                    Err(error) => tracing::warn!(map = %name, %error, "changes could not be published"),
                }
            }
            Err(error) if error.kind == ErrorKind::MapNotFound => {
                told.remove(&name);
            }
            Err(error) => tracing::warn!(map = %name, %error, "changes could not be told"),
        }
    }
}

//! Two servers on one key space: each would answer some of the queries and apply some of the scans.
//!
//! A server shows a liveliness token. One that finds another's does not start; one that finds another's later, because
//! two networks have come together, stops answering as the other does, until one of them is gone.

use super::ZenohError;
use ::zenoh::Session;
use ::zenoh::sample::{Sample, SampleKind};
use std::collections::BTreeSet;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

/// How often a server that starts looks again whether another one's token is gone, and how long it waits between: the
/// token of a server that was killed a moment ago lingers until its connection is known to be lost.
const LOOKS: u32 = 10;
const PAUSE: Duration = Duration::from_millis(200);

/// The longest that one look takes.
const LOOK: Duration = Duration::from_secs(1);

/// The other servers on this key space.
#[derive(Debug, Clone)]
pub struct Rivals(Arc<Inner>);

#[derive(Debug)]
struct Inner {
    own: String,
    alive: Mutex<BTreeSet<String>>,
}

/// The key of a server's token.
pub fn token(prefix: &str, id: &str) -> String {
    format!("{prefix}/@server/{id}")
}

impl Rivals {
    /// None known yet. `own` is the key of the server's own token.
    pub fn new(own: String) -> Self {
        Self(Arc::new(Inner { own, alive: Mutex::default() }))
    }

    /// Another server that is there now.
    pub fn any(&self) -> Option<String> {
        self.0.alive.lock().unwrap_or_else(PoisonError::into_inner).first().cloned()
    }

    /// Takes note of a token that appeared or went.
    pub fn note(&self, sample: &Sample) {
        let key = sample.key_expr().as_str();
        if key == self.0.own {
            return;
        }
        let mut alive = self.0.alive.lock().unwrap_or_else(PoisonError::into_inner);
        match sample.kind() {
            SampleKind::Put => {
                if alive.insert(key.to_owned()) {
                    tracing::error!(other = key, "another server is on the same keys: none of the two answers");
                }
            }
            SampleKind::Delete => {
                if alive.remove(key) {
                    tracing::warn!(other = key, "the other server on the same keys is gone");
                }
            }
        }
    }
}

/// Waits until no other server is there.
///
/// # Errors
/// [`ZenohError::AnotherServer`] when one stays.
pub async fn alone(session: &Session, prefix: &str) -> Result<(), ZenohError> {
    let mut other = None;
    for look in 0..LOOKS {
        if look > 0 {
            tokio::time::sleep(PAUSE).await;
        }
        other = find(session, prefix).await?;
        if other.is_none() {
            return Ok(());
        }
    }
    Err(ZenohError::AnotherServer(other.unwrap_or_default()))
}

async fn find(session: &Session, prefix: &str) -> Result<Option<String>, ZenohError> {
    let failed = |error: ::zenoh::Error| ZenohError::Session(error.to_string());
    let replies = session.liveliness().get(token(prefix, "*")).timeout(LOOK).await.map_err(failed)?;
    let mut other = None;
    while let Ok(reply) = replies.recv_async().await {
        if let Ok(sample) = reply.result() {
            other = Some(sample.key_expr().to_string());
        }
    }
    Ok(other)
}

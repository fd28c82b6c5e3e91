//! A health check that crosses the wire: a client of its own asks the server through the network how it is.

use super::ZenohError;
use super::guard::Guard;
use super::rivals::token;
use super::settings::{self, ZenohSettings};
use crate::transport::door::Door;
use ::zenoh::Session;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

/// How often is asked, and how long an answer may take.
const INTERVAL: Duration = Duration::from_secs(2);
const PATIENCE: Duration = Duration::from_secs(2);

/// So many questions without an answer, one after the other, and the server is not healthy: one can be lost.
const MISSES: u32 = 2;

/// Whether the server is to be reached over Zenoh.
#[derive(Debug, Clone)]
pub struct Reachable(Arc<AtomicBool>);

impl Reachable {
    /// True while questions are answered.
    pub fn now(&self) -> bool {
        self.0.load(Ordering::Acquire)
    }
}

/// The key that is asked.
pub fn health(prefix: &str, id: &str) -> String {
    format!("{}/health", token(prefix, id))
}

/// Starts asking, and returns when the first question was answered.
///
/// # Errors
/// [`ZenohError::Session`] when the client cannot connect; [`ZenohError::Unreachable`] without an answer.
pub async fn start(
    settings: &ZenohSettings,
    guard: &Guard,
    endpoints: &[String],
    key: String,
    door: Door,
) -> Result<Reachable, ZenohError> {
    let failed = |error: ::zenoh::Error| ZenohError::Session(format!("the health check cannot connect: {error}"));
    let client = ::zenoh::open(settings::client(settings, guard, endpoints)?).await.map_err(failed)?;
    let mut answered = false;
    for _ in 0..MISSES {
        answered = answered || ask(&client, &key).await;
    }
    if !answered {
        return Err(ZenohError::Unreachable(key));
    }
    let reachable = Reachable(Arc::new(AtomicBool::new(true)));
    tokio::spawn(watch(client, key, door, reachable.clone()));
    Ok(reachable)
}

async fn watch(client: Session, key: String, door: Door, reachable: Reachable) {
    let mut misses = 0;
    loop {
        tokio::select! {
            () = door.draining() => break,
            () = tokio::time::sleep(INTERVAL) => {}
        }
        misses = if ask(&client, &key).await { 0 } else { misses + 1 };
        let healthy = misses < MISSES;
        if reachable.0.swap(healthy, Ordering::AcqRel) != healthy {
            if healthy {
                tracing::info!("reachable over Zenoh again");
            } else {
                tracing::error!("not reachable over Zenoh");
            }
        }
    }
    // The process ends with it; a connection that does not close in time is closed by that.
    let _ = client.close().await;
}

async fn ask(client: &Session, key: &str) -> bool {
    let Ok(replies) = client.get(key).timeout(PATIENCE).await else { return false };
    while let Ok(reply) = replies.recv_async().await {
        if reply.result().is_ok() {
            return true;
        }
    }
    false
}

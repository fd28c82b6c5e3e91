//! Best-effort scans: `put` under `{prefix}/{map}/scans/{robot}`. They may be lost on the way and nobody is told, so
//! what did not come, came late or was refused is counted.

use super::Context;
use super::gaps::{Came, Gaps};
use super::keys;
use crate::service::{ErrorKind, ServiceError};
use crate::transport::access::OnBehalf;
use crate::wire::{self, v1};
use ::zenoh::sample::Sample;
use metrics::counter;
use std::sync::Arc;
use tokio::sync::{Semaphore, mpsc};
use tokio_util::task::TaskTracker;

pub(super) const SCANS: &str = "ubbmap_zenoh_scans_total";
pub(super) const MISSING: &str = "ubbmap_zenoh_scans_missing_total";

/// What became of best-effort scans.
fn count(outcome: &'static str, scans: u64) {
    if scans > 0 {
        counter!(SCANS, "outcome" => outcome).increment(scans);
    }
}

/// Takes a sample on a thread of Zenoh's: it is handed on or dropped, never waited for.
pub fn take(queue: &mpsc::Sender<Sample>, sample: Sample) {
    if queue.try_send(sample).is_err() {
        count("dropped", 1);
    }
}

/// The scans of one sample.
struct Sent {
    map: String,
    robot: String,
    scans: Vec<v1::Scan>,
}

/// Applies samples until their subscriber is gone.
pub async fn run(
    mut queue: mpsc::Receiver<Sample>,
    context: Arc<Context>,
    places: Arc<Semaphore>,
    tracker: TaskTracker,
) {
    let mut gaps = Gaps::default();
    while let Some(sample) = queue.recv().await {
        let Some(sent) = decode(&context, &sample) else {
            count("refused", 1);
            continue;
        };
        note(&mut gaps, &sent);
        if context.rivals.any().is_some() {
            count("refused", sent.scans.len() as u64);
            continue;
        }
        // The semaphore is never closed.
        let place = Arc::clone(&places).acquire_owned().await.ok();
        let context = Arc::clone(&context);
        tracker.spawn(async move {
            apply(&context.caller, sent).await;
            drop(place);
        });
    }
}

fn decode(context: &Context, sample: &Sample) -> Option<Sent> {
    let (map, robot) = keys::scans(&context.settings.prefix, sample.key_expr().as_str())?;
    let payload = sample.payload().to_bytes();
    if payload.len() > context.settings.message_bytes {
        return None;
    }
    let request: v1::InsertScansRequest = wire::message(&payload).ok()?;
    Some(Sent { map: map.to_owned(), robot: robot.to_owned(), scans: request.scans })
}

fn note(gaps: &mut Gaps, sent: &Sent) {
    for sequence in sent.scans.iter().filter_map(|scan| scan.sequence) {
        match gaps.note(&sent.map, &sent.robot, sequence) {
            Came::After(missing) => counter!(MISSING).increment(missing),
            Came::Late => count("late", 1),
            Came::InOrder => {}
        }
    }
}

async fn apply(service: &OnBehalf, sent: Sent) {
    let scans = sent.scans.len() as u64;
    let mut batch = wire::Batch::of_robot(sent.scans, &sent.robot);
    let inserted = async { service.insert(&wire::map_name(&sent.map)?, batch.take_scans()).await };
    match inserted.await {
        Ok(answer) => {
            let response = batch.response(answer);
            count("applied", response.applied.into());
            count("duplicate", response.duplicates.into());
            count("refused", response.rejected.len() as u64);
        }
        Err(error) => {
            let error: ServiceError = error;
            tracing::debug!(map = sent.map, robot = sent.robot, %error, "best-effort scans were not applied");
            count(if error.kind == ErrorKind::Busy { "dropped" } else { "refused" }, scans);
        }
    }
}

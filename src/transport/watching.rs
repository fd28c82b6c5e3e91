//! A watch of a map as messages, for every transport that can push.

use super::access::OnBehalf;
use super::client::Client;
use super::door::{Door, Place, ending};
use crate::service::{ServiceError, Watch, limit_hit, setting};
use crate::wire::{self, v1};
use std::time::Duration;
use tokio::sync::mpsc;

/// Messages that wait for the client. What is committed while they wait is put together, so more would only be older.
const WAITING: usize = 1;

/// How long the last words of a stream wait for a client that does not read.
const LAST_WORDS: Duration = Duration::from_secs(2);

/// One message to the client, or why there are no more.
pub type Change = Result<v1::WatchMapResponse, ServiceError>;

/// Begins a watch; its messages end with the map, the server, the caller's grant, or the receiver.
///
/// # Errors
/// As [`OnBehalf::watch`], and those of a [stream's place](Door::stream).
pub async fn begin(
    service: &OnBehalf,
    door: &Door,
    client: Option<&Client>,
    request: &v1::WatchMapRequest,
) -> Result<mpsc::Receiver<Change>, ServiceError> {
    let place = door.stream(client)?;
    let map = wire::map_name(&request.map)?;
    let watch = service.watch(&map, request.since, wire::watch_query(request)).await?;
    let (out, receiver) = mpsc::channel(WAITING);
    tokio::spawn(run(watch, service.clone(), door.clone(), out, place));
    Ok(receiver)
}

/// Waits until there is no more waiting for a client that takes nothing: its grant or the server ends, or it is too long.
/// It has a moment for the last words then.
pub async fn left(asking: &OnBehalf, door: &Door) {
    tokio::select! {
        () = door.draining() => {}
        _ = asking.ended() => {}
        () = tokio::time::sleep(door.idle_timeout()) => return limit_hit(setting::IDLE_SECONDS),
    }
    tokio::time::sleep(LAST_WORDS).await;
}

async fn run(mut watch: Watch, asking: OnBehalf, door: Door, out: mpsc::Sender<Change>, place: Place) {
    loop {
        // The place of the message comes first: what changes while the client is slow is then in the message.
        let reserved = tokio::select! {
            biased;
            reserved = out.reserve() => reserved,
            () = left(&asking, &door) => break,
        };
        let Ok(permit) = reserved else { break };
        let change = tokio::select! {
            // Nothing is told once the grant has ended.
            biased;
            () = out.closed() => break,
            () = door.draining() => Err(ending()),
            ended = asking.ended() => Err(ended),
            change = watch.next() => change.map(wire::watch_response),
        };
        let ended = change.is_err();
        permit.send(change);
        if ended {
            break;
        }
    }
    drop(place);
}

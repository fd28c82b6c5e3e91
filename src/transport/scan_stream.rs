//! Scans as they come: each acknowledged when it is durable, with so many under way and no more.
//!
//! A scan is read only when there is a place for it, so a sender that is faster than the map is held up by its own
//! connection. Acknowledgements come in the order of the stream.

use super::access::OnBehalf;
use super::door::{Door, ending};
use super::watching::left;
use crate::service::{ErrorKind, ServiceError};
use crate::store::MapName;
use crate::wire::{self, Batch, v1};
use futures_util::stream::{FuturesOrdered, Stream, StreamExt};
use std::pin::pin;
use tokio::sync::mpsc;

/// One message to the sender, or why there are no more.
pub type Acknowledgement = Result<v1::StreamScansResponse, ServiceError>;

/// Applies the scans of `incoming` until it, the server or the sender's grant ends, or an error ends it. What was read is acknowledged
/// first. `window` is how many scans may be under way. The work of a sender that has gone is finished unacknowledged.
pub async fn run(
    service: &OnBehalf,
    door: &Door,
    window: usize,
    incoming: impl Stream<Item = Result<v1::StreamScansRequest, ServiceError>>,
    out: mpsc::Sender<Acknowledgement>,
) {
    let mut incoming = pin!(incoming);
    let mut grant = pin!(service.ended());
    let mut map: Option<MapName> = None;
    let mut index = 0;
    let mut under_way = FuturesOrdered::new();
    let mut end = None;
    let mut reading = true;
    loop {
        tokio::select! {
            biased;
            Some(fate) = under_way.next(), if !under_way.is_empty() => {
                let failed = Acknowledgement::is_err(&fate);
                if !hand_over(&out, fate, service, door).await || failed {
                    return;
                }
            }
            () = door.draining(), if reading => {
                reading = false;
                end = Some(ending());
            }
            ended = &mut grant, if reading => {
                reading = false;
                end = Some(ended);
            }
            message = incoming.next(), if reading && under_way.len() < window => {
                match message.map(|message| message.and_then(|message| take(&mut map, message))) {
                    Some(Ok((map, scan))) => {
                        under_way.push_back(apply(service, map, scan, index));
                        index += 1;
                    }
                    Some(Err(error)) => {
                        reading = false;
                        end = Some(error);
                    }
                    None => reading = false,
                }
            }
            else => break,
        }
    }
    if let Some(error) = end {
        // A sender that has gone is told nothing.
        hand_over(&out, Err(error), service, door).await;
    }
}

/// Gives a message to the sender; false when it is gone or takes nothing for too long.
async fn hand_over(
    out: &mpsc::Sender<Acknowledgement>,
    message: Acknowledgement,
    service: &OnBehalf,
    door: &Door,
) -> bool {
    tokio::select! {
        biased;
        sent = out.send(message) => sent.is_ok(),
        () = left(service, door) => false,
    }
}

/// The map and scan of a message; the first names the map.
fn take(map: &mut Option<MapName>, message: v1::StreamScansRequest) -> Result<(MapName, v1::Scan), ServiceError> {
    let scan = message.scan.ok_or_else(|| invalid("scan", "scan is missing".to_owned()))?;
    let name = match map {
        Some(name) if message.map.is_empty() || message.map == name.as_str() => name.clone(),
        Some(name) => {
            let other: String = message.map.chars().take(80).collect();
            return Err(invalid("map", format!("the stream is of map {:?}, a message names {other:?}", name.as_str())));
        }
        None => map.insert(wire::map_name(&message.map)?).clone(),
    };
    Ok((name, scan))
}

fn invalid(field: &str, detail: String) -> ServiceError {
    ServiceError::new(ErrorKind::InvalidRequest, detail).at(field)
}

async fn apply(service: &OnBehalf, map: MapName, scan: v1::Scan, index: u64) -> Acknowledgement {
    let (robot, sequence) = (scan.robot.clone(), scan.sequence);
    let mut batch = Batch::new(vec![scan]);
    let mut response =
        v1::StreamScansResponse { robot, sequence, index, revision: 0, duplicate: false, rejected: None };
    match service.insert_when_free(&map, batch.take_scans()).await {
        Ok(answer) => {
            let answer = batch.response(answer);
            response.revision = answer.revision;
            response.duplicate = answer.duplicates > 0;
            response.rejected = answer.rejected.into_iter().next();
        }
        // Its sender may send this one again; the others go on.
        Err(error) if error.kind == ErrorKind::Busy => {
            let code = error.kind.code().to_owned();
            response.rejected = Some(v1::RejectedScan { index: 0, code, detail: error.detail });
        }
        Err(error) => return Err(error),
    }
    if let Some(rejected) = &mut response.rejected {
        rejected.index = u32::try_from(index).unwrap_or(u32::MAX);
    }
    Ok(response)
}

//! Those who watch: one over server-sent events, who checks that the map never goes back; one over gRPC, who keeps a copy of a
//! part of the map; and a planner.

use super::robots::{agent, lazy};
use super::{Shared, judge};
use std::collections::BTreeMap;
use std::io::{BufRead, BufReader};
use std::sync::atomic::Ordering;
use std::time::Duration;
use ubbmap::store::read_map_file;
use ubbmap::wire::v1;

/// The part that is copied: the first row of buildings.
const SOUTH_NORTH: (f64, f64) = (-360.0, -280.0);

/// Of the map's leaves and blocks, metres.
const BLOCK: f64 = 6.4;

/// The map's lower edge, metres.
const EDGE: f64 = -3276.8;

/// A thread of its own. Every message begins where the one before ended, over any number of restarts.
pub fn server_sent(shared: &Shared) {
    let mut last: Option<u64> = None;
    while !shared.is_over() {
        if let Err(what) = follow(shared, &mut last) {
            shared.trouble(&format!("events: {what}"));
            std::thread::sleep(Duration::from_millis(200));
        }
    }
}

fn follow(shared: &Shared, last: &mut Option<u64>) -> Result<(), String> {
    let url = format!("{}/v1/maps/hall/events", shared.url);
    let mut request = agent().get(url).header("accept", "text/event-stream");
    if let Some(revision) = last {
        request = request.header("last-event-id", revision.to_string());
    }
    let request = request.config().timeout_global(None).build();
    let answer = request.call().map_err(|error| error.to_string())?;
    if !answer.status().is_success() {
        return Err(answer.status().to_string());
    }
    let mut first = true;
    for line in BufReader::new(answer.into_body().into_reader()).lines() {
        let line = line.map_err(|error| error.to_string())?;
        if shared.is_over() {
            return Ok(());
        }
        let Some(data) = line.strip_prefix("data:") else { continue };
        let message: serde_json::Value = serde_json::from_str(data).map_err(|error| error.to_string())?;
        let number = |field: &str| message[field].as_str().and_then(|text| text.parse::<u64>().ok());
        let Some(revision) = number("revision") else { return Err(format!("the end: {data}")) };
        let (since, before) = (number("since"), *last);
        if before.is_some_and(|before| revision < before || (!first && since != Some(before))) {
            shared.wrong(&format!("events went from {before:?} to {since:?}..{revision}"));
        }
        *last = Some(revision);
        first = false;
        shared.events.fetch_add(1, Ordering::Relaxed);
    }
    Err("the stream ended".to_owned())
}

/// A copy of a part of the map, as changes tell it.
#[derive(Debug, Default)]
pub struct Copy {
    blocks: BTreeMap<(u32, u32), Vec<u8>>,
    pub revision: u64,
}

/// Keeps a copy until told to stop, and until it has come to the revision that the map then has.
pub async fn copy(shared: Shared) -> Copy {
    let mut copy = Copy::default();
    while !shared.is_over() || copy.revision < shared.last_revision.load(Ordering::Relaxed) {
        if let Err(what) = keep(&shared, &mut copy).await {
            shared.trouble(&format!("watch: {what}"));
            tokio::time::sleep(Duration::from_millis(200)).await;
        }
    }
    copy
}

async fn keep(shared: &Shared, copy: &mut Copy) -> Result<(), String> {
    let told = |status: tonic::Status| format!("{:?} {}", status.code(), status.message());
    let request = v1::WatchMapRequest {
        map: "hall".to_owned(),
        since: Some(copy.revision),
        min_y: Some(SOUTH_NORTH.0),
        max_y: Some(SOUTH_NORTH.1),
        contents: true,
        ..v1::WatchMapRequest::default()
    };
    // A stream lasts longer than a call.
    let channel = tonic::transport::Endpoint::from_shared(shared.url.clone()).unwrap().connect().await;
    let channel = channel.map_err(|error| error.to_string())?;
    let mut client = ubbmap::transport::grpc::generated::map_service_client::MapServiceClient::new(channel);
    client = client.max_decoding_message_size(64 << 20);
    let mut changes = client.watch_map(request).await.map_err(told)?.into_inner();
    let mut first = true;
    loop {
        let last = shared.last_revision.load(Ordering::Relaxed);
        if shared.is_over() && last > 0 && copy.revision >= last {
            return Ok(());
        }
        let message = match tokio::time::timeout(Duration::from_secs(1), changes.message()).await {
            Ok(message) => message.map_err(told)?.ok_or("the stream ended")?,
            // What is outside the box is not told; a new watch tells where the map stands.
            Err(_) if shared.is_over() => return Ok(()),
            Err(_) => continue,
        };
        if message.revision < copy.revision && !(message.everything && first) {
            shared.wrong(&format!("a watch went from {} to {}", copy.revision, message.revision));
        }
        if message.everything {
            *copy = whole(shared).await?;
            shared.anew.fetch_add(1, Ordering::Relaxed);
        } else if message.revision > copy.revision || first {
            for block in message.blocks {
                copy.blocks.insert((block.x, block.y), block.classes);
            }
            copy.revision = message.revision;
        }
        first = false;
        shared.changes.fetch_add(1, Ordering::Relaxed);
    }
}

/// The map as a file.
pub async fn export(shared: &Shared, snapshot: &str) -> Result<Vec<u8>, String> {
    let request = v1::ExportMapRequest {
        map: "hall".to_owned(),
        snapshot: snapshot.to_owned(),
        ..v1::ExportMapRequest::default()
    };
    let told = |status: tonic::Status| format!("{:?} {}", status.code(), status.message());
    let mut pieces = lazy(&shared.url).export_map(request).await.map_err(told)?.into_inner();
    let mut file = Vec::new();
    while let Some(piece) = pieces.message().await.map_err(told)? {
        file.extend_from_slice(&piece.data);
    }
    Ok(file)
}

async fn whole(shared: &Shared) -> Result<Copy, String> {
    let file = export(shared, "").await?;
    let (_, map) = read_map_file(&mut &*file).map_err(|error| error.to_string())?;
    Ok(Copy { blocks: judge::blocks(&map.tree), revision: map.revision })
}

impl Copy {
    /// Holds it to the map as it was exported at the end.
    ///
    /// # Errors
    /// The first block that differs.
    pub fn compare(&self, file: &[u8]) -> Result<usize, String> {
        let (_, map) = read_map_file(&mut &*file).map_err(|error| error.to_string())?;
        if self.revision > map.revision {
            return Err(format!("the copy is of revision {}, the map of {}", self.revision, map.revision));
        }
        let sought = judge::blocks(&map.tree);
        let inside = |at: &(u32, u32)| {
            let low = EDGE + f64::from(at.1) * BLOCK;
            low < SOUTH_NORTH.1 && low + BLOCK > SOUTH_NORTH.0
        };
        let unknown = map.tree.scale().unknown();
        let same = |at: &(u32, u32)| match (self.blocks.get(at), sought.get(at)) {
            (Some(ours), None) => ours.iter().all(|class| *class == unknown),
            (ours, theirs) => ours == theirs,
        };
        let mut all = self.blocks.keys().chain(sought.keys()).filter(|at| inside(at));
        match all.clone().find(|at| !same(at)) {
            Some(differs) => Err(format!("block {differs:?} of the copy of revision {} differs", self.revision)),
            None => Ok(all.by_ref().filter(|at| sought.contains_key(at)).count() / 2),
        }
    }
}

/// Asks all the time for a tile and for what is free where robots drive.
pub async fn plan(shared: Shared) {
    let mut client = lazy(&shared.url);
    for turn in 0.. {
        if shared.is_over() {
            break;
        }
        tokio::time::sleep(Duration::from_millis(50)).await;
        let begun = std::time::Instant::now();
        let asked = if turn % 2 == 0 {
            let (z, x) = (8, 128 - 19 + turn % 38);
            let request = v1::GetTileRequest { map: "hall".to_owned(), z, x, y: 115 + turn % 25, ..Default::default() };
            client.get_tile(request).await.map(drop)
        } else {
            let scan = super::robots::scan_of(&shared.fleet, turn as usize % shared.robots, u64::from(turn));
            let middle = |side: Option<v1::Interval>| side.and_then(|side| side.min);
            let center = scan.pose.map(|pose| v1::Point { x: middle(pose.x), y: middle(pose.y) });
            let disc = v1::region::Shape::Disc(v1::DiscRegion { center, radius: Some(0.35) });
            let regions = vec![v1::Region { shape: Some(disc) }];
            let request = v1::CheckGuaranteedFreeRequest { map: "hall".to_owned(), regions, ..Default::default() };
            client.check_guaranteed_free(request).await.map(drop)
        };
        match asked {
            Ok(()) => shared.asked.record(begun.elapsed()),
            Err(status) => shared.trouble(&format!("planner: {:?} {}", status.code(), status.message())),
        }
    }
}

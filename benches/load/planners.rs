//! Planners: tiles and guaranteed-free queries at a steady rate, whether or not the last one was answered.

use crate::figures::Latencies;
use crate::robots::Fleet;
use crate::server::Server;
use std::sync::Arc;
use std::time::{Duration, Instant};
use tokio::sync::Semaphore;
use tokio::task::JoinSet;
use tonic::transport::Channel;
use ubbmap::transport::grpc::generated::map_service_client::MapServiceClient;
use ubbmap::wire::v1;

/// Tiles of the building: leaves of 0.1 m, and coarser ones.
const TILES: [(u32, u32, u32); 4] = [(8, 128, 128), (7, 64, 64), (6, 32, 32), (9, 257, 256)];

/// Connections of all planners together.
const CONNECTIONS: usize = 4;

/// Queries without an answer at most; one that would be too many is left out, and misses in the figures.
const WAITING: usize = 200;

/// What the planners measured.
#[derive(Debug, Clone, Default)]
pub struct Asked {
    pub tiles: Latencies,
    pub free: Latencies,
}

impl Asked {
    pub fn forget(&self) {
        self.tiles.forget();
        self.free.forget();
    }
}

type Client = MapServiceClient<Channel>;

/// Asks until `end`: `rate` tiles a second, and as many regions.
pub async fn ask(
    server: &Server,
    rate: f64,
    fleet: &Arc<Fleet>,
    asked: &Asked,
    begin: Instant,
    end: Instant,
    work: &mut JoinSet<()>,
) {
    if rate <= 0.0 {
        return;
    }
    let mut clients = Vec::new();
    for _ in 0..CONNECTIONS {
        clients.push(MapServiceClient::connect(server.url.clone()).await.unwrap());
    }
    let (fleet, asked) = (Arc::clone(fleet), asked.clone());
    work.spawn(async move {
        let waiting = Arc::new(Semaphore::new(WAITING));
        let period = Duration::from_secs_f64(1.0 / rate);
        for turn in 0_u32.. {
            let due = begin + period * turn;
            if due >= end {
                break;
            }
            tokio::time::sleep_until(due.into()).await;
            let client = &clients[turn as usize % CONNECTIONS];
            for tile in [true, false] {
                let Ok(place) = Arc::clone(&waiting).try_acquire_owned() else { continue };
                let (mut client, fleet, asked) = (client.clone(), Arc::clone(&fleet), asked.clone());
                tokio::spawn(async move {
                    let latencies = if tile {
                        one_tile(&mut client, turn).await;
                        &asked.tiles
                    } else {
                        one_region(&mut client, &fleet, turn).await;
                        &asked.free
                    };
                    latencies.record(due.elapsed());
                    drop(place);
                });
            }
        }
        // All places back: all answered.
        drop(waiting.acquire_many(WAITING as u32).await.unwrap());
    });
}

async fn one_tile(client: &mut Client, turn: u32) {
    let (z, x, y) = TILES[turn as usize % TILES.len()];
    let request = v1::GetTileRequest { map: "hall".to_owned(), z, x, y, ..v1::GetTileRequest::default() };
    let tile = client.get_tile(request).await.unwrap().into_inner();
    assert_eq!(tile.classes.len(), 256 * 256);
}

/// A robot's disc where one of the fleet was, and the way to where another was.
async fn one_region(client: &mut Client, fleet: &Fleet, turn: u32) {
    let (a, b) = (fleet.place(turn as usize), fleet.place(turn as usize + 7));
    let point = |(x, y): (f64, f64)| v1::Point { x: Some(x), y: Some(y) };
    let disc = v1::DiscRegion { center: Some(point(a)), radius: Some(0.35) };
    let path = v1::PathRegion { points: vec![point(a), point(b)], radius: Some(0.35) };
    let regions = [v1::region::Shape::Disc(disc), v1::region::Shape::Path(path)];
    let request = v1::CheckGuaranteedFreeRequest {
        map: "hall".to_owned(),
        regions: regions.map(|shape| v1::Region { shape: Some(shape) }).into(),
        ..v1::CheckGuaranteedFreeRequest::default()
    };
    assert_eq!(client.check_guaranteed_free(request).await.unwrap().into_inner().results.len(), 2);
}

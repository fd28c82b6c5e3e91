//! Operations over REST and gRPC alike, for limits: what each transport says of them.

#![allow(clippy::unwrap_used, reason = "a test may end where its ground is not as it should be")]

use crate::http_support::{Answer, Site};
use serde_json::{Value, json};
use std::time::{Duration, Instant};
use ubbmap::wire::v1;

/// What came of an operation: nothing to say, or why it was refused.
pub type Fate = Result<(), String>;

/// An operation with its body as JSON.
#[derive(Debug, Clone)]
pub enum Asked {
    Create(String, Value),
    Insert(Value),
    Classes(Value),
    Free(Value),
    /// All of the map.
    Region,
    Grid(f64),
    Snapshot(String),
}

impl Asked {
    /// Over REST. Scans that were refused by themselves are a refusal.
    pub fn rest(&self, site: &Site) -> Fate {
        let answer = match self {
            Self::Create(name, config) => site.put(&format!("/v1/maps/{name}"), &config.to_string()),
            Self::Insert(body) => site.post("/v1/maps/hall/scans", &body.to_string()),
            Self::Classes(body) => site.post("/v1/maps/hall/classes", &body.to_string()),
            Self::Free(body) => site.post("/v1/maps/hall/guaranteed-free", &body.to_string()),
            Self::Region => site.get("/v1/maps/hall/region"),
            Self::Grid(side) => site.get(&format!("/v1/maps/hall/grid?{}", square(*side))),
            Self::Snapshot(name) => site.post("/v1/maps/hall/snapshots", &json!({ "name": name }).to_string()),
        };
        told(&answer)
    }

    /// Over gRPC.
    pub fn rpc(&self, site: &Site) -> Fate {
        let mut client = site.rpc();
        let with_map = |body: &Value| {
            let mut body = body.clone();
            body["map"] = json!("hall");
            body
        };
        let said = |status: tonic::Status| status.message().to_owned();
        match self {
            Self::Create(name, config) => {
                let config = Some(serde_json::from_value(config.clone()).unwrap());
                let request = v1::CreateMapRequest { map: name.clone(), config };
                site.run(client.create_map(request)).map(drop).map_err(said)
            }
            Self::Insert(body) => {
                let request: v1::InsertScansRequest = serde_json::from_value(with_map(body)).unwrap();
                let answer = site.run(client.insert_scans(request)).map_err(said)?.into_inner();
                answer.rejected.first().map_or(Ok(()), |rejected| Err(rejected.detail.clone()))
            }
            Self::Classes(body) => {
                let request: v1::GetClassesRequest = serde_json::from_value(with_map(body)).unwrap();
                site.run(client.get_classes(request)).map(drop).map_err(said)
            }
            Self::Free(body) => {
                let request: v1::CheckGuaranteedFreeRequest = serde_json::from_value(with_map(body)).unwrap();
                site.run(client.check_guaranteed_free(request)).map(drop).map_err(said)
            }
            Self::Region => {
                let request = v1::GetRegionRequest { map: "hall".to_owned(), ..v1::GetRegionRequest::default() };
                site.run(client.get_region(request)).map(drop).map_err(said)
            }
            Self::Grid(side) => {
                let [min_x, min_y, max_x, max_y] = [0.0, 0.0, *side, *side].map(Some);
                let request = v1::GetGridRequest {
                    map: "hall".to_owned(),
                    min_x,
                    min_y,
                    max_x,
                    max_y,
                    ..v1::GetGridRequest::default()
                };
                site.run(client.get_grid(request)).map(drop).map_err(said)
            }
            Self::Snapshot(name) => {
                let request = v1::CreateSnapshotRequest { map: "hall".to_owned(), name: name.clone() };
                site.run(client.create_snapshot(request)).map(drop).map_err(said)
            }
        }
    }
}

fn square(side: f64) -> String {
    format!("min_x=0&min_y=0&max_x={side}&max_y={side}")
}

fn told(answer: &Answer) -> Fate {
    let body = String::from_utf8_lossy(&answer.body).into_owned();
    if !(200..300).contains(&answer.status) {
        assert_eq!(answer.header("content-type"), Some("application/problem+json"), "{body}");
        return Err(answer.json()["detail"].as_str().unwrap().to_owned());
    }
    match answer.json()["rejected"].as_array().and_then(|rejected| rejected.first()) {
        Some(rejected) => Err(rejected["detail"].as_str().unwrap().to_owned()),
        None => Ok(()),
    }
}

/// How often a limit was met, as the metrics tell it.
pub fn hits(site: &Site, setting: &str) -> u64 {
    let text = String::from_utf8(site.get("/metrics").body).unwrap();
    let line = format!("ubbmap_limit_hits_total{{limit=\"{setting}\"}} ");
    let count = text.lines().find_map(|line_of| line_of.strip_prefix(&line));
    count.unwrap_or_else(|| panic!("no {line}")).parse().unwrap()
}

/// Bytes of requests that this server holds. The metrics are those of all the servers of a process.
pub fn incoming(site: &Site) -> usize {
    site.server.as_ref().unwrap().door().incoming().used()
}

/// Bytes of answers that this server holds.
pub fn answers(site: &Site) -> usize {
    site.server.as_ref().unwrap().door().answers().used()
}

/// Tries until it is so; ends the test where it never is.
#[track_caller]
pub fn at_last(mut is_so: impl FnMut() -> bool) {
    let begun = Instant::now();
    while !is_so() {
        assert!(begun.elapsed() < Duration::from_secs(30), "it never came");
        std::thread::sleep(Duration::from_millis(10));
    }
}

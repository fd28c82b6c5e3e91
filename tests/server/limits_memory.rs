//! Memory of requests and answers on their way, whoever sends or reads slowly.

#![allow(clippy::unwrap_used, reason = "a test may end where its ground is not as it should be")]

use crate::grpc_support::refused;
use crate::http_support::{Site, gzip, ring};
use crate::limits_support::{answers, at_last, hits, incoming};
use crate::service_support::{self, map_name};
use serde_json::json;
use std::io::{Read, Write};
use std::net::TcpStream;
use std::sync::atomic::Ordering;
use std::time::Duration;
use tonic::Code;
use ubbmap::service::ErrorKind;
use ubbmap::wire::v1;

fn connect(site: &Site) -> TcpStream {
    let stream = TcpStream::connect(site.server.as_ref().unwrap().address()).unwrap();
    stream.set_read_timeout(Some(Duration::from_secs(20))).unwrap();
    stream
}

/// A body of JSON that is mostly blanks: a thousandth of it when it is zipped.
fn blank(bytes: usize) -> String {
    format!("{{\"points\":[{}]}}", " ".repeat(bytes - 13))
}

#[test]
fn bodies_on_their_way_share_a_memory_that_a_slow_sender_gives_back() {
    let site = Site::with(|config| {
        config.limits.body_bytes = 1 << 20;
        config.limits.incoming_bytes = 1 << 20;
    });
    site.make_hall();
    let whole = blank(1 << 20);
    assert_eq!(site.post("/v1/maps/hall/classes", &whole).status, 200);
    let zipped = gzip(whole.as_bytes());
    assert!(zipped.len() < 10_000);
    let headers = [("content-type", "application/json"), ("content-encoding", "gzip")];
    // Both, what came and what it unfolds to, are counted.
    let refused_alone = site.send("POST", "/v1/maps/hall/classes", &headers, &zipped);
    assert!(refused_alone.problem(413, "BODY_TOO_LARGE").1.contains("setting limits.incoming_bytes"));
    let zipped = gzip(blank(900_000).as_bytes());
    assert_eq!(site.send("POST", "/v1/maps/hall/classes", &headers, &zipped).status, 200);

    let mut slow = connect(&site);
    let head = "POST /v1/maps/hall/classes HTTP/1.1\r\nHost: x\r\nContent-Type: application/json\r\nContent-Length: 600000\r\n\r\n";
    slow.write_all(head.as_bytes()).unwrap();
    slow.write_all(" ".repeat(500_000).as_bytes()).unwrap();
    // Of two that come at once either may be the one that finds no room.
    at_last(|| incoming(&site) == 500_000);
    let before = hits(&site, "limits.incoming_bytes");
    at_last(|| site.send("POST", "/v1/maps/hall/classes", &headers, &zipped).status == 429);
    let answer = site.send("POST", "/v1/maps/hall/classes", &headers, &zipped);
    let (_, detail) = answer.problem(429, "BUSY");
    assert!(detail.contains("setting limits.incoming_bytes"), "{detail}");
    assert_eq!(answer.header("retry-after"), Some("1"));
    let mut client = site.rpc();
    let points = vec![v1::Point { x: Some(1.0), y: Some(1.0) }; 45_000];
    let request = v1::GetClassesRequest { map: "hall".to_owned(), points, depth: None, snapshot: String::new() };
    let (_, detail) = refused(site.run(client.get_classes(request)), Code::ResourceExhausted, "BUSY");
    assert!(detail.contains("setting limits.incoming_bytes"), "{detail}");
    assert!(hits(&site, "limits.incoming_bytes") >= before + 3);
    // Small ones find room all the while, and large ones when the slow one has gone.
    assert_eq!(site.post("/v1/maps/hall/scans", &ring("r", Some(1)).to_string()).status, 200);
    drop(slow);
    at_last(|| site.send("POST", "/v1/maps/hall/classes", &headers, &zipped).status == 200);
}

#[test]
fn a_line_and_a_message_of_a_stream_are_counted_until_they_end() {
    let site = Site::with(|config| {
        config.limits.body_bytes = 1 << 20;
        config.limits.incoming_bytes = 1 << 20;
    });
    site.make_hall();
    // A stream of more than the memory, in lines that fit.
    let line = format!("{}{}\n", ring("r", None), " ".repeat(300_000));
    let headers = [("content-type", "application/x-ndjson"), ("accept", "application/x-ndjson")];
    let answer = site.send("POST", "/v1/maps/hall/scans", &headers, line.repeat(10).as_bytes());
    let text = String::from_utf8(answer.body).unwrap();
    assert_eq!(text.lines().filter(|line| line.contains("\"revision\"")).count(), 10, "{text}");

    let mut slow = connect(&site);
    let head = "POST /v1/maps/hall/scans HTTP/1.1\r\nHost: x\r\nContent-Type: application/x-ndjson\r\nAccept: application/x-ndjson\r\n\
        Content-Length: 5000000\r\n\r\n";
    slow.write_all(head.as_bytes()).unwrap();
    slow.write_all(" ".repeat(700_000).as_bytes()).unwrap();
    at_last(|| incoming(&site) == 700_000);
    at_last(|| site.post("/v1/maps/hall/classes", &blank(500_000)).status == 429);
    // The line ends, and its memory is free.
    slow.write_all(b"\n").unwrap();
    at_last(|| site.post("/v1/maps/hall/classes", &blank(500_000)).status == 200);
}

#[test]
fn answers_on_their_way_share_a_memory_and_who_does_not_read_is_cut_off() {
    let site = Site::with(|config| {
        config.limits.answer_bytes = 40 << 20;
        config.limits.idle_seconds = 8.0;
        config.limits.cells_per_answer = 1 << 25;
    });
    assert_eq!(site.put("/v1/maps/wide", &json!({ "depth": 12 }).to_string()).status, 201);
    let path = "/v1/maps/wide/grid";
    let length = site.get(path).body.len();
    assert!(length > 20 << 20, "{length}");
    let mut slow = connect(&site);
    slow.write_all(format!("GET {path} HTTP/1.1\r\nHost: x\r\n\r\n").as_bytes()).unwrap();
    let before = (hits(&site, "limits.answer_bytes"), hits(&site, "limits.idle_seconds"));
    // Its answer first: of two that come at once either may be the one that finds no room.
    at_last(|| answers(&site) >= length);
    at_last(|| site.get(path).status == 429);
    let mut client = site.rpc();
    let request = v1::GetGridRequest { map: "wide".to_owned(), ..v1::GetGridRequest::default() };
    // gRPC sends bytes as they are, so two such answers fit beside the slow one's no more than one of REST.
    let grid = site.run(client.get_grid(request));
    assert!(
        grid.is_ok() || grid.as_ref().is_err_and(|status| status.message().contains("limits.answer_bytes")),
        "{grid:?}"
    );
    // It does not read for longer than it may: what it held is free again, and its answer ends early.
    at_last(|| site.get(path).status == 200);
    let mut rest = Vec::new();
    let _ = slow.read_to_end(&mut rest);
    assert!(rest.len() < length, "{} of {length}", rest.len());
    assert!(hits(&site, "limits.answer_bytes") > before.0 && hits(&site, "limits.idle_seconds") > before.1);
}

#[test]
fn an_answer_that_no_memory_would_hold_is_refused_for_good() {
    let site = Site::with(|config| config.limits.answer_bytes = 1 << 20);
    assert_eq!(site.put("/v1/maps/wide", &json!({ "depth": 10 }).to_string()).status, 201);
    let (_, detail) = site.get("/v1/maps/wide/grid").problem(400, "REGION_TOO_LARGE");
    assert!(detail.contains("setting limits.answer_bytes"), "{detail}");
    assert_eq!(site.get("/v1/maps/wide/grid?depth=9").status, 200);
    let mut client = site.rpc();
    let whole = v1::GetGridRequest { map: "wide".to_owned(), ..v1::GetGridRequest::default() };
    let (_, detail) = refused(site.run(client.get_grid(whole)), Code::OutOfRange, "REGION_TOO_LARGE");
    assert!(detail.contains("setting limits.answer_bytes"), "{detail}");
}

#[test]
fn a_robot_that_sends_most_does_not_keep_another_out() {
    let site = Site::with(|config| config.writer.queue = 8);
    site.make_hall();
    let service = site.server.as_ref().unwrap().service().clone();
    let send = |robot: &str, sequence: u64| {
        let (service, scan) = (service.clone(), service_support::ring(robot, Some(sequence), 0.0));
        site.runtime.spawn(async move { service.insert(&map_name("hall"), vec![scan]).await })
    };
    // The map is loaded; then one in the commit that hangs, and as many as it likes.
    assert_eq!(site.run(send("greedy", 100)).unwrap().unwrap().applied, 1);
    site.store.hold();
    let mut taken = vec![send("greedy", 0)];
    at_last(|| site.store.waiting.load(Ordering::SeqCst) > 0);
    let mut refusal = None;
    for sequence in 1..=20 {
        let sent = send("greedy", sequence);
        // What is refused is refused at once, what is taken waits for the store.
        let answer = site.runtime.block_on(async {
            tokio::select! {
                answer = sent => Some(answer.unwrap()),
                () = tokio::time::sleep(Duration::from_millis(300)) => None,
            }
        });
        if let Some(answer) = answer {
            refusal = Some(answer.unwrap_err());
            break;
        }
    }
    let refusal = refusal.unwrap();
    assert!(refusal.kind == ErrorKind::Busy && refusal.detail.contains("robot \"greedy\""), "{refusal}");
    taken.push(send("other", 1));
    site.store.release();
    for answer in taken {
        assert_eq!(site.run(answer).unwrap().unwrap().applied, 1);
    }
}

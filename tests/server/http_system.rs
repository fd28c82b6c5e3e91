//! Routes that are not there, health and metrics, full servers, slow stores, and the end.

#![allow(clippy::unwrap_used, reason = "a test may end where its ground is not as it should be")]

use crate::http_support::{Site, agent, ring, send};
use serde_json::json;
use std::sync::atomic::Ordering;
use std::thread;
use std::time::{Duration, Instant};

#[test]
fn paths_without_a_route_are_problems() {
    let site = Site::hall();
    for path in ["/nowhere", "/v1", "/v1/maps/", "/v1/maps/hall/", "/v1/maps/hall/snapshot", "/v1/maps/hall/tiles/0/0"]
    {
        site.get(path).problem(404, "ROUTE_NOT_FOUND");
    }
    for (method, path, allowed) in [
        ("POST", "/v1/maps", "GET"),
        ("POST", "/v1/maps/hall", "PUT"),
        ("GET", "/v1/maps/hall/scans", "POST"),
        ("DELETE", "/v1/maps/hall/grid", "GET"),
        ("PUT", "/healthz", "GET"),
    ] {
        let answer = site.send(method, path, &[], b"");
        answer.problem(405, "METHOD_NOT_ALLOWED");
        assert!(answer.header("allow").unwrap().contains(allowed), "{answer:?}");
    }
}

#[test]
fn the_server_tells_what_it_is_and_how_it_is() {
    let site = Site::hall();
    let index = site.get("/").json();
    assert_eq!((&index["name"], &index["version"]), (&json!("ubbmap"), &json!(env!("CARGO_PKG_VERSION"))));
    let routes = index["routes"].as_array().unwrap();
    assert!(routes.len() > 10);
    for route in routes {
        let (method, path) = route.as_str().unwrap().split_once(' ').unwrap();
        let path = path.split('?').next().unwrap();
        let path = path
            .replace("{map}", "x")
            .replace("{z}", "0")
            .replace("{x}", "0")
            .replace("{y}", "0")
            .replace("{ending}", "png");
        // A form that no answer has: a stream would never end.
        let headers = if path.ends_with("/events") { &[("accept", "image/png")][..] } else { &[] };
        let answer = site.send(method, &path, headers, b"");
        let body = String::from_utf8_lossy(&answer.body);
        let missing = answer.status == 405 || (answer.status == 404 && body.contains("ROUTE_NOT_FOUND"));
        assert!(!missing, "{route}: {body}");
        site.put("/v1/maps/x", "{}");
    }
    assert_eq!(site.get("/healthz").status, 200);
    assert_eq!(site.get("/readyz").json(), json!({"status": "ready"}));
    let head = site.send("HEAD", "/v1/maps/hall", &[], b"");
    assert_eq!((head.status, head.body.len()), (200, 0));
    site.get("/v1/maps?limit=3").problem(400, "INVALID_REQUEST");

    let answer = site.get("/metrics");
    assert!(answer.header("content-type").unwrap().starts_with("text/plain"));
    let text = String::from_utf8(answer.body).unwrap();
    let counted = |line: &str| {
        let labels = ["method=\"PUT\"", "route=\"/v1/maps/{map}\"", "status=\"201\""];
        line.starts_with("ubbmap_http_requests_total{") && labels.iter().all(|label| line.contains(label))
    };
    assert!(text.lines().any(counted), "{text}");
    assert!(text.contains("# HELP ubbmap_http_request_seconds"));
}

#[test]
fn two_servers_of_one_process_share_the_metrics() {
    let (one, two) = (Site::hall(), Site::hall());
    assert_eq!(one.get("/metrics").status, 200);
    assert!(String::from_utf8(two.get("/metrics").body).unwrap().contains("ubbmap_http_requests_total"));
}

#[test]
fn a_full_queue_tells_clients_to_come_back() {
    let site = Site::with(|config| config.writer.queue = 1);
    site.make_hall();
    assert_eq!(site.post("/v1/maps/hall/scans", &ring("r", Some(1)).to_string()).json()["applied"], 1);
    site.store.hold();
    let url = format!("{}/v1/maps/hall/scans", site.url());
    let clients: Vec<_> = (0..6)
        .map(|robot| {
            let url = url.clone();
            let body = ring(&format!("r{robot}"), Some(1)).to_string();
            thread::spawn(move || {
                send(&agent(), "POST", &url, &[("content-type", "application/json")], body.as_bytes())
            })
        })
        .collect();
    let begun = Instant::now();
    while clients.iter().filter(|client| client.is_finished()).count() == 0 && begun.elapsed().as_secs() < 20 {
        thread::sleep(Duration::from_millis(10));
    }
    // Those that were taken wait for the store; the others were told at once. Reads do not wait.
    assert_eq!(site.get("/v1/maps/hall").json()["revision"], "1");
    site.store.release();
    let answers: Vec<_> = clients.into_iter().map(|client| client.join().unwrap()).collect();
    let (busy, done): (Vec<_>, Vec<_>) = answers.iter().partition(|answer| answer.status == 429);
    assert!(!busy.is_empty() && !done.is_empty(), "{answers:?}");
    for answer in busy {
        answer.problem(429, "BUSY");
        assert!(answer.header("retry-after").unwrap().parse::<u32>().unwrap() >= 1);
    }
    let applied: u64 = done.iter().map(|answer| answer.json()["applied"].as_u64().unwrap()).sum();
    assert_eq!(applied, done.len() as u64);
}

#[test]
fn a_full_server_still_tells_how_it_is() {
    let site = Site::with(|config| config.limits.requests = 1);
    site.make_hall();
    site.store.hold();
    let url = format!("{}/v1/maps/hall/scans", site.url());
    let body = ring("a", Some(1)).to_string();
    let client = thread::spawn(move || send(&agent(), "POST", &url, &[], body.as_bytes()));
    while site.store.waiting.load(Ordering::SeqCst) == 0 {
        thread::sleep(Duration::from_millis(5));
    }
    let refused = site.get("/v1/maps");
    refused.problem(429, "BUSY");
    assert!(refused.header("retry-after").is_some());
    assert_eq!(site.get("/healthz").status, 200);
    assert_eq!(site.get("/metrics").status, 200);
    site.store.release();
    assert_eq!(client.join().unwrap().status, 200);
    assert_eq!(site.get("/v1/maps").status, 200);
}

#[test]
fn a_request_that_takes_too_long_is_a_problem() {
    let site = Site::with(|config| config.limits.request_seconds = 0.3);
    site.make_hall();
    site.store.hold();
    let answer = site.post("/v1/maps/hall/scans", &ring("a", Some(1)).to_string());
    answer.problem(503, "TIMEOUT");
    site.store.release();
    // The scan was taken; sent again it is applied once.
    let again = site.post("/v1/maps/hall/scans", &ring("a", Some(1)).to_string()).json();
    assert_eq!(again["applied"].as_u64().unwrap() + again["duplicates"].as_u64().unwrap(), 1);
    assert_eq!(site.get("/v1/maps/hall").json()["robots"][0]["applied"], "1");
}

#[test]
fn a_head_that_does_not_come_is_not_waited_for() {
    let site = Site::with(|config| config.limits.header_seconds = 0.3);
    let begun = Instant::now();
    site.raw(b"GET /healthz HTTP/1.1\r\nHost: x\r\nX-Slow:");
    assert!(begun.elapsed() < Duration::from_secs(10));
    // What is no HTTP at all ends that connection alone.
    site.raw(b"\x16\x03\x01\x02\x00\x01\x00\x01\xfc\x03\x03\r\n\r\n");
    assert_eq!(site.get("/healthz").status, 200);
}

#[test]
fn a_body_that_breaks_off_ends_that_request_alone() {
    let site = Site::with(|config| config.limits.request_seconds = 0.5);
    site.make_hall();
    let head = b"POST /v1/maps/hall/scans HTTP/1.1\r\nHost: x\r\nContent-Length: 1000\r\n\r\n{\"scans\":";
    let answer = String::from_utf8_lossy(&site.raw(head)).into_owned();
    assert!(answer.starts_with("HTTP/1.1 503") && answer.contains("\"TIMEOUT\""), "{answer}");
    assert_eq!(site.get("/v1/maps/hall").json()["revision"], "0");
}

#[test]
fn the_end_waits_for_requests_under_way() {
    let mut site = Site::hall();
    site.store.hold();
    let url = format!("{}/v1/maps/hall/scans", site.url());
    let body = ring("a", Some(1)).to_string();
    let client = thread::spawn(move || send(&agent(), "POST", &url, &[], body.as_bytes()));
    while site.store.waiting.load(Ordering::SeqCst) == 0 {
        thread::sleep(Duration::from_millis(5));
    }
    let server = site.server.take().unwrap();
    let address = server.address();
    let service = server.service().clone();
    let end = site.runtime.spawn(server.shutdown());
    // New connections are turned away while the request under way still waits.
    let begun = Instant::now();
    while std::net::TcpStream::connect(address).is_ok() && begun.elapsed().as_secs() < 10 {
        thread::sleep(Duration::from_millis(10));
    }
    assert!(std::net::TcpStream::connect(address).is_err());
    assert!(!end.is_finished() && !client.is_finished());
    site.store.release();
    let answer = client.join().unwrap();
    assert_eq!((answer.status, &answer.json()["applied"]), (200, &json!(1)));
    site.runtime.block_on(end).unwrap().unwrap();
    assert!(!service.is_ready());
}

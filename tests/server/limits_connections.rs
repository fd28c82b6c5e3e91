//! Limits on connections, heads and streams, and pages of other origins.

#![allow(clippy::unwrap_used, reason = "a test may end where its ground is not as it should be")]

use crate::grpc_support::{message, refused, ring};
use crate::http_support::{Answer, Site};
use crate::limits_support::{at_last, hits};
use std::io::{Read, Write};
use std::net::TcpStream;
use std::time::Duration;
use tonic::Code;
use ubbmap::wire::v1;

fn connect(site: &Site) -> TcpStream {
    let stream = TcpStream::connect(site.server.as_ref().unwrap().address()).unwrap();
    stream.set_read_timeout(Some(Duration::from_secs(20))).unwrap();
    stream
}

/// A connection with one answer on it, left open.
fn used(site: &Site) -> (TcpStream, String) {
    let mut stream = connect(site);
    stream.write_all(b"GET /healthz HTTP/1.1\r\nHost: x\r\n\r\n").unwrap();
    let mut head = [0; 4096];
    let length = stream.read(&mut head).unwrap();
    (stream, String::from_utf8_lossy(&head[..length]).into_owned())
}

#[test]
fn a_client_has_so_many_connections_and_is_told_so_on_the_next() {
    let site = Site::with(|config| config.limits.connections_per_client = 3);
    let agent = 1; // The helper of these tests keeps one open.
    assert_eq!(site.get("/healthz").status, 200);
    let open: Vec<_> = (agent..3).map(|_| used(&site)).collect();
    assert!(open.iter().all(|(_, answer)| answer.starts_with("HTTP/1.1 200")), "{open:?}");
    let before = hits(&site, "limits.connections_per_client");
    let (mut refused_here, answer) = used(&site);
    assert!(answer.starts_with("HTTP/1.1 429") && answer.contains("connection: close"), "{answer}");
    assert!(answer.contains("setting limits.connections_per_client") && answer.contains("retry-after: 1"), "{answer}");
    assert_eq!(refused_here.read(&mut [0; 10]).unwrap(), 0, "it is closed");
    let told = site.run(async {
        let mut client = tonic::client::Grpc::new(
            tonic::transport::Channel::from_shared(site.url()).unwrap().connect().await.unwrap(),
        );
        client.ready().await.unwrap();
        let codec = tonic_prost::ProstCodec::<v1::ListMapsRequest, v1::ListMapsResponse>::default();
        let path = "/ubbmap.v1.MapService/ListMaps".parse().unwrap();
        client.unary(tonic::Request::new(v1::ListMapsRequest {}), path, codec).await
    });
    let (_, detail) = refused(told, Code::ResourceExhausted, "BUSY");
    assert!(detail.contains("setting limits.connections_per_client"), "{detail}");
    assert!(hits(&site, "limits.connections_per_client") >= before + 2);
    drop(open);
    at_last(|| used(&site).1.starts_with("HTTP/1.1 200"));
}

#[test]
fn a_client_has_so_many_streams_over_all_transports() {
    let site = Site::with(|config| config.limits.streams_per_client = 2).with_hall();
    let watch = v1::WatchMapRequest { map: "hall".to_owned(), ..v1::WatchMapRequest::default() };
    let mut client = site.rpc();
    let one = site.run(client.watch_map(watch.clone())).unwrap();
    let mut two = connect(&site);
    two.write_all(b"GET /v1/maps/hall/events HTTP/1.1\r\nHost: x\r\nAccept: text/event-stream\r\n\r\n").unwrap();
    assert!(two.read(&mut [0; 100]).unwrap() > 0);
    let before = hits(&site, "limits.streams_per_client");
    let (_, detail) = refused(site.run(client.watch_map(watch.clone())), Code::ResourceExhausted, "BUSY");
    assert!(detail.contains("setting limits.streams_per_client"), "{detail}");
    let scans = tokio_stream::iter([message("hall", ring("r", Some(1)))]);
    refused(site.run(client.stream_scans(scans)), Code::ResourceExhausted, "BUSY");
    let (_, detail) = site.get("/v1/maps/hall/events").problem(429, "BUSY");
    assert!(detail.contains("setting limits.streams_per_client"), "{detail}");
    let lines = [("content-type", "application/x-ndjson"), ("accept", "application/x-ndjson")];
    site.send("POST", "/v1/maps/hall/scans", &lines, b"\n").problem(429, "BUSY");
    assert!(hits(&site, "limits.streams_per_client") >= before + 4);
    drop((one, two));
    // Their ends are seen with the next change.
    let body = crate::http_support::ring("s", None).to_string();
    at_last(|| {
        site.post("/v1/maps/hall/scans", &body);
        site.run(client.watch_map(watch.clone())).is_ok()
    });
}

/// A request with a head of about so many bytes.
fn headed(site: &Site, bytes: usize) -> Answer {
    site.send("GET", "/v1/maps", &[("x-long", &"a".repeat(bytes))], b"")
}

#[test]
fn a_head_is_as_large_as_it_may_be_and_no_larger() {
    let site = Site::with(|config| config.limits.header_bytes = 2048);
    assert_eq!(headed(&site, 1000).status, 200);
    let before = hits(&site, "limits.header_bytes");
    let (_, detail) = headed(&site, 2048).problem(431, "HEADERS_TOO_LARGE");
    assert!(detail.contains("the limit is 2048 (setting limits.header_bytes)"), "{detail}");
    let mut client = site.rpc();
    let mut request = tonic::Request::new(v1::ListMapsRequest {});
    request.metadata_mut().insert("x-long", "a".repeat(2048).parse().unwrap());
    let (_, detail) = refused(site.run(client.list_maps(request)), Code::ResourceExhausted, "HEADERS_TOO_LARGE");
    assert!(detail.contains("setting limits.header_bytes"), "{detail}");
    assert_eq!(hits(&site, "limits.header_bytes"), before + 2);
    // A flood is cut off by the reader of heads, and others are served.
    let mut flood = connect(&site);
    let _ = flood.write_all(b"GET / HTTP/1.1\r\nHost: x\r\n");
    for at in 0..100_000 {
        if flood.write_all(format!("x-{at}: {}\r\n", "a".repeat(100)).as_bytes()).is_err() {
            break;
        }
        assert!(at < 50_000, "a head without an end is read");
    }
    assert_eq!(site.get("/healthz").status, 200);
}

#[test]
fn a_connection_without_a_request_is_closed() {
    let site = Site::with(|config| config.limits.idle_seconds = 0.3);
    let before = hits(&site, "limits.idle_seconds");
    let (mut quiet, _) = used(&site);
    assert_eq!(quiet.read(&mut [0; 10]).unwrap(), 0);
    // Of HTTP/2 likewise, though it answers pings.
    let mut second = connect(&site);
    second.write_all(&[PREFACE, &[0, 0, 0, 4, 0, 0, 0, 0, 0]].concat()).unwrap();
    let mut rest = Vec::new();
    second.read_to_end(&mut rest).unwrap();
    at_last(|| hits(&site, "limits.idle_seconds") >= before + 2);
    // One that is watched is not idle, however quiet the map.
    site.make_hall();
    let mut client = site.rpc();
    let watch = v1::WatchMapRequest { map: "hall".to_owned(), ..v1::WatchMapRequest::default() };
    site.run(async {
        let mut changes = client.watch_map(watch).await.unwrap().into_inner();
        assert!(changes.message().await.unwrap().is_some());
        let quiet = tokio::time::timeout(Duration::from_secs(1), changes.message()).await;
        assert!(quiet.is_err(), "{quiet:?}");
    });
}

#[test]
fn what_sends_nothing_at_all_is_closed_and_counted() {
    let site = Site::with(|config| config.limits.header_seconds = 0.2);
    let before = hits(&site, "limits.header_seconds");
    let mut silent = connect(&site);
    assert_eq!(silent.read(&mut [0; 10]).unwrap(), 0);
    assert!(hits(&site, "limits.header_seconds") > before);
}

#[test]
fn a_full_server_counts_who_waits_to_be_accepted() {
    let site = Site::with(|config| config.limits.connections = 2);
    let (one, _) = used(&site);
    assert_eq!(site.get("/healthz").status, 200);
    // Both places are taken: the next one waits until one is free.
    let mut third = connect(&site);
    third.write_all(b"GET /healthz HTTP/1.1\r\nHost: x\r\n\r\n").unwrap();
    at_last(|| hits(&site, "limits.connections") > 0);
    drop(one);
    let mut head = [0; 12];
    third.read_exact(&mut head).unwrap();
    assert_eq!(&head, b"HTTP/1.1 200");
}

const PREFACE: &[u8] = b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n";

/// Frames of HTTP/2 until the server closes: type, stream and payload.
fn frames(mut bytes: &[u8]) -> Vec<(u8, u32, Vec<u8>)> {
    let mut all = Vec::new();
    while let [a, b, c, kind, _, s0, s1, s2, s3, rest @ ..] = bytes {
        let length = u32::from_be_bytes([0, *a, *b, *c]) as usize;
        let Some((payload, more)) = rest.split_at_checked(length) else { break };
        all.push((*kind, u32::from_be_bytes([*s0, *s1, *s2, *s3]), payload.to_vec()));
        bytes = more;
    }
    all
}

#[test]
fn a_connection_of_http_2_says_how_many_requests_it_takes_and_ends_under_a_flood_of_resets() {
    let site = Site::with(|config| config.limits.requests_per_connection = 7);
    let mut flood = connect(&site);
    flood.write_all(&[PREFACE, &[0, 0, 0, 4, 0, 0, 0, 0, 0]].concat()).unwrap();
    // A request (:method GET, :scheme http, :path /, :authority x) and its end, over and over (CVE-2023-44487).
    let block = [0x82, 0x86, 0x84, 0x41, 1, b'x'];
    for turn in 0..20_000_u32 {
        let stream = (2 * turn + 1).to_be_bytes();
        let headers = [&[0, 0, 6, 1, 5][..], &stream, &block].concat();
        let reset = [&[0, 0, 4, 3, 0][..], &stream, &8_u32.to_be_bytes()].concat();
        if flood.write_all(&[headers, reset].concat()).is_err() {
            break;
        }
    }
    let mut answer = Vec::new();
    let _ = flood.read_to_end(&mut answer);
    let frames = frames(&answer);
    // SETTINGS_MAX_CONCURRENT_STREAMS is 3.
    let settings = &frames.iter().find(|(kind, ..)| *kind == 4).unwrap().2;
    assert!(settings.chunks(6).any(|setting| setting == [0, 3, 0, 0, 0, 7]), "{settings:?}");
    // GOAWAY is 7, and ENHANCE_YOUR_CALM 11.
    let away = frames.iter().find(|(kind, ..)| *kind == 7);
    assert!(away.is_some_and(|(.., payload)| payload[4..8] == [0, 0, 0, 11]), "{away:?}");
    assert_eq!(site.get("/healthz").status, 200);
}

#[test]
fn pages_of_other_origins_are_let_in_by_name_and_none_by_default() {
    let origin = [("origin", "https://app.example.org")];
    let preflight = [
        ("origin", "https://app.example.org"),
        ("access-control-request-method", "POST"),
        ("access-control-request-headers", "content-type,authorization"),
    ];
    let site = Site::new();
    let allowed = |answer: &Answer| answer.header("access-control-allow-origin").map(str::to_owned);
    assert_eq!(allowed(&site.send("GET", "/v1/maps", &origin, b"")), None);
    assert_eq!(allowed(&site.send("OPTIONS", "/v1/maps/hall/scans", &preflight, b"")), None);

    let site = Site::with(|config| config.cors_origins = "https://app.example.org, https://b.example.org".to_owned());
    let answer = site.send("GET", "/v1/maps", &origin, b"");
    assert_eq!(allowed(&answer).as_deref(), Some("https://app.example.org"));
    assert!(answer.header("access-control-expose-headers").unwrap().contains("retry-after"));
    assert_eq!(answer.header("access-control-allow-credentials"), None);
    let answer = site.send("OPTIONS", "/v1/maps/hall/scans", &preflight, b"");
    assert_eq!((answer.status, allowed(&answer).as_deref()), (200, Some("https://app.example.org")));
    assert!(answer.header("access-control-allow-headers").unwrap().contains("authorization"));
    assert_eq!(allowed(&site.send("GET", "/v1/maps", &[("origin", "https://c.example.org")], b"")), None);
    // gRPC-Web of such a page, too.
    let web = [("origin", "https://b.example.org"), ("content-type", "application/grpc-web+proto")];
    let answer = site.send("POST", "/ubbmap.v1.MapService/ListMaps", &web, &[0; 5]);
    assert_eq!(allowed(&answer).as_deref(), Some("https://b.example.org"));
}

#[test]
fn reads_find_a_place_beside_all_the_insertions_that_there_may_be() {
    let site = Site::with(|config| {
        config.limits.requests = 3;
        config.limits.insertions = 2;
    });
    site.make_hall();
    // The server says that it waits for the body, so the place is taken; or it refuses.
    let begin = || {
        let mut stream = connect(&site);
        let head = "POST /v1/maps/hall/scans HTTP/1.1\r\nHost: x\r\nContent-Type: application/json\r\nContent-Length: 10\r\n\
            Expect: 100-continue\r\n\r\n";
        stream.write_all(head.as_bytes()).unwrap();
        let mut answer = [0; 4096];
        let length = stream.read(&mut answer).unwrap();
        (stream, String::from_utf8_lossy(&answer[..length]).into_owned())
    };
    let before = hits(&site, "limits.insertions");
    let begun = [begin(), begin()];
    assert!(begun.iter().all(|(_, answer)| answer.starts_with("HTTP/1.1 100")), "{begun:?}");
    let (_, refused_here) = begin();
    assert!(
        refused_here.starts_with("HTTP/1.1 429") && refused_here.contains("setting limits.insertions"),
        "{refused_here}"
    );
    let mut client = site.rpc();
    let request = v1::InsertScansRequest { map: "hall".to_owned(), scans: vec![ring("r", Some(1))] };
    let (_, detail) = refused(site.run(client.insert_scans(request)), Code::ResourceExhausted, "BUSY");
    assert!(detail.contains("setting limits.insertions"), "{detail}");
    assert!(hits(&site, "limits.insertions") >= before + 2);
    assert_eq!(site.get("/v1/maps/hall").status, 200);
    drop(begun);
    at_last(|| begin().1.starts_with("HTTP/1.1 100"));
}

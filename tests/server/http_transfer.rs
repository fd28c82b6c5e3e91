//! Exports and imports over REST: files that are whole or refused, slow clients that hold up nobody.

#![allow(clippy::unwrap_used, reason = "a test may end where its ground is not as it should be")]

use crate::http_support::{Answer, Site, gzip, ring};
use crate::service_support::{config_of, map_name};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde_json::json;
use std::collections::BTreeMap;
use std::io::{Read, Write};
use std::net::TcpStream;
use std::sync::Arc;
use std::time::{Duration, Instant};
use ubbmap::mapping::EvidenceRule;
use ubbmap::quadtree::{Block, BlockAddress, BlockView, OccupancyTree};
use ubbmap::store::{LoadedMap, write_map_file};

fn insert(site: &Site, sequence: u64) {
    assert_eq!(site.post("/v1/maps/hall/scans", &ring("a", Some(sequence)).to_string()).json()["applied"], 1);
}

fn import(site: &Site, map: &str, file: &[u8]) -> Answer {
    site.send("PUT", &format!("/v1/maps/{map}/import"), &[("content-type", "application/octet-stream")], file)
}

#[test]
fn a_map_goes_out_as_a_file_and_comes_in_under_another_name() {
    let site = Site::hall();
    for sequence in 1..4 {
        insert(&site, sequence);
    }
    let file = site.get("/v1/maps/hall/export");
    assert_eq!((file.status, file.header("content-type")), (200, Some("application/octet-stream")));
    assert_eq!(file.header("content-disposition"), Some("attachment; filename=\"hall-r3.ubbmap\""));
    assert_eq!(file.header("ubbmap-revision"), Some("3"));
    assert_eq!(file.header("content-length"), Some(file.body.len().to_string().as_str()));
    let tag = file.header("etag").unwrap();
    let again = site.send("GET", "/v1/maps/hall/export?format=ubbmap", &[("if-none-match", tag)], b"");
    assert_eq!((again.status, again.body.len(), again.header("etag")), (304, 0, Some(tag)));

    let imported = import(&site, "copy", &file.body);
    assert_eq!((imported.status, imported.json()), (201, json!({"name": "copy", "revision": "3"})));
    let of = |map: &str, what: &str| site.get(&format!("/v1/maps/{map}/{what}")).json();
    assert_eq!(of("copy", "region")["leaves"], of("hall", "region")["leaves"]);
    let show = |map: &str| site.get(&format!("/v1/maps/{map}")).json();
    for what in ["revision", "config", "robots", "bounds"] {
        assert_eq!(show("copy")[what], show("hall")[what], "{what}");
    }
    import(&site, "copy", &file.body).problem(409, "MAP_EXISTS");

    insert(&site, 4);
    let changed = site.send("GET", "/v1/maps/hall/export", &[("if-none-match", tag)], b"");
    assert_eq!((changed.status, changed.header("ubbmap-revision")), (200, Some("4")));
    let nav2 = site.get("/v1/maps/hall/export?format=nav2&depth=7&mode=scale");
    assert_eq!(nav2.header("content-type"), Some("application/zip"));
    assert_eq!(nav2.header("content-disposition"), Some("attachment; filename=\"hall-r4-nav2.zip\""));
    assert!(nav2.body.starts_with(b"PK"));
    for (query, field) in [
        ("format=png", "format"),
        ("format=nav2&mode=raw", "mode"),
        ("mode=scale", "mode"),
        ("depth=3", "depth"),
        ("format=nav2&depth=x", "depth"),
        ("snapshot=", "snapshot"),
        ("revision=3", "revision"),
    ] {
        assert_eq!(site.get(&format!("/v1/maps/hall/export?{query}")).problem(400, "INVALID_REQUEST").0, field);
    }
}

#[test]
fn what_is_no_whole_file_leaves_nothing() {
    let site = Site::with(|config| config.limits.import_bytes = 5000);
    site.make_hall();
    insert(&site, 1);
    let file = site.get("/v1/maps/hall/export").body;
    let (field, detail) = import(&site, "copy", &[0; 5001]).problem(413, "BODY_TOO_LARGE");
    assert!(field == "body" && detail.contains("5000 bytes") && detail.contains("limits.import_bytes"), "{detail}");
    let (field, detail) = import(&site, "copy", &file[..file.len() / 2]).problem(400, "INVALID_FILE");
    assert!(field == "data" && detail.contains("it is cut"), "{field}: {detail}");
    let packed = site.send("PUT", "/v1/maps/copy/import", &[("content-encoding", "gzip")], &gzip(&file));
    packed.problem(415, "UNSUPPORTED_MEDIA_TYPE");
    import(&site, "Copy", &file).problem(400, "INVALID_NAME");
    // A client that says how much it will send, and goes away in the middle.
    let mut stream = TcpStream::connect(site.server.as_ref().unwrap().address()).unwrap();
    let head = format!("PUT /v1/maps/copy/import HTTP/1.1\r\nhost: x\r\ncontent-length: {}\r\n\r\n", file.len());
    stream.write_all(head.as_bytes()).unwrap();
    stream.write_all(&file[..file.len() - 1]).unwrap();
    drop(stream);
    std::thread::sleep(Duration::from_millis(300));
    assert_eq!(site.get("/v1/maps").json()["maps"].as_array().unwrap().len(), 1);
    assert_eq!(import(&site, "copy", &file).status, 201, "the name is free");
}

/// A map file that is larger than what sockets hold.
fn large_file() -> Vec<u8> {
    let config = config_of(0.1, 13, 10, EvidenceRule::Guaranteed);
    let mut tree = OccupancyTree::new(13, config.scale());
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    for code in 0..12_000 {
        let mut leaves = Box::new([0; 64 * 64]);
        rng.fill_bytes(&mut leaves[..]);
        leaves.iter_mut().for_each(|leaf| *leaf = 1 + *leaf % 10);
        tree.set_block(BlockAddress::from_morton(code), BlockView::Mixed(Arc::new(Block::from_leaves(leaves))));
    }
    let mut file = Vec::new();
    write_map_file(&mut file, &config, &LoadedMap { revision: 1, tree, windows: BTreeMap::new() }).unwrap();
    assert!(file.len() > 16 << 20, "{}", file.len());
    file
}

#[test]
fn a_client_that_does_not_read_its_file_holds_up_its_own_transfer_only() {
    let site = Site::with(|config| {
        config.limits.transfers = 1;
        config.limits.transfer_seconds = 6.0;
        config.limits.queries = 1;
    });
    site.make_hall();
    assert_eq!(import(&site, "large", &large_file()).status, 201);
    let mut stream = TcpStream::connect(site.server.as_ref().unwrap().address()).unwrap();
    stream.write_all(b"GET /v1/maps/large/export HTTP/1.1\r\nhost: x\r\n\r\n").unwrap();
    let mut first = [0; 100];
    stream.read_exact(&mut first).unwrap();
    assert!(first.starts_with(b"HTTP/1.1 200"));
    // The one place is taken; everything else goes on, the map that is being sent too.
    site.get("/v1/maps/hall/export").problem(429, "BUSY");
    import(&site, "other", b"").problem(429, "BUSY");
    insert(&site, 1);
    assert_eq!(site.get("/v1/maps/large/grid?depth=8").status, 200);
    let scan = ring("a", Some(1)).to_string();
    assert_eq!(site.post("/v1/maps/large/scans", &scan).json()["applied"], 1);
    assert_eq!(site.post("/v1/maps/large/snapshots", r#"{"name": "now"}"#).status, 201);
    // Its time is over at some point, and the place is free; what it gets then is no whole file.
    let begun = Instant::now();
    while site.get("/v1/maps/hall/export").status != 200 {
        assert!(begun.elapsed() < Duration::from_secs(40), "the place is never given back");
        std::thread::sleep(Duration::from_millis(50));
    }
    let mut rest = Vec::new();
    stream.set_read_timeout(Some(Duration::from_secs(20))).unwrap();
    let _ = stream.read_to_end(&mut rest);
    let text = String::from_utf8_lossy(&rest[..400]).into_owned() + &String::from_utf8_lossy(&first);
    assert!(text.contains("content-length") || text.contains("Content-Length"), "{text}");
    let whole = site.get("/v1/maps/large/export").body.len();
    assert!(rest.len() < whole / 2 + whole / 3, "{} of {whole}", rest.len());
    assert!(site.run(site.server.as_ref().unwrap().service().map(&map_name("large"))).unwrap().revision == 2);
}

#[test]
fn an_upload_that_stands_still_is_ended() {
    let site = Site::with(|config| config.limits.transfer_seconds = 0.3);
    site.make_hall();
    let head = b"PUT /v1/maps/copy/import HTTP/1.1\r\nhost: x\r\nconnection: close\r\ncontent-length: 100\r\n\r\n";
    let answer = String::from_utf8_lossy(&site.raw(head)).into_owned();
    assert!(answer.starts_with("HTTP/1.1 503") && answer.contains("\"code\":\"TIMEOUT\""), "{answer}");
    assert!(answer.contains("not transferred within 0.3 s"), "{answer}");
}

#[test]
fn an_upload_may_take_longer_than_a_request() {
    let site = Site::with(|config| config.limits.request_seconds = 0.4);
    site.make_hall();
    insert(&site, 1);
    let file = site.get("/v1/maps/hall/export").body;
    let mut stream = TcpStream::connect(site.server.as_ref().unwrap().address()).unwrap();
    let head = format!(
        "PUT /v1/maps/copy/import HTTP/1.1\r\nhost: x\r\nconnection: close\r\ncontent-length: {}\r\n\r\n",
        file.len()
    );
    stream.write_all(head.as_bytes()).unwrap();
    for piece in file.chunks(file.len().div_ceil(4)) {
        std::thread::sleep(Duration::from_millis(300));
        stream.write_all(piece).unwrap();
    }
    let mut answer = String::new();
    stream.read_to_string(&mut answer).unwrap();
    assert!(answer.starts_with("HTTP/1.1 201"), "{answer}");
}

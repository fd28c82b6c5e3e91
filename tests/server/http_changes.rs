//! Changes over HTTP: at once, as server-sent events, as lines; and scans as a stream of lines.

#![allow(clippy::unwrap_used, reason = "a test may end where its ground is not as it should be")]

use crate::http_support::{Answer, Site, ring};
use base64_of::decode;
use prost::Message;
use serde_json::{Value, json};
use std::io::{BufRead, BufReader, Read, Write};
use std::net::TcpStream;
use std::thread;
use std::time::Duration;
use ubbmap::wire::v1;

const SCANS: &str = "/v1/maps/hall/scans";

fn insert(site: &Site, sequence: u64) -> Answer {
    let mut scan = ring("a", Some(sequence));
    scan["pose"]["x"] = json!({"min": 0.2 * sequence as f64, "max": 0.2 * sequence as f64});
    let answer = site.post(SCANS, &scan.to_string());
    assert_eq!(answer.json()["applied"], 1);
    answer
}

/// A request whose answer is read as it comes, without the chunks' own lines.
struct Stream {
    reader: BufReader<TcpStream>,
}

impl Stream {
    fn open(site: &Site, request: &str) -> Self {
        let stream = TcpStream::connect(site.server.as_ref().unwrap().address()).unwrap();
        stream.set_read_timeout(Some(Duration::from_secs(20))).unwrap();
        (&stream).write_all(request.as_bytes()).unwrap();
        Self { reader: BufReader::new(stream) }
    }

    fn get(site: &Site, path: &str, headers: &str) -> Self {
        Self::open(site, &format!("GET {path} HTTP/1.1\r\nHost: x\r\n{headers}\r\n"))
    }

    fn send(&mut self, bytes: &[u8]) {
        let chunk = [format!("{:x}\r\n", bytes.len()).as_bytes(), bytes, b"\r\n"].concat();
        self.reader.get_mut().write_all(&chunk).unwrap();
    }

    fn line(&mut self) -> Option<String> {
        let mut line = String::new();
        let read = self.reader.read_line(&mut line).unwrap_or(0);
        (read > 0).then(|| line.trim_end().to_owned())
    }

    /// The next line that begins so, and what stands behind that.
    fn next(&mut self, start: &str) -> Option<String> {
        while let Some(line) = self.line() {
            if let Some(rest) = line.strip_prefix(start) {
                return Some(rest.to_owned());
            }
        }
        None
    }

    /// `(id, data)` of the next event.
    fn event(&mut self) -> (Option<u64>, Value) {
        let (mut id, mut data) = (None, None);
        while id.is_none() || data.is_none() {
            let line = self.line().unwrap();
            if let Some(text) = line.strip_prefix("id: ") {
                id = Some(text.parse().unwrap());
            } else if let Some(text) = line.strip_prefix("data: ") {
                data = Some(serde_json::from_str(text).unwrap());
            } else if line == "event: end" {
                let data = self.next("data: ").unwrap();
                return (None, serde_json::from_str(&data).unwrap());
            }
        }
        (id, data.unwrap())
    }
}

#[test]
fn changes_since_a_revision_come_as_json_and_protobuf() {
    let site = Site::hall();
    for sequence in 1..=3 {
        insert(&site, sequence);
    }
    let answer = site.get("/v1/maps/hall/changes?since=2").json();
    assert_eq!(
        (&answer["revision"], &answer["since"], &answer["everything"]),
        (&json!("3"), &json!("2"), &json!(false))
    );
    let blocks = answer["blocks"].as_array().unwrap();
    assert!(!blocks.is_empty() && blocks.iter().all(|block| block["revision"] == "3" && block["classes"] == ""));
    let path = "/v1/maps/hall/changes?since=0&contents=true&depth=4&min_x=0&max_x=6.4&min_y=0&max_y=6.4";
    let answer = site.send("GET", path, &[("accept", "application/x-protobuf")], b"");
    let changes = v1::GetChangesResponse::decode(&answer.body[..]).unwrap();
    // One block of 64 x 64 leaves of 0.1 m is this box; at depth 4 it has 4 x 4 cells.
    assert_eq!((changes.blocks.len(), changes.blocks[0].classes.len(), changes.depth), (1, 16, 4));
    let grid = site.get("/v1/maps/hall/grid?depth=4&min_x=0&max_x=6.4&min_y=0&max_y=6.4&format=json").json();
    assert_eq!(decode(grid["classes"].as_str().unwrap()), changes.blocks[0].classes);
    for (query, field) in [
        ("", "since"),
        ("?since=x", "since"),
        ("?since=-1", "since"),
        ("?since=1&since=2", "since"),
        ("?since=1&contents=perhaps", "contents"),
        ("?since=1&colour=red", "colour"),
    ] {
        let answer = site.get(&format!("/v1/maps/hall/changes{query}"));
        assert_eq!(answer.problem(400, "INVALID_REQUEST").0, field, "{query}");
    }
    site.get("/v1/maps/hall/changes?since=0&depth=9").problem(400, "DEPTH_OUT_OF_RANGE");
    site.get("/v1/maps/nowhere/changes?since=0").problem(404, "MAP_NOT_FOUND");
    site.get("/v1/maps/hall/changes?since=5");
}

#[test]
fn events_come_with_every_commit_and_resume_where_the_client_stopped() {
    let site = Site::hall();
    let mut events = Stream::get(&site, "/v1/maps/hall/events", "");
    assert_eq!(events.next("HTTP/1.1 ").unwrap(), "200 OK");
    assert_eq!(events.next("content-type: ").unwrap(), "text/event-stream");
    // The first event says where the map stands.
    let (id, first) = events.event();
    assert_eq!((id, &first["revision"], &first["blocks"]), (Some(0), &json!("0"), &json!([])));
    for sequence in 1..=3 {
        insert(&site, sequence);
        let (id, mut event) = events.event();
        assert_eq!((id, &event["since"]), (Some(sequence), &json!((sequence - 1).to_string())));
        assert_eq!(event.as_object_mut().unwrap().remove("robots"), Some(json!([])));
        let told = site.get(&format!("/v1/maps/hall/changes?since={}", sequence - 1)).json();
        assert_eq!(event, told);
    }
    drop(events);
    for sequence in 4..=6 {
        insert(&site, sequence);
    }
    // The header stands above the query string, as after a lost connection.
    let mut events = Stream::get(&site, "/v1/maps/hall/events?since=0", "Last-Event-ID: 3\r\n");
    let (id, event) = events.event();
    assert_eq!((id, &event["since"], &event["everything"]), (Some(6), &json!("3"), &json!(false)));
    let answer = site.send("GET", "/v1/maps/hall/events", &[("last-event-id", "x")], b"");
    assert_eq!(answer.problem(400, "INVALID_REQUEST").0, "last-event-id");
    site.get("/v1/maps/nowhere/events").problem(404, "MAP_NOT_FOUND");
    site.send("GET", "/v1/maps/hall/events", &[("accept", "image/png")], b"").problem(406, "NOT_ACCEPTABLE");
    // The map's end is the stream's.
    assert_eq!(site.send("DELETE", "/v1/maps/hall", &[], b"").status, 204);
    let (id, end) = events.event();
    assert_eq!((id, &end["code"]), (None, &json!("MAP_NOT_FOUND")));
}

#[test]
fn events_come_as_lines_too() {
    let site = Site::hall();
    let mut lines = Stream::get(&site, "/v1/maps/hall/events?since=0", "Accept: application/x-ndjson\r\n");
    assert_eq!(lines.next("content-type: ").unwrap(), "application/x-ndjson");
    let message =
        |lines: &mut Stream| -> Value { serde_json::from_str(&format!("{{{}", lines.next("{").unwrap())).unwrap() };
    assert_eq!(message(&mut lines)["revision"], "0");
    insert(&site, 1);
    assert_eq!(message(&mut lines)["revision"], "1");
}

#[test]
fn streams_are_limited_and_end_with_the_server() {
    let mut site = Site::with(|config| config.limits.streams = 1);
    site.make_hall();
    let mut events = Stream::get(&site, "/v1/maps/hall/events", "");
    events.event();
    site.get("/v1/maps/hall/events").problem(429, "BUSY");
    // Operations have a limit of their own.
    assert_eq!(site.get("/v1/maps").status, 200);
    site.shut_down();
    assert_eq!(events.event().1["code"], "SHUTTING_DOWN");
}

#[test]
fn a_stream_of_lines_is_acknowledged_line_by_line() {
    let site = Site::hall();
    let head = "POST /v1/maps/hall/scans HTTP/1.1\r\nHost: x\r\nContent-Type: application/x-ndjson\r\n\
                Accept: application/x-ndjson\r\nTransfer-Encoding: chunked\r\n\r\n";
    let mut stream = Stream::open(&site, head);
    let message =
        |stream: &mut Stream| -> Value { serde_json::from_str(&format!("{{{}", stream.next("{").unwrap())).unwrap() };
    for (at, (sequence, duplicate)) in [(1, false), (2, false), (1, true)].into_iter().enumerate() {
        // A line may come in pieces, and several in one.
        let line = format!("{}\n", ring("a", Some(sequence)));
        let (first, second) = line.split_at(line.len() / 2);
        stream.send(first.as_bytes());
        thread::sleep(Duration::from_millis(20));
        stream.send(second.as_bytes());
        let answer = message(&mut stream);
        assert_eq!(answer["index"], at.to_string());
        assert_eq!((&answer["sequence"], &answer["duplicate"]), (&json!(sequence.to_string()), &json!(duplicate)));
        // What was acknowledged is to be seen.
        let map = site.get("/v1/maps/hall").json();
        assert_eq!(map["robots"][0]["highest_sequence"], if at == 0 { "1" } else { "2" });
    }
    let mut wide = ring("a", Some(9));
    wide["pose"]["x"] = json!({"min": 0, "max": 3});
    stream.send(format!("{wide}\n\n{}\n", ring("a", Some(3))).as_bytes());
    let rejected = message(&mut stream);
    assert_eq!((&rejected["rejected"]["code"], &rejected["index"]), (&json!("POSE_TOO_WIDE"), &json!("3")));
    assert_eq!(message(&mut stream)["sequence"], "3");
    // A line that is no scan ends the stream with a problem that names it.
    stream.send(b"nonsense\n");
    let problem = message(&mut stream);
    assert_eq!(problem["code"], "INVALID_REQUEST");
    assert!(problem["detail"].as_str().unwrap().starts_with("line 7: "), "{problem}");
    let mut rest = String::new();
    stream.reader.read_to_string(&mut rest).unwrap_or_default();
    assert_eq!(site.get("/v1/maps/hall").json()["robots"][0]["applied"], "3");
    let zipped =
        [("content-type", "application/x-ndjson"), ("accept", "application/x-ndjson"), ("content-encoding", "gzip")];
    site.send("POST", SCANS, &zipped, b"").problem(415, "UNSUPPORTED_MEDIA_TYPE");
    let lines = [("content-type", "application/x-ndjson"), ("accept", "application/x-ndjson")];
    site.send("POST", "/v1/maps/nowhere/scans", &lines, b"").problem(404, "MAP_NOT_FOUND");
}

/// The Base64 of proto3 JSON, undone by the rules of RFC 4648 alone.
mod base64_of {
    pub fn decode(text: &str) -> Vec<u8> {
        const ALPHABET: &[u8] = b"ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
        let mut bytes = Vec::new();
        let (mut bits, mut count) = (0_u32, 0);
        for letter in text.bytes().filter(|letter| *letter != b'=') {
            bits = bits << 6 | ALPHABET.iter().position(|known| *known == letter).unwrap() as u32;
            count += 6;
            if count >= 8 {
                count -= 8;
                bytes.push((bits >> count) as u8);
            }
        }
        bytes
    }
}

#[test]
fn robots_are_listed_and_come_with_the_events_where_they_are_asked_for() {
    let site = Site::hall();
    assert_eq!(site.get("/v1/maps/hall/robots").json(), json!({"revision": "0", "robots": []}));
    insert(&site, 1);
    let list = site.get("/v1/maps/hall/robots").json();
    let robot = &list["robots"][0];
    assert_eq!((&list["revision"], &robot["robot"], &robot["sequence"]), (&json!("1"), &json!("a"), &json!("1")));
    assert_eq!((&robot["pose"]["x"], &robot["sensor"]), (&json!({"min": 0.2, "max": 0.2}), &json!("default")));
    let mut asked = Stream::get(&site, "/v1/maps/hall/events?robots=true", "");
    let mut silent = Stream::get(&site, "/v1/maps/hall/events", "");
    assert_eq!(asked.event().1["robots"], list["robots"]);
    assert_eq!(silent.event().1["robots"], json!([]));
    insert(&site, 2);
    let told = asked.event().1;
    assert_eq!(told["robots"], site.get("/v1/maps/hall/robots").json()["robots"]);
    assert_eq!(told["robots"][0]["pose"]["x"]["min"], 0.4);
    assert_eq!(silent.event().1["robots"], json!([]));
    site.get("/v1/maps/hall/events?robots=yes").problem(400, "INVALID_REQUEST");
    site.get("/v1/maps/hall/changes?since=0&robots=true").problem(400, "INVALID_REQUEST");
    site.get("/v1/maps/hall/robots?since=0").problem(400, "INVALID_REQUEST");
    site.get("/v1/maps/nowhere/robots").problem(404, "MAP_NOT_FOUND");
}

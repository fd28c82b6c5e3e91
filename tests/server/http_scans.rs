//! Scans over HTTP: every form of body, and what a bad one does.

#![allow(clippy::unwrap_used, reason = "a test may end where its ground is not as it should be")]

use crate::http_support::{Site, gzip, ring};
use prost::Message;
use serde_json::{Value, json};
use ubbmap::wire::v1;

const SCANS: &str = "/v1/maps/hall/scans";
const JSON: (&str, &str) = ("content-type", "application/json");
const GZIP: (&str, &str) = ("content-encoding", "gzip");

fn list(scans: &[Value]) -> String {
    json!({ "scans": scans }).to_string()
}

#[test]
fn scans_are_applied_once() {
    let site = Site::hall();
    let body = list(&[ring("amr-7", Some(1)), ring("amr-7", Some(2)), ring("amr-8", Some(1))]);
    let first = site.post(SCANS, &body);
    assert_eq!(first.status, 200);
    assert_eq!(first.json(), json!({"revision": "1", "applied": 3, "duplicates": 0, "rejected": []}));
    let again = site.post(SCANS, &body);
    assert_eq!(again.json(), json!({"revision": "1", "applied": 0, "duplicates": 3, "rejected": []}));
    let robots = site.get("/v1/maps/hall").json()["robots"].clone();
    let expected = json!([
        {"robot": "amr-7", "highest_sequence": "2", "applied": "2"},
        {"robot": "amr-8", "highest_sequence": "1", "applied": "1"}]);
    assert_eq!(robots, expected);
}

#[test]
fn every_form_of_body_says_the_same() {
    let site = Site::hall();
    let scan = ring("a", None);
    let wire: v1::Scan = serde_json::from_value(scan.clone()).unwrap();
    let message = v1::InsertScansRequest { map: String::new(), scans: vec![wire] }.encode_to_vec();
    let lines = format!("{scan}\n\n{scan}\r\n");
    let one = scan.to_string();
    let many = list(std::slice::from_ref(&scan));
    let bodies: [(&str, Vec<u8>, u32); 8] = [
        ("application/json", one.into_bytes(), 1),
        ("application/json; charset=utf-8", many.clone().into_bytes(), 1),
        ("application/x-ndjson", lines.into_bytes(), 2),
        ("application/x-protobuf", message.clone(), 1),
        ("application/protobuf", message.clone(), 1),
        ("Application/JSON", format!("\n {many}").into_bytes(), 1),
        ("application/x-ndjson", Vec::new(), 0),
        ("application/x-protobuf", Vec::new(), 0),
    ];
    for (media, body, applied) in bodies {
        for zipped in [false, true] {
            let mut headers = vec![("content-type", media)];
            let body = if zipped { gzip(&body) } else { body.clone() };
            headers.extend(zipped.then_some(GZIP));
            let answer = site.send("POST", SCANS, &headers, &body);
            assert_eq!(answer.status, 200, "{media}: {}", String::from_utf8_lossy(&answer.body));
            assert_eq!(answer.json()["applied"], applied, "{media}");
        }
    }
    let accept = [("content-type", "application/x-protobuf"), ("accept", "application/x-protobuf")];
    let answer = site.send("POST", SCANS, &accept, &message);
    assert_eq!(v1::InsertScansResponse::decode(&answer.body[..]).unwrap().applied, 1);
}

#[test]
fn names_in_camel_case_and_special_numbers_are_taken() {
    let site = Site::hall();
    let mut scan = ring("a", None);
    scan["ranges"] = json!(["NaN", "Infinity", "-Infinity", "3.0", 3, 3.5e0]);
    let text = scan.to_string().replace("angle_min", "angleMin").replace("angle_increment", "angleIncrement");
    assert_eq!(site.post(SCANS, &text).json()["applied"], 1);
    let created = site.put("/v1/maps/camel", r#"{"minObstacleWidth": 0.5, "depth": 6}"#);
    assert_eq!(created.json()["config"]["min_obstacle_width"], 0.5);
}

#[test]
fn bad_scans_are_named_and_good_ones_applied() {
    let site = Site::hall();
    let mut wide = ring("a", None);
    wide["pose"]["x"] = json!({"min": 0, "max": 3});
    let mut inverted = ring("a", None);
    inverted["pose"]["theta"] = json!({"min": 1, "max": 0.5});
    let mut nan = ring("a", None);
    nan["pose"]["y"]["min"] = json!("NaN");
    let mut empty = ring("a", None);
    empty["ranges"] = json!([]);
    let mut uneven = ring("a", None);
    uneven["angles"] = json!([0, 1]);
    uneven.as_object_mut().unwrap().retain(|key, _| !key.starts_with("angle_"));
    let mut unknown = ring("a", None);
    unknown["sensor"] = json!("rear");
    let mut missing = ring("a", None);
    missing["pose"].as_object_mut().unwrap().remove("y");
    let body = list(&[ring("a", None), wide, inverted, nan, empty, uneven, unknown, missing, ring("a", Some(1))]);
    let answer = site.post(SCANS, &body).json();
    assert_eq!((&answer["applied"], &answer["revision"]), (&json!(2), &json!("1")));
    let rejected = answer["rejected"].as_array().unwrap();
    let named: Vec<_> = rejected
        .iter()
        .map(|scan| (scan["index"].as_u64().unwrap(), scan["code"].as_str().unwrap(), scan["detail"].as_str().unwrap()))
        .collect();
    let words = ["pose.x", "pose.theta", "pose.y", "ranges", "angles", "sensor", "pose.y"];
    assert_eq!(named.len(), words.len(), "{named:?}");
    for ((at, word), (index, code, detail)) in words.iter().enumerate().zip(&named) {
        assert_eq!(*index, at as u64 + 1);
        assert!(!code.is_empty() && detail.contains(word), "{code} {detail}");
    }
    assert_eq!(named[0].1, "POSE_TOO_WIDE");
}

#[test]
fn a_broken_body_changes_nothing() {
    let site = Site::hall();
    let good = list(&[ring("a", Some(1))]);
    let cut = &good[..good.len() - 1];
    let zipped = gzip(good.as_bytes());
    let protobuf = ("content-type", "application/x-protobuf");
    let lines = format!("{}\n{{\"pose\": []}}\n", ring("a", Some(1)));
    let ndjson = ("content-type", "application/x-ndjson");
    type Case<'a> = (&'a [(&'a str, &'a str)], Vec<u8>, &'a str);
    let cases: [Case<'_>; 8] = [
        (&[JSON], cut.into(), "JSON"),
        (&[JSON], good.replace("\"ranges\"", "\"rangs\"").into_bytes(), "rangs"),
        (&[JSON, GZIP], good.clone().into_bytes(), "gzip"),
        (&[JSON, GZIP], zipped[..zipped.len() - 9].to_vec(), "gzip"),
        (&[JSON, GZIP], [&zipped[..], b"more"].concat(), "gzip"),
        (&[protobuf], good.clone().into_bytes(), "protobuf"),
        (&[protobuf], vec![0x12, 0xff, 0xff, 0x7f], "protobuf"),
        (&[ndjson], lines.into_bytes(), "line 2"),
    ];
    for (headers, body, word) in cases {
        let (_, detail) = site.send("POST", SCANS, headers, &body).problem(400, "INVALID_REQUEST");
        assert!(detail.contains(word), "{word}: {detail}");
        assert!(word != "line 2" || !detail.contains("line 1"), "one line is at fault: {detail}");
    }
    assert_eq!(site.get("/v1/maps/hall").json()["revision"], "0");
    site.post("/v1/maps/nowhere/scans", &good).problem(404, "MAP_NOT_FOUND");
    let other = json!({"map": "other", "scans": []}).to_string();
    assert_eq!(site.post(SCANS, &other).problem(400, "INVALID_REQUEST").0, "map");
}

#[test]
fn forms_that_are_not_known_are_refused() {
    let site = Site::hall();
    let body = list(&[ring("a", None)]);
    for (name, value) in [("content-type", "text/plain"), ("content-encoding", "br"), ("content-type", "")] {
        let mut headers = vec![(name, value)];
        if name != "content-type" {
            headers.push(JSON);
        }
        let (field, _) = site.send("POST", SCANS, &headers, body.as_bytes()).problem(415, "UNSUPPORTED_MEDIA_TYPE");
        assert_eq!(field, name);
    }
    let headers = [JSON, ("accept", "text/html")];
    site.send("POST", SCANS, &headers, body.as_bytes()).problem(406, "NOT_ACCEPTABLE");
    let lines = [("content-type", "application/x-ndjson")];
    site.send("POST", "/v1/maps/hall/classes", &lines, b"{}").problem(415, "UNSUPPORTED_MEDIA_TYPE");
    // A client without the header means JSON; a web page without it has not been allowed to ask.
    assert_eq!(site.send("POST", SCANS, &[], body.as_bytes()).status, 200);
    let page = [("origin", "https://elsewhere.example")];
    site.send("POST", SCANS, &page, body.as_bytes()).problem(415, "UNSUPPORTED_MEDIA_TYPE");
}

#[test]
fn bodies_are_limited_also_after_decompression() {
    let site = Site::with(|config| config.limits.body_bytes = 100_000);
    site.make_hall();
    let spaces = " ".repeat(100_001);
    for headers in [&[JSON][..], &[JSON, GZIP][..]] {
        let body = if headers.len() == 2 { gzip(spaces.as_bytes()) } else { spaces.clone().into_bytes() };
        let (field, detail) = site.send("POST", SCANS, headers, &body).problem(413, "BODY_TOO_LARGE");
        assert_eq!(field, "body");
        assert!(detail.contains("100000"), "{detail}");
    }
    // 1 GiB of spaces in about 1 MiB would be the same; 64 MiB in 64 KiB do, and take no more memory than the limit.
    let bomb = gzip(" ".repeat(64 << 20).as_bytes());
    site.send("POST", SCANS, &[JSON, GZIP], &bomb[..bomb.len().min(100_000)]).problem(413, "BODY_TOO_LARGE");
    let most = format!("{}{}", list(&[ring("a", None)]), " ".repeat(50_000));
    assert_eq!(site.post(SCANS, &most).status, 200);
}

#[test]
fn a_body_far_beyond_the_limit_is_told_why() {
    let site = Site::hall();
    let body = vec![b' '; (16 << 20) + 1];
    site.send("POST", SCANS, &[JSON], &body).problem(413, "BODY_TOO_LARGE");
    assert_eq!(site.post(SCANS, &list(&[ring("a", None)])).status, 200);
}

#[test]
fn counts_are_limited() {
    let site = Site::with(|config| {
        config.limits.scans_per_request = 3;
        config.limits.beams_per_scan = 300;
    });
    site.make_hall();
    let four: Vec<_> = (0..4).map(|_| ring("a", None)).collect();
    assert_eq!(site.post(SCANS, &list(&four)).problem(400, "TOO_MANY_SCANS").0, "scans");
    let lines: String = four.iter().map(|scan| format!("{scan}\n")).collect();
    let headers = [("content-type", "application/x-ndjson")];
    site.send("POST", SCANS, &headers, lines.as_bytes()).problem(400, "TOO_MANY_SCANS");
    let answer = site.post(SCANS, &ring("a", None).to_string()).json();
    assert_eq!(answer["rejected"][0]["code"], "TOO_MANY_BEAMS");
}

#[test]
fn a_sequence_older_than_its_window_is_refused() {
    let site = Site::hall();
    assert_eq!(site.post(SCANS, &ring("a", Some(5000)).to_string()).json()["applied"], 1);
    let answer = site.post(SCANS, &list(&[ring("a", Some(3976)), ring("a", Some(3977))])).json();
    assert_eq!(answer["applied"], 1);
    assert_eq!(answer["rejected"][0]["code"], "SEQUENCE_TOO_OLD");
}

/// JSON has no number for it, and null is none either.
#[test]
fn a_stamp_that_is_no_number_was_null_in_answers() {
    let site = Site::hall();
    let mut scan = ring("a", Some(1));
    scan["stamp"] = "NaN".into();
    assert_eq!(site.post(SCANS, &scan.to_string()).json()["applied"], 1);
    let robots = site.get("/v1/maps/hall/robots").json();
    assert_eq!((&robots["robots"][0]["robot"], &robots["robots"][0]["stamp"]), (&"a".into(), &0.0.into()), "{robots}");
}

#[test]
fn scans_are_counted_by_robot_and_outcome() {
    let site = Site::hall();
    let mut wide = ring("by-robot", Some(2));
    wide["pose"]["x"] = serde_json::json!({"min": 0, "max": 3});
    let body = list(&[ring("by-robot", Some(1)), wide]);
    assert_eq!(site.post(SCANS, &body).json()["applied"], 1);
    assert_eq!(site.post(SCANS, &list(&[ring("by-robot", Some(1))])).json()["duplicates"], 1);
    let metrics = String::from_utf8(site.get("/metrics").body).unwrap();
    for outcome in ["applied", "duplicate", "rejected"] {
        let line = format!("ubbmap_robot_scans_total{{robot=\"by-robot\",outcome=\"{outcome}\"}} 1");
        assert!(metrics.contains(&line), "{line} is not in {metrics}");
    }
}

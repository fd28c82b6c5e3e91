//! Whatever is sent: an answer below 500, and the server goes on.

#![allow(clippy::unwrap_used, reason = "a test may end where its ground is not as it should be")]

use crate::http_support::{Site, gzip, ring};
use proptest::collection::vec;
use proptest::prelude::*;
use proptest::test_runner::{Config, TestRunner};
use prost::Message;
use serde_json::{Value, json};
use ubbmap::wire::v1;

const ROUTES: [(&str, &str); 4] = [
    ("POST", "/v1/maps/hall/scans"),
    ("POST", "/v1/maps/hall/classes"),
    ("POST", "/v1/maps/hall/guaranteed-free"),
    ("PUT", "/v1/maps/new"),
];
const MEDIA: [&str; 4] = ["application/json", "application/x-protobuf", "application/x-ndjson", "image/png"];

#[derive(Debug, Clone)]
struct Sent {
    route: usize,
    media: usize,
    zipped: bool,
    encoded: bool,
    body: Vec<u8>,
}

/// Numbers that tend to break things.
fn number() -> impl Strategy<Value = Value> {
    prop_oneof![
        any::<f64>().prop_map(|v| json!(v)),
        (-20.0..20.0).prop_map(|v: f64| json!(v)),
        any::<i64>().prop_map(|v| json!(v)),
        any::<u64>().prop_map(|v| json!(v.to_string())),
        prop::sample::select(vec!["NaN", "Infinity", "-Infinity", "1e400", "", "0x1"]).prop_map(|v| json!(v)),
        Just(json!(1e308)),
        Just(Value::Null),
    ]
}

fn point() -> impl Strategy<Value = Value> {
    (number(), number()).prop_map(|(x, y)| json!({"x": x, "y": y}))
}

fn region() -> impl Strategy<Value = Value> {
    prop_oneof![
        [number(), number(), number(), number()]
            .prop_map(|[a, b, c, d]| json!({"box": {"min_x": a, "min_y": b, "max_x": c, "max_y": d}})),
        (point(), number()).prop_map(|(center, radius)| json!({"disc": {"center": center, "radius": radius}})),
        vec(point(), 0..6).prop_map(|points| json!({"polygon": {"points": points}})),
        (vec(point(), 0..6), number())
            .prop_map(|(points, radius)| json!({"path": {"points": points, "radius": radius}})),
    ]
}

/// Requests that are nearly right: the right form with any numbers in it.
fn request() -> impl Strategy<Value = Value> {
    let interval = || (number(), number()).prop_map(|(min, max)| json!({"min": min, "max": max}));
    let scan = (interval(), interval(), interval(), vec(number(), 0..20), [number(), number(), number(), number()])
        .prop_map(|(x, y, theta, ranges, [min, step, footprint, sequence])| {
            json!({"robot": "a", "sequence": sequence, "pose": {"x": x, "y": y, "theta": theta}, "ranges": ranges,
                "angle_min": min, "angle_increment": step, "footprint_radius": footprint})
        });
    let config = (number(), number(), number(), number()).prop_map(
        |(a, b, c, d)| json!({"resolution": a, "depth": b, "classes": c, "sensors": {"default": {"range_max": d}}}),
    );
    prop_oneof![
        vec(scan, 0..4).prop_map(|scans| json!({ "scans": scans })),
        (vec(point(), 0..5), number()).prop_map(|(points, depth)| json!({"points": points, "depth": depth})),
        (vec(region(), 0..4), 0..5_u32).prop_map(|(regions, q)| json!({"regions": regions, "tolerance": q})),
        config,
    ]
}

fn sent() -> impl Strategy<Value = Sent> {
    let body = prop_oneof![
        2 => vec(any::<u8>(), 0..400),
        2 => "[\\[\\]{}\",:0-9a-z\\-. ]{0,200}".prop_map(String::into_bytes),
        6 => request().prop_map(|value| value.to_string().into_bytes()),
        2 => (request(), any::<prop::sample::Index>(), any::<u8>()).prop_map(|(value, at, byte)| {
            let mut bytes = value.to_string().into_bytes();
            let at = at.index(bytes.len());
            bytes[at] = byte;
            bytes
        }),
        2 => (any::<prop::sample::Index>(), any::<u8>()).prop_map(|(at, byte)| {
            let scan: v1::Scan = serde_json::from_value(ring("a", None)).unwrap();
            let mut bytes = v1::InsertScansRequest { map: String::new(), scans: vec![scan] }.encode_to_vec();
            let at = at.index(bytes.len());
            bytes[at] = byte;
            bytes
        }),
    ];
    (0..ROUTES.len(), 0..MEDIA.len(), any::<bool>(), any::<bool>(), body).prop_map(
        |(route, media, zipped, encoded, body)| Sent {
            route,
            media: if media == 3 { 0 } else { media },
            zipped,
            encoded,
            body,
        },
    )
}

#[test]
fn no_bytes_bring_the_server_down() {
    let site = Site::hall();
    let mut runner = TestRunner::new(Config { cases: 1500, failure_persistence: None, ..Config::default() });
    runner
        .run(&sent(), |sent| {
            let (method, path) = ROUTES[sent.route];
            let body = if sent.zipped { gzip(&sent.body) } else { sent.body.clone() };
            let mut headers = vec![("content-type", MEDIA[sent.media])];
            if sent.zipped || (sent.encoded && sent.route == 0) {
                headers.push(("content-encoding", "gzip"));
            }
            let answer = site.send(method, path, &headers, &body);
            prop_assert!(answer.status < 500, "{sent:?}: {}", String::from_utf8_lossy(&answer.body));
            if answer.status >= 400 {
                prop_assert_eq!(answer.header("content-type"), Some("application/problem+json"));
                let problem = answer.json();
                prop_assert_eq!(problem["status"].as_u64(), Some(u64::from(answer.status)));
                prop_assert!(
                    problem["detail"].as_str().is_some_and(|detail| !detail.is_empty() && detail.len() < 3000)
                );
            }
            Ok(())
        })
        .unwrap();
    assert_eq!(site.get("/readyz").status, 200);
    assert_eq!(site.post(ROUTES[0].1, &ring("z", None).to_string()).json()["applied"], 1);
}

#[test]
fn no_query_string_brings_the_server_down() {
    let site = Site::hall();
    let name = prop::sample::select(vec!["min_x", "min_y", "max_x", "max_y", "depth", "format", "z"]);
    let value = prop_oneof![
        "[-+0-9.eE]{0,8}",
        prop::sample::select(vec!["nan", "inf", "-inf", "1e308", "0", "8", "npy", "png", "-0", "%ff", "%", "1e-320"])
            .prop_map(str::to_owned),
    ];
    let query = vec((name, value), 0..5)
        .prop_map(|pairs| pairs.iter().map(|(name, value)| format!("{name}={value}&")).collect::<String>());
    let path = prop::sample::select(vec!["region", "grid", "tiles/0/0/0.png", "tiles/30/1/1.npy"]);
    let mut runner = TestRunner::new(Config { cases: 600, failure_persistence: None, ..Config::default() });
    runner
        .run(&(path, query), |(path, query)| {
            let answer = site.get(&format!("/v1/maps/hall/{path}?{query}"));
            prop_assert!(answer.status < 500, "{path}?{query}: {}", String::from_utf8_lossy(&answer.body));
            Ok(())
        })
        .unwrap();
    assert_eq!(site.get("/readyz").status, 200);
}

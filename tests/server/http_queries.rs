//! Classes, leaves and guaranteed-free over HTTP.

#![allow(clippy::unwrap_used, reason = "a test may end where its ground is not as it should be")]

use crate::http_support::{Site, ring};
use prost::Message;
use serde_json::{Value, json};
use ubbmap::wire::v1;

const CLASSES: &str = "/v1/maps/hall/classes";
const FREE: &str = "/v1/maps/hall/guaranteed-free";
const REGION: &str = "/v1/maps/hall/region";

/// The map after five scans of a round wall 3 m about (0, 0): the inside is free, the wall occupied.
fn mapped() -> Site {
    let site = Site::hall();
    for _ in 0..5 {
        assert_eq!(site.post("/v1/maps/hall/scans", &ring("a", None).to_string()).json()["applied"], 1);
    }
    site
}

#[test]
fn classes_are_those_of_the_points() {
    let site = mapped();
    let points = json!([{"x": 1.0, "y": 1.0}, {"x": 3.01, "y": 0.0}, {"x": 10, "y": 10}, {"x": 500, "y": 0}]);
    let answer = site.post(CLASSES, &json!({ "points": points }).to_string());
    assert_eq!(answer.status, 200);
    assert_eq!(answer.json(), json!({"revision": "5", "depth": 8, "classes": [1, 10, 5, 5]}));
    let coarse = site.post(CLASSES, &json!({ "points": points, "depth": 0 }).to_string()).json();
    assert_eq!(coarse, json!({"revision": "5", "depth": 0, "classes": [10, 10, 10, 5]}));
    let wire = v1::GetClassesRequest {
        map: "hall".to_owned(),
        points: vec![v1::Point { x: Some(1.0), y: Some(1.0) }],
        ..v1::GetClassesRequest::default()
    };
    let headers = [("content-type", "application/x-protobuf"), ("accept", "application/x-protobuf")];
    let answer = site.send("POST", CLASSES, &headers, &wire.encode_to_vec());
    assert_eq!(v1::GetClassesResponse::decode(&answer.body[..]).unwrap().classes, [1]);
}

#[test]
fn bad_points_are_named() {
    let site = Site::hall();
    for (body, code, field) in [
        (r#"{"points": [{"x": 1, "y": 1}, {"x": 1}]}"#, "INVALID_POINT", "points[1].y"),
        (r#"{"points": [{"x": 1, "y": "NaN"}]}"#, "INVALID_POINT", "points[0]"),
        (r#"{"points": [], "depth": 9}"#, "DEPTH_OUT_OF_RANGE", "depth"),
        (r#"{"points": [], "depth": 25}"#, "DEPTH_OUT_OF_RANGE", "depth"),
        (r#"{"points": [[1, 2, 3]]}"#, "INVALID_REQUEST", "points[0]"),
        (r#"{"point": []}"#, "INVALID_REQUEST", "point"),
    ] {
        let (named, _) = site.post(CLASSES, body).problem(400, code);
        assert!(named.starts_with(field), "{body}: {named}");
    }
    let site = Site::with(|config| config.limits.points_per_query = 2);
    site.make_hall();
    let many = json!({"points": [{"x": 0, "y": 0}, {"x": 0, "y": 0}, {"x": 0, "y": 0}]});
    assert_eq!(site.post(CLASSES, &many.to_string()).problem(400, "TOO_MANY_POINTS").0, "points");
}

#[test]
fn leaves_of_a_box_are_told_in_z_order() {
    let site = mapped();
    let all = site.get(REGION).json();
    assert_eq!((&all["revision"], &all["depth"]), (&json!("5"), &json!(8)));
    let leaves = all["leaves"].as_array().unwrap();
    // The leaves fill the root exactly.
    let area: f64 = leaves.iter().map(|leaf| 0.25_f64.powi(leaf["depth"].as_i64().unwrap() as i32)).sum();
    assert!((area - 1.0).abs() < 1e-12, "{area}");
    let one = site.get(&format!("{REGION}?min_x=1&min_y=1&max_x=1.1&max_y=1.1")).json();
    assert_eq!(one["leaves"].as_array().unwrap().len(), 1);
    assert_eq!(one["leaves"][0]["class"], 1);
    let root = site.get(&format!("{REGION}?depth=0")).json();
    assert_eq!(root["leaves"], json!([{"depth": 0, "x": 0, "y": 0, "class": 10}]));
    let wire = site.send("GET", REGION, &[("accept", "application/x-protobuf")], b"");
    assert_eq!(v1::GetRegionResponse::decode(&wire.body[..]).unwrap().leaves.len(), leaves.len());
}

#[test]
fn bad_boxes_are_named() {
    let site = mapped();
    for (query, code, field) in [
        ("min_x=abc", "INVALID_REQUEST", "min_x"),
        ("depth=-1", "INVALID_REQUEST", "depth"),
        ("depth=1.5", "INVALID_REQUEST", "depth"),
        ("dept=1", "INVALID_REQUEST", "dept"),
        ("depth=1&depth=2", "INVALID_REQUEST", "depth"),
        ("depth=9", "DEPTH_OUT_OF_RANGE", "depth"),
        ("min_x=1&max_x=0", "INVALID_REGION", ""),
        ("min_x=NaN", "INVALID_REGION", ""),
        ("max_y=inf", "INVALID_REGION", ""),
    ] {
        let (named, detail) = site.get(&format!("{REGION}?{query}")).problem(400, code);
        assert!(named.starts_with(field), "{query}: {named} {detail}");
        site.get(&format!("/v1/maps/hall/grid?{query}")).problem(400, code);
    }
    let site = Site::with(|config| config.limits.leaves_per_answer = 100);
    site.make_hall();
    assert_eq!(site.post("/v1/maps/hall/scans", &ring("a", None).to_string()).json()["applied"], 1);
    let (_, detail) = site.get(REGION).problem(400, "REGION_TOO_LARGE");
    assert!(detail.contains("100") && detail.contains("depth"), "{detail}");
}

#[test]
fn guaranteed_free_tells_why_not() {
    let site = mapped();
    let request = json!({"regions": [
        {"box": {"min_x": 0, "min_y": 0, "max_x": 1, "max_y": 0.5}},
        {"disc": {"center": {"x": 1.5, "y": 1}, "radius": 0.4}},
        {"polygon": {"points": [{"x": 0, "y": 0}, {"x": 1, "y": 0}, {"x": 0, "y": 1}]}},
        {"path": {"points": [{"x": 0, "y": 0}, {"x": 5, "y": 0}], "radius": 0.35}},
        {"box": {"min_x": 3, "min_y": 0, "max_x": 3.01, "max_y": 0.01}},
        {"disc": {"center": {"x": 8, "y": 8}, "radius": 0}},
        {"disc": {"center": {"x": 800, "y": 8}, "radius": 0}}]});
    let answer = site.post(FREE, &request.to_string());
    assert_eq!(answer.status, 200, "{}", String::from_utf8_lossy(&answer.body));
    let value = answer.json();
    assert_eq!((&value["revision"], &value["sound"]), (&json!("5"), &json!(true)));
    let results = value["results"].as_array().unwrap();
    for result in &results[..3] {
        assert_eq!(result, &json!({"free": true, "max_class": 1}));
    }
    let path = &results[3];
    assert_eq!(path["free"], false);
    let distance = path["witness"]["distance"].as_f64().unwrap();
    assert!((2.0..3.2).contains(&distance), "{distance}");
    assert_eq!(path["witness"]["depth"], 8);
    let wall = &results[4];
    assert_eq!((&wall["reason"], &wall["max_class"]), (&json!("REASON_OCCUPIED"), &json!(10)));
    assert_eq!(wall["witness"]["class"], 10);
    assert!(wall["witness"].get("distance").is_none());
    assert_eq!((&results[5]["reason"], &results[5]["max_class"]), (&json!("REASON_UNKNOWN"), &json!(5)));
    let outside = &results[6]["witness"];
    assert!(outside.get("depth").is_none() && outside.get("distance").is_none(), "{outside}");
    assert_eq!(outside["class"], 5);

    let tolerant = |tolerance: u32| {
        let request =
            json!({"regions": [{"disc": {"center": {"x": 1, "y": 1}, "radius": 0.1}}], "tolerance": tolerance});
        site.post(FREE, &request.to_string())
    };
    assert_eq!(tolerant(3).json()["results"][0]["free"], true);
    assert_eq!(tolerant(4).problem(400, "TOLERANCE_TOO_HIGH").0, "tolerance");
}

#[test]
fn bad_regions_are_named() {
    let site = Site::hall();
    let over = |region: Value| json!({"regions": [{"disc": {"center": {"x": 0, "y": 0}, "radius": 1}}, region]});
    for (region, code, field) in [
        (json!({}), "INVALID_REGION", "regions[1]"),
        (json!({"box": {"min_x": 1, "min_y": 0, "max_x": 0, "max_y": 1}}), "INVALID_REGION", "regions[1].box"),
        (json!({"disc": {"center": {"x": "NaN", "y": 0}, "radius": 1}}), "INVALID_REGION", "regions[1].disc.center.x"),
        (json!({"disc": {"center": {"x": 0, "y": 0}, "radius": -1}}), "INVALID_REGION", "regions[1].disc.radius"),
        (json!({"polygon": {"points": [{"x": 0, "y": 0}]}}), "INVALID_REGION", "regions[1].polygon.points"),
        (json!({"path": {"points": [], "radius": 1}}), "INVALID_REGION", "regions[1].path.points"),
        (json!({"circle": {}}), "INVALID_REQUEST", "regions[1].circle"),
        (json!({"disc": {"center": {"x": 0, "y": 0}, "r": 1}}), "INVALID_REQUEST", "regions[1].disc.r"),
    ] {
        let body = over(region.clone()).to_string();
        let (named, _) = site.post(FREE, &body).problem(400, code);
        assert!(named.starts_with(field), "{region}: {named}");
    }
    let both = r#"{"regions": [{"disc": {"center": {"x": 0, "y": 0}, "radius": 1}, "box": {}}]}"#;
    site.post(FREE, both).problem(400, "INVALID_REQUEST");
    let site = Site::with(|config| config.limits.regions_per_query = 1);
    site.make_hall();
    let two = over(json!({"disc": {"center": {"x": 0, "y": 0}, "radius": 1}}));
    assert_eq!(site.post(FREE, &two.to_string()).problem(400, "TOO_MANY_REGIONS").0, "regions");
}

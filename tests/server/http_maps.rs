//! Maps over HTTP.

#![allow(clippy::unwrap_used, reason = "a test may end where its ground is not as it should be")]

use crate::http_support::Site;
use prost::Message;
use serde_json::json;
use ubbmap::wire::v1;

const PROTOBUF: &str = "application/x-protobuf";

#[test]
fn a_map_is_created_once_and_found_again() {
    let site = Site::new();
    let first = site.put("/v1/maps/hall", r#"{"depth": 8, "resolution": 0.05}"#);
    assert_eq!(first.status, 201);
    let value = first.json();
    assert_eq!((&value["name"], &value["revision"], &value["existed"]), (&json!("hall"), &json!("0"), &json!(false)));
    assert_eq!(value["config"]["classes"], 10);
    assert_eq!(value["config"]["origin"], json!({"x": -6.4, "y": -6.4}));
    assert_eq!(value["bounds"], json!({"min_x": -6.4, "min_y": -6.4, "max_x": 6.4, "max_y": 6.4}));
    assert_eq!(value["unknown_class"], 5);
    assert_eq!(value["robots"], json!([]));
    assert!(value["created"].as_f64().unwrap() > 1e9);
    assert!(value["config"]["sensors"]["default"].get("no_return_free_to").is_none());

    let again = site.put("/v1/maps/hall", r#"{"config": {"resolution": "0.05", "depth": "8", "classes": 10}}"#);
    assert_eq!((again.status, again.json()["existed"].clone()), (200, json!(true)));
    let other = site.put("/v1/maps/hall", r#"{"depth": 9, "resolution": 0.05}"#);
    other.problem(409, "MAP_EXISTS");
    assert_eq!(site.get("/v1/maps/hall").json()["config"], value["config"]);
}

#[test]
fn no_body_is_the_default_configuration() {
    let site = Site::new();
    let created = site.send("PUT", "/v1/maps/plain", &[], b"");
    assert_eq!(created.status, 201);
    let config = created.json()["config"].clone();
    assert_eq!((&config["resolution"], &config["depth"]), (&json!(0.1), &json!(16)));
    assert_eq!(config["evidence"], "EVIDENCE_GUARANTEED");
    assert_eq!(site.put("/v1/maps/plain", &config.to_string()).status, 200);
}

#[test]
fn maps_are_listed_by_name_and_deleted() {
    let site = Site::new();
    assert_eq!(site.get("/v1/maps").json(), json!({"maps": []}));
    for name in ["b", "a", "c-1_x"] {
        assert_eq!(site.put(&format!("/v1/maps/{name}"), r#"{"depth": 6}"#).status, 201);
    }
    let names = |site: &Site| -> Vec<String> {
        let list = site.get("/v1/maps").json();
        list["maps"].as_array().unwrap().iter().map(|map| map["name"].as_str().unwrap().to_owned()).collect()
    };
    assert_eq!(names(&site), ["a", "b", "c-1_x"]);
    let deleted = site.send("DELETE", "/v1/maps/b", &[], b"");
    assert_eq!((deleted.status, deleted.body.len()), (204, 0));
    assert_eq!(names(&site), ["a", "c-1_x"]);
    site.get("/v1/maps/b").problem(404, "MAP_NOT_FOUND");
    site.send("DELETE", "/v1/maps/b", &[], b"").problem(404, "MAP_NOT_FOUND");
    assert_eq!(site.put("/v1/maps/b", r#"{"depth": 7}"#).status, 201);
}

#[test]
fn protobuf_goes_in_and_comes_out() {
    let site = Site::new();
    let config = v1::MapConfig { depth: Some(7), evidence: v1::Evidence::Outer.into(), ..Default::default() };
    let request = v1::CreateMapRequest { map: "hall".to_owned(), config: Some(config) };
    let headers = [("content-type", "application/protobuf"), ("accept", PROTOBUF)];
    let created = site.send("PUT", "/v1/maps/hall", &headers, &request.encode_to_vec());
    assert_eq!((created.status, created.header("content-type")), (201, Some(PROTOBUF)));
    let response = v1::CreateMapResponse::decode(&created.body[..]).unwrap();
    assert_eq!((response.name.as_str(), response.unknown_class), ("hall", 5));
    assert_eq!(response.config.unwrap().depth, Some(7));
    let read = site.send("GET", "/v1/maps/hall", &[("accept", PROTOBUF)], b"");
    let map = v1::GetMapResponse::decode(&read.body[..]).unwrap();
    assert_eq!(map.config.unwrap().evidence, i32::from(v1::Evidence::Outer));
    let list = site.send("GET", "/v1/maps", &[("accept", PROTOBUF)], b"");
    assert_eq!(v1::ListMapsResponse::decode(&list.body[..]).unwrap().maps[0].name, "hall");
    let elsewhere = site.send("PUT", "/v1/maps/other", &headers, &request.encode_to_vec());
    assert_eq!(elsewhere.problem(400, "INVALID_REQUEST").0, "map");
}

#[test]
fn bad_configurations_change_nothing_and_name_their_field() {
    let site = Site::new();
    for (body, code, field) in [
        (r#"{"classes": 3}"#, "INVALID_CONFIG", "config.classes"),
        (r#"{"resolution": 0}"#, "INVALID_CONFIG", "config.resolution"),
        (r#"{"resolution": "NaN"}"#, "INVALID_CONFIG", "config.resolution"),
        (r#"{"depth": 25}"#, "INVALID_CONFIG", "config.depth"),
        (
            r#"{"sensors": {"default": {"range_error": {"minus": 100}}}}"#,
            "INVALID_CONFIG",
            "config.sensors[default].range_error.minus",
        ),
        (r#"{"colour": 1}"#, "INVALID_REQUEST", "config.colour"),
        (r#"{"config": {"colour": 1}}"#, "INVALID_REQUEST", "config.colour"),
        (r#"{"map": "other", "config": {}}"#, "INVALID_REQUEST", "map"),
        ("{", "INVALID_REQUEST", "config"),
        ("nonsense", "INVALID_REQUEST", "config"),
    ] {
        let answer = site.put("/v1/maps/hall", body);
        assert_eq!(answer.problem(400, code).0, field, "{body}");
    }
    for name in ["Hall", "-a", "a.b", "%C3%A4", "%20", &"a".repeat(64)] {
        let answer = site.put(&format!("/v1/maps/{name}"), "{}");
        assert_eq!(answer.problem(400, "INVALID_NAME").0, "map", "{name}");
        site.get(&format!("/v1/maps/{name}")).problem(400, "INVALID_NAME");
    }
    site.get("/v1/maps/%ff").problem(400, "INVALID_REQUEST");
    assert_eq!(site.get("/v1/maps").json(), json!({"maps": []}));
}

#[test]
fn a_configuration_has_a_limit_of_its_own() {
    let site = Site::with(|config| config.limits.config_bytes = 1000);
    let long = format!(r#"{{"depth": 8{}}}"#, " ".repeat(2000));
    assert_eq!(site.put("/v1/maps/hall", &long).problem(413, "BODY_TOO_LARGE").0, "body");
    let site = Site::with(|config| config.limits.maps = 1);
    assert_eq!(site.put("/v1/maps/a", "{}").status, 201);
    site.put("/v1/maps/b", "{}").problem(409, "TOO_MANY_MAPS");
}

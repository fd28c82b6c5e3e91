//! The JSON of the interface: what is written, what is taken, and how errors name fields.
#![allow(clippy::unwrap_used, clippy::panic, reason = "tests")]

use super::decode::{Encoding, create_request, free_request, insert_request, scan_lines};
use super::{Batch, map_config, regions, to_wire_config, v1};
use crate::mapping::RegionLimits;
use crate::sensor::Angles;
use crate::service::{ErrorKind, InsertAnswer, Rejection, ServiceError};
use prost::Message;
use serde_json::{Value, json};

const SCAN: &str = r#"{"robot":"amr-7","sequence":"1234","pose":{"x":{"min":1,"max":2},"y":{"min":0,"max":0},
    "theta":{"min":0,"max":0}},"angle_min":-1.5,"angle_increment":0.01,"ranges":[2.31,"NaN","Infinity","-Infinity","2.5",3]}"#;

fn scans(text: &str) -> Result<Vec<v1::Scan>, ServiceError> {
    insert_request(text.as_bytes(), Encoding::Json, 1024).map(|request| request.scans)
}

fn config(text: &str) -> Result<crate::mapping::MapConfig, ServiceError> {
    map_config(create_request(text.as_bytes(), Encoding::Json)?.config.unwrap_or_default())
}

fn field(error: ServiceError) -> (ErrorKind, String) {
    (error.kind, error.field.unwrap_or_default())
}

#[test]
fn defaults_are_written_and_absent_values_are_not() {
    let answer = v1::InsertScansResponse { revision: 412, ..Default::default() };
    let value = serde_json::to_value(&answer).unwrap();
    assert_eq!(value, json!({"revision": "412", "applied": 0, "duplicates": 0, "rejected": []}));
    let value = serde_json::to_value(v1::FreeResult { free: true, max_class: 1, ..Default::default() }).unwrap();
    assert_eq!(value, json!({"free": true, "max_class": 1}));
    let refused = v1::FreeResult {
        max_class: 7,
        reason: Some(v1::Reason::Occupied.into()),
        witness: Some(v1::Witness { depth: Some(16), x: Some(0), y: Some(2), class: 7, ..Default::default() }),
        ..Default::default()
    };
    let expected = json!({"free": false, "max_class": 7, "reason": "REASON_OCCUPIED",
        "witness": {"depth": 16, "x": 0, "y": 2, "class": 7, "min_x": 0.0, "min_y": 0.0, "size": 0.0}});
    assert_eq!(serde_json::to_value(refused).unwrap(), expected);
    let grid = v1::GetGridResponse { classes: vec![1, 2, 3], ..Default::default() };
    assert_eq!(serde_json::to_value(grid).unwrap()["classes"], "AQID");
}

#[test]
fn the_default_configuration_is_written_in_full() {
    let value = serde_json::to_value(to_wire_config(&config("").unwrap())).unwrap();
    let expected = json!({
        "resolution": 0.1, "depth": 16, "origin": {"x": -3276.8, "y": -3276.8}, "classes": 10,
        "evidence": "EVIDENCE_GUARANTEED", "min_obstacle_width": 0.02,
        "sensors": {"default": {
            "range_error": {"minus": 0.035, "plus": 0.035}, "beam_opening": 0.004363, "beam_diameter": 0.012,
            "range_min": 0.0, "range_max": 81.0, "beam_angle_error": 0.0, "mount": {"x": 0.0, "y": 0.0, "theta": 0.0}}}});
    assert_eq!(value, expected);
    // What is written can be sent back and means the same.
    assert_eq!(config(&value.to_string()).unwrap(), config("{}").unwrap());
    assert_eq!(config(&json!({"config": value}).to_string()).unwrap(), config("  \n").unwrap());
}

#[test]
fn fields_of_sensors_have_defaults_one_by_one() {
    let text = r#"{"sensors": {"front": {"range_max": 30, "rangeError": {"plus": "0.5"}, "no_return_free_to": 8}}}"#;
    let config = config(text).unwrap();
    assert_eq!(config.sensors().len(), 1);
    let spec = config.sensors()["front"].spec();
    assert_eq!((spec.range_error_minus, spec.range_error_plus), (0.035, 0.5));
    assert_eq!((spec.range_max, spec.no_return_free_to), (30.0, Some(8.0)));
}

#[test]
fn bad_configurations_name_their_field() {
    for (text, expected) in [
        (r#"{"classes": 3}"#, "config.classes"),
        (r#"{"resolution": 0}"#, "config.resolution"),
        (r#"{"resolution": "NaN"}"#, "config.resolution"),
        (r#"{"depth": 25}"#, "config.depth"),
        (r#"{"origin": {"x": 1}}"#, "config.origin.y"),
        (r#"{"origin": {"x": "Infinity", "y": 0}}"#, "config.origin"),
        (r#"{"min_obstacle_width": -1}"#, "config.min_obstacle_width"),
        (r#"{"sensors": {"default": {"range_error": {"minus": 90}}}}"#, "config.sensors[default].range_error.minus"),
        (r#"{"sensors": {"Big One": {}}}"#, "config.sensors"),
        (r#"{"resolution": 0.001, "sensors": {"a": {}}}"#, "config.sensors[a].range_max"),
    ] {
        let error = config(text).unwrap_err();
        assert_eq!(field(error), (ErrorKind::InvalidConfig, expected.to_owned()), "{text}");
    }
    let strange = v1::MapConfig { evidence: 17, ..Default::default() };
    assert_eq!(field(map_config(strange).unwrap_err()).1, "config.evidence");
}

#[test]
fn json_that_does_not_fit_names_its_field() {
    for (text, expected) in [
        (r#"{"resolutions": 1}"#, "config.resolutions"),
        (r#"{"depth": 1.5}"#, "config.depth"),
        (r#"{"depth": -1}"#, "config.depth"),
        (r#"{"depth": "many"}"#, "config.depth"),
        (r#"{"evidence": "GUARANTEED"}"#, "config.evidence"),
        (r#"{"sensors": {"front": {"range_error": {"minus": true}}}}"#, "config.sensors[front].range_error.minus"),
        (r#"{"config": {"mount": 1}}"#, "config.mount"),
        (r#"{"depth": 16"#, "config"),
        ("[]", "config"),
    ] {
        let error = create_request(text.as_bytes(), Encoding::Json).unwrap_err();
        assert_eq!(field(error), (ErrorKind::InvalidRequest, expected.to_owned()), "{text}");
    }
    for (text, expected) in [
        (r#"{"scans": [{}, {"pose": {"x": {"min": 1, "maximum": 2}}}]}"#, "scans[1].pose.x.maximum"),
        (r#"{"scans": [{"ranges": [1, 2, "three"]}]}"#, "scans[0].ranges[2]"),
        (r#"{"scans": [{"ranges": [1, null]}]}"#, "scans[0].ranges[1]"),
        (r#"{"scans": [{"ranges": ["inf"]}]}"#, "scans[0].ranges[0]"),
        (r#"{"scans": [], "more": 1}"#, "more"),
        (r#"{"ranges": [1, {}]}"#, "ranges[1]"),
        (r#"{"sequence": -4}"#, "sequence"),
        (r#"{"sequence": 18446744073709551616}"#, "sequence"),
    ] {
        assert_eq!(field(scans(text).unwrap_err()), (ErrorKind::InvalidRequest, expected.to_owned()), "{text}");
    }
    let error = scans(r#"{"scans": [{"rangs": []}]}"#).unwrap_err();
    assert!(error.detail.contains("unknown field `rangs`"), "{}", error.detail);
}

#[test]
fn a_body_is_a_list_of_scans_or_one() {
    let one = scans(SCAN).unwrap();
    let list = scans(&format!(r#" {{ "scans": [{SCAN}] }}"#)).unwrap();
    let named = scans(&format!(r#"{{"map": "hall", "scans": [{SCAN}]}}"#)).unwrap();
    for scans in [&one, &list, &named] {
        assert_eq!(scans.len(), 1);
        assert_eq!(scans[0].sequence, Some(1234));
        let ranges = &scans[0].ranges;
        assert!(ranges[1].is_nan());
        assert_eq!((ranges[0], ranges[2], ranges[3]), (2.31, f32::INFINITY, f32::NEG_INFINITY));
        assert_eq!((ranges[4], ranges[5]), (2.5, 3.0));
    }
    let camel = SCAN.replace("angle_min", "angleMin").replace("angle_increment", "angleIncrement");
    assert_eq!(scans(&camel).unwrap()[0].angle_min, Some(-1.5));
}

#[test]
fn lines_are_scans_and_errors_name_the_line() {
    let scan = SCAN.replace('\n', " ");
    let text = format!("{scan}\r\n\n{scan}");
    assert_eq!(scan_lines(text.as_bytes(), 2).unwrap().len(), 2);
    assert_eq!(scan_lines(text.as_bytes(), 1).unwrap_err().kind, ErrorKind::TooManyScans);
    let error = scan_lines(format!("{scan}\n\n{{\"pose\": 3}}\n").as_bytes(), 9).unwrap_err();
    assert!(error.detail.starts_with("line 3: "), "{}", error.detail);
    assert_eq!(error.field.as_deref(), Some("scans[1].pose"));
}

#[test]
fn long_lists_are_refused_before_they_take_memory() {
    let many = format!(r#"{{"scans": [{}{{}}]}}"#, "{},".repeat(1_000_000));
    let error = scans(&many).unwrap_err();
    assert_eq!(error.kind, ErrorKind::TooManyScans);
    assert!(error.detail.contains("1000001") && error.detail.contains("1024"), "{}", error.detail);
    let bytes = [0x12, 0x00].repeat(1_000_000);
    assert_eq!(insert_request(&bytes, Encoding::Protobuf, 1024).unwrap_err().kind, ErrorKind::TooManyScans);
    assert_eq!(insert_request(&bytes[..2050], Encoding::Protobuf, 1024).unwrap_err().kind, ErrorKind::TooManyScans);
    assert_eq!(insert_request(&bytes[..2048], Encoding::Protobuf, 1024).unwrap().scans.len(), 1024);
    assert_eq!(free_request(&bytes, Encoding::Protobuf, 10).unwrap_err().kind, ErrorKind::TooManyRegions);
}

#[test]
fn a_bad_scan_keeps_its_place_in_the_answer() {
    let text = format!(
        r#"{{"scans": [{{}}, {SCAN}, {{"pose": {{"x": {{"min": 1}}}}}}, {SCAN}, {}, {}]}}"#,
        SCAN.replace("\"angle_min\":-1.5,", ""),
        SCAN.replace("\"angle_min\"", "\"angles\":[1],\"angle_min\""),
    );
    let mut batch = Batch::new(scans(&text).unwrap());
    assert_eq!(batch.take_scans().len(), 2);
    // The service refuses the second of the two that it saw: the fourth of the request.
    let rejected = vec![Rejection { index: 1, code: "POSE_TOO_WIDE", detail: "pose.x".to_owned() }];
    let answer = InsertAnswer { revision: 7, applied: 1, duplicates: 0, rejected };
    let response = batch.response(answer);
    let named: Vec<_> = response.rejected.iter().map(|scan| (scan.index, scan.code.as_str())).collect();
    let expected = [
        (0, "POSE_MISSING"),
        (2, "POSE_MISSING"),
        (3, "POSE_TOO_WIDE"),
        (4, "ANGLES_MISSING"),
        (5, "ANGLES_AMBIGUOUS"),
    ];
    assert_eq!(named, expected);
    assert!(response.rejected[1].detail.starts_with("pose.x.max is missing"), "{}", response.rejected[1].detail);
    assert_eq!((response.revision, response.applied), (7, 1));
}

#[test]
fn angles_stand_in_place_of_the_step() {
    let text = SCAN.replace("\"angle_min\":-1.5,\"angle_increment\":0.01", "\"angles\":[0,1,2,3,4,5]");
    let mut batch = Batch::new(scans(&text).unwrap());
    assert_eq!(batch.take_scans()[0].angles, Angles::Listed(vec![0.0, 1.0, 2.0, 3.0, 4.0, 5.0]));
    let mut batch = Batch::new(scans(SCAN).unwrap());
    assert_eq!(batch.take_scans()[0].angles, Angles::Uniform { min: -1.5, increment: 0.01 });
}

#[test]
fn regions_without_a_part_are_refused_by_its_name() {
    for (text, expected) in [
        (r#"{"regions": [{}]}"#, "regions[0]"),
        (r#"{"regions": [{"box": {"min_x": 0, "min_y": 0, "max_x": 1}}]}"#, "regions[0].box.max_y"),
        (r#"{"regions": [{"disc": {"radius": 1}}]}"#, "regions[0].disc.center"),
        (r#"{"regions": [{"disc": {"center": {"y": 1}, "radius": 1}}]}"#, "regions[0].disc.center.x"),
        (r#"{"regions": [{"disc": {"center": {"x": 1, "y": 1}}}]}"#, "regions[0].disc.radius"),
        (r#"{"regions": [{"path": {"points": [{"x": 1, "y": 1}]}}]}"#, "regions[0].path.radius"),
        (r#"{"regions": [{"polygon": {"points": [{"x": 1, "y": 1}, {"x": 1}]}}]}"#, "regions[0].polygon.points[1].y"),
    ] {
        let request = free_request(text.as_bytes(), Encoding::Json, 10).unwrap();
        let error = regions(request.regions, &RegionLimits::default()).unwrap_err();
        assert_eq!(field(error), (ErrorKind::InvalidRegion, expected.to_owned()), "{text}");
    }
}

#[test]
fn both_encodings_say_the_same() {
    let request = v1::InsertScansRequest { map: "m".to_owned(), scans: scans(SCAN).unwrap() };
    let mut request = request;
    request.scans[0].ranges[1] = 4.0;
    let text = serde_json::to_string(&request).unwrap();
    let value: Value = serde_json::from_str(&text).unwrap();
    assert_eq!(value["scans"][0]["sequence"], "1234");
    request.scans[0].ranges.truncate(2);
    let text = serde_json::to_string(&request).unwrap();
    let from_json = insert_request(text.as_bytes(), Encoding::Json, 9).unwrap();
    let from_bytes = insert_request(&request.encode_to_vec(), Encoding::Protobuf, 9).unwrap();
    assert_eq!(from_json, request);
    assert_eq!(from_bytes, request);
}

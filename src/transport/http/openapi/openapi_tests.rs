//! The description against the code that it is made of.

#![allow(clippy::unwrap_used, reason = "a test may end where its ground is not as it should be")]

use super::document::document;
use super::table::OPERATIONS;
use crate::service::ErrorKind;
use crate::wire::v1;
use serde::Serialize;
use serde::de::DeserializeOwned;
use serde_json::{Map, Value};
use std::collections::BTreeSet;

#[test]
fn every_operation_of_the_table_is_served_and_described_once() {
    let document = document().unwrap();
    let described: Vec<String> = OPERATIONS.iter().map(|operation| operation.id.to_owned()).collect();
    let mut served: Vec<String> = super::super::routes().known.iter().map(|known| known.id.to_owned()).collect();
    served.sort();
    let mut sorted = described.clone();
    sorted.sort();
    assert_eq!(served, sorted);
    let methods = document["paths"].as_object().unwrap().values().flat_map(|path| path.as_object().unwrap().values());
    let ids: BTreeSet<String> = methods.map(|method| method["operationId"].as_str().unwrap().to_owned()).collect();
    assert_eq!(ids, described.into_iter().collect());
}

#[test]
fn every_reference_of_the_description_leads_somewhere() {
    let document = document().unwrap();
    let mut seen = 0;
    each(&document, &mut |value| {
        let Some(reference) = value.get("$ref").and_then(Value::as_str) else { return };
        let pointer = reference.strip_prefix('#').unwrap();
        assert!(document.pointer(pointer).is_some_and(|found| !found.as_object().unwrap().is_empty()), "{reference}");
        seen += 1;
    });
    assert!(seen > 100, "{seen}");
}

#[test]
fn the_description_knows_every_error_of_the_table() {
    let document = document().unwrap();
    let codes = document["components"]["schemas"]["Problem"]["properties"]["code"]["enum"].as_array().unwrap().clone();
    assert_eq!(codes, ErrorKind::ALL.iter().map(|kind| Value::from(kind.code())).collect::<Vec<_>>());
    let text = document.to_string();
    // Errors of routes that are not there, and of a connection without TLS, belong to no operation.
    let elsewhere = [ErrorKind::RouteNotFound, ErrorKind::MethodNotAllowed, ErrorKind::TlsRequired];
    for kind in ErrorKind::ALL.iter().filter(|kind| !elsewhere.contains(kind)) {
        assert!(text.contains(&format!("- `{}`: ", kind.code())), "{kind:?} is an error of no operation");
    }
}

/// An example read as the message and written again is the same: no field is missing, unknown or of another form.
fn holds<T: Serialize + DeserializeOwned>(example: &Value) {
    let message: T = serde_json::from_value(example.clone()).unwrap();
    assert_eq!(serde_json::to_value(&message).unwrap(), *example);
}

#[test]
fn every_answer_that_is_shown_has_the_form_of_its_message() {
    let examples: Map<String, Value> = serde_json::from_str(include_str!("examples.json")).unwrap();
    let mut answers = 0;
    for (name, example) in &examples {
        let hold: fn(&Value) = match name.as_str() {
            "CreateMapResponse" => holds::<v1::CreateMapResponse>,
            "GetMapResponse" => holds::<v1::GetMapResponse>,
            "ListMapsResponse" => holds::<v1::ListMapsResponse>,
            "InsertScansResponse" => holds::<v1::InsertScansResponse>,
            "GetClassesResponse" => holds::<v1::GetClassesResponse>,
            "CheckGuaranteedFreeResponse" => holds::<v1::CheckGuaranteedFreeResponse>,
            "GetRegionResponse" => holds::<v1::GetRegionResponse>,
            "GetGridResponse" => holds::<v1::GetGridResponse>,
            "GetChangesResponse" => holds::<v1::GetChangesResponse>,
            "WatchMapResponse" => holds::<v1::WatchMapResponse>,
            "StreamScansResponse" => holds::<v1::StreamScansResponse>,
            "CreateSnapshotResponse" => holds::<v1::CreateSnapshotResponse>,
            "ListSnapshotsResponse" => holds::<v1::ListSnapshotsResponse>,
            "RestoreSnapshotResponse" => holds::<v1::RestoreSnapshotResponse>,
            "ListRobotsResponse" => holds::<v1::ListRobotsResponse>,
            "ImportMapResponse" => holds::<v1::ImportMapResponse>,
            // Requests are tried on a server.
            _ => {
                assert!(!name.ends_with("Response"), "{name} is held to no message");
                continue;
            }
        };
        hold(example);
        answers += 1;
    }
    assert_eq!(answers, 16);
}

fn each(value: &Value, seen: &mut impl FnMut(&Value)) {
    seen(value);
    match value {
        Value::Object(map) => map.values().for_each(|value| each(value, seen)),
        Value::Array(list) => list.iter().for_each(|value| each(value, seen)),
        _ => {}
    }
}

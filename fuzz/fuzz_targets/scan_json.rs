//! Scans and other requests as proto3 JSON: nothing panics, and what is read is written and read again as the same.
#![no_main]

use libfuzzer_sys::fuzz_target;
use serde::Serialize;
use serde::de::DeserializeOwned;
use ubbmap::wire::{self, Batch, Encoding, v1};

/// Most elements of a list.
const MOST: usize = 1024;

fn round<T: Serialize + DeserializeOwned>(message: &T) {
    let text = serde_json::to_string(message).expect("a message is written as JSON");
    // Requests are only read: what is no number is not written as proto3 JSON has it. Answers hold none.
    if text.contains("null") {
        return;
    }
    let again: T = serde_json::from_str(&text).expect("what was written is read");
    // NaN is not equal to itself, its text is.
    assert_eq!(text, serde_json::to_string(&again).expect("a message is written as JSON"));
}

fuzz_target!(|bytes: &[u8]| {
    if let Ok(request) = wire::insert_request(bytes, Encoding::Json, MOST) {
        round(&request);
        let mut batch = Batch::new(request.scans);
        drop(batch.take_scans());
    }
    if let Ok(request) = wire::create_request(bytes, Encoding::Json) {
        round(&request);
        // The configuration is refused or one that the core took.
        let _ = request.config.map(wire::map_config);
    }
    if let Ok(request) = wire::free_request(bytes, Encoding::Json, MOST) {
        round(&request);
        let _ = wire::regions(request.regions, &Default::default());
    }
    if let Ok(request) = wire::classes_request(bytes, Encoding::Json, MOST) {
        round(&request);
    }
    if let Ok(request) = wire::request::<v1::ImportMapRequest>(bytes, Encoding::Json) {
        round(&request);
    }
});

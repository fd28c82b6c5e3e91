//! Every request of the interface from protobuf bytes; the first byte chooses which.
#![no_main]

use libfuzzer_sys::fuzz_target;
use ubbmap::wire::{self, Batch, Encoding, v1};

const MOST: usize = 1024;

fuzz_target!(|bytes: &[u8]| {
    let Some((which, bytes)) = bytes.split_first() else { return };
    match which % 10 {
        0 => {
            if let Ok(request) = wire::insert_request(bytes, Encoding::Protobuf, MOST) {
                assert!(request.scans.len() <= MOST);
                drop(Batch::new(request.scans).take_scans());
            }
        }
        1 => {
            if let Ok(request) = wire::message::<v1::InsertScansRequest>(bytes) {
                drop(Batch::of_robot(request.scans, "amr-7").take_scans());
            }
        }
        2 => drop(wire::create_request(bytes, Encoding::Protobuf).map(|request| request.config.map(wire::map_config))),
        3 => {
            if let Ok(request) = wire::free_request(bytes, Encoding::Protobuf, MOST) {
                let _ = wire::regions(request.regions, &Default::default());
            }
        }
        4 => drop(wire::classes_request(bytes, Encoding::Protobuf, MOST)),
        5 => drop(wire::message::<v1::StreamScansRequest>(bytes)),
        6 => drop(wire::message::<v1::GetRegionRequest>(bytes)),
        7 => drop(wire::message::<v1::GetGridRequest>(bytes)),
        8 => drop(wire::message::<v1::WatchMapRequest>(bytes)),
        _ => drop(wire::message::<v1::ExportMapRequest>(bytes)),
    }
});

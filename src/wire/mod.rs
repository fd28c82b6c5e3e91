//! Floor 5: the types of the interface, generated from `proto/`, and their conversion by hand to those of the service.
//!
//! One file an edge. Errors name the field in the request's own words (`regions[0].disc.radius`).

mod answers;
mod changes;
mod config;
mod decode;
mod free;
mod json;
mod number;
mod queries;
mod robots;
mod scans;
mod snapshots;
#[cfg(test)]
mod wire_tests;

pub use answers::{
    classes_response, create_map_response, get_map_response, grid_response, list_maps_response, region_response,
    tile_response,
};
pub use changes::{changes_query, changes_response, watch_query, watch_response};
pub use config::{map_config, to_wire_config};
pub use decode::{
    Encoding, classes_request, create_request, free_request, insert_request, message, request, scan_line, scan_lines,
};
pub use free::{free_response, regions};
pub use number::JsonNumber;
pub use queries::{grid_query, map_name, points, region_query, same_map};
pub use robots::list_robots_response;
pub use scans::Batch;
pub use snapshots::{
    create_snapshot_response, export_form, import_response, list_snapshots_response, snapshot_name, snapshot_wanted,
};

/// The messages of the package `ubbmap.v1` with their proto3 JSON.
#[expect(missing_docs, clippy::all, reason = "generated")]
pub mod v1 {
    include!(concat!(env!("OUT_DIR"), "/ubbmap.v1.rs"));
    include!(concat!(env!("OUT_DIR"), "/ubbmap.v1.serde.rs"));
}

//! End-to-end tests of everything above the core: store, service, transports, logs and the command line.
#![cfg(feature = "server")]
#![allow(clippy::unwrap_used, clippy::panic, clippy::print_stderr, reason = "a test may fail loudly")]

mod cli_build;
mod cli_experiment;
mod cli_picture;
mod cli_server;
mod cli_support;
mod grpc_calls;
mod grpc_streams;
mod grpc_support;
mod http_bytes;
mod http_changes;
mod http_maps;
mod http_queries;
mod http_rasters;
mod http_restart;
mod http_scans;
mod http_support;
mod http_system;
mod logs;
mod logs_real;
mod parity;
mod parity_support;
mod report;
mod service_changes;
mod service_commits;
mod service_hostile;
mod service_inserts;
mod service_maps;
mod service_paging;
mod service_queries;
mod service_sled;
mod service_support;
mod store_damage;
mod store_durability;
mod store_files;
mod store_fixtures;
mod store_model;
mod store_names;
mod store_paging;
mod store_suite;
mod store_support;
mod zenoh_calls;
mod zenoh_support;

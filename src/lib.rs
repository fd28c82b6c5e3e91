//! `ubbmap`: k-class occupancy quadtree maps from laser scans whose errors are unknown but bounded.
//!
//! The floors, lowest first; a module uses only modules on its own floor or below:
//!
//! | floor | module | what lives there |
//! | --- | --- | --- |
//! | 0 | [`interval`] | outward-rounded intervals, boxes, three-valued verdicts |
//! | 0 | `sync` | the locks and atomics of what runs at once |
//! | 0 | [`vector`] | functions compiled once for each set of vector instructions |
//! | 1 | [`sensor`] | pose boxes, sensor models, validated scans, measurement sets |
//! | 1 | [`quadtree`] | node addresses, blocks, the k-class occupancy quadtree |
//! | 2 | [`mapping`] | the evidence of one scan, regions, guaranteed-free |
//! | 2 | [`simulation`] | worlds with exact geometry, cone beams, robots with bounded errors |
//! | 3 | `store` | durable records, map files |
//! | 4 | `service` | named maps, one writer each, queries |
//! | 5 | `wire` | messages of the interface and their conversion |
//! | 5 | `transport` | HTTP: translation only |
//! | 6 | `config`, `telemetry`, `reload`, `app`, `logs`, `picture`, `experiment`, `cli` | the program |
//!
//! Floors 0 to 2 do no I/O, read no clock and are not async; they build with `--no-default-features`.

#[cfg(all(feature = "server", feature = "shuttle"))]
compile_error!(
    "the feature `shuttle` is for tests of schedules and runs nothing else: build with `--no-default-features`"
);

pub mod interval;
pub mod mapping;
pub mod quadtree;
pub mod sensor;
pub mod simulation;
mod sync;
pub mod vector;

#[cfg(feature = "server")]
pub mod app;
#[cfg(feature = "server")]
pub mod cli;
#[cfg(feature = "server")]
pub mod config;
#[cfg(feature = "server")]
pub mod experiment;
#[cfg(feature = "server")]
pub mod logs;
#[cfg(feature = "server")]
pub mod picture;
#[cfg(feature = "server")]
pub mod reload;
#[cfg(feature = "service")]
pub mod service;
#[cfg(feature = "service")]
pub mod store;
#[cfg(feature = "server")]
pub mod telemetry;
#[cfg(feature = "server")]
pub mod transport;
#[cfg(feature = "server")]
pub mod wire;

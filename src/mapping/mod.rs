//! Floor 2: what a scan proves, and what a map promises.
//!
//! [`Surveyor`] turns a scan into evidence without looking at the map: a pure function of the map's configuration and
//! the scan, so many scans are computed in parallel. [`Region`] and [`guaranteed_free`] answer whether a region is
//! free in a map.

mod config;
mod evidence;
mod free;
mod gaussian;
mod outside;
pub mod reference;
mod region;

pub use config::{
    EvidenceRule, MAX_OBSTACLE_WIDTH, MAX_REACH_CELLS, MAX_SENSORS, MAX_SPREAD_CELLS, MapConfig, MapConfigError,
    is_name,
};
pub use evidence::{Fault, Surveyor};
pub use free::{FreeAnswer, Reason, Witness, guaranteed_free, try_guaranteed_free};
pub use gaussian::{CellPoint, GaussianGrid, GaussianModel};
pub use region::{MAX_REGION_COORDINATE, Region, RegionError, RegionLimits};

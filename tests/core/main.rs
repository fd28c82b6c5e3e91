//! Tests of the core's public interface: floors 0 to 2.

mod free;
mod free_edges;
mod free_lens;
mod gaussian;
mod interval_arithmetic;
mod interval_trig;
mod interval_vectors;
mod measurement_cone;
mod measurement_set;
mod paged;
mod paged_support;
mod paper;
mod paving;
mod quadtree_grid;
mod quadtree_support;
mod quadtree_tree;
mod regions;
mod regions_exact;
mod rules;
#[cfg(feature = "server")]
mod rules_logs;
mod rules_narrow;
mod rules_near;
mod rules_support;
mod sensor_model;
mod sensor_scan;
mod surveyor;
mod tidy;
mod vector;

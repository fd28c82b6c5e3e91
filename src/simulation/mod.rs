//! Floor 2: simulated worlds with exact geometry, cone beams and robots whose errors keep their bounds.
//!
//! Used by `ubbmap demo` and, as an oracle of its own, by the soundness tests: it shares no code with the evidence rules.
//! Every answer that a scan is made from errs, by at most some 10^-9 m, towards a *shorter* distance, so that rounding
//! never makes a beam see past an obstacle that it touches.

mod building;
mod cone;
#[cfg(test)]
mod cone_tests;
mod fleet;
#[cfg(test)]
mod fleet_tests;
mod furniture;
mod glass;
mod part;
mod scanner;
mod world;

pub use building::{Building, Room};
pub use cone::Cone;
pub use fleet::{Fleet, SimulatedScan};
pub use glass::{Pane, fail_at_glass};
pub use part::Part;
pub use scanner::{Motion, Pose, Profile, Quirks, angle_errors, pose_box_around, simulate_scan};
pub use world::{Shape, World};

/// A point or direction of the plane, metres.
pub type Point = nalgebra::Vector2<f64>;

/// How much shapes are widened before a beam is held against them, metres: far above the rounding errors of the closed
/// forms at map coordinates up to 10^5 m, far below anything that a sensor tells apart.
pub const GUARD: f64 = 1e-9;

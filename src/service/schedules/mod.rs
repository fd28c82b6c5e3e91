//! The paths of commits, watches and places under schedules that are chosen, see [`crate::sync::explore`].
//!
//! Each of these tests was seen to fail when what it guards was taken out.

mod budget;
mod commits;
mod ends;
mod gate;
mod places;
mod scene;
mod snapshots;
mod watches;

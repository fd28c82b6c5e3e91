//! What the service answers. Plain data, no wire types.

use super::robots::RobotPose;
use crate::mapping::{FreeAnswer, MapConfig};
use crate::quadtree::{Class, Leaf, NodeAddress};
use crate::store::{MapId, MapName};

/// A map as it stands.
#[derive(Debug, Clone, PartialEq)]
pub struct MapDescription {
    /// Its name.
    pub name: MapName,
    /// Its configuration.
    pub config: MapConfig,
    /// Its revision.
    pub revision: u64,
    /// Seconds since the Unix epoch.
    pub created: f64,
    /// The robots that sent numbered scans, by name.
    pub robots: Vec<RobotDescription>,
    /// When a block last changed, seconds since the Unix epoch; `None` where none did, that was not kept, or the map is
    /// one of a list.
    pub last_change: Option<f64>,
}

/// Names a map's content for good, as an entity tag does: no two contents have the same version.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct MapVersion {
    /// The map's number in the store, never used again after the map is deleted.
    pub map_id: u32,
    /// Its revision.
    pub revision: u64,
}

/// What a map knows of a robot.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct RobotDescription {
    /// Its name.
    pub name: String,
    /// The highest sequence number applied.
    pub highest_sequence: Option<u64>,
    /// How many numbered scans were applied.
    pub applied: u64,
}

/// The answer to a creation.
#[derive(Debug, Clone, PartialEq)]
pub struct Created {
    /// False when the map was there already with this configuration.
    pub created: bool,
    /// The map.
    pub map: MapDescription,
}

/// A scan of a request that was not applied.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Rejection {
    /// Its index in the request.
    pub index: usize,
    /// A stable word such as `POSE_TOO_WIDE`.
    pub code: &'static str,
    /// A sentence that names the field.
    pub detail: String,
}

/// The answer to an insertion.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct InsertAnswer {
    /// The revision that holds what was applied (the current one when nothing was).
    pub revision: u64,
    /// Scans applied.
    pub applied: u64,
    /// Scans applied before, not applied again.
    pub duplicates: u64,
    /// Scans refused.
    pub rejected: Vec<Rejection>,
}

/// Classes at points, in the order asked.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ClassesAnswer {
    /// The revision read.
    pub revision: u64,
    /// The depth read.
    pub depth: u8,
    /// One class a point; unknown outside the root.
    pub classes: Vec<Class>,
}

/// A half-open box in metres with a depth; `None` bounds are the root's, `None` depth is the map's.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct BoxQuery {
    /// `[min_x, ..`
    pub min_x: Option<f64>,
    /// `[min_y, ..`
    pub min_y: Option<f64>,
    /// `.., max_x)`
    pub max_x: Option<f64>,
    /// `.., max_y)`
    pub max_y: Option<f64>,
    /// Depth to read at most to.
    pub depth: Option<u32>,
}

/// Quadtree leaves in Z-order.
#[derive(Debug, Clone, PartialEq)]
pub struct RegionAnswer {
    /// The revision read.
    pub revision: u64,
    /// The depth read at most to.
    pub depth: u8,
    /// The leaves.
    pub leaves: Vec<Leaf>,
    /// When the last of the blocks that meet the box changed, seconds since the Unix epoch; `None` where none did, or
    /// where that was not kept.
    pub last_change: Option<f64>,
    /// The blocks that meet the box and ever changed, in Z-order and without contents; empty where they were not asked
    /// for.
    pub blocks: Vec<BlockChange>,
}

/// A dense raster of maximum classes.
#[derive(Debug, Clone, PartialEq)]
pub struct Raster {
    /// The map's number in the store: with the revision it names this content for good, also when a map is deleted and
    /// another of the same name is created.
    pub map_id: u32,
    /// The revision read.
    pub revision: u64,
    /// Depth of the cells.
    pub depth: u8,
    /// Column of the first cell, in cells of `depth`.
    pub x: u32,
    /// Row of the first cell, in cells of `depth`.
    pub y: u32,
    /// Cells along x.
    pub width: u32,
    /// Cells along y.
    pub height: u32,
    /// Min corner, metres.
    pub min: (f64, f64),
    /// Side of a cell, metres.
    pub cell_size: f64,
    /// Classes of the map's scale: `k`.
    pub class_count: u8,
    /// `height * width` classes, row-major, row 0 at min_y.
    pub classes: Vec<Class>,
}

/// Answers of a guaranteed-free query, one a region.
#[derive(Debug, Clone, PartialEq)]
pub struct FreeAnswers {
    /// The revision read.
    pub revision: u64,
    /// True for maps with guaranteed evidence.
    pub sound: bool,
    /// Depth of the map's leaves.
    pub depth: u8,
    /// The answers in the order asked.
    pub results: Vec<FreeAnswer>,
}

/// Which changes are asked for.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct ChangesQuery {
    /// Only blocks that have interior in common with this box; its depth is that of the cells of the contents.
    pub area: BoxQuery,
    /// With the contents of each block.
    pub contents: bool,
    /// With the robots whose scans were applied.
    pub robots: bool,
}

/// What changed after one revision up to another.
#[derive(Debug, Clone, PartialEq)]
pub struct Changes {
    /// Everything up to this revision is in it.
    pub revision: u64,
    /// Changes after this revision are in it.
    pub since: u64,
    /// True when there is no telling what changed, or it is too much: take the whole map anew.
    pub everything: bool,
    /// Depth of the cells of the contents.
    pub depth: u8,
    /// In Z-order.
    pub blocks: Vec<BlockChange>,
    /// Robots whose scans were applied, by name; empty where they were not asked for.
    pub robots: Vec<RobotPose>,
}

/// A node that changed: a block of 64 x 64 leaves, or a coarser one where the depth asked for is.
#[derive(Debug, Clone, PartialEq)]
pub struct BlockChange {
    /// Its address.
    pub node: NodeAddress,
    /// The last revision that changed it.
    pub revision: u64,
    /// When that was, seconds since the Unix epoch; `None` where it was not kept.
    pub changed: Option<f64>,
    /// Its cells as they are at the answer's revision, row-major, row 0 at min_y; empty where they were not asked for.
    pub classes: Vec<Class>,
}

/// Tells that a map has a new revision.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct CommitNotice {
    /// The map's name.
    pub name: MapName,
    /// Its number in the store: another map of the same name has another.
    pub id: MapId,
    /// The revision.
    pub revision: u64,
}

//! Which leaves hold obstacle points, by exact geometry, and which of them a scan called empty.

use std::collections::HashMap;
use ubbmap::quadtree::{BlockMasks, Grid, LeafMasks};
use ubbmap::simulation::{Point, World};

/// Leaves are taken smaller by this on all sides, metres: only obstacle points that are certainly inside count.
const MARGIN: f64 = 1e-9;

/// The empty leaves of a scan, to look up one at a time.
pub struct EmptyLeaves<'a> {
    blocks: HashMap<(u32, u32), &'a BlockMasks>,
}

impl<'a> EmptyLeaves<'a> {
    pub fn new(masks: &'a LeafMasks) -> Self {
        let mut blocks = HashMap::with_capacity(masks.blocks.len());
        for (address, masks) in &masks.blocks {
            assert!(blocks.insert((address.x, address.y), masks).is_none(), "block {address:?} comes twice");
            if let BlockMasks::Some { occupied, empty } = masks {
                assert!(occupied.iter().zip(empty.iter()).all(|(o, e)| o & e == 0), "{address:?}: both at once");
            }
        }
        Self { blocks }
    }

    pub fn contains(&self, (x, y): (u32, u32)) -> bool {
        match self.blocks.get(&(x / 64, y / 64)) {
            None => false,
            Some(BlockMasks::AllEmpty) => true,
            Some(BlockMasks::Some { empty, .. }) => empty[(y % 64) as usize] >> (x % 64) & 1 == 1,
        }
    }

    /// True when the leaf or one of the eight about it is empty: a leaf at the border of what is proven.
    pub fn is_near(&self, (x, y): (u32, u32)) -> bool {
        let near = |v: u32| [v.wrapping_sub(1), v, v + 1];
        near(x).into_iter().any(|x| near(y).into_iter().any(|y| self.contains((x, y))))
    }
}

/// The closed square of a leaf: min corner and side, metres.
pub fn leaf_square(grid: &Grid, (x, y): (u32, u32)) -> (Point, f64) {
    let (ox, oy) = grid.origin();
    let resolution = grid.resolution();
    (Point::new(ox + f64::from(x) * resolution, oy + f64::from(y) * resolution), resolution)
}

/// All leaves of the root, within `reach` of `from`, whose closed square certainly holds an obstacle point; each once.
pub fn obstacle_leaves(world: &World, grid: &Grid, from: Point, reach: f64) -> Vec<(u32, u32)> {
    let (ox, oy) = grid.origin();
    let resolution = grid.resolution();
    let last = i64::from(grid.side()) - 1;
    let index = |v: f64, origin: f64| ((v - origin) / resolution).floor() as i64;
    let mut leaves = Vec::new();
    for part in world.parts() {
        let (center, radius) = part.bounds();
        let first_row = index((center.y - radius).max(from.y - reach), oy) - 1;
        let last_row = index((center.y + radius).min(from.y + reach), oy) + 1;
        for row in first_row.max(0)..=last_row.min(last) {
            let (corner, _) = leaf_square(grid, (0, row as u32));
            let Some((lo, hi)) = part.extent_in_strip(corner.y + MARGIN, corner.y + resolution - MARGIN) else {
                continue;
            };
            let (lo, hi) = (lo.max(from.x - reach), hi.min(from.x + reach));
            for column in (index(lo, ox) - 1).max(0)..=(index(hi, ox) + 1).min(last) {
                let (corner, _) = leaf_square(grid, (column as u32, row as u32));
                if lo <= corner.x + resolution - MARGIN && hi >= corner.x + MARGIN {
                    leaves.push((column as u32, row as u32));
                }
            }
        }
    }
    leaves.sort_unstable();
    leaves.dedup();
    let half = Point::new(0.5 * resolution, 0.5 * resolution);
    leaves.retain(|leaf| (leaf_square(grid, *leaf).0 + half - from).norm() <= reach);
    leaves
}

/// True when nothing stands between a point and the nearest point of a leaf's square.
pub fn is_in_sight(world: &World, grid: &Grid, leaf: (u32, u32), from: Point) -> bool {
    let (corner, size) = leaf_square(grid, leaf);
    let nearest = Point::new(from.x.clamp(corner.x, corner.x + size), from.y.clamp(corner.y, corner.y + size));
    world.sees(from, from + (nearest - from) * (1.0 - 1e-6))
}

/// What was checked.
#[derive(Debug, Clone, Copy, Default)]
pub struct Tally {
    /// Scans.
    pub scans: u64,
    /// Leaf-scan pairs that count: a leaf that holds an obstacle point within the sensor's reach, with nothing between
    /// the sensor and the leaf's nearest corner; and a scan.
    pub pairs: u64,
    /// The same with the leaves that stand behind others, or inside of obstacles.
    pub all: u64,
    /// Pairs whose leaf or a neighbour was proven empty: those at the border of what is proven.
    pub contested: u64,
    /// Leaves called empty in all.
    pub empty: u64,
    /// Pairs whose leaf was called empty.
    pub violations: u64,
}

impl Tally {
    /// Adds the leaves of one scan; returns those that were wrongly called empty.
    pub fn add(
        &mut self,
        masks: &LeafMasks,
        world: &World,
        grid: &Grid,
        (from, reach): (Point, f64),
    ) -> Vec<(u32, u32)> {
        let leaves = obstacle_leaves(world, grid, from, reach);
        let empty = EmptyLeaves::new(masks);
        let wrong: Vec<_> = leaves.iter().copied().filter(|leaf| empty.contains(*leaf)).collect();
        self.scans += 1;
        self.all += leaves.len() as u64;
        self.pairs += leaves.iter().filter(|leaf| is_in_sight(world, grid, **leaf, from)).count() as u64;
        self.contested += leaves.iter().filter(|leaf| empty.is_near(**leaf)).count() as u64;
        self.empty += masks.counts().1;
        self.violations += wrong.len() as u64;
        wrong
    }
}

//! What the store's tests share: random maps, commits and comparisons.

use proptest::prelude::*;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::collections::BTreeMap;
use std::sync::Arc;
use ubbmap::mapping::{EvidenceRule, MapConfig};
use ubbmap::quadtree::{
    Block, BlockAddress, BlockView, ClassScale, Grid, LeafRange, NodeAddress, OccupancyTree, RowMask,
};
use ubbmap::sensor::{Mount, SensorModel, SensorSpec};
use ubbmap::store::{Commit, LoadedMap, MapId, MapName, MapStore, RobotName, SequenceWindow};

/// A configuration with `sensors` sensors that differ in every field.
pub fn config(depth: u32, classes: u32, sensors: usize) -> MapConfig {
    let grid = Grid::new(0.05, depth, Some((-12.7, 3.3))).unwrap();
    let sensor = |index: usize| {
        let x = index as f64;
        let spec = SensorSpec {
            range_error_minus: 0.01 + x / 1000.0,
            range_error_plus: 0.02 + x / 1000.0,
            beam_opening: 0.003 + x / 10_000.0,
            beam_diameter: 0.01 + x / 1000.0,
            range_min: 0.05 + x / 100.0,
            range_max: 20.0 + x,
            no_return_free_to: (index % 2 == 1).then_some(8.0 + x / 10.0),
            beam_angle_error: x / 10_000.0,
            mount: Mount { x: 0.1 + x, y: -0.2 - x, theta: 0.1 * x },
        };
        (format!("laser-{index}"), SensorModel::new(spec).unwrap())
    };
    let rule = [EvidenceRule::Guaranteed, EvidenceRule::Outer, EvidenceRule::Inner][sensors % 3];
    MapConfig::new(grid, ClassScale::new(classes).unwrap(), rule, 0.02, (0..sensors).map(sensor).collect()).unwrap()
}

pub fn name(name: &str) -> MapName {
    MapName::new(name).unwrap()
}

pub fn robot(number: u64) -> RobotName {
    RobotName::new(&format!("AMR-{number}.b_1")).unwrap()
}

/// A map as a writer holds it, and the commits that made it.
pub struct Model {
    pub config: MapConfig,
    pub tree: OccupancyTree,
    pub windows: BTreeMap<RobotName, SequenceWindow>,
    pub revision: u64,
    random: ChaCha8Rng,
}

impl Model {
    pub fn new(config: MapConfig, seed: u64) -> Self {
        let tree = OccupancyTree::new(config.grid().depth(), config.scale());
        Self { config, tree, windows: BTreeMap::new(), revision: 0, random: ChaCha8Rng::seed_from_u64(seed) }
    }

    /// The next commit: some blocks change (mixed, of one class, back to unknown), some robots move on.
    pub fn step(&mut self, blocks: usize) -> Commit {
        let side = self.config.grid().side().div_ceil(64);
        let scale = self.config.scale();
        let mut changed = BTreeMap::new();
        for _ in 0..blocks {
            // Near one corner, so that blocks come again.
            let near = side.min(6);
            let address = BlockAddress { x: self.random.random_range(0..near), y: self.random.random_range(0..near) };
            let view = match self.random.random_range(0..8) {
                0 => BlockView::Uniform(scale.unknown()),
                1 => BlockView::Uniform(self.random.random_range(1..=scale.count())),
                _ => self.mixed(address),
            };
            self.tree.set_block(address, view);
            changed.insert((address.x, address.y), self.tree.block(address));
        }
        self.revision += 1;
        let mut windows = BTreeMap::new();
        for _ in 0..self.random.random_range(0..3) {
            let robot = robot(self.random.random_range(0..5));
            let window = self.windows.entry(robot.clone()).or_default();
            for _ in 0..self.random.random_range(1..50) {
                let ahead = self.random.random_range(0..60);
                window.record(window.highest().unwrap_or(1 << 40).saturating_add(ahead) - 20);
            }
            windows.insert(robot, window.clone());
        }
        let blocks = changed.into_iter().map(|((x, y), view)| (BlockAddress { x, y }, view)).collect();
        Commit {
            revision: self.revision,
            changed: 1.7e9 + self.revision as f64,
            blocks,
            windows: windows.into_iter().collect(),
        }
    }

    fn mixed(&mut self, address: BlockAddress) -> BlockView {
        let mut block = match self.tree.block(address) {
            BlockView::Uniform(class) => Block::uniform(class),
            BlockView::Mixed(block) => Block::clone(&block),
        };
        for _ in 0..self.random.random_range(1..6) {
            let mut masks: [RowMask; 2] = [[0; 64]; 2];
            for mask in &mut masks {
                let (x, y) = (self.random.random_range(0..60_u32), self.random.random_range(0..60_usize));
                let row = self.random.random_range(1..u64::from(u32::MAX)) << x;
                let rows = self.random.random_range(1..=64 - y);
                mask[y..y + rows].fill(row);
            }
            block.apply(&masks[0], &masks[1], self.config.scale());
        }
        BlockView::Mixed(Arc::new(block))
    }

    pub fn loaded(&self) -> LoadedMap {
        LoadedMap { revision: self.revision, tree: self.tree.clone(), windows: self.windows.clone() }
    }
}

/// Leaves of the quadtree as `(depth, x, y, class)`.
fn leaves(tree: &OccupancyTree) -> Vec<(u8, u32, u32, u8)> {
    let all = LeafRange { min_x: 0, min_y: 0, max_x: 1 << tree.depth(), max_y: 1 << tree.depth() };
    let mut leaves = Vec::new();
    tree.visit_leaves(&all, tree.depth(), &mut |leaf| {
        let NodeAddress { depth, x, y } = leaf.node;
        leaves.push((depth, x, y, leaf.class));
        true
    });
    leaves
}

/// Leaf for leaf, revision and windows.
pub fn assert_same(found: &LoadedMap, expected: &LoadedMap) {
    assert_eq!(found.revision, expected.revision);
    assert_eq!(found.windows, expected.windows);
    assert_eq!((found.tree.depth(), found.tree.scale()), (expected.tree.depth(), expected.tree.scale()));
    assert_eq!(leaves(&found.tree), leaves(&expected.tree));
}

/// A map with `commits` commits in a store, and its model.
pub fn fill(store: &dyn MapStore, map: &str, config: MapConfig, seed: u64, commits: usize) -> (MapId, Model) {
    let id = store.create(&name(map), &config, 1.5e9).unwrap();
    let mut model = Model::new(config, seed);
    for _ in 0..commits {
        store.commit(id, &model.step(6)).unwrap();
    }
    (id, model)
}

/// Depths and classes of every form that blocks take on disk.
pub fn shapes() -> impl Strategy<Value = (u32, u32)> {
    (1_u32..=12, prop_oneof![4_u32..=16, 17_u32..=255])
}

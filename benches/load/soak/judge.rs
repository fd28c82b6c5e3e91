//! Builds by the engine alone what a map must be, and compares.

use super::ledger::{Ledger, Restored};
use super::robots::{PERIOD, scan_of};
use crate::robots::Fleet;
use std::collections::BTreeMap;
use ubbmap::mapping::{MapConfig, Surveyor};
use ubbmap::quadtree::{BlockAddress, BlockView, LeafMasks, OccupancyTree};
use ubbmap::sensor::{Angles, PoseBox, PoseLimits, Scan, ScanLimits, ScanSpec};
use ubbmap::store::read_map_file;
use ubbmap::wire::v1;

/// Compares an exported map with the one that is built offline from what the ledger says that its revision holds.
///
/// # Errors
/// How they differ.
pub fn judge(
    file: &[u8],
    ledger: &Ledger,
    restored: &[Restored],
    fleet: &Fleet,
    robots: usize,
) -> Result<String, String> {
    let (config, found) = read_map_file(&mut &*file).map_err(|error| error.to_string())?;
    let mut held = Vec::new();
    for robot in 0..robots {
        let steps = ledger.held(robot, restored, found.revision);
        let count = found.windows.iter().find(|(name, _)| name.as_str() == format!("robot-{robot}"));
        let count = count.map_or(0, |(_, window)| window.count());
        if count != steps.len() as u64 {
            let (revision, known) = (found.revision, steps.len());
            return Err(format!(
                "robot-{robot}: {count} scans in the map of revision {revision}, {known} acknowledged"
            ));
        }
        held.push((robot, steps));
    }
    let scans: usize = held.iter().map(|(_, steps)| steps.len()).sum();
    // Robots have ground of their own, so each half of them makes blocks of its own.
    let (one, other) = held.split_at(held.len() / 2);
    let (mut tree, other) = std::thread::scope(|scope| {
        let other = scope.spawn(|| build(&config, fleet, other));
        (build(&config, fleet, one), other.join().unwrap())
    });
    for (x, y) in blocks(&other).into_keys() {
        assert!(
            matches!(tree.block(BlockAddress { x, y }), BlockView::Uniform(class) if class == tree.scale().unknown())
        );
        tree.set_block(BlockAddress { x, y }, other.block(BlockAddress { x, y }));
    }
    let (ours, theirs) = (blocks(&tree), blocks(&found.tree));
    let differ: Vec<&(u32, u32)> =
        ours.keys().chain(theirs.keys()).filter(|at| ours.get(at) != theirs.get(at)).collect();
    if let Some(first) = differ.first() {
        return Err(format!("revision {}: {} blocks differ, the first is {first:?}", found.revision, differ.len()));
    }
    if tree != found.tree {
        return Err(format!("revision {}: the same blocks, another tree", found.revision));
    }
    let leaves: usize = theirs.values().map(Vec::len).sum();
    Ok(format!("revision {}: {scans} scans, {} blocks, {leaves} leaves, all equal", found.revision, theirs.len()))
}

/// The map of these steps of robots.
fn build(config: &MapConfig, fleet: &Fleet, held: &[(usize, Vec<u64>)]) -> OccupancyTree {
    let mut tree = OccupancyTree::new(config.grid().depth(), config.scale());
    let (mut surveyor, mut changed) = (Surveyor::new(), Vec::new());
    for (robot, steps) in held {
        let mut evidence: Vec<Option<LeafMasks>> = vec![None; PERIOD as usize];
        for step in steps {
            let masks = evidence[(step % PERIOD) as usize]
                .get_or_insert_with(|| surveyor.survey(config, &checked(config, &scan_of(fleet, *robot, *step))));
            changed.clear();
            tree.apply(masks, &mut changed);
        }
    }
    tree
}

/// The classes of every block that is not unknown as a whole.
pub fn blocks(tree: &OccupancyTree) -> BTreeMap<(u32, u32), Vec<u8>> {
    let unknown = OccupancyTree::new(tree.depth(), tree.scale());
    let nothing = classes(&unknown.block(BlockAddress { x: 0, y: 0 }));
    let mut all = BTreeMap::new();
    tree.visit_blocks(&mut |at, view| {
        let classes = classes(view);
        if classes != nothing {
            all.insert((at.x, at.y), classes);
        }
    });
    all
}

fn classes(view: &BlockView) -> Vec<u8> {
    match view {
        BlockView::Uniform(class) => vec![*class; 64 * 64],
        BlockView::Mixed(block) => block.leaves().to_vec(),
    }
}

fn checked(config: &MapConfig, scan: &v1::Scan) -> Scan {
    let side = |side: Option<v1::Interval>| side.and_then(|side| Some((side.min?, side.max?))).unwrap();
    let pose = scan.pose.unwrap();
    let spec = ScanSpec {
        pose: PoseBox::new(side(pose.x), side(pose.y), side(pose.theta), &PoseLimits::default()).unwrap(),
        angles: Angles::Uniform { min: scan.angle_min.unwrap(), increment: scan.angle_increment.unwrap() },
        ranges: scan.ranges.clone(),
        footprint_radius: scan.footprint_radius,
        sweep_rotation: scan.sweep_rotation,
        sweep_translation: scan.sweep_translation,
    };
    Scan::new(spec, config.sensors()["default"], &ScanLimits::default()).unwrap()
}

//! What every store asks of a commit before it writes anything.

use super::{Commit, LoadedMap, StoreError, StoredMap};
use crate::mapping::MapConfig;
use crate::quadtree::{BLOCK_SIDE, BlockAddress, BlockView, Class, Grid};
use std::collections::BTreeSet;

/// True when the map has a block at the address.
pub(super) fn holds(grid: &Grid, address: BlockAddress) -> bool {
    let blocks = grid.side().div_ceil(BLOCK_SIDE);
    address.x < blocks && address.y < blocks
}

/// The revision is above the map's; blocks are within the map, each once, of classes of its scale; robots each once.
///
/// # Errors
/// [`StoreError::Refused`] with the first that is not so.
pub(super) fn check_commit(stored: &StoredMap, commit: &Commit) -> Result<(), StoreError> {
    if commit.revision <= stored.revision {
        let (new, old) = (commit.revision, stored.revision);
        return Err(StoreError::Refused(format!("revision {new} is not above the map's, {old}")));
    }
    let grid = stored.config.grid();
    let highest = stored.config.scale().count();
    let mut seen = BTreeSet::new();
    for (address, view) in &commit.blocks {
        let refused = |why: String| StoreError::Refused(format!("block ({}, {}): {why}", address.x, address.y));
        if !holds(grid, *address) {
            return Err(refused("outside the map".to_owned()));
        }
        if !seen.insert(address.morton()) {
            return Err(refused("twice in one commit".to_owned()));
        }
        if let Some(class) = class_off_scale(view, grid, highest) {
            return Err(refused(format!("class {class} is not in 1..={highest}")));
        }
    }
    let mut robots = BTreeSet::new();
    for (robot, _) in &commit.windows {
        if !robots.insert(robot) {
            return Err(StoreError::Refused(format!("robot {robot}: twice in one commit")));
        }
    }
    Ok(())
}

/// What is to become a map's contents has the map's depth and classes.
///
/// # Errors
/// [`StoreError::Refused`] when it has others.
pub(super) fn check_contents(config: &MapConfig, contents: &LoadedMap) -> Result<(), StoreError> {
    let (depth, scale) = (contents.tree.depth(), contents.tree.scale());
    if depth == config.grid().depth() && scale == config.scale() {
        return Ok(());
    }
    Err(StoreError::Refused(format!("contents of depth {depth} and {} classes do not fit the map", scale.count())))
}

fn class_off_scale(view: &BlockView, grid: &Grid, highest: Class) -> Option<Class> {
    let off = |class: Class| !(1..=highest).contains(&class);
    match view {
        BlockView::Uniform(class) => Some(*class).filter(|class| off(*class)),
        BlockView::Mixed(block) => {
            let side = grid.side().min(BLOCK_SIDE) as usize;
            let rows = block.leaves().chunks_exact(BLOCK_SIDE as usize).take(side);
            rows.flat_map(|row| {
                let row = &row[..side];
                let low = row.iter().copied().fold(Class::MAX, Class::min);
                let high = row.iter().copied().fold(0, Class::max);
                [low, high]
            })
            .find(|class| off(*class))
        }
    }
}

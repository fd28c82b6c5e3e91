//! Guaranteed-free for regions whose numbers lie on edges of leaves, a float beside them, or are next to nothing.
#![allow(clippy::unwrap_used, clippy::panic, reason = "a test that cannot be set up has failed")]

use crate::regions_exact::Dice;
use std::sync::Arc;
use ubbmap::mapping::{Region, RegionLimits, guaranteed_free};
use ubbmap::quadtree::{Block, BlockAddress, BlockView, Class, ClassScale, Grid, NodeAddress, OccupancyTree};

/// A map of one block or a few, from the class of each leaf.
fn map_of(grid: &Grid, class: &mut dyn FnMut(u32, u32) -> Class) -> OccupancyTree {
    let (depth, side) = (grid.depth(), grid.side());
    let mut tree = OccupancyTree::new(depth, ClassScale::new(10).unwrap());
    for (bx, by) in (0..side.div_ceil(64)).flat_map(|by| (0..side.div_ceil(64)).map(move |bx| (bx, by))) {
        let mut leaves = Box::new([5; 64 * 64]);
        for (x, y) in (0..side.min(64)).flat_map(|y| (0..side.min(64)).map(move |x| (x, y))) {
            leaves[(y * 64 + x) as usize] = class(bx * 64 + x, by * 64 + y);
        }
        let view = BlockView::Mixed(Arc::new(Block::from_leaves(leaves)));
        tree.set_block(BlockAddress { x: bx, y: by }, view);
    }
    tree
}

fn path(points: &[(f64, f64)], radius: f64) -> Region {
    Region::path(points.to_vec(), radius, &RegionLimits::default()).unwrap()
}

/// The square of its length is 0, and a root of that was divided by.
#[test]
fn a_path_shorter_than_any_root_of_a_square_missed_the_leaf_beside_an_edge() {
    let grid = Grid::new(0.5, 8, Some((0.0, 0.0))).unwrap();
    let tree = map_of(&grid, &mut |x, y| if (x, y) == (32, 0) { 10 } else { 1 });
    for end in [(16.0, 1e-170), (16.0, 1e-163), (16.0, 5e-324), (16.0, 1e-150)] {
        for radius in [0.0, 1e-3] {
            let answer = guaranteed_free(&tree, &grid, &path(&[(16.0, 0.0), end], radius), 0);
            assert!(!answer.free && answer.max_class == 10, "to {end:?}, radius {radius}: {answer:?}");
        }
    }
}

/// Its length times a radius is 0 too, so that every corner seemed to be within it.
#[test]
fn a_path_of_a_length_next_to_nothing_met_leaves_beyond_its_radius() {
    let grid = Grid::new(0.05, 7, None).unwrap();
    let tree = map_of(&grid, &mut |x, y| if (x, y) == (72, 72) { 10 } else { 1 });
    // From (0.4, 0.4) on, 0.57 m from the path.
    let leaf = grid.node_box(NodeAddress { depth: 7, x: 72, y: 72 });
    for start in [5e-324, 1e-310, 1e-163, 1e-101] {
        let region = path(&[(start, 0.0), (0.0, 0.0), (0.0, 0.0)], 0.45);
        assert!(!region.meets(&leaf), "{start}");
        let answer = guaranteed_free(&tree, &grid, &region, 0);
        assert!(answer.free && answer.max_class == 1, "{start}: {answer:?}");
    }
}

/// The leaf (0, 3) begins at `3 * 0.1`, which is above the float 0.3: the first piece's bounds leave it out, the path's do not.
#[test]
fn a_path_along_an_edge_was_refused_without_a_witness() {
    let grid = Grid::new(0.1, 6, Some((0.0, 0.0))).unwrap();
    let tree = map_of(&grid, &mut |x, y| if (x, y) == (0, 3) { 10 } else { 1 });
    let region = path(&[(0.05, 0.3), (0.15, 0.3), (0.15, 0.6)], 0.0);
    let answer = guaranteed_free(&tree, &grid, &region, 0);
    assert!(answer.free || answer.refusal.is_some(), "{answer:?}");
}

/// A coordinate on an edge of a leaf, a float beside one, near one, anywhere, or next to nothing.
fn coordinate(dice: &mut Dice, grid: &Grid, origin: f64) -> f64 {
    let (side, resolution) = (f64::from(grid.side()), grid.resolution());
    let edge = origin + dice.real(0.0, side + 1.0).floor() * resolution;
    match dice.whole(0, 8) {
        0..=2 => edge,
        3 => edge.next_up(),
        4 => edge.next_down(),
        5 => edge + resolution * dice.real(-1e-6, 1e-6),
        6 if edge == 0.0 => dice.pick(&[1e-170, -1e-170, 5e-324, 1e-310, -0.0, 1e-160, 1e-154]),
        6 => edge + 0.5 * resolution,
        7 => origin + resolution * dice.real(-0.1 * side, 1.1 * side),
        _ => origin + resolution * dice.real(0.0, side),
    }
}

/// A path of a few pieces, some along an axis, some next to nothing long, some there and back.
fn random_path(dice: &mut Dice, grid: &Grid) -> Region {
    let (resolution, origin) = (grid.resolution(), grid.origin());
    let mut points = vec![(coordinate(dice, grid, origin.0), coordinate(dice, grid, origin.1))];
    for _ in 0..dice.whole(0, 4) {
        let last = points[points.len() - 1];
        let next = (coordinate(dice, grid, origin.0), coordinate(dice, grid, origin.1));
        points.push(match dice.whole(0, 5) {
            0 => (last.0, next.1),
            1 => (next.0, last.1),
            2 => (last.0 + resolution * dice.real(-1e-8, 1e-8), last.1 + resolution * dice.real(-1.0, 1.0)),
            3 => (last.0.next_up(), dice.pick(&[last.1, last.1.next_down(), last.1 + 1e-170])),
            4 => points[0],
            _ => next,
        });
    }
    let radius = dice.pick(&[0.0, 0.0, 0.5, 1.0, 1e-9, 3.0]) * resolution;
    path(&points, radius)
}

#[test]
fn every_path_that_is_not_free_has_a_witness_that_it_meets() {
    let mut dice = Dice(91);
    let (mut free, mut refused) = (0, 0);
    for _ in 0..120 {
        let depth = dice.pick(&[1, 3, 5, 6, 7]);
        let resolution = dice.pick(&[0.1, 0.5, 1.0 / 3.0, 0.07, 1e-4, 1e4]);
        let side = resolution * f64::from(1_u32 << depth);
        let origin = dice.pick(&[(0.0, 0.0), (-0.5 * side, -0.5 * side), (123.4 * side, -77.7), (-0.0, -side)]);
        let Ok(grid) = Grid::new(resolution, depth, Some(origin)) else { continue };
        let rare = dice.pick(&[0.5, 0.05, 0.005]);
        let tree =
            map_of(&grid, &mut |_, _| if dice.chance(rare) { dice.whole(1, 10) as Class } else { dice.pick(&[1, 2]) });
        for _ in 0..80 {
            let region = match random_path(&mut dice, &grid) {
                region if dice.chance(0.9) => region,
                // Too far away for a lens.
                _ => {
                    let near = (coordinate(&mut dice, &grid, origin.0), coordinate(&mut dice, &grid, origin.1));
                    path(&[near, (near.0, near.1 + (5e7 * resolution).min(9e7))], 0.0)
                }
            };
            let tolerance = dice.pick(&[0, 1, 2]);
            let answer = guaranteed_free(&tree, &grid, &region, tolerance);
            let context = format!("{region:?} on {grid:?}, tolerance {tolerance}: {answer:?}");
            let (range, beyond) = grid.leaves_meeting(&region.bounds());
            let met = |leaf: NodeAddress| {
                (range.min_x..range.max_x).contains(&leaf.x)
                    && (range.min_y..range.max_y).contains(&leaf.y)
                    && region.meets(&grid.node_box(leaf))
            };
            let all = (range.min_y..range.max_y).flat_map(|y| (range.min_x..range.max_x).map(move |x| (x, y)));
            let inside = all.map(|(x, y)| NodeAddress { depth: grid.depth(), x, y }).filter(|leaf| met(*leaf));
            let largest = inside.map(|leaf| tree.max_class(leaf)).max().unwrap_or(0);
            assert!(answer.max_class == largest || (beyond && answer.max_class == largest.max(5)), "{context}");
            assert_eq!(answer.free, answer.max_class <= 4 - tolerance, "{context}");
            assert_eq!(answer.free, answer.refusal.is_none(), "{context}");
            let Some((_, witness)) = answer.refusal else {
                free += 1;
                continue;
            };
            refused += 1;
            assert!(witness.class > 4 - tolerance && witness.distance.is_some(), "{context}");
            if let Some(leaf) = witness.node {
                assert!(met(leaf) && tree.max_class(leaf) == witness.class, "{context}");
            }
        }
    }
    assert!(free > 500 && refused > 3_000, "{free} free, {refused} refused");
}

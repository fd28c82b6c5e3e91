//! Regions with numbers of every kind, seen through the quick tests, against the exact test of every leaf.
#![allow(clippy::unwrap_used, clippy::panic, reason = "a test that cannot be set up has failed")]

use crate::regions_exact::Dice;
use std::sync::Arc;
use ubbmap::mapping::{Region, RegionLimits, guaranteed_free};
use ubbmap::quadtree::{Block, BlockAddress, BlockView, Class, ClassScale, Grid, NodeAddress, OccupancyTree};

const DEPTH: u32 = 8;

/// A map whose leaves lie at coordinates that are no floats, some far from zero.
fn map(dice: &mut Dice) -> (OccupancyTree, Grid) {
    let resolution = dice.pick(&[0.1, 0.05, 0.3, 1.0 / 3.0, 0.25]);
    let far = dice.pick(&[0.0, 0.0, 1e3, 1e6, 3e7]);
    let corner = |dice: &mut Dice| far + (dice.real(-40.0, 0.0) / resolution).floor() * resolution;
    let grid = Grid::new(resolution, DEPTH, Some((corner(dice), corner(dice)))).unwrap();
    let mut tree = OccupancyTree::new(DEPTH as u8, ClassScale::new(10).unwrap());
    for (x, y) in (0..4).flat_map(|y| (0..4).map(move |x| (x, y))) {
        let mut leaves = Box::new([dice.pick(&[1, 1, 2, 5]); 64 * 64]);
        for _ in 0..dice.whole(0, 40) {
            let (i, class) = (dice.whole(0, 4095) as usize, dice.whole(1, 10) as Class);
            leaves[i..(i + dice.whole(1, 9) as usize).min(4096)].fill(class);
        }
        let view = if dice.chance(0.3) {
            BlockView::Uniform(1)
        } else {
            BlockView::Mixed(Arc::new(Block::from_leaves(leaves)))
        };
        tree.set_block(BlockAddress { x, y }, view);
    }
    (tree, grid)
}

/// A region within the root: anywhere, or with edges of leaves for coordinates and whole leaves for a radius.
fn region(dice: &mut Dice, grid: &Grid) -> Region {
    let (resolution, origin) = (grid.resolution(), grid.origin());
    let on_edges = dice.chance(0.5);
    let nudge = dice.pick(&[0.0, 0.0, f64::EPSILON, -f64::EPSILON]);
    let coordinate = |dice: &mut Dice, origin: f64| {
        let leaves = dice.real(60.0, 190.0);
        let value = origin + if on_edges { leaves.floor() } else { leaves } * resolution;
        value + nudge * value.abs()
    };
    let point = |dice: &mut Dice| (coordinate(dice, origin.0), coordinate(dice, origin.1));
    let radius = if on_edges { dice.whole(0, 9) as f64 } else { dice.real(0.0, 30.0) } * resolution;
    match dice.whole(0, 5) {
        0 => Region::disc(point(dice), radius).unwrap(),
        1 => {
            let (a, b) = (point(dice), point(dice));
            Region::rectangle((a.0.min(b.0), a.1.min(b.1)), (a.0.max(b.0), a.1.max(b.1))).unwrap()
        }
        2 => {
            // More pieces than are looked at together.
            let mut at = point(dice);
            let mut points = vec![at];
            for _ in 0..dice.whole(60, 150) {
                at = (at.0 + dice.real(-1.0, 1.0) * resolution, at.1 + dice.real(-1.0, 1.0) * resolution);
                points.push(at);
            }
            Region::path(points, 0.2 * radius, &RegionLimits::default()).unwrap()
        }
        3 => {
            // Along an axis, nearly so, or a piece of no length.
            let (x, y) = point(dice);
            let along = dice.real(-50.0, 50.0) * resolution;
            let beside = dice.pick(&[0.0, 1e-9, 0.01, 0.5, 2.0]) * resolution;
            let end = dice.pick(&[(x + along, y + beside), (x - beside, y + along), (x, y)]);
            Region::path(vec![(x, y), end], radius, &RegionLimits::default()).unwrap()
        }
        _ => {
            let points = (0..dice.whole(1, 4)).map(|_| point(dice)).collect();
            Region::path(points, radius, &RegionLimits::default()).unwrap()
        }
    }
}

#[test]
fn answers_are_those_of_the_exact_test_of_every_leaf() {
    let mut dice = Dice(77);
    let (mut free, mut refused) = (0, 0);
    for _ in 0..40 {
        let (tree, grid) = map(&mut dice);
        for _ in 0..60 {
            let region = region(&mut dice, &grid);
            let answer = guaranteed_free(&tree, &grid, &region, dice.pick(&[0, 1, 2]));
            let (range, beyond) = grid.leaves_meeting(&region.bounds());
            let met: Vec<NodeAddress> = (range.min_y..range.max_y)
                .flat_map(|y| (range.min_x..range.max_x).map(move |x| NodeAddress { depth: DEPTH as u8, x, y }))
                .filter(|leaf| region.meets(&grid.node_box(*leaf)))
                .collect();
            let largest = met.iter().map(|leaf| tree.max_class(*leaf)).max().unwrap();
            let context = format!("{region:?} on {grid:?}: {answer:?}");
            assert!(!beyond || answer.max_class >= 5, "{context}");
            if !beyond {
                assert_eq!(answer.max_class, largest, "{context}");
            }
            match answer.refusal {
                None => free += 1,
                Some((_, witness)) => {
                    assert!(witness.node.is_none_or(|leaf| met.contains(&leaf)), "{context}");
                    refused += 1;
                }
            }
        }
    }
    assert!(free > 100 && refused > 1000, "{free} free, {refused} refused");
}

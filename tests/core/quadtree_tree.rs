//! The block form holds the same map as a plain node-by-node quadtree, over random evidence.
#![allow(clippy::unwrap_used, clippy::panic, reason = "a test fails by panicking")]

use crate::quadtree_support::{EVERYTHING, at_depth, block_masks, cells, grown, leaf_masks, random};
use rand::RngExt;
use std::sync::Arc;
use ubbmap::quadtree::{
    Block, BlockAddress, BlockMasks, BlockView, ClassScale, Descent, Leaf, LeafMasks, LeafRange, NodeAddress,
    OccupancyTree, ReferenceTree,
};

const CLASSES: [u32; 6] = [4, 5, 10, 11, 254, 255];

fn leaves(tree: &OccupancyTree, depth: u8) -> Vec<Leaf> {
    let mut found = Vec::new();
    assert!(tree.visit_leaves(&EVERYTHING, depth, &mut |leaf| {
        found.push(leaf);
        true
    }));
    found
}

fn assert_same_map(tree: &OccupancyTree, reference: &ReferenceTree) {
    for depth in 0..=tree.depth() + 1 {
        assert_eq!(leaves(tree, depth), reference.leaves(depth), "leaves down to {depth} of {}", tree.depth());
    }
    let statistics = tree.statistics();
    assert_eq!((statistics.nodes, statistics.leaves), reference.root().counts());
    assert_eq!(tree.max_class(NodeAddress { depth: 0, x: 0, y: 0 }), reference.root().max_class());
    let unknown = tree.scale().unknown();
    let area = |wanted: &dyn Fn(u8) -> bool| {
        let matching = reference.leaves(tree.depth()).into_iter().filter(|leaf| wanted(leaf.class));
        matching.map(|leaf| 1_u64 << (2 * (tree.depth() - leaf.node.depth))).sum::<u64>()
    };
    assert_eq!(statistics.free_cells, area(&|class| class < unknown));
    assert_eq!(statistics.unknown_cells, area(&|class| class == unknown));
    assert_eq!(statistics.occupied_cells, area(&|class| class > unknown));
}

fn changed_blocks(before: &ReferenceTree, after: &ReferenceTree, depth: u8) -> Vec<BlockAddress> {
    let side = 1_usize << depth;
    let (before, after) = (cells(before, depth), cells(after, depth));
    let blocks = 1_u32 << depth.saturating_sub(6);
    let mut found = Vec::new();
    for (y, x) in (0..blocks).flat_map(|y| (0..blocks).map(move |x| (y, x))) {
        let rows = (y as usize * 64..(y as usize * 64 + 64).min(side)).map(|row| {
            let start = row * side + x as usize * 64;
            start..start + side.min(64)
        });
        if rows.into_iter().any(|cells| before[cells.clone()] != after[cells]) {
            found.push(BlockAddress { x, y });
        }
    }
    found
}

#[test]
fn the_block_form_is_the_plain_quadtree() {
    for depth in 1..=10_u8 {
        for (index, classes) in CLASSES.into_iter().enumerate() {
            let mut rng = random(u64::from(depth) * 100 + index as u64);
            let scale = ClassScale::new(classes).unwrap();
            let (mut tree, mut reference) = (OccupancyTree::new(depth, scale), ReferenceTree::new(depth, scale));
            for scan in 0..if depth > 8 { 24 } else { 60 } {
                let masks = leaf_masks(&mut rng, depth);
                let before = reference.clone();
                let mut changed = Vec::new();
                tree.apply(&masks, &mut changed);
                reference.apply(&masks);
                if depth <= 8 {
                    changed.sort_by_key(|block| (block.y, block.x));
                    assert_eq!(changed, changed_blocks(&before, &reference, depth));
                }
                if scan % 12 == 11 {
                    assert_same_map(&tree, &reference);
                }
            }
        }
    }
}

#[test]
fn a_saturated_map_is_one_node_again() {
    for depth in [1, 3, 5, 6, 8] {
        let scale = ClassScale::new(10).unwrap();
        let mut tree = OccupancyTree::new(depth, scale);
        let mut rng = random(7);
        let blocks = 1_u32 << depth.saturating_sub(6);
        let all = (0..blocks).flat_map(|y| (0..blocks).map(move |x| BlockAddress { x, y }));
        let every = |masks: &dyn Fn() -> BlockMasks| LeafMasks { blocks: all.clone().map(|a| (a, masks())).collect() };
        for _ in 0..20 {
            tree.apply(&leaf_masks(&mut rng, depth), &mut Vec::new());
        }
        for _ in 0..10 {
            tree.apply(&every(&|| BlockMasks::AllEmpty), &mut Vec::new());
        }
        let free = TreeShape { nodes: 1, class: 1 };
        assert_eq!(TreeShape::of(&tree), free);
        let mut changed = Vec::new();
        tree.apply(&every(&|| BlockMasks::AllEmpty), &mut changed);
        assert!(changed.is_empty(), "nothing is left to take");
        let full = || BlockMasks::Some { occupied: Box::new([u64::MAX; 64]), empty: Box::new([0; 64]) };
        for _ in 0..9 {
            tree.apply(&every(&full), &mut changed);
        }
        assert_eq!(TreeShape::of(&tree), TreeShape { nodes: 1, class: 10 });
        assert_eq!(changed.len(), 9 * (blocks * blocks) as usize);
        assert!(tree.statistics().memory_bytes < 200);
    }
}

#[derive(Debug, PartialEq)]
struct TreeShape {
    nodes: u64,
    class: u8,
}

impl TreeShape {
    fn of(tree: &OccupancyTree) -> Self {
        Self { nodes: tree.statistics().nodes, class: tree.max_class(NodeAddress { depth: 0, x: 0, y: 0 }) }
    }
}

#[test]
fn rasters_and_maxima_are_those_of_the_leaves() {
    let mut rng = random(3);
    for depth in 1..=9_u8 {
        let (tree, reference) = grown(u64::from(depth), depth, 10, 25);
        for at in 0..=depth {
            let side = 1_u32 << at;
            let expected = at_depth(&reference, depth, at);
            let whole = LeafRange { min_x: 0, min_y: 0, max_x: side, max_y: side };
            assert_eq!(tree.raster(&whole, at), expected);
            for (i, class) in expected.iter().enumerate() {
                let node = NodeAddress { depth: at, x: i as u32 % side, y: i as u32 / side };
                assert_eq!(tree.max_class(node), *class);
                assert_eq!(reference.max_class(node), *class);
            }
            // A part that may reach beyond the root, where all is unknown.
            let mut span = || {
                let (a, b) = (rng.random_range(0..=side + 2), rng.random_range(0..=side + 2));
                (a.min(b), a.max(b))
            };
            let ((min_x, max_x), (min_y, max_y)) = (span(), span());
            let part = tree.raster(&LeafRange { min_x, min_y, max_x, max_y }, at);
            let inside = |x: u32, y: u32| x < side && y < side;
            let cell = |x, y| if inside(x, y) { expected[(y * side + x) as usize] } else { tree.scale().unknown() };
            let columns = min_x..max_x;
            let wanted: Vec<u8> = (min_y..max_y).flat_map(|y| columns.clone().map(move |x| cell(x, y))).collect();
            assert_eq!(part, wanted);
        }
        let deeper = NodeAddress { depth: depth + 2, x: 5, y: 6 };
        assert_eq!(tree.max_class(deeper), tree.max_class(NodeAddress { depth, x: 1, y: 1 }));
        assert_eq!(tree.max_class(NodeAddress { depth, x: 1 << depth, y: 0 }), tree.scale().unknown());
    }
}

#[test]
fn a_visit_of_a_range_gives_the_leaves_that_meet_it() {
    let mut rng = random(11);
    for round in 0..60 {
        let depth = 1 + round % 9;
        let (tree, reference) = grown(u64::from(round), depth, 10, 15);
        let cut = rng.random_range(0..=depth);
        let side = 1_u32 << depth;
        let (a, b, c, d) = (0..=side, 0..=side, 0..=side, 0..=side);
        let (a, b, c, d) = (rng.random_range(a), rng.random_range(b), rng.random_range(c), rng.random_range(d));
        let range = LeafRange { min_x: a.min(b), min_y: c.min(d), max_x: a.max(b), max_y: c.max(d) };
        let meets = |leaf: &Leaf| {
            let shift = depth - leaf.node.depth;
            let axis = |i: u32, min: u32, max: u32| i << shift < max && (i + 1) << shift > min;
            !range.is_empty()
                && axis(leaf.node.x, range.min_x, range.max_x)
                && axis(leaf.node.y, range.min_y, range.max_y)
        };
        let expected: Vec<Leaf> = reference.leaves(cut).into_iter().filter(meets).collect();
        let mut found = Vec::new();
        assert!(tree.visit_leaves(&range, cut, &mut |leaf| {
            found.push(leaf);
            true
        }));
        assert_eq!(found, expected);
        if expected.len() > 1 {
            let mut left = expected.len() / 2;
            let ran_through = tree.visit_leaves(&range, cut, &mut |_| {
                left -= 1;
                left > 0
            });
            assert!(!ran_through && left == 0);
        }
    }
}

#[test]
fn a_descent_comes_by_every_node_and_by_the_parts_of_leaves() {
    for depth in 1..=8_u8 {
        let (tree, reference) = grown(40 + u64::from(depth), depth, 6, 20);
        let mut nodes = 0;
        let mut found = Vec::new();
        assert!(tree.descend(&mut |node, class, is_leaf| {
            nodes += 1;
            if is_leaf {
                found.push(Leaf { node, class });
                Descent::Skip
            } else {
                Descent::Into
            }
        }));
        assert_eq!((nodes, found), (reference.root().counts().0, reference.leaves(depth)));

        let mut everywhere = 0;
        let mut last = None;
        assert!(tree.descend(&mut |node, class, _| {
            everywhere += 1;
            assert_eq!(class, reference.max_class(node));
            let key = NodeKey::of(node, depth);
            assert!(last < Some(key), "children follow their parent, in Z-order");
            last = Some(key);
            Descent::Into
        }));
        assert_eq!(everywhere, ((1_u64 << (2 * (depth + 1))) - 1) / 3);

        let mut calls = 0;
        assert!(!tree.descend(&mut |_, _, _| {
            calls += 1;
            if calls == 3 { Descent::Stop } else { Descent::Into }
        }));
        assert_eq!(calls, 3);
    }
}

/// Order of a pre-order visit: by the first cell, then larger nodes first.
#[derive(Clone, Copy, PartialEq, PartialOrd)]
struct NodeKey(u64, u8);

impl NodeKey {
    fn of(node: NodeAddress, depth: u8) -> Self {
        let shift = depth - node.depth;
        Self(BlockAddress { x: node.x << shift, y: node.y << shift }.morton(), node.depth)
    }
}

#[test]
fn an_older_clone_never_changes() {
    let mut rng = random(17);
    for depth in [2, 6, 7, 9] {
        let mut tree = OccupancyTree::new(depth, ClassScale::new(7).unwrap());
        let mut kept: Vec<(OccupancyTree, Vec<Leaf>)> = Vec::new();
        for _ in 0..40 {
            tree.apply(&leaf_masks(&mut rng, depth), &mut Vec::new());
            if rng.random_bool(0.5) {
                kept.push((tree.clone(), leaves(&tree, depth)));
            }
            if rng.random_bool(0.2) && !kept.is_empty() {
                // Writing goes on from an older revision: trees share blocks both ways.
                tree = kept[rng.random_range(0..kept.len())].0.clone();
            }
        }
        for (old, as_it_was) in &kept {
            assert_eq!(&leaves(old, depth), as_it_was);
        }
    }
}

#[test]
fn untouched_and_unchanged_blocks_stay_shared() {
    let scale = ClassScale::new(4).unwrap();
    let mut tree = OccupancyTree::new(8, scale);
    let one = |x: u32, row: u64| {
        let mut empty = Box::new([0; 64]);
        empty[3] = row;
        let masks = BlockMasks::Some { occupied: Box::new([0; 64]), empty };
        LeafMasks { blocks: vec![(BlockAddress { x, y: 1 }, masks)] }
    };
    tree.apply(&one(0, 0b11), &mut Vec::new());
    tree.apply(&one(1, 0b11), &mut Vec::new());
    let old = tree.clone();
    let mut changed = Vec::new();
    tree.apply(&one(0, 0b11), &mut changed);
    assert!(changed.is_empty(), "class 1 is the lowest: u is 2 here");
    tree.apply(&one(1, 0b110), &mut changed);
    assert_eq!(changed, [BlockAddress { x: 1, y: 1 }]);
    let shared = |x| match (old.block(BlockAddress { x, y: 1 }), tree.block(BlockAddress { x, y: 1 })) {
        (BlockView::Mixed(a), BlockView::Mixed(b)) => Arc::ptr_eq(&a, &b),
        other => panic!("mixed blocks expected, got {other:?}"),
    };
    assert!(shared(0));
    assert!(!shared(1));
}

#[test]
fn evidence_that_changes_nothing_copies_nothing() {
    let address = BlockAddress { x: 0, y: 0 };
    let masks = |occupied: [u64; 64], empty: [u64; 64]| {
        let masks = BlockMasks::Some { occupied: Box::new(occupied), empty: Box::new(empty) };
        LeafMasks { blocks: vec![(address, masks)] }
    };
    // A tree of one block: its root is the block itself.
    let mut tree = OccupancyTree::new(6, ClassScale::new(4).unwrap());
    tree.apply(&masks([0; 64], [0xff; 64]), &mut Vec::new());
    let old = tree.clone();
    let mut changed = Vec::new();
    tree.apply(&masks([0; 64], [0xf0; 64]), &mut changed);
    let (BlockView::Mixed(before), BlockView::Mixed(after)) = (old.block(address), tree.block(address)) else {
        panic!("a mixed block is expected");
    };
    assert!(changed.is_empty() && Arc::ptr_eq(&before, &after));
    // Leaves in both masks count as occupied, also where nothing is left to add.
    tree.set_block(address, BlockView::Uniform(4));
    tree.apply(&masks([u64::MAX; 64], [7; 64]), &mut changed);
    assert!(changed.is_empty());
    assert_eq!(tree.block(address), BlockView::Uniform(4));
}

#[test]
fn a_tree_is_rebuilt_from_its_blocks() {
    for depth in 1..=9_u8 {
        let (tree, reference) = grown(90 + u64::from(depth), depth, 9, 30);
        let mut rebuilt = OccupancyTree::new(depth, tree.scale());
        let mut last = None;
        tree.visit_blocks(&mut |address, view| {
            assert!(last < Some(address.morton()), "Z-order");
            last = Some(address.morton());
            assert_ne!(*view, BlockView::Uniform(tree.scale().unknown()));
            assert_eq!(tree.block(address), *view);
            rebuilt.set_block(address, view.clone());
        });
        assert_eq!(rebuilt, tree);
        assert_same_map(&rebuilt, &reference);
        // Blocks that hold unknown alone were left out of the visit and are unknown in a new tree.
        let blocks = 1_u32 << depth.saturating_sub(6);
        for (x, y) in (0..blocks).flat_map(|y| (0..blocks).map(move |x| (x, y))) {
            rebuilt.set_block(BlockAddress { x, y }, BlockView::Uniform(tree.scale().unknown()));
        }
        assert_eq!(rebuilt, OccupancyTree::new(depth, tree.scale()));
    }
}

#[test]
fn a_block_that_does_not_fit_is_made_to() {
    let scale = ClassScale::new(6).unwrap();
    let mut leaves = Box::new([3; 64 * 64]);
    (leaves[0], leaves[1], leaves[64 * 63]) = (0, 200, 250);
    let block = BlockView::Mixed(Arc::new(Block::from_leaves(leaves)));
    let mut large = OccupancyTree::new(7, scale);
    large.set_block(BlockAddress { x: 1, y: 1 }, block.clone());
    let class = |tree: &OccupancyTree, x, y| tree.max_class(NodeAddress { depth: tree.depth(), x, y });
    assert_eq!([class(&large, 64, 64), class(&large, 65, 64), class(&large, 64, 127)], [1, 6, 6]);
    let mut small = OccupancyTree::new(2, scale);
    small.set_block(BlockAddress { x: 0, y: 0 }, block.clone());
    assert_eq!(small.statistics().leaves, 7, "one quad of four leaves and three merged ones");
    assert_eq!(small.max_class(NodeAddress { depth: 0, x: 0, y: 0 }), 6);
    small.set_block(BlockAddress { x: 1, y: 0 }, block);
    assert_eq!(small.block(BlockAddress { x: 1, y: 0 }), BlockView::Uniform(3));
    small.set_block(BlockAddress { x: 0, y: 0 }, BlockView::Mixed(Arc::new(Block::uniform(2))));
    assert_eq!(small.block(BlockAddress { x: 0, y: 0 }), BlockView::Uniform(2));
}

#[test]
fn a_block_steps_its_leaves_and_keeps_its_maxima() {
    let mut rng = random(23);
    for round in 0..400 {
        let scale = ClassScale::new(CLASSES[round % CLASSES.len()]).unwrap();
        let grain = 1 << rng.random_range(0..7);
        let patch: Vec<u8> = (0..64 * 64).map(|_| rng.random_range(1..=scale.occupied())).collect();
        let at = |x: usize, y: usize| patch[(y / grain * 64 + x / grain) % (64 * 64)];
        let mut cells = [0; 64 * 64];
        for (i, cell) in cells.iter_mut().enumerate() {
            *cell = at(i % 64, i / 64);
        }
        let mut block = Block::from_leaves(Box::new(cells));
        let masks = block_masks(&mut rng);
        let changed = match &masks {
            BlockMasks::AllEmpty => block.apply_all_empty(scale),
            BlockMasks::Some { occupied, empty } => {
                // A leaf in both masks counts as occupied.
                let both: Vec<u64> = empty.iter().zip(occupied.iter()).map(|(e, o)| e | o).collect();
                let empty: &[u64; 64] = both.as_slice().try_into().unwrap();
                let foreseen = block.would_change(occupied, empty, scale);
                let changed = block.apply(occupied, empty, scale);
                assert_eq!(foreseen, changed);
                changed
            }
        };
        let mut expected = cells;
        for (i, class) in expected.iter_mut().enumerate() {
            let (occupied, empty) = match &masks {
                BlockMasks::AllEmpty => (false, true),
                BlockMasks::Some { occupied, empty } => {
                    (occupied[i / 64] >> (i % 64) & 1 == 1, empty[i / 64] >> (i % 64) & 1 == 1)
                }
            };
            *class = scale.step(*class, occupied, empty);
        }
        assert_eq!(block.leaves(), &expected);
        assert_eq!(changed, cells != expected);
        let uniform = expected.iter().all(|class| *class == expected[0]).then_some(expected[0]);
        assert_eq!(block.as_uniform(), uniform);
        for level in 0..=6_u8 {
            let (count, size) = (1_u32 << level, 64_usize >> level);
            for (x, y) in (0..count).flat_map(|y| (0..count).map(move |x| (x, y))) {
                let rows = (y as usize * size..(y as usize + 1) * size).map(|row| row * 64 + x as usize * size);
                let max = rows.flat_map(|start| expected[start..start + size].iter()).max();
                assert_eq!(Some(&block.max_at(level, x, y)), max);
                assert_eq!(block.max_at(level, x + count, y + 3 * count), block.max_at(level, x, y));
            }
        }
    }
}

#[test]
fn the_deepest_tree_works_at_its_far_corner() {
    let scale = ClassScale::new(10).unwrap();
    let mut tree = OccupancyTree::new(24, scale);
    let corner = BlockAddress { x: (1 << 18) - 1, y: (1 << 18) - 1 };
    let mut occupied = Box::new([0; 64]);
    occupied[63] = 1 << 63;
    let masks = BlockMasks::Some { occupied, empty: Box::new([0; 64]) };
    tree.apply(&LeafMasks { blocks: vec![(corner, masks)] }, &mut Vec::new());
    let last = (1 << 24) - 1;
    assert_eq!(tree.max_class(NodeAddress { depth: 24, x: last, y: last }), 6);
    assert_eq!(tree.max_class(NodeAddress { depth: 24, x: last - 1, y: last }), 5);
    let statistics = tree.statistics();
    assert_eq!((statistics.leaves, statistics.nodes), (24 * 3 + 1, 24 * 4 + 1));
    assert_eq!((statistics.unknown_cells, statistics.occupied_cells), ((1 << 48) - 1, 1));
    let range = LeafRange { min_x: last - 1, min_y: last - 1, max_x: last + 1, max_y: last + 1 };
    assert_eq!(tree.raster(&range, 24), [5, 5, 5, 6]);
    assert_eq!(leaves(&tree, 24).len(), 73);
}

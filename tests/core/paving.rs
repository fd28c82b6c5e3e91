//! The bisection form: the same map, converted without loss.
#![allow(clippy::unwrap_used, clippy::panic, reason = "a test fails by panicking")]

use crate::quadtree_support::{cells, grown};
use ubbmap::quadtree::{BlockMasks, ClassScale, LeafMasks, OccupancyPaving, OccupancyTree};

/// Leaves of the bisection of a box of cells, straight from the raster: bisect while classes differ.
fn bisections(cells: &[u8], side: usize, [x0, y0, x1, y1]: [usize; 4], along_x: bool) -> u64 {
    let first = cells[y0 * side + x0];
    if (y0..y1).all(|y| cells[y * side + x0..y * side + x1].iter().all(|class| *class == first)) {
        return 1;
    }
    let (low, high) = if along_x {
        let middle = usize::midpoint(x0, x1);
        ([x0, y0, middle, y1], [middle, y0, x1, y1])
    } else {
        let middle = usize::midpoint(y0, y1);
        ([x0, y0, x1, middle], [x0, middle, x1, y1])
    };
    bisections(cells, side, low, !along_x) + bisections(cells, side, high, !along_x)
}

#[test]
fn the_two_forms_convert_into_each_other_without_loss() {
    for depth in 1..=9_u8 {
        for (seed, classes) in [(1, 4), (2, 10), (3, 255)] {
            for scans in [0, 1, 5, 40] {
                let (tree, reference) = grown(seed * 1000 + u64::from(depth), depth, classes, scans);
                let paving = OccupancyPaving::from_tree(&tree);
                assert_eq!(paving.to_tree(), tree);
                assert_eq!(OccupancyPaving::from_tree(&paving.to_tree()), paving);
                assert_eq!((paving.depth(), paving.scale()), (depth, tree.scale()));

                let side = 1_usize << depth;
                let expected = cells(&reference, depth);
                assert_eq!(paving.leaf_count(), bisections(&expected, side, [0, 0, side, side], true));
                assert_eq!(paving.node_count(), 2 * paving.leaf_count() - 1);
                assert!(paving.leaf_count() <= tree.statistics().leaves);

                let mut drawn = vec![0; side * side];
                let mut leaves = 0;
                paving.visit_leaves(&mut |area, class| {
                    leaves += 1;
                    for y in area.min_y as usize..area.max_y as usize {
                        for cell in &mut drawn[y * side + area.min_x as usize..y * side + area.max_x as usize] {
                            assert_eq!(*cell, 0, "leaves do not overlap");
                            *cell = class;
                        }
                    }
                });
                assert_eq!((drawn, leaves), (expected, paving.leaf_count()));
            }
        }
    }
}

#[test]
fn two_classes_side_by_side_take_one_bisection() {
    let mut tree = OccupancyTree::new(2, ClassScale::new(10).unwrap());
    let left_half = BlockMasks::Some { occupied: Box::new([0; 64]), empty: Box::new([0b0011; 64]) };
    tree.apply(
        &LeafMasks { blocks: vec![(ubbmap::quadtree::BlockAddress { x: 0, y: 0 }, left_half)] },
        &mut Vec::new(),
    );
    let paving = OccupancyPaving::from_tree(&tree);
    assert_eq!((paving.leaf_count(), tree.statistics().leaves), (2, 4));
}

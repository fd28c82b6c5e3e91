//! Random evidence for the tests of quadtrees.
#![allow(clippy::unwrap_used, reason = "a test fails by panicking")]

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use ubbmap::quadtree::{
    BlockAddress, BlockMasks, ClassScale, LeafMasks, LeafRange, OccupancyTree, ReferenceTree, RowMask,
};

pub const EVERYTHING: LeafRange = LeafRange { min_x: 0, min_y: 0, max_x: u32::MAX, max_y: u32::MAX };

pub fn random(seed: u64) -> ChaCha8Rng {
    ChaCha8Rng::seed_from_u64(seed)
}

/// Bits `first..end` of a word.
fn bits(first: u32, end: u32) -> u64 {
    (first..end).fold(0, |word, bit| word | 1 << bit)
}

/// Masks of one block: single leaves, noise, rectangles, or all leaves; occupied and empty ones apart.
pub fn block_masks(rng: &mut ChaCha8Rng) -> BlockMasks {
    let mut occupied: Box<RowMask> = Box::new([0; 64]);
    let mut empty: Box<RowMask> = Box::new([0; 64]);
    match rng.random_range(0..8) {
        0..=2 => return BlockMasks::AllEmpty,
        3 => {
            for _ in 0..rng.random_range(1..6) {
                occupied[rng.random_range(0..64)] |= 1 << rng.random_range(0..64);
                empty[rng.random_range(0..64)] |= 1 << rng.random_range(0..64);
            }
        }
        4 => {
            occupied.fill_with(|| rng.random::<u64>() & rng.random::<u64>());
            empty.fill_with(|| rng.random());
        }
        5 => occupied.fill(u64::MAX),
        6 => empty.fill(u64::MAX),
        _ => {
            for mask in [&mut occupied, &mut empty] {
                // Even edges often, so that quads merge.
                let grain = 1 << rng.random_range(0..6);
                let mut span = || {
                    let (a, b) = (rng.random_range(0..=64 / grain), rng.random_range(0..=64 / grain));
                    (a.min(b) * grain, a.max(b) * grain)
                };
                let ((x0, x1), (y0, y1)) = (span(), span());
                mask[y0 as usize..y1 as usize].fill(bits(x0, x1));
            }
        }
    }
    for (empty, occupied) in empty.iter_mut().zip(occupied.iter()) {
        *empty &= !occupied;
    }
    BlockMasks::Some { occupied, empty }
}

/// Evidence of one scan about some blocks of a tree of `depth`, each once; now and then a block outside the root.
pub fn leaf_masks(rng: &mut ChaCha8Rng, depth: u8) -> LeafMasks {
    let side = 1_u32 << depth.saturating_sub(6);
    let mut masks = LeafMasks::default();
    for _ in 0..rng.random_range(1..=4) {
        let outside = u32::from(rng.random_bool(0.05));
        // A corner of the root is visited more often than the rest: its classes reach both ends of the scale.
        let span = if rng.random_bool(0.7) { side.min(2) } else { side } + outside;
        let address = BlockAddress { x: rng.random_range(0..span), y: rng.random_range(0..span) };
        if masks.blocks.iter().all(|(known, _)| *known != address) {
            masks.blocks.push((address, block_masks(rng)));
        }
    }
    masks
}

/// A block form and a reference tree after the same random evidence.
pub fn grown(seed: u64, depth: u8, classes: u32, scans: usize) -> (OccupancyTree, ReferenceTree) {
    let mut rng = random(seed);
    let scale = ClassScale::new(classes).unwrap();
    let (mut tree, mut reference) = (OccupancyTree::new(depth, scale), ReferenceTree::new(depth, scale));
    for _ in 0..scans {
        let masks = leaf_masks(&mut rng, depth);
        tree.apply(&masks, &mut Vec::new());
        reference.apply(&masks);
    }
    (tree, reference)
}

/// Classes of all smallest cells, row-major from the lowest row.
pub fn cells(reference: &ReferenceTree, depth: u8) -> Vec<u8> {
    at_depth(reference, depth, depth)
}

/// Maximum classes of the nodes at `at`, row-major, drawn from the leaves of the reference.
pub fn at_depth(reference: &ReferenceTree, depth: u8, at: u8) -> Vec<u8> {
    let side = 1_usize << depth;
    let coarse = 1_usize << at;
    let mut raster = vec![0; coarse * coarse];
    for leaf in reference.leaves(depth) {
        let size = 1_usize << (depth - leaf.node.depth);
        for y in 0..size {
            for x in 0..size {
                let (x, y) = (leaf.node.x as usize * size + x, leaf.node.y as usize * size + y);
                let class = &mut raster[y * coarse / side * coarse + x * coarse / side];
                *class = leaf.class.max(*class);
            }
        }
    }
    raster
}

//! Maps whose blocks come and go, against the same maps held as a whole.
#![allow(clippy::unwrap_used, clippy::panic, reason = "a test fails by panicking")]

use crate::paged_support::{Desk, Root};
use crate::quadtree_support::{EVERYTHING, leaf_masks, random};
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use std::sync::atomic::Ordering;
use ubbmap::mapping::{Region, RegionLimits, guaranteed_free, try_guaranteed_free};
use ubbmap::quadtree::{BlockView, Grid, LeafRange, NodeAddress, PageError};

const DEPTH: u8 = 9;

/// Three blocks.
const TINY: usize = 3 * 5600;

fn leaves(root: &Root, depth: u8) -> (Vec<ubbmap::quadtree::Leaf>, Vec<ubbmap::quadtree::Leaf>) {
    let (mut paged, mut whole) = (Vec::new(), Vec::new());
    root.paged
        .try_visit_leaves(&EVERYTHING, depth, &mut |leaf| {
            paged.push(leaf);
            true
        })
        .unwrap();
    root.whole.visit_leaves(&EVERYTHING, depth, &mut |leaf| {
        whole.push(leaf);
        true
    });
    (paged, whole)
}

/// Asks a root a few random questions, in both forms.
fn compare(root: &Root, rng: &mut ChaCha8Rng) {
    let side = 1_u32 << DEPTH;
    let depth = rng.random_range(0..=DEPTH);
    let (x, y) = (rng.random_range(0..1_u32 << depth), rng.random_range(0..1_u32 << depth));
    let node = NodeAddress { depth, x, y };
    assert_eq!(root.paged.try_max_class(node).unwrap(), root.whole.max_class(node));
    match rng.random_range(0..4) {
        0 => {
            let (paged, whole) = leaves(root, depth);
            assert_eq!(paged, whole);
        }
        1 => {
            let end = 1 << depth;
            let range = LeafRange { min_x: x, min_y: y, max_x: end.min(x + 100), max_y: end.min(y + 100) };
            assert_eq!(root.paged.try_raster(&range, depth).unwrap(), root.whole.raster(&range, depth));
        }
        2 => {
            let mut blocks = Vec::new();
            root.paged.try_visit_blocks(&mut |address, view| blocks.push((address, view.clone()))).unwrap();
            let mut expected = Vec::new();
            root.whole.visit_blocks(&mut |address, view| expected.push((address, view.clone())));
            assert_eq!(blocks, expected);
        }
        _ => {
            let grid = Grid::new(0.1, u32::from(DEPTH), None).unwrap();
            let half = 0.05 * f64::from(side);
            let mut point = || (rng.random_range(-half..half), rng.random_range(-half..half));
            let path = Region::path(vec![point(), point(), point()], 0.7, &RegionLimits::default()).unwrap();
            for region in [path, Region::disc(point(), 2.0).unwrap()] {
                let answer = try_guaranteed_free(&root.paged, &grid, &region, 1).unwrap();
                assert_eq!(answer, guaranteed_free(&root.whole, &grid, &region, 1));
            }
        }
    }
}

#[test]
fn a_map_under_a_tiny_limit_answers_as_one_in_memory_at_every_revision_that_is_held() {
    let mut rng = random(31);
    let mut desk = Desk::new(DEPTH, TINY);
    let mut older: Vec<Root> = Vec::new();
    for round in 0..600 {
        let scans: Vec<_> = (0..rng.random_range(1..4)).map(|_| leaf_masks(&mut rng, DEPTH)).collect();
        let before = desk.root.clone();
        desk.commit(&scans, rng.random_bool(0.1));
        if rng.random_bool(0.2) {
            older.push(before);
        }
        if older.len() > 6 || (!older.is_empty() && rng.random_bool(0.1)) {
            older.swap_remove(rng.random_range(0..older.len()));
        }
        compare(&desk.root, &mut rng);
        if let Some(root) = older.get(rng.random_range(0..7)) {
            compare(root, &mut rng);
        }
        if round % 100 == 50 {
            // Started anew: nobody reads what was before.
            older.clear();
            desk.root = desk.reopened();
        }
    }
    let counted = desk.cache.statistics();
    assert!(counted.evictions > 500 && counted.loads > 500 && counted.hits > 500, "{counted:?}");
    assert_eq!(counted.loads, desk.shelf.fetches.load(Ordering::SeqCst));
    // Without readers of older revisions the limit holds again with the next block that comes.
    older.clear();
    compare(&desk.reopened(), &mut rng);
    for _ in 0..20 {
        compare(&desk.root, &mut rng);
    }
    assert!(desk.cache.statistics().bytes <= TINY as u64, "{:?}", desk.cache.statistics());
    drop(desk.root);
    drop(desk.pager);
    assert_eq!(desk.cache.statistics().bytes, 0, "what goes with its tree is counted out");
}

#[test]
fn readers_hold_their_revision_while_the_writer_replaces_it_and_the_cache_lets_go() {
    let mut rng = random(32);
    let mut desk = Desk::new(DEPTH, TINY);
    for _ in 0..40 {
        desk.commit(&[leaf_masks(&mut rng, DEPTH)], false);
    }
    std::thread::scope(|scope| {
        let (sender, receiver) = std::sync::mpsc::sync_channel::<Root>(2);
        let receiver = std::sync::Arc::new(std::sync::Mutex::new(receiver));
        for seed in 0..3 {
            let receiver = std::sync::Arc::clone(&receiver);
            scope.spawn(move || {
                let mut rng = random(seed);
                loop {
                    let root = receiver.lock().unwrap().recv();
                    let Ok(root) = root else { break };
                    (0..6).for_each(|_| compare(&root, &mut rng));
                }
            });
        }
        for _ in 0..300 {
            sender.send(desk.root.clone()).unwrap();
            desk.commit(&[leaf_masks(&mut rng, DEPTH)], rng.random_bool(0.1));
        }
    });
    assert!(desk.cache.statistics().evictions > 200, "{:?}", desk.cache.statistics());
    compare(&desk.root, &mut rng);
}

#[test]
fn a_block_that_cannot_be_read_fails_what_looks_into_it_and_nothing_else() {
    let mut rng = random(33);
    let mut desk = Desk::new(DEPTH, 1);
    for _ in 0..60 {
        desk.commit(&[leaf_masks(&mut rng, DEPTH)], false);
    }
    let root = desk.reopened();
    let mut mixed = Vec::new();
    root.whole.visit_blocks(&mut |address, view| mixed.extend(matches!(view, BlockView::Mixed(_)).then_some(address)));
    assert!(mixed.len() > 3);
    desk.shelf.broken.store(true, Ordering::SeqCst);
    let before = desk.shelf.fetches.load(Ordering::SeqCst);
    // Down to the blocks the maxima answer.
    for depth in 0..=DEPTH - 6 {
        let end = 1 << depth;
        let range = LeafRange { min_x: 0, min_y: 0, max_x: end, max_y: end };
        assert_eq!(root.paged.try_raster(&range, depth).unwrap(), root.whole.raster(&range, depth));
        let (paged, whole) = leaves(&root, depth);
        assert_eq!(paged, whole);
    }
    assert_eq!(desk.shelf.fetches.load(Ordering::SeqCst), before);
    let leaf = NodeAddress { depth: DEPTH, x: mixed[0].x * 64, y: mixed[0].y * 64 };
    assert!(matches!(root.paged.try_max_class(leaf), Err(PageError::Source(_))));
    assert!(matches!(root.paged.in_memory().try_max_class(leaf), Err(PageError::Absent)));
    assert!(root.paged.hold_replaced(&mixed).is_err());
    let masks = loop {
        let masks = leaf_masks(&mut rng, DEPTH);
        if masks.blocks.iter().any(|(address, _)| mixed.contains(address)) {
            break masks;
        }
    };
    assert!(root.paged.prepare(&masks).is_err());
    // It is not remembered: what can be read again is.
    desk.shelf.broken.store(false, Ordering::SeqCst);
    assert_eq!(root.paged.try_max_class(leaf).unwrap(), root.whole.max_class(leaf));
    assert_eq!(root.paged.try_whole().unwrap(), root.whole);
    desk.root = root;
    desk.commit(&[masks], false);
    compare(&desk.root, &mut rng);
}

#[test]
fn what_is_read_and_not_changed_is_neither_copied_nor_owned() {
    let mut rng = random(34);
    let mut desk = Desk::new(DEPTH, usize::MAX);
    for _ in 0..60 {
        desk.commit(&[leaf_masks(&mut rng, DEPTH)], false);
    }
    let root = desk.reopened();
    assert_eq!(root.paged.try_whole().unwrap(), root.whole);
    let loads = desk.cache.statistics().loads;
    (0..50).for_each(|_| compare(&root, &mut rng));
    assert_eq!(desk.cache.statistics().loads, loads, "all blocks are in memory");
    assert_eq!(root.paged.in_memory().try_whole().unwrap(), root.whole);
    assert_eq!(desk.cache.statistics().evictions, 0);
}

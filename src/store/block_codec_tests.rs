//! The block codec against a plain reader of the quadtree, over random blocks and random bytes.

#![allow(clippy::unwrap_used, clippy::panic, reason = "a test fails by panicking")]

use super::block_codec::{BlockCodec, MAX_ENCODED};
use crate::quadtree::{Block, BlockView, Class, ClassScale};
use proptest::prelude::*;
use rand::{Rng, RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::sync::Arc;

type Leaves = [Class; 64 * 64];

/// Splits a square at random down to the leaves, so that every mix of node sizes comes up.
fn paint(random: &mut impl Rng, leaves: &mut Leaves, (x, y, side): (usize, usize, usize), split: f64, k: u8) {
    if side > 1 && random.random_bool(split) {
        let half = side / 2;
        for (dx, dy) in [(0, 0), (half, 0), (0, half), (half, half)] {
            paint(random, leaves, (x + dx, y + dy, half), split, k);
        }
        return;
    }
    let class = random.random_range(1..=k);
    for row in y..y + side {
        leaves[row * 64 + x..][..side].fill(class);
    }
}

fn random_block(seed: u64, split: f64, depth: u8, k: u8) -> Box<Leaves> {
    let mut leaves = Box::new([1; 64 * 64]);
    paint(&mut ChaCha8Rng::seed_from_u64(seed), &mut leaves, (0, 0, 1 << depth.min(6)), split, k);
    leaves
}

/// The form of `docs/store-format.md`, one bit at a time: the oracle.
fn plain_bits(leaves: &Leaves, (x, y, side): (usize, usize, usize), width: u32, bits: &mut Vec<bool>) {
    let class = leaves[y * 64 + x];
    let same = (y..y + side).all(|row| leaves[row * 64 + x..][..side].iter().all(|other| *other == class));
    if side > 1 {
        bits.push(!same);
    }
    if same {
        bits.extend((0..width).rev().map(|bit| (class - 1) >> bit & 1 == 1));
        return;
    }
    let half = side / 2;
    for (dx, dy) in [(0, 0), (half, 0), (0, half), (half, half)] {
        plain_bits(leaves, (x + dx, y + dy, half), width, bits);
    }
}

fn plain_bytes(leaves: &Leaves, side: usize, width: u32) -> Vec<u8> {
    let mut bits = Vec::new();
    plain_bits(leaves, (0, 0, side), width, &mut bits);
    bits.chunks(8)
        .map(|byte| byte.iter().enumerate().fold(0, |sum, (place, bit)| sum | u8::from(*bit) << (7 - place)))
        .collect()
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(400))]

    #[test]
    fn every_block_has_the_described_form_and_comes_back(
        seed: u64, split in 0.0..=1.0, depth in 1_u8..=8, k in 4_u8..=255, shallow in any::<bool>(),
    ) {
        let k = if shallow { 4 + k % 13 } else { k };
        let side = 1_usize << depth.min(6);
        let leaves = random_block(seed, split, depth, k);
        let codec = BlockCodec::new(depth, ClassScale::new(u32::from(k)).unwrap());
        let mut bytes = vec![0xaa];
        codec.encode(&BlockView::Mixed(Arc::new(Block::from_leaves(leaves.clone()))), &mut bytes).unwrap();
        let bytes = &bytes[1..];
        prop_assert_eq!(bytes, plain_bytes(&leaves, side, if k <= 16 { 4 } else { 8 }));
        let first = leaves[0];
        let uniform = (0..side).all(|y| leaves[y * 64..][..side].iter().all(|class| *class == first));
        match codec.decode(bytes).unwrap() {
            BlockView::Uniform(class) => prop_assert!(uniform && class == first),
            BlockView::Mixed(block) => prop_assert!(!uniform && block.leaves() == &*leaves),
        }
    }

    #[test]
    fn cut_lengthened_and_padded_forms_are_refused(seed: u64, split in 0.3..=1.0, k in 4_u8..=40, fill in 1_u8..) {
        let codec = BlockCodec::new(16, ClassScale::new(u32::from(k)).unwrap());
        let leaves = random_block(seed, split, 6, k);
        let mut bytes = Vec::new();
        codec.encode(&BlockView::Mixed(Arc::new(Block::from_leaves(leaves.clone()))), &mut bytes).unwrap();
        prop_assert!(codec.decode(&bytes[..bytes.len() - 1]).is_err());
        prop_assert!(codec.decode(&[bytes.as_slice(), &[0]].concat()).is_err());
        let mut bits = Vec::new();
        plain_bits(&leaves, (0, 0, 64), if k <= 16 { 4 } else { 8 }, &mut bits);
        let padding = (8 - bits.len() % 8) % 8;
        if padding > 0 {
            *bytes.last_mut().unwrap() |= (fill & ((1 << padding) - 1)).max(1);
            prop_assert!(codec.decode(&bytes).is_err());
        }
    }

    #[test]
    fn what_decodes_is_the_one_form_of_its_block(
        bytes in prop::collection::vec(any::<u8>(), 0..600), depth in 1_u8..=24, k in 4_u8..=255,
    ) {
        let codec = BlockCodec::new(depth, ClassScale::new(u32::from(k)).unwrap());
        if let Ok(view) = codec.decode(&bytes) {
            let mut again = Vec::new();
            codec.encode(&view, &mut again).unwrap();
            prop_assert_eq!(again, bytes);
        }
    }

    #[test]
    fn a_changed_bit_never_decodes_to_the_same_block(seed: u64, split in 0.3..=1.0, k in 4_u8..=20, at: usize) {
        let codec = BlockCodec::new(9, ClassScale::new(u32::from(k)).unwrap());
        let view = BlockView::Mixed(Arc::new(Block::from_leaves(random_block(seed, split, 6, k))));
        let mut bytes = Vec::new();
        codec.encode(&view, &mut bytes).unwrap();
        let at = at % (bytes.len() * 8);
        bytes[at / 8] ^= 1 << (at % 8);
        prop_assert!(codec.decode(&bytes).ok() != Some(view));
    }
}

#[test]
fn a_block_of_one_class_is_one_or_two_bytes() {
    for (k, length) in [(4, 1), (10, 1), (16, 1), (17, 2), (255, 2)] {
        let codec = BlockCodec::new(16, ClassScale::new(k).unwrap());
        for class in 1..=k as u8 {
            let mut bytes = Vec::new();
            codec.encode(&BlockView::Uniform(class), &mut bytes).unwrap();
            assert_eq!((bytes.len(), codec.decode(&bytes).unwrap()), (length, BlockView::Uniform(class)));
        }
    }
}

#[test]
fn the_longest_block_fits_and_nothing_longer_does() {
    let codec = BlockCodec::new(6, ClassScale::new(255).unwrap());
    let mut leaves = Box::new([1; 64 * 64]);
    for (index, class) in leaves.iter_mut().enumerate() {
        *class = (index % 255) as u8 + 1;
    }
    let mut bytes = Vec::new();
    codec.encode(&BlockView::Mixed(Arc::new(Block::from_leaves(leaves))), &mut bytes).unwrap();
    assert_eq!(bytes.len(), MAX_ENCODED);
    bytes.push(0);
    assert!(codec.decode(&bytes).unwrap_err().0.contains("at most"));
}

#[test]
fn classes_off_the_scale_are_refused_both_ways() {
    let codec = BlockCodec::new(6, ClassScale::new(10).unwrap());
    let mut bytes = Vec::new();
    for class in [0, 11, 255] {
        assert!(codec.encode(&BlockView::Uniform(class), &mut bytes).is_err());
        let mut leaves = Box::new([5; 64 * 64]);
        leaves[777] = class;
        assert!(codec.encode(&BlockView::Mixed(Arc::new(Block::from_leaves(leaves))), &mut bytes).is_err());
    }
    assert!(bytes.is_empty());
    // 0 and then class - 1 = 10.
    assert!(codec.decode(&[0b0101_0000]).unwrap_err().0.contains("class 11"));
}

#[test]
fn a_split_node_of_one_class_is_refused() {
    let codec = BlockCodec::new(1, ClassScale::new(10).unwrap());
    // 1, then four times class 5 (4 bits of 4).
    assert!(codec.decode(&[0b1010_0010, 0b0010_0010, 0b0000_0000]).unwrap_err().0.contains("one class"));
    assert!(codec.decode(&[0b1010_0010, 0b0010_0010, 0b1000_0000]).is_ok());
}

//! The frame of records: any change of key or value is seen and named.

#![allow(clippy::unwrap_used, clippy::panic, reason = "a test fails by panicking")]

use super::keys::{self, Kind};
use super::record;
use super::{MapId, StoreError};
use crate::quadtree::BlockAddress;
use proptest::prelude::*;

fn block_key(map: u32, x: u32, y: u32) -> Vec<u8> {
    keys::block(MapId(map), BlockAddress { x, y })
}

proptest! {
    #[test]
    fn a_sealed_record_opens(map: u32, x in 0..1_u32 << 18, y in 0..1_u32 << 18, revision: u64, content: Vec<u8>) {
        let key = block_key(map, x, y);
        let value = record::seal(&key, revision, &content);
        let record = record::open(&key, Kind::Block, &value).unwrap();
        prop_assert_eq!((record.revision, record.content), (revision, content.as_slice()));
        prop_assert_eq!(keys::block_of(&key), Some(BlockAddress { x, y }));
        prop_assert_eq!(keys::map_of(&key), Some(MapId(map)));
    }

    #[test]
    fn any_bytes_open_without_a_panic(key: Vec<u8>, value: Vec<u8>) {
        let kind = key.first().copied().and_then(Kind::from_byte).unwrap_or(Kind::Block);
        prop_assert!(record::open(&key, kind, &value).is_err());
        prop_assert!(!keys::describe(&key).is_empty());
    }
}

#[test]
fn every_flipped_bit_and_every_cut_is_named() {
    let key = block_key(7, 3, 9);
    let value = record::seal(&key, 41, b"some content");
    for bit in 0..value.len() * 8 {
        let mut changed = value.clone();
        changed[bit / 8] ^= 1 << (bit % 8);
        let error = record::open(&key, Kind::Block, &changed).unwrap_err();
        assert!(matches!(&error, StoreError::Damaged { .. }), "bit {bit}: {error}");
        assert!(error.to_string().contains("map 7, block (3, 9)"), "bit {bit}: {error}");
    }
    for length in 0..value.len() {
        assert!(record::open(&key, Kind::Block, &value[..length]).is_err(), "cut to {length}");
    }
}

#[test]
fn a_record_under_another_key_is_damage() {
    let value = record::seal(&block_key(7, 3, 9), 41, b"content");
    assert!(record::open(&block_key(7, 9, 3), Kind::Block, &value).is_err());
    assert!(record::open(&block_key(8, 3, 9), Kind::Block, &value).is_err());
    assert!(record::open(&keys::of_map(Kind::State, MapId(7)), Kind::State, &value).is_err());
}

#[test]
fn a_sound_record_of_a_later_version_is_newer_not_damaged() {
    let key = block_key(7, 3, 9);
    let mut value = record::seal(&key, 41, b"content");
    value.truncate(value.len() - 4);
    value[0] = Kind::Block.version() + 1;
    let length = u32::try_from(key.len()).unwrap().to_be_bytes();
    let sum = crc32c::crc32c(&[&length[..], &key, &value].concat());
    value.extend_from_slice(&sum.to_be_bytes());
    let error = record::open(&key, Kind::Block, &value).unwrap_err();
    assert!(matches!(error, StoreError::NewerFormat { found: 3, supported: 2, .. }), "{error}");
}

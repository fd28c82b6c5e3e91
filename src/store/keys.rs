//! Keys of the store: one byte of kind, then the map's number and what is unique within it.

use super::MapId;
use crate::quadtree::BlockAddress;
use std::fmt::Write as _;

/// What a record holds: the first byte of its key and the second of its value.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
#[repr(u8)]
pub(super) enum Kind {
    /// The store's header.
    Header = 0x01,
    /// The number that the next map gets.
    NextMap = 0x02,
    /// The number of the last write.
    LastWrite = 0x03,
    /// A map's name, which leads to its number.
    Name = 0x10,
    /// A map: what never changes.
    Map = 0x11,
    /// One sensor of a map.
    Sensor = 0x12,
    /// A map's revision and how many records belong to it.
    State = 0x13,
    /// A map that is being deleted.
    Tombstone = 0x14,
    /// A robot's sequence window.
    Window = 0x20,
    /// A block.
    Block = 0x30,
    /// What is known of a group of blocks.
    Group = 0x31,
    /// A snapshot.
    Snapshot = 0x40,
    /// A block's record that a commit replaced and a snapshot needs.
    KeptBlock = 0x41,
    /// A window's record that a commit replaced and a snapshot needs.
    KeptWindow = 0x42,
    /// A map with kept records that no snapshot needs any more.
    Sweep = 0x43,
}

impl Kind {
    const ALL: [Self; 15] = [
        Self::Header,
        Self::NextMap,
        Self::LastWrite,
        Self::Name,
        Self::Map,
        Self::Sensor,
        Self::State,
        Self::Tombstone,
        Self::Window,
        Self::Block,
        Self::Group,
        Self::Snapshot,
        Self::KeptBlock,
        Self::KeptWindow,
        Self::Sweep,
    ];

    /// The version of the form in which records of this kind are written, and the newest that is read.
    pub(super) fn version(self) -> u8 {
        match self {
            Self::LastWrite | Self::State | Self::Block | Self::Group | Self::KeptBlock => 2,
            _ => 1,
        }
    }

    /// The kind of a key or record byte.
    pub(super) fn from_byte(byte: u8) -> Option<Self> {
        Self::ALL.into_iter().find(|kind| *kind as u8 == byte)
    }
}

/// Key of the store's header.
pub(super) const HEADER: [u8; 1] = [Kind::Header as u8];

/// Key of the counter of map numbers.
pub(super) const NEXT_MAP: [u8; 1] = [Kind::NextMap as u8];

/// Key of the number of the last write.
pub(super) const LAST_WRITE: [u8; 1] = [Kind::LastWrite as u8];

/// Key of a map's name.
pub(super) fn name(name: &str) -> Vec<u8> {
    let mut key = vec![Kind::Name as u8];
    key.extend_from_slice(name.as_bytes());
    key
}

/// `kind`, map: the key of the one record of this kind that a map has, or the prefix of its many.
pub(super) fn of_map(kind: Kind, id: MapId) -> Vec<u8> {
    let mut key = Vec::with_capacity(13);
    key.push(kind as u8);
    key.extend_from_slice(&id.0.to_be_bytes());
    key
}

/// Key of a sensor or window by its name.
pub(super) fn named(kind: Kind, id: MapId, name: &str) -> Vec<u8> {
    let mut key = of_map(kind, id);
    key.extend_from_slice(name.as_bytes());
    key
}

/// Key of a block: in Z-order within its map.
pub(super) fn block(id: MapId, address: BlockAddress) -> Vec<u8> {
    let mut key = of_map(Kind::Block, id);
    key.extend_from_slice(&address.morton().to_be_bytes());
    key
}

/// Key of a group of blocks by its number: in Z-order within its map.
pub(super) fn group(id: MapId, number: u64) -> Vec<u8> {
    let mut key = of_map(Kind::Group, id);
    key.extend_from_slice(&number.to_be_bytes());
    key
}

/// Key of a block's record that the commit of a revision replaced.
pub(super) fn kept_block(id: MapId, address: BlockAddress, replaced: u64) -> Vec<u8> {
    let mut key = of_map(Kind::KeptBlock, id);
    key.extend_from_slice(&address.morton().to_be_bytes());
    key.extend_from_slice(&replaced.to_be_bytes());
    key
}

/// Key of a window's record that the commit of a revision replaced. No name has the byte between.
pub(super) fn kept_window(id: MapId, robot: &str, replaced: u64) -> Vec<u8> {
    let mut key = named(Kind::KeptWindow, id, robot);
    key.push(0);
    key.extend_from_slice(&replaced.to_be_bytes());
    key
}

/// The revision that replaced a kept record.
pub(super) fn replaced_of(key: &[u8]) -> Option<u64> {
    let at = key.len().checked_sub(8).filter(|at| *at > 5)?;
    key[at..].try_into().ok().map(u64::from_be_bytes)
}

/// The block of a kept block's key.
pub(super) fn kept_block_of(key: &[u8]) -> Option<BlockAddress> {
    let code = tail(key).get(..8).filter(|_| tail(key).len() == 16)?;
    code.try_into().ok().map(|code| BlockAddress::from_morton(u64::from_be_bytes(code)))
}

/// The robot of a kept window's key.
pub(super) fn kept_robot_of(key: &[u8]) -> Option<&str> {
    let name = tail(key).get(..tail(key).len().checked_sub(9)?)?;
    std::str::from_utf8(name).ok()
}

/// The number of a group's key.
pub(super) fn group_of(key: &[u8]) -> Option<u64> {
    tail(key).try_into().ok().map(u64::from_be_bytes)
}

/// What stands behind kind and map in a key.
pub(super) fn tail(key: &[u8]) -> &[u8] {
    key.get(5..).unwrap_or_default()
}

/// The map's number in a key that has one.
pub(super) fn map_of(key: &[u8]) -> Option<MapId> {
    key.get(1..5).and_then(|id| id.try_into().ok()).map(|id| MapId(u32::from_be_bytes(id)))
}

/// The block of a block's key.
pub(super) fn block_of(key: &[u8]) -> Option<BlockAddress> {
    tail(key).try_into().ok().map(|code| BlockAddress::from_morton(u64::from_be_bytes(code)))
}

/// A key in words, for messages.
pub(super) fn describe(key: &[u8]) -> String {
    let of_map = |what: &str| match map_of(key) {
        Some(id) => format!("map {}, {what}", id.0),
        None => format!("{what} with a short key {}", hexadecimal(key)),
    };
    let text = || String::from_utf8_lossy(tail(key)).into_owned();
    match key.first().copied().and_then(Kind::from_byte) {
        None => format!("unknown key {}", hexadecimal(key)),
        Some(Kind::Header) => "the store's header".to_owned(),
        Some(Kind::NextMap) => "the counter of map numbers".to_owned(),
        Some(Kind::LastWrite) => "the number of the last write".to_owned(),
        Some(Kind::Name) => format!("the name {:?}", String::from_utf8_lossy(&key[1..])),
        Some(Kind::Map) => of_map("its configuration"),
        Some(Kind::Sensor) => of_map(&format!("sensor {:?}", text())),
        Some(Kind::State) => of_map("its revision"),
        Some(Kind::Tombstone) => of_map("its tombstone"),
        Some(Kind::Window) => of_map(&format!("sequence window of robot {:?}", text())),
        Some(Kind::Group) => match group_of(key) {
            Some(number) => of_map(&format!("group of blocks {number}")),
            None => of_map(&format!("group of blocks with a wrong key {}", hexadecimal(key))),
        },
        Some(Kind::Snapshot) => of_map(&format!("snapshot {:?}", text())),
        Some(Kind::Sweep) => of_map("its mark of what snapshots no longer need"),
        Some(Kind::KeptBlock) => match (kept_block_of(key), replaced_of(key)) {
            (Some(address), Some(replaced)) => {
                of_map(&format!("block ({}, {}) as kept from before revision {replaced}", address.x, address.y))
            }
            _ => of_map(&format!("kept block with a wrong key {}", hexadecimal(key))),
        },
        Some(Kind::KeptWindow) => match (kept_robot_of(key), replaced_of(key)) {
            (Some(robot), Some(replaced)) => {
                of_map(&format!("sequence window of robot {robot:?} as kept from before revision {replaced}"))
            }
            _ => of_map(&format!("kept window with a wrong key {}", hexadecimal(key))),
        },
        Some(Kind::Block) => match block_of(key) {
            Some(address) => of_map(&format!("block ({}, {})", address.x, address.y)),
            None => of_map(&format!("block with a wrong key {}", hexadecimal(key))),
        },
    }
}

fn hexadecimal(bytes: &[u8]) -> String {
    let mut text = String::new();
    for byte in bytes.iter().take(80) {
        // Writing to a string cannot fail.
        let _ = write!(text, "{byte:02x}");
    }
    text
}

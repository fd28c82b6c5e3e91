//! What is known of a map's blocks without reading them: one record for each group of 8 x 8 blocks.
//!
//! With it a map opens in the time that its groups take, not its blocks. A group's record is written in the commit that
//! writes any of its blocks. It repeats what the blocks' records say, so one that is damaged is made anew from them.
//!
//! A group: which of its 64 blocks have a record, and which of them are of mixed classes (u64 each; block `i` at bit `i`,
//! `i` the low six bits of its Morton code); then for each block that has a record, in ascending order, its maximum class
//! (u8), the revision that wrote it (u64) and the time of that (f64; not in version 1 of the record).

use super::block_codec::BlockCodec;
use super::bytes::{Malformed, Reader, put_f64};
use super::checks::holds;
use super::config_record::{MapRecord, decode_block};
use super::digest::Digest;
use super::keys::{self, Kind};
use super::record::{self, Record, damaged};
use super::sled_catalogue::Entry;
use super::sled_open::guarded;
use super::sled_records::Records;
use super::{BlockStamp, MapId, StoreError, StoredMap};
use crate::quadtree::{BlockAddress, BlockTag, BlockView, Class};
use std::collections::BTreeMap;

/// Bits of a Morton code that tell the blocks of a group apart.
const BITS: u32 = 6;

/// Groups that a migration writes in one batch.
const BATCH: usize = 1000;

/// What is known of a block that has a record.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Known {
    /// The revision that wrote it, and when.
    pub(super) stamp: BlockStamp,
    /// Its maximum class.
    pub(super) max: Class,
    /// Not of one class.
    pub(super) mixed: bool,
}

/// What a commit does to one block: what is known of it then, and whether it had a record before.
pub(super) struct Noted {
    pub(super) address: BlockAddress,
    pub(super) known: Known,
    pub(super) before: bool,
}

impl Known {
    pub(super) fn tag(&self, address: BlockAddress) -> BlockTag {
        BlockTag { address, revision: self.stamp.revision, max: self.max }
    }

    pub(super) fn of(view: &BlockView, stamp: BlockStamp) -> Self {
        match view {
            BlockView::Uniform(class) => Self { stamp, max: *class, mixed: false },
            BlockView::Mixed(block) => Self { stamp, max: block.max_at(0, 0, 0), mixed: true },
        }
    }

    /// A block whose record is damaged: it may hold anything, and reading it tells the damage.
    fn unreadable(highest: Class, value: &[u8]) -> Self {
        let stamp = BlockStamp { revision: record::revision_of(value), changed: 0.0 };
        Self { stamp, max: highest, mixed: true }
    }
}

/// The blocks of one group that have a record, by the low bits of their Morton codes.
#[derive(Debug, Clone, PartialEq, Default)]
pub(super) struct Group(BTreeMap<u8, Known>);

/// The group of a block.
pub(super) fn group_of(address: BlockAddress) -> u64 {
    address.morton() >> BITS
}

fn place(address: BlockAddress) -> u8 {
    (address.morton() & ((1 << BITS) - 1)) as u8
}

impl Group {
    pub(super) fn encode(&self) -> Vec<u8> {
        let bits = |chosen: &dyn Fn(&Known) -> bool| {
            self.0.iter().filter(|(_, known)| chosen(known)).fold(0_u64, |bits, (place, _)| bits | 1 << place)
        };
        let mut out = Vec::with_capacity(16 + 17 * self.0.len());
        out.extend_from_slice(&bits(&|_| true).to_be_bytes());
        out.extend_from_slice(&bits(&|known| known.mixed).to_be_bytes());
        for known in self.0.values() {
            out.push(known.max);
            out.extend_from_slice(&known.stamp.revision.to_be_bytes());
            put_f64(&mut out, known.stamp.changed);
        }
        out
    }

    pub(super) fn decode(record: &Record<'_>) -> Result<Self, Malformed> {
        let mut reader = Reader::new(record.content);
        let (present, mixed) = (reader.u64("blocks")?, reader.u64("mixed blocks")?);
        if present == 0 || mixed & !present != 0 {
            return Err(Malformed::new("a group without blocks, or a mixed block that is none of the group's"));
        }
        let mut blocks = BTreeMap::new();
        for place in (0..64_u8).filter(|place| present >> place & 1 == 1) {
            let max = reader.u8("maximum class")?;
            let revision = reader.u64("revision")?;
            let changed = if record.version > 1 { reader.f64("time of the last change")? } else { 0.0 };
            let stamp = BlockStamp { revision, changed };
            blocks.insert(place, Known { stamp, max, mixed: mixed >> place & 1 == 1 });
        }
        reader.end()?;
        Ok(Self(blocks))
    }

    fn has(&self, address: BlockAddress) -> bool {
        self.0.contains_key(&place(address))
    }

    /// Notes a block's new record.
    pub(super) fn note(&mut self, address: BlockAddress, known: Known) {
        self.0.insert(place(address), known);
    }

    /// The blocks of this group, which has this number.
    fn blocks(&self, number: u64) -> impl Iterator<Item = (BlockAddress, Known)> + '_ {
        let address = move |place: u8| BlockAddress::from_morton(number << BITS | u64::from(place));
        self.0.iter().map(move |(place, known)| (address(*place), *known))
    }

    /// The group as its blocks' records tell it.
    fn of_blocks(tree: &sled::Tree, id: MapId, number: u64, codec: &BlockCodec) -> Result<Self, StoreError> {
        let mut group = Self::default();
        let (first, last) = (number << BITS, number << BITS | ((1 << BITS) - 1));
        let [from, to] = [first, last].map(|code| keys::block(id, BlockAddress::from_morton(code)));
        let mut records = tree.range(from..=to);
        while let Some((key, value)) = guarded("reading blocks", || records.next().transpose())? {
            group.note_record(&key, &value, codec);
        }
        Ok(group)
    }

    fn note_record(&mut self, key: &[u8], value: &[u8], codec: &BlockCodec) {
        let Some(address) = keys::block_of(key) else { return };
        let read = || {
            let record = record::open(key, Kind::Block, value).ok()?;
            let (changed, view) = decode_block(codec, &record).ok()?;
            Some(Known::of(&view, BlockStamp { revision: record.revision, changed }))
        };
        self.note(address, read().unwrap_or_else(|| Known::unreadable(codec.highest(), value)));
    }
}

/// A record before it is framed.
type KeyAndContent = (Vec<u8>, Vec<u8>);

impl Records {
    /// Key and content of the groups of a commit's blocks as they are after it.
    pub(super) fn groups_after(
        &self,
        id: MapId,
        noted: &[Noted],
        codec: &BlockCodec,
    ) -> Result<Vec<KeyAndContent>, StoreError> {
        let mut groups: BTreeMap<u64, Vec<&Noted>> = BTreeMap::new();
        for noted in noted {
            groups.entry(group_of(noted.address)).or_default().push(noted);
        }
        let after = |(number, noted): (u64, Vec<&Noted>)| {
            let key = keys::group(id, number);
            let stored = self.get(&key)?.map(|value| open_group(&key, &value));
            let mut group = match stored {
                Some(Ok(group)) if noted.iter().all(|noted| group.has(noted.address) == noted.before) => group,
                None if noted.iter().all(|noted| !noted.before) => Group::default(),
                Some(Err(newer @ StoreError::NewerFormat { .. })) => return Err(newer),
                _ => {
                    tracing::warn!("{}: made anew from its blocks", keys::describe(&key));
                    Group::of_blocks(&self.db(), id, number, codec)?
                }
            };
            noted.iter().for_each(|noted| group.note(noted.address, noted.known));
            Ok((key, group.encode()))
        };
        groups.into_iter().map(after).collect()
    }

    /// What is known of a map's blocks, in Z-order: what its groups tell, or, where they do not tell of all, what the
    /// blocks do. The map must be held.
    pub(super) fn known_blocks(&self, entry: &Entry) -> Result<Vec<(BlockAddress, Known)>, StoreError> {
        let known = self.read_groups(entry)?;
        if known.len() as u64 == entry.counts.blocks && digest_of(&known) == entry.counts.block_digest {
            return Ok(known);
        }
        tracing::warn!(
            map = entry.stored.id.0,
            "its groups of blocks do not tell of all blocks as they are: each block is read instead"
        );
        let known = self.read_blocks(entry, &mut |_, _| ())?;
        entry.check_blocks(&known)?;
        Ok(known)
    }

    /// What a map's groups tell of its blocks. A group that cannot be right is made anew from its blocks.
    fn read_groups(&self, entry: &Entry) -> Result<Vec<(BlockAddress, Known)>, StoreError> {
        let StoredMap { id, config, revision, .. } = &entry.stored;
        let mut known = Vec::new();
        self.scan(&keys::of_map(Kind::Group, *id), &mut |key, value| {
            let Some(number) = keys::group_of(key) else { return Ok(()) };
            let sound = |(address, known): &(BlockAddress, Known)| {
                let classes = 1..=config.scale().count();
                holds(config.grid(), *address) && known.stamp.revision <= *revision && classes.contains(&known.max)
            };
            match open_group(key, value) {
                Ok(group) if group.blocks(number).all(|block| sound(&block)) => known.extend(group.blocks(number)),
                Err(newer @ StoreError::NewerFormat { .. }) => return Err(newer),
                _ => {
                    tracing::warn!("{}: made anew from its blocks", keys::describe(key));
                    let group = Group::of_blocks(&self.db(), *id, number, &entry.codec())?;
                    known.extend(group.blocks(number).filter(sound));
                }
            }
            Ok(())
        })?;
        Ok(known)
    }

    /// Holds a map's groups against its blocks. The map must be held.
    pub(super) fn check_groups(&self, entry: &Entry, blocks: &[(BlockAddress, Known)]) -> Result<(), StoreError> {
        let mut expected: BTreeMap<u64, Group> = BTreeMap::new();
        for (address, known) in blocks {
            expected.entry(group_of(*address)).or_default().note(*address, *known);
        }
        self.scan(&keys::of_map(Kind::Group, entry.stored.id), &mut |key, value| {
            let group = open_group(key, value)?;
            match keys::group_of(key).and_then(|number| expected.remove(&number)) {
                Some(expected) if expected == group => Ok(()),
                _ => Err(damaged(key, "it tells of other blocks than there are")),
            }
        })?;
        match expected.first_key_value() {
            Some((number, _)) => Err(damaged(&keys::group(entry.stored.id, *number), "missing")),
            None => Ok(()),
        }
    }
}

fn digest_of(known: &[(BlockAddress, Known)]) -> Digest {
    let mut digest = Digest::default();
    known.iter().for_each(|(address, known)| digest.toggle_block(*address, known.stamp.revision));
    digest
}

impl Entry {
    /// Holds all of a map's blocks against its state.
    pub(super) fn check_blocks(&self, known: &[(BlockAddress, Known)]) -> Result<(), StoreError> {
        let (found, expected) = (known.len() as u64, self.counts.blocks);
        let key = keys::of_map(Kind::State, self.stored.id);
        if found != expected {
            return Err(damaged(&key, &format!("{found} blocks found of {expected}")));
        }
        if digest_of(known) != self.counts.block_digest {
            let why = format!("some of its blocks are older than its revision, {}", self.stored.revision);
            return Err(damaged(&key, &why));
        }
        Ok(())
    }
}

/// A group's record, read.
pub(super) fn open_group(key: &[u8], value: &[u8]) -> Result<Group, StoreError> {
    let record = record::open(key, Kind::Group, value)?;
    Group::decode(&record).map_err(|why| damaged(key, &why.to_string()))
}

/// Version 1 to 2: the groups of every map, from its blocks. A map that cannot be read is passed over.
pub(super) fn write_groups(tree: &sled::Tree) -> Result<(), StoreError> {
    let prefix = [Kind::Map as u8];
    let mut maps = tree.scan_prefix(prefix);
    while let Some((key, value)) = guarded("reading maps", || maps.next().transpose())? {
        let map = record::open(&key, Kind::Map, &value).ok().and_then(|record| MapRecord::decode(record.content).ok());
        if let (Some(id), Some(map)) = (keys::map_of(&key), map) {
            write_groups_of(tree, id, &map.fixed.codec())?;
        }
    }
    Ok(())
}

fn write_groups_of(tree: &sled::Tree, id: MapId, codec: &BlockCodec) -> Result<(), StoreError> {
    let mut batch = Vec::new();
    let mut open: Option<(u64, Group)> = None;
    let close = |open: Option<(u64, Group)>, batch: &mut Vec<(Vec<u8>, Vec<u8>)>| {
        let Some((number, group)) = open else { return };
        let key = keys::group(id, number);
        // As of no revision of its own: what it says was written before.
        let value = record::seal(&key, 0, &group.encode());
        batch.push((key, value));
    };
    let mut blocks = tree.scan_prefix(keys::of_map(Kind::Block, id));
    while let Some((key, value)) = guarded("reading blocks", || blocks.next().transpose())? {
        let Some(number) = keys::block_of(&key).map(group_of) else { continue };
        if open.as_ref().is_none_or(|(current, _)| *current != number) {
            close(open.replace((number, Group::default())), &mut batch);
        }
        if let Some((_, group)) = &mut open {
            group.note_record(&key, &value, codec);
        }
        if batch.len() >= BATCH {
            write(tree, &mut batch)?;
        }
    }
    close(open, &mut batch);
    write(tree, &mut batch)
}

fn write(tree: &sled::Tree, records: &mut Vec<(Vec<u8>, Vec<u8>)>) -> Result<(), StoreError> {
    let mut batch = sled::Batch::default();
    for (key, value) in records.drain(..) {
        batch.insert(key, value);
    }
    guarded("writing groups of blocks", || tree.apply_batch(batch))
}

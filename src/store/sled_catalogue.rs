//! What a store on disk holds: read once when it is opened, and checked record by record on demand.

use super::block_codec::BlockCodec;
use super::bytes::{Malformed, Reader};
use super::config_record::{Counts, MapRecord, SnapshotRecord, decode_block, decode_sensor, decode_window};
use super::digest::Digest;
use super::groups::open_group;
use super::keys::{self, Kind};
use super::record::{self, Record, damaged};
use super::sled_open::{Database, guarded};
use super::{
    DamagedMap, MapId, MapName, RobotName, SequenceWindow, SnapshotName, StoreError, StoredMap, StoredSnapshot,
};
use crate::mapping::is_name;
use std::collections::BTreeMap;
use std::sync::{Arc, Mutex};

/// A map at its last durable revision.
#[derive(Debug, Clone)]
pub(super) struct Entry {
    pub(super) stored: StoredMap,
    pub(super) counts: Counts,
    /// By name.
    pub(super) snapshots: Arc<BTreeMap<SnapshotName, Snapshot>>,
    /// Held by whoever reads or changes the map's records.
    pub(super) busy: Arc<Mutex<()>>,
}

/// A snapshot whose record is sound.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Snapshot {
    pub(super) stored: StoredSnapshot,
    pub(super) record: SnapshotRecord,
}

impl Entry {
    /// A map that was just made.
    pub(super) fn new(stored: StoredMap, counts: Counts) -> Self {
        Self { stored, counts, snapshots: Arc::default(), busy: Arc::default() }
    }

    /// The revision of the last snapshot: what was written up to it must be kept when it is replaced.
    pub(super) fn newest_snapshot(&self) -> Option<u64> {
        self.snapshots.values().map(|snapshot| snapshot.stored.revision).max()
    }

    /// How the map's blocks are written.
    pub(super) fn codec(&self) -> BlockCodec {
        BlockCodec::new(self.stored.config.grid().depth(), self.stored.config.scale())
    }
}

/// All maps of a store.
#[derive(Debug, Default)]
pub(super) struct Catalogue {
    pub(super) maps: BTreeMap<MapId, Entry>,
    pub(super) damaged: Vec<DamagedMap>,
}

impl Catalogue {
    /// The map of a name, or why it cannot be read.
    pub(super) fn find(&self, name: &MapName) -> Option<Result<MapId, &DamagedMap>> {
        let sound = self.maps.values().find(|entry| entry.stored.name == *name).map(|entry| Ok(entry.stored.id));
        sound.or_else(|| self.damaged.iter().find(|damaged| damaged.name.as_ref() == Some(name)).map(Err))
    }

    /// Reads every map's configuration and revision. What is damaged in one map is noted and does not stop the others.
    pub(super) fn read(db: &Database) -> Result<Self, StoreError> {
        let mut catalogue = Self::default();
        let names: Vec<_> =
            guarded("reading the names of maps", || db.scan_prefix([Kind::Name as u8]).collect::<Result<_, _>>())?;
        for (key, value) in names {
            let mut found = DamagedMap { id: None, name: None, what: String::new() };
            match read_entry(db, &key, &value, &mut found) {
                Ok(entry) => {
                    catalogue.maps.insert(entry.stored.id, entry);
                }
                Err(error) => {
                    found.what = error.to_string();
                    tracing::error!(
                        map = found.name.as_ref().map(MapName::as_str),
                        "map left out, it cannot be read: {}",
                        found.what
                    );
                    catalogue.damaged.push(found);
                }
            }
        }
        Ok(catalogue)
    }
}

/// The content of a record, decoded; what is wrong is named by the key.
fn content<T>(
    key: &[u8],
    kind: Kind,
    value: &[u8],
    decode: impl FnOnce(&[u8]) -> Result<T, Malformed>,
) -> Result<T, StoreError> {
    decode(record::open(key, kind, value)?.content).map_err(|why| damaged(key, &why.to_string()))
}

fn number(content: &[u8]) -> Result<u32, Malformed> {
    let mut reader = Reader::new(content);
    let number = reader.u32("number")?;
    reader.end()?;
    Ok(number)
}

/// The number that the next map gets.
pub(super) fn next_map(db: &Database) -> Result<u32, StoreError> {
    let value = guarded("reading the counter of map numbers", || db.get(keys::NEXT_MAP))?
        .ok_or_else(|| damaged(&keys::NEXT_MAP, "missing"))?;
    content(&keys::NEXT_MAP, Kind::NextMap, &value, number)
}

fn name_of(key: &[u8]) -> Result<MapName, StoreError> {
    let name = std::str::from_utf8(key.get(1..).unwrap_or_default()).ok().and_then(|name| MapName::new(name).ok());
    name.ok_or_else(|| damaged(key, "not a name"))
}

fn read_entry(db: &Database, key: &[u8], value: &[u8], found: &mut DamagedMap) -> Result<Entry, StoreError> {
    let name = name_of(key)?;
    found.name = Some(name.clone());
    let id = MapId(content(key, Kind::Name, value, number)?);
    found.id = Some(id);

    let get = |kind: Kind| {
        let key = keys::of_map(kind, id);
        let value = guarded("reading a map", || db.get(&key))?.ok_or_else(|| damaged(&key, "missing"))?;
        Ok::<_, StoreError>((key, value))
    };
    let (key, value) = get(Kind::Map)?;
    let map = content(&key, Kind::Map, &value, MapRecord::decode)?;
    if map.name != name {
        return Err(damaged(&key, &format!("it is called {}, but {name} leads to it", map.name)));
    }
    let (state_key, value) = get(Kind::State)?;
    let state = record::open(&state_key, Kind::State, &value)?;
    let counts = Counts::decode(&state).map_err(|why| damaged(&state_key, &why.to_string()))?;

    let mut sensors = BTreeMap::new();
    let prefix = keys::of_map(Kind::Sensor, id);
    let records: Vec<_> = guarded("reading sensors", || db.scan_prefix(&prefix).collect::<Result<_, _>>())?;
    for (key, value) in &records {
        let (name, sensor) = read_sensor(key, value)?;
        sensors.insert(name, sensor);
    }
    if sensors.len() as u64 != counts.sensors {
        return Err(damaged(&key, &format!("{} sensors found of {}", sensors.len(), counts.sensors)));
    }
    if Digest::of_records(records.iter().map(|(_, value)| value.as_ref())) != counts.sensor_digest {
        return Err(damaged(&state_key, "some of its sensors are older than what it says"));
    }
    let config = map.fixed.with_sensors(sensors).map_err(|why| damaged(&key, &why.to_string()))?;
    let stored = StoredMap { id, name, config, revision: state.revision, created: map.created };
    let snapshots = read_snapshots(db, &stored)?;
    Ok(Entry { snapshots: Arc::new(snapshots), ..Entry::new(stored, counts) })
}

/// The snapshots of a map. One that is damaged is left out, and does not keep the map from being served.
fn read_snapshots(db: &Database, map: &StoredMap) -> Result<BTreeMap<SnapshotName, Snapshot>, StoreError> {
    let mut snapshots = BTreeMap::new();
    let mut records = db.scan_prefix(keys::of_map(Kind::Snapshot, map.id));
    while let Some((key, value)) = guarded("reading snapshots", || records.next().transpose())? {
        match read_snapshot(&key, &value, map.revision) {
            Ok(snapshot) => {
                snapshots.insert(snapshot.stored.name.clone(), snapshot);
            }
            Err(newer @ StoreError::NewerFormat { .. }) => return Err(newer),
            Err(error) => tracing::error!(map = map.name.as_str(), "snapshot left out, it cannot be read: {error}"),
        }
    }
    Ok(snapshots)
}

fn read_snapshot(key: &[u8], value: &[u8], revision: u64) -> Result<Snapshot, StoreError> {
    let name = std::str::from_utf8(keys::tail(key)).ok().and_then(|name| SnapshotName::new(name).ok());
    let name = name.ok_or_else(|| damaged(key, "not a snapshot's name"))?;
    let framed = record::open(key, Kind::Snapshot, value)?;
    not_later(key, &framed, revision)?;
    let record = SnapshotRecord::decode(framed.content).map_err(|why| damaged(key, &why.to_string()))?;
    Ok(Snapshot { stored: StoredSnapshot { name, revision: framed.revision, created: record.created }, record })
}

fn read_sensor(key: &[u8], value: &[u8]) -> Result<(String, crate::sensor::SensorModel), StoreError> {
    let name = std::str::from_utf8(keys::tail(key)).ok().filter(|name| is_name(name));
    let name = name.ok_or_else(|| damaged(key, "not a name"))?;
    let sensor = content(key, Kind::Sensor, value, |content| {
        let mut reader = Reader::new(content);
        let sensor = decode_sensor(&mut reader)?;
        reader.end()?;
        Ok(sensor)
    })?;
    Ok((name.to_owned(), sensor))
}

/// The number of the last write, and the digest of the states of all maps; none where the record's form has none.
pub(super) fn last_write_of(value: &[u8]) -> Result<(u64, Option<Digest>), StoreError> {
    let record = record::open(&keys::LAST_WRITE, Kind::LastWrite, value)?;
    let read = || {
        let mut reader = Reader::new(record.content);
        let number = reader.u64("number")?;
        let states = if record.version > 1 { Some(Digest(reader.u64("digest of states")?)) } else { None };
        reader.end()?;
        Ok::<_, Malformed>((number, states))
    };
    read().map_err(|why| damaged(&keys::LAST_WRITE, &why.to_string()))
}

/// The digest of the states of all maps; none where one of them is damaged, which is told by itself.
pub(super) fn states_of(db: &Database) -> Result<Option<Digest>, StoreError> {
    let mut digest = Digest::default();
    let mut names = db.scan_prefix([Kind::Name as u8]);
    while let Some((key, value)) = guarded("reading the names of maps", || names.next().transpose())? {
        let state = content(&key, Kind::Name, &value, number).map(|id| keys::of_map(Kind::State, MapId(id)));
        let Ok(state) = state else { return Ok(None) };
        match guarded("reading a map's state", || db.get(&state))? {
            Some(value) if record::open(&state, Kind::State, &value).is_ok() => digest.toggle_record(&value),
            _ => return Ok(None),
        }
    }
    Ok(Some(digest))
}

/// A record that belongs to a revision may not be of a later one.
pub(super) fn not_later(key: &[u8], record: &Record<'_>, revision: u64) -> Result<(), StoreError> {
    if record.revision <= revision {
        return Ok(());
    }
    Err(damaged(key, &format!("of revision {}, but the map's is {revision}", record.revision)))
}

/// A robot's window out of its record.
pub(super) fn read_window(key: &[u8], value: &[u8], revision: u64) -> Result<(RobotName, StoredWindow), StoreError> {
    let name = std::str::from_utf8(keys::tail(key)).ok().and_then(|name| RobotName::new(name).ok());
    let name = name.ok_or_else(|| damaged(key, "not a robot's name"))?;
    let window = open_window(key, Kind::Window, value)?;
    if window.revision > revision {
        return Err(damaged(key, &format!("of revision {}, but the map's is {revision}", window.revision)));
    }
    Ok((name, window))
}

/// A window as its record tells it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct StoredWindow {
    /// The revision that wrote it.
    pub(super) revision: u64,
    pub(super) window: SequenceWindow,
}

/// A window out of its record, or of one that is kept.
pub(super) fn open_window(key: &[u8], kind: Kind, value: &[u8]) -> Result<StoredWindow, StoreError> {
    let record = record::open(key, kind, value)?;
    let mut reader = Reader::new(record.content);
    let window = decode_window(&mut reader).and_then(|window| reader.end().map(|()| window));
    let window = window.map_err(|why| damaged(key, &why.to_string()))?;
    Ok(StoredWindow { revision: record.revision, window })
}

/// What a check of every record found.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Verification {
    /// Maps that can be listed.
    pub maps: u64,
    /// Records looked at.
    pub records: u64,
    /// Bytes of their keys and values.
    pub bytes: u64,
    /// What is wrong, each with its map and record.
    pub problems: Vec<String>,
}

/// Checks one record by itself.
pub(super) fn check_record(key: &[u8], value: &[u8], codec: Option<&BlockCodec>) -> Result<(), StoreError> {
    let kind = key.first().copied().and_then(Kind::from_byte).ok_or_else(|| damaged(key, "unknown kind"))?;
    match kind {
        Kind::Header => content(key, kind, value, super::config_record::Header::format_of).map(|_| ()),
        Kind::NextMap => content(key, kind, value, number).map(|_| ()),
        Kind::LastWrite => last_write_of(value).map(|_| ()),
        Kind::Name => name_of(key).and_then(|_| content(key, kind, value, number)).map(|_| ()),
        Kind::Map => content(key, kind, value, MapRecord::decode).map(|_| ()),
        Kind::Sensor => read_sensor(key, value).map(|_| ()),
        Kind::State => {
            let record = record::open(key, kind, value)?;
            Counts::decode(&record).map(|_| ()).map_err(|why| damaged(key, &why.to_string()))
        }
        Kind::Snapshot => read_snapshot(key, value, u64::MAX).map(|_| ()),
        Kind::Sweep => content(key, kind, value, |_| Ok(())),
        Kind::KeptWindow => open_window(key, kind, value).map(|_| ()),
        Kind::Tombstone => content(key, kind, value, |_| Ok(())),
        Kind::Window => read_window(key, value, u64::MAX).map(|_| ()),
        Kind::Group => open_group(key, value).map(|_| ()),
        Kind::Block | Kind::KeptBlock => {
            let record = record::open(key, kind, value)?;
            let decoded = codec.map_or(Ok(()), |codec| decode_block(codec, &record).map(|_| ()));
            decoded.map_err(|why| damaged(key, &why.to_string()))
        }
    }
}

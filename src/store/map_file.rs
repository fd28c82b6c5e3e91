//! The `.ubbmap` file: one map in one file, compressed as one stream, under checksums throughout.
//!
//! | bytes | what |
//! | --- | --- |
//! | 0..8 | `89 55 42 42 4D 41 50 0A`, "\x89UBBMAP\n" |
//! | 8..12 | version, 1 |
//! | 12..20 | length `n` of the compressed payload |
//! | 20..24 | CRC32C of the compressed payload |
//! | 24..32 | length of the payload |
//! | 32..36 | CRC32C of the payload |
//! | 36..40 | CRC32C of bytes 0..36 |
//! | 40..40+n | the payload as one zstd frame; nothing follows |
//!
//! Payload: configuration (35 bytes); sensors: count (u16), each name and sensor; revision (u64); windows: count (u32),
//! each name and window; blocks: count (u64), each its Morton code less the one before (LEB128; the first as it is),
//! length (LEB128) and bits. Sensors, robots and blocks are in ascending order.

use super::block_codec::{BlockCodec, MAX_ENCODED};
use super::bytes::{Malformed, Reader, put_name};
use super::checks::holds;
use super::config_record::{FixedConfig, decode_sensor, decode_window, encode_sensor, encode_window};
use super::{LoadedMap, RobotName, SequenceWindow};
use crate::mapping::{MapConfig, is_name};
use crate::quadtree::{BlockAddress, BlockView, OccupancyTree};
use std::collections::BTreeMap;
use std::io::{self, Read, Write};
use thiserror::Error;

/// What every map file begins with.
pub const MAP_FILE_MAGIC: [u8; 8] = *b"\x89UBBMAP\n";

/// The version of map files that this program writes, and the newest that it reads.
const FILE_VERSION: u32 = 1;

const HEADER: usize = 40;

/// zstd's level: a map of a megabyte takes tens of milliseconds.
const LEVEL: i32 = 9;

/// zstd's window is held to 2^27 bytes, 128 MiB.
const WINDOW_LOG: u32 = 27;

/// Bytes of a window: see [`encode_window`].
const WINDOW_BYTES: usize = 145;

/// How large a map file may be: a small file can hold a map too large for memory.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct MapFileLimits {
    /// Bytes of the compressed payload.
    pub file_bytes: u64,
    /// Bytes of the payload.
    pub payload_bytes: u64,
    /// Blocks of one class.
    pub uniform_blocks: u64,
    /// Blocks of several classes, 5.5 KB of memory each.
    pub mixed_blocks: u64,
    /// Robots with a sequence window.
    pub windows: u64,
}

impl Default for MapFileLimits {
    /// 256 MiB of file, 1 GiB of payload, 4 million blocks of one class, 2^18 mixed ones (10 square kilometres at a
    /// resolution of 0.1 m; 1.4 GB of memory), 2^18 robots.
    fn default() -> Self {
        Self {
            file_bytes: 256 << 20,
            payload_bytes: 1 << 30,
            uniform_blocks: 4_000_000,
            mixed_blocks: 1 << 18,
            windows: 1 << 18,
        }
    }
}

/// Why a map file cannot be written or read.
#[derive(Debug, Error)]
pub enum MapFileError {
    /// It does not begin as a map file does.
    #[error("not a map file: it does not begin with the mark of a .ubbmap file")]
    NotAMapFile,
    /// Written by a newer version.
    #[error("the map file has format version {found}, this program reads up to {supported}")]
    NewerFormat {
        /// Its version.
        found: u32,
        /// The newest version known.
        supported: u32,
    },
    /// Cut, changed or never right.
    #[error("the map file is damaged: {0}")]
    Damaged(String),
    /// Beyond a limit.
    #[error("the map file is too large: {what} {found}, the limit is {limit}")]
    TooLarge {
        /// What is too large or too many.
        what: &'static str,
        /// How large.
        found: u64,
        /// The limit.
        limit: u64,
    },
    /// Reading or writing failed.
    #[error("map file: {0}")]
    Io(#[from] io::Error),
}

impl From<Malformed> for MapFileError {
    fn from(malformed: Malformed) -> Self {
        Self::Damaged(malformed.0)
    }
}

fn within(what: &'static str, found: u64, limit: u64) -> Result<(), MapFileError> {
    if found <= limit { Ok(()) } else { Err(MapFileError::TooLarge { what, found, limit }) }
}

/// Writes a map. The same map gives the same bytes.
///
/// # Errors
/// [`MapFileError::Io`], and [`MapFileError::TooLarge`] when [`read_map_file`] would refuse what would be written;
/// nothing is written then.
pub fn write_map_file(out: &mut impl Write, config: &MapConfig, map: &LoadedMap) -> Result<(), MapFileError> {
    let limits = MapFileLimits::default();
    let mut payload = Vec::new();
    FixedConfig::of(config).encode(&mut payload);
    let sensors = u16::try_from(config.sensors().len()).map_err(|_| Malformed::new("too many sensors"))?;
    payload.extend_from_slice(&sensors.to_be_bytes());
    for (name, sensor) in config.sensors() {
        put_name(&mut payload, name);
        encode_sensor(sensor, &mut payload);
    }
    payload.extend_from_slice(&map.revision.to_be_bytes());
    within("robots", map.windows.len() as u64, limits.windows)?;
    payload.extend_from_slice(&u32::try_from(map.windows.len()).unwrap_or(u32::MAX).to_be_bytes());
    for (robot, window) in &map.windows {
        put_name(&mut payload, robot.as_str());
        encode_window(window, &mut payload);
    }
    encode_blocks(&map.tree, &limits, &mut payload)?;
    within("payload bytes", payload.len() as u64, limits.payload_bytes)?;
    let compressed = zstd::bulk::compress(&payload, LEVEL)?;
    within("bytes", compressed.len() as u64, limits.file_bytes)?;

    let mut header = Vec::with_capacity(HEADER);
    header.extend_from_slice(&MAP_FILE_MAGIC);
    header.extend_from_slice(&FILE_VERSION.to_be_bytes());
    header.extend_from_slice(&(compressed.len() as u64).to_be_bytes());
    header.extend_from_slice(&crc32c::crc32c(&compressed).to_be_bytes());
    header.extend_from_slice(&(payload.len() as u64).to_be_bytes());
    header.extend_from_slice(&crc32c::crc32c(&payload).to_be_bytes());
    header.extend_from_slice(&crc32c::crc32c(&header).to_be_bytes());
    out.write_all(&header)?;
    out.write_all(&compressed)?;
    Ok(out.flush()?)
}

fn encode_blocks(tree: &OccupancyTree, limits: &MapFileLimits, payload: &mut Vec<u8>) -> Result<(), MapFileError> {
    let codec = BlockCodec::new(tree.depth(), tree.scale());
    let mut entries = Vec::new();
    let mut bits = Vec::new();
    let mut last = 0;
    let (mut uniform, mut mixed) = (0_u64, 0_u64);
    let mut failed = None;
    tree.visit_blocks(&mut |address, view| {
        match view {
            BlockView::Uniform(_) => uniform += 1,
            BlockView::Mixed(_) => mixed += 1,
        }
        if failed.is_some() || uniform > limits.uniform_blocks || mixed > limits.mixed_blocks {
            return;
        }
        bits.clear();
        failed = codec.encode(view, &mut bits).err();
        put_varint(&mut entries, address.morton() - last);
        last = address.morton();
        put_varint(&mut entries, bits.len() as u64);
        entries.extend_from_slice(&bits);
    });
    within("blocks of one class", uniform, limits.uniform_blocks)?;
    within("mixed blocks", mixed, limits.mixed_blocks)?;
    if let Some(malformed) = failed {
        return Err(malformed.into());
    }
    payload.extend_from_slice(&(uniform + mixed).to_be_bytes());
    payload.extend_from_slice(&entries);
    Ok(())
}

fn put_varint(out: &mut Vec<u8>, mut value: u64) {
    while value >= 0x80 {
        out.push(value as u8 | 0x80);
        value >>= 7;
    }
    out.push(value as u8);
}

/// Reads a map file within [`MapFileLimits::default`].
///
/// # Errors
/// [`MapFileError`]: a file that was cut or changed anywhere is refused, with the reason.
pub fn read_map_file(input: &mut impl Read) -> Result<(MapConfig, LoadedMap), MapFileError> {
    read_map_file_within(input, &MapFileLimits::default())
}

/// Reads a map file within limits.
///
/// # Errors
/// As [`read_map_file`].
pub fn read_map_file_within(
    input: &mut impl Read,
    limits: &MapFileLimits,
) -> Result<(MapConfig, LoadedMap), MapFileError> {
    let mut header = Vec::with_capacity(HEADER);
    input.by_ref().take(HEADER as u64).read_to_end(&mut header)?;
    if !header.starts_with(&MAP_FILE_MAGIC) {
        return Err(MapFileError::NotAMapFile);
    }
    if header.len() < HEADER {
        return Err(MapFileError::Damaged(format!("it ends after {} bytes, within its header", header.len())));
    }
    let mut fields = Reader::new(&header[MAP_FILE_MAGIC.len()..]);
    let version = fields.u32("version")?;
    let compressed_length = fields.u64("compressed length")?;
    let compressed_sum = fields.u32("compressed checksum")?;
    let payload_length = fields.u64("payload length")?;
    let payload_sum = fields.u32("payload checksum")?;
    if fields.u32("header checksum")? != crc32c::crc32c(&header[..HEADER - 4]) {
        return Err(MapFileError::Damaged("wrong checksum of its header".to_owned()));
    }
    if version > FILE_VERSION {
        return Err(MapFileError::NewerFormat { found: version, supported: FILE_VERSION });
    }
    if version == 0 {
        return Err(MapFileError::Damaged("version 0".to_owned()));
    }
    within("bytes", compressed_length, limits.file_bytes)?;
    within("payload bytes", payload_length, limits.payload_bytes)?;

    let mut compressed = Vec::new();
    // One byte more than there should be tells whether something follows.
    input.by_ref().take(compressed_length + 1).read_to_end(&mut compressed)?;
    if compressed.len() as u64 != compressed_length {
        let found = compressed.len() as u64;
        return Err(MapFileError::Damaged(if found < compressed_length {
            format!("it is cut: {found} of {compressed_length} bytes follow its header")
        } else {
            "something follows its end".to_owned()
        }));
    }
    if crc32c::crc32c(&compressed) != compressed_sum {
        return Err(MapFileError::Damaged("wrong checksum of its compressed payload".to_owned()));
    }
    let mut decoder = zstd::stream::read::Decoder::with_buffer(compressed.as_slice())?.single_frame();
    decoder.window_log_max(WINDOW_LOG)?;
    let mut payload = Payload { input: io::BufReader::new(decoder), left: payload_length, sum: 0, buffer: Vec::new() };
    let map = read_payload(&mut payload, limits)?;
    let Payload { mut input, left, sum, .. } = payload;
    if left != 0 || input.read(&mut [0])? != 0 {
        return Err(MapFileError::Damaged("its payload is longer than its parts".to_owned()));
    }
    if sum != payload_sum {
        return Err(MapFileError::Damaged("wrong checksum of its payload".to_owned()));
    }
    Ok(map)
}

/// The payload as it is unpacked: never more of it than its length in memory.
struct Payload<R> {
    input: R,
    left: u64,
    sum: u32,
    buffer: Vec<u8>,
}

impl<R: Read> Payload<R> {
    /// The next bytes; `count` is small, whatever the file says.
    fn take(&mut self, count: usize) -> Result<&[u8], MapFileError> {
        if count as u64 > self.left {
            return Err(MapFileError::Damaged("its payload ends within a part".to_owned()));
        }
        self.buffer.resize(count, 0);
        self.input
            .read_exact(&mut self.buffer)
            .map_err(|error| MapFileError::Damaged(format!("its payload cannot be unpacked: {error}")))?;
        self.left -= count as u64;
        self.sum = crc32c::crc32c_append(self.sum, &self.buffer);
        Ok(&self.buffer)
    }

    fn array<const N: usize>(&mut self) -> Result<[u8; N], MapFileError> {
        let mut array = [0; N];
        array.copy_from_slice(self.take(N)?);
        Ok(array)
    }

    fn name(&mut self) -> Result<String, MapFileError> {
        let [length] = self.array()?;
        let name = String::from_utf8(self.take(usize::from(length))?.to_vec());
        name.map_err(|_| MapFileError::Damaged("a name is not UTF-8".to_owned()))
    }

    fn varint(&mut self) -> Result<u64, MapFileError> {
        let mut value = 0_u64;
        for shift in (0..64).step_by(7) {
            let [byte] = self.array()?;
            let part = u64::from(byte & 0x7f);
            if part << shift >> shift != part || (byte == 0 && shift > 0) {
                break;
            }
            value |= part << shift;
            if byte < 0x80 {
                return Ok(value);
            }
        }
        Err(MapFileError::Damaged("a number that is too long".to_owned()))
    }
}

fn read_payload<R: Read>(
    payload: &mut Payload<R>,
    limits: &MapFileLimits,
) -> Result<(MapConfig, LoadedMap), MapFileError> {
    let fixed = payload.array::<35>()?;
    let fixed = FixedConfig::decode(&mut Reader::new(&fixed))?;
    let mut sensors = BTreeMap::new();
    for _ in 0..u16::from_be_bytes(payload.array()?) {
        let name = payload.name()?;
        let mut sensor = payload.take(81)?.to_vec();
        if sensor[80] == 1 {
            sensor.extend_from_slice(payload.take(8)?);
        }
        let sensor = decode_sensor(&mut Reader::new(&sensor))?;
        if !is_name(&name) || sensors.last_key_value().is_some_and(|(last, _)| *last >= name) {
            return Err(MapFileError::Damaged(format!("sensor {name:?} is out of order")));
        }
        sensors.insert(name, sensor);
    }
    let config = fixed.with_sensors(sensors)?;
    let revision = u64::from_be_bytes(payload.array()?);
    let windows = read_windows(payload, limits)?;
    let tree = read_blocks(payload, &config, limits)?;
    Ok((config, LoadedMap { revision, tree, windows }))
}

fn read_windows<R: Read>(
    payload: &mut Payload<R>,
    limits: &MapFileLimits,
) -> Result<BTreeMap<RobotName, SequenceWindow>, MapFileError> {
    let count = u32::from_be_bytes(payload.array()?);
    within("robots", u64::from(count), limits.windows)?;
    let mut windows = BTreeMap::new();
    for _ in 0..count {
        let robot = RobotName::new(&payload.name()?).map_err(|error| MapFileError::Damaged(error.to_string()))?;
        let window = decode_window(&mut Reader::new(payload.take(WINDOW_BYTES)?))?;
        if windows.last_key_value().is_some_and(|(last, _)| *last >= robot) {
            return Err(MapFileError::Damaged(format!("robot {robot} is out of order")));
        }
        windows.insert(robot, window);
    }
    Ok(windows)
}

fn read_blocks<R: Read>(
    payload: &mut Payload<R>,
    config: &MapConfig,
    limits: &MapFileLimits,
) -> Result<OccupancyTree, MapFileError> {
    let (grid, scale) = (config.grid(), config.scale());
    let codec = BlockCodec::new(grid.depth(), scale);
    let mut tree = OccupancyTree::new(grid.depth(), scale);
    let (mut uniform, mut mixed) = (0, 0);
    let mut last = None::<u64>;
    for _ in 0..u64::from_be_bytes(payload.array()?) {
        let step = payload.varint()?;
        let code = match last {
            None => Some(step),
            Some(last) => last.checked_add(step).filter(|code| *code > last),
        };
        let address = code.map(BlockAddress::from_morton).filter(|address| holds(grid, *address));
        let address = address.ok_or_else(|| MapFileError::Damaged("a block out of order or of the map".to_owned()))?;
        last = code;
        let length = payload.varint()?;
        if length > MAX_ENCODED as u64 {
            return Err(MapFileError::Damaged(format!("a block of {length} bytes")));
        }
        let named = |why: Malformed| MapFileError::Damaged(format!("block ({}, {}): {why}", address.x, address.y));
        let view = codec.decode(payload.take(length as usize)?).map_err(named)?;
        match view {
            BlockView::Uniform(_) => uniform += 1,
            BlockView::Mixed(_) => mixed += 1,
        }
        within("blocks of one class", uniform, limits.uniform_blocks)?;
        within("mixed blocks", mixed, limits.mixed_blocks)?;
        tree.set_block(address, view);
    }
    Ok(tree)
}

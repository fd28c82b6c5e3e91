//! A map's configuration, sensors, revision and windows as contents of records: the disk's types.
//!
//! The newest version of every content, and what is read of older ones. Fields are big-endian; floats are their IEEE 754 bits, so what is read is what was
//! written to the last bit. Everything read is checked by the constructors that check it at the interface.

use super::block_codec::BlockCodec;
use super::bytes::{Malformed, Reader, put_f64, put_name};
use super::digest::Digest;
use super::record::Record;
use super::{MapName, SequenceWindow};
use crate::mapping::{EvidenceRule, MapConfig};
use crate::quadtree::{BlockView, ClassScale, Grid};
use crate::sensor::{Mount, SensorModel, SensorSpec};
use std::collections::BTreeMap;

/// What never changes of a map.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct MapRecord {
    pub(super) name: MapName,
    pub(super) created: f64,
    pub(super) fixed: FixedConfig,
}

/// A configuration without its sensors.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct FixedConfig {
    grid: Grid,
    scale: ClassScale,
    rule: EvidenceRule,
    min_obstacle_width: f64,
}

impl FixedConfig {
    /// What of a configuration is not its sensors.
    pub(super) fn of(config: &MapConfig) -> Self {
        Self {
            grid: *config.grid(),
            scale: config.scale(),
            rule: config.rule(),
            min_obstacle_width: config.min_obstacle_width(),
        }
    }

    /// The configuration with these sensors.
    pub(super) fn with_sensors(self, sensors: BTreeMap<String, SensorModel>) -> Result<MapConfig, Malformed> {
        MapConfig::new(self.grid, self.scale, self.rule, self.min_obstacle_width, sensors)
            .map_err(|error| Malformed(error.to_string()))
    }

    /// How blocks of such a map are written.
    pub(super) fn codec(&self) -> BlockCodec {
        BlockCodec::new(self.grid.depth(), self.scale)
    }

    /// Appends 35 bytes.
    pub(super) fn encode(&self, out: &mut Vec<u8>) {
        put_f64(out, self.grid.resolution());
        out.push(self.grid.depth());
        put_f64(out, self.grid.origin().0);
        put_f64(out, self.grid.origin().1);
        out.push(self.scale.count());
        out.push(match self.rule {
            EvidenceRule::Guaranteed => 1,
            EvidenceRule::Outer => 2,
            EvidenceRule::Inner => 3,
        });
        put_f64(out, self.min_obstacle_width);
    }

    /// Takes 35 bytes.
    pub(super) fn decode(reader: &mut Reader<'_>) -> Result<Self, Malformed> {
        let resolution = reader.f64("resolution")?;
        let depth = u32::from(reader.u8("depth")?);
        let origin = (reader.f64("origin.x")?, reader.f64("origin.y")?);
        let grid = Grid::new(resolution, depth, Some(origin)).map_err(|error| Malformed(error.to_string()))?;
        let scale = ClassScale::new(u32::from(reader.u8("classes")?)).map_err(|error| Malformed(error.to_string()))?;
        let rule = match reader.u8("evidence")? {
            1 => EvidenceRule::Guaranteed,
            2 => EvidenceRule::Outer,
            3 => EvidenceRule::Inner,
            other => return Err(Malformed(format!("evidence: no rule {other}"))),
        };
        let min_obstacle_width = reader.f64("min_obstacle_width")?;
        Ok(Self { grid, scale, rule, min_obstacle_width })
    }
}

impl MapRecord {
    pub(super) fn encode(&self) -> Vec<u8> {
        let mut out = Vec::with_capacity(128);
        put_name(&mut out, self.name.as_str());
        put_f64(&mut out, self.created);
        self.fixed.encode(&mut out);
        out
    }

    pub(super) fn decode(content: &[u8]) -> Result<Self, Malformed> {
        let mut reader = Reader::new(content);
        let name = MapName::new(reader.name("name")?).map_err(|error| Malformed(error.to_string()))?;
        let created = reader.f64("created")?;
        let fixed = FixedConfig::decode(&mut reader)?;
        reader.end()?;
        Ok(Self { name, created, fixed })
    }
}

/// Appends a sensor, 97 or 105 bytes.
pub(super) fn encode_sensor(sensor: &SensorModel, out: &mut Vec<u8>) {
    let spec = sensor.spec();
    for value in [
        spec.range_error_minus,
        spec.range_error_plus,
        spec.beam_opening,
        spec.beam_diameter,
        spec.range_min,
        spec.range_max,
        spec.beam_angle_error,
        spec.mount.x,
        spec.mount.y,
        spec.mount.theta,
    ] {
        put_f64(out, value);
    }
    out.push(u8::from(spec.no_return_free_to.is_some()));
    if let Some(free_to) = spec.no_return_free_to {
        put_f64(out, free_to);
    }
}

/// Takes a sensor.
pub(super) fn decode_sensor(reader: &mut Reader<'_>) -> Result<SensorModel, Malformed> {
    let mut spec = SensorSpec {
        range_error_minus: reader.f64("range_error.minus")?,
        range_error_plus: reader.f64("range_error.plus")?,
        beam_opening: reader.f64("beam_opening")?,
        beam_diameter: reader.f64("beam_diameter")?,
        range_min: reader.f64("range_min")?,
        range_max: reader.f64("range_max")?,
        beam_angle_error: reader.f64("beam_angle_error")?,
        mount: Mount { x: reader.f64("mount.x")?, y: reader.f64("mount.y")?, theta: reader.f64("mount.theta")? },
        no_return_free_to: None,
    };
    if reader.flag("no_return_free_to")? {
        spec.no_return_free_to = Some(reader.f64("no_return_free_to")?);
    }
    SensorModel::new(spec).map_err(|error| Malformed(error.to_string()))
}

/// How many records of a map there are, so that a lost one is missed; and from which revision on every change of a
/// block is known.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub(super) struct Counts {
    /// Block records.
    pub(super) blocks: u64,
    /// Window records.
    pub(super) windows: u64,
    /// Sensor records.
    pub(super) sensors: u64,
    /// Snapshot records.
    pub(super) snapshots: u64,
    /// Records of blocks and windows that are kept for snapshots.
    pub(super) kept: u64,
    /// Every block that changed after this revision has a record.
    pub(super) complete_from: u64,
    /// Of the block records.
    pub(super) block_digest: Digest,
    /// Of the window records.
    pub(super) window_digest: Digest,
    /// Of the sensor records.
    pub(super) sensor_digest: Digest,
}

impl Counts {
    pub(super) fn encode(&self) -> Vec<u8> {
        let Self { blocks, windows, sensors, snapshots, kept, complete_from, .. } = self;
        let digests = [&self.block_digest.0, &self.window_digest.0, &self.sensor_digest.0];
        let fields = [blocks, windows, sensors, snapshots, kept, complete_from];
        fields.iter().chain(&digests).flat_map(|count| count.to_be_bytes()).collect()
    }

    /// The counts of a record, which also tells of its map's revision.
    pub(super) fn decode(record: &Record<'_>) -> Result<Self, Malformed> {
        let mut reader = Reader::new(record.content);
        let mut counts = Self {
            blocks: reader.u64("blocks")?,
            windows: reader.u64("windows")?,
            sensors: reader.u64("sensors")?,
            complete_from: record.revision,
            ..Self::default()
        };
        if record.version > 1 {
            counts.snapshots = reader.u64("snapshots")?;
            counts.kept = reader.u64("kept records")?;
            counts.complete_from = reader.u64("complete from")?;
            counts.block_digest = Digest(reader.u64("digest of blocks")?);
            counts.window_digest = Digest(reader.u64("digest of windows")?);
            counts.sensor_digest = Digest(reader.u64("digest of sensors")?);
        }
        reader.end()?;
        Ok(counts)
    }
}

/// A snapshot's content; its revision is the frame's.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct SnapshotRecord {
    pub(super) created: f64,
    /// Blocks that had a record then.
    pub(super) blocks: u64,
    /// Windows that had one.
    pub(super) windows: u64,
}

impl SnapshotRecord {
    pub(super) fn encode(&self) -> Vec<u8> {
        let mut out = Vec::with_capacity(24);
        put_f64(&mut out, self.created);
        out.extend_from_slice(&self.blocks.to_be_bytes());
        out.extend_from_slice(&self.windows.to_be_bytes());
        out
    }

    pub(super) fn decode(content: &[u8]) -> Result<Self, Malformed> {
        let mut reader = Reader::new(content);
        let (created, blocks, windows) = (reader.f64("created")?, reader.u64("blocks")?, reader.u64("windows")?);
        reader.end()?;
        Ok(Self { created, blocks, windows })
    }
}

/// Appends a block's content: the time of its last change and its bits.
pub(super) fn encode_block(
    codec: &BlockCodec,
    changed: f64,
    view: &BlockView,
    out: &mut Vec<u8>,
) -> Result<(), Malformed> {
    put_f64(out, changed);
    codec.encode(view, out)
}

/// A block's content out of its bits.
pub(super) fn timed(changed: f64, bits: &[u8]) -> Vec<u8> {
    let mut out = Vec::with_capacity(8 + bits.len());
    put_f64(&mut out, changed);
    out.extend_from_slice(bits);
    out
}

/// Takes a block and the time of its last change; 0 where the record's form has none.
pub(super) fn decode_block(codec: &BlockCodec, record: &Record<'_>) -> Result<(f64, BlockView), Malformed> {
    let mut reader = Reader::new(record.content);
    let changed = if record.version > 1 { reader.f64("time of the last change")? } else { 0.0 };
    Ok((changed, codec.decode(reader.rest())?))
}

/// Appends a window, 145 bytes: whether there is a highest number, it, how many were applied, the ring of bits.
pub(super) fn encode_window(window: &SequenceWindow, out: &mut Vec<u8>) {
    out.push(u8::from(window.highest().is_some()));
    out.extend_from_slice(&window.highest().unwrap_or_default().to_be_bytes());
    out.extend_from_slice(&window.count().to_be_bytes());
    for word in window.bits() {
        out.extend_from_slice(&word.to_be_bytes());
    }
}

/// Takes a window.
pub(super) fn decode_window(reader: &mut Reader<'_>) -> Result<SequenceWindow, Malformed> {
    let any = reader.flag("window's highest")?;
    let highest = reader.u64("window's highest")?;
    let count = reader.u64("window's count")?;
    let mut bits = [0; 16];
    for word in &mut bits {
        *word = reader.u64("window's bits")?;
    }
    if !any && highest != 0 {
        return Err(Malformed::new("window: a number without its flag"));
    }
    SequenceWindow::from_parts(any.then_some(highest), bits, count)
        .ok_or_else(|| Malformed::new("window: its parts contradict each other"))
}

/// The store's header.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Header {
    /// Version of the store's format.
    pub(super) format: u32,
    /// When the store was created, seconds since the Unix epoch.
    pub(super) created: f64,
    /// The program that created it.
    pub(super) program: String,
}

impl Header {
    pub(super) fn encode(&self) -> Vec<u8> {
        let mut out = self.format.to_be_bytes().to_vec();
        put_f64(&mut out, self.created);
        put_name(&mut out, &self.program);
        out
    }

    /// Reads the format's version alone, which stands first in every version.
    pub(super) fn format_of(content: &[u8]) -> Result<u32, Malformed> {
        Reader::new(content).u32("format")
    }
}

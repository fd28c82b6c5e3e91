//! What the fuzzer calls (`fuzz/`): contents of records, behind frames that are right.

use super::block_codec::BlockCodec;
use super::bytes::Reader;
use super::config_record::{
    Counts, Header, MapRecord, SnapshotRecord, decode_block, decode_sensor, decode_window, encode_block, encode_sensor,
    encode_window,
};
use super::groups::Group;
use super::keys::Kind;
use super::record;
use crate::quadtree::ClassScale;

/// Reads a content as one of a kind, and holds that what is read is written as it was.
pub fn record(kind: u8, content: &[u8]) {
    let Some(kind) = Kind::from_byte(kind) else { return };
    let key = [kind as u8, 0, 0, 0, 7];
    let value = record::seal(&key, 7, content);
    let Ok(record) = record::open(&key, kind, &value) else { return };
    let mut written = Vec::new();
    let known = match kind {
        Kind::Header => Header::format_of(record.content).map(|_| None),
        Kind::Map => MapRecord::decode(record.content).map(|map| Some(map.encode())),
        Kind::Sensor => {
            let mut reader = Reader::new(record.content);
            let sensor = decode_sensor(&mut reader);
            sensor.and_then(|sensor| reader.end().map(|()| sensor)).map(|sensor| {
                encode_sensor(&sensor, &mut written);
                Some(written)
            })
        }
        Kind::State => Counts::decode(&record).map(|counts| Some(counts.encode())),
        Kind::Window | Kind::KeptWindow => {
            let mut reader = Reader::new(record.content);
            let window = decode_window(&mut reader);
            window.and_then(|window| reader.end().map(|()| window)).map(|window| {
                encode_window(&window, &mut written);
                Some(written)
            })
        }
        Kind::Block | Kind::KeptBlock => {
            // Shallow maps and wide classes have forms of their own; the first byte of the time chooses.
            let depth = 1 + content.first().copied().unwrap_or_default() % 8;
            let classes = if content.get(1).copied().unwrap_or_default() % 2 == 0 { 10 } else { 200 };
            let Ok(scale) = ClassScale::new(classes) else { return };
            let codec = BlockCodec::new(depth, scale);
            decode_block(&codec, &record).and_then(|(changed, view)| {
                encode_block(&codec, changed, &view, &mut written)?;
                Ok(Some(written))
            })
        }
        Kind::Group => Group::decode(&record).map(|group| Some(group.encode())),
        Kind::Snapshot => SnapshotRecord::decode(record.content).map(|snapshot| Some(snapshot.encode())),
        Kind::NextMap | Kind::LastWrite | Kind::Name | Kind::Tombstone | Kind::Sweep => return,
    };
    if let Ok(Some(written)) = known {
        assert_eq!(written, content, "{kind:?} is written as other bytes than it was read from");
    }
}

//! The frame around every value of the store.
//!
//! | bytes | what |
//! | --- | --- |
//! | 0 | version of the form of records of this kind |
//! | 1 | kind, the same as the first byte of the key |
//! | 2..10 | the map's revision when the record was written; 0 where there is none |
//! | 10..14 | length `n` of the content |
//! | 14..14+n | content |
//! | last 4 | CRC32C over the key's length (u32), the key, and all of the above |
//!
//! The first byte and the checksum at the end stay where they are in every later version, so that damage is told from
//! a newer form. The key is under the checksum: a record that turns up under another key is damage too.

use super::StoreError;
use super::keys::{self, Kind};

/// Bytes before the content.
const HEAD: usize = 14;

/// Bytes behind the content.
const TAIL: usize = 4;

/// A record whose frame is right.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Record<'a> {
    /// The version of its form.
    pub(super) version: u8,
    /// The map's revision when it was written.
    pub(super) revision: u64,
    /// Its content.
    pub(super) content: &'a [u8],
}

fn checksum(key: &[u8], framed: &[u8]) -> u32 {
    let length = u32::try_from(key.len()).unwrap_or(u32::MAX).to_be_bytes();
    crc32c::crc32c_append(crc32c::crc32c_append(crc32c::crc32c(&length), key), framed)
}

/// Frames a content. The kind is the key's first byte.
pub(super) fn seal(key: &[u8], revision: u64, content: &[u8]) -> Vec<u8> {
    debug_assert!(u32::try_from(content.len()).is_ok(), "contents are a few kilobytes");
    let mut value = Vec::with_capacity(HEAD + content.len() + TAIL);
    let kind = key.first().copied().unwrap_or_default();
    value.push(Kind::from_byte(kind).map_or(1, Kind::version));
    value.push(kind);
    value.extend_from_slice(&revision.to_be_bytes());
    value.extend_from_slice(&u32::try_from(content.len()).unwrap_or(u32::MAX).to_be_bytes());
    value.extend_from_slice(content);
    let sum = checksum(key, &value);
    value.extend_from_slice(&sum.to_be_bytes());
    value
}

/// Checks a frame and gives what is in it.
///
/// # Errors
/// [`StoreError::Damaged`] naming map and record; [`StoreError::NewerFormat`] for a sound record of a later version.
pub(super) fn open<'a>(key: &[u8], kind: Kind, value: &'a [u8]) -> Result<Record<'a>, StoreError> {
    let damaged = |why: &str| damaged(key, why);
    if value.len() < HEAD + TAIL {
        return Err(damaged(&format!("{} bytes, the least is {}", value.len(), HEAD + TAIL)));
    }
    let (framed, sum) = value.split_at(value.len() - TAIL);
    if checksum(key, framed).to_be_bytes() != sum {
        return Err(damaged("wrong checksum"));
    }
    if framed[0] > kind.version() {
        return Err(StoreError::NewerFormat {
            what: keys::describe(key),
            found: u32::from(framed[0]),
            supported: u32::from(kind.version()),
        });
    }
    if framed[0] == 0 {
        return Err(damaged("version 0"));
    }
    if framed[1] != kind as u8 || key.first() != Some(&framed[1]) {
        return Err(damaged("a record of another kind"));
    }
    let mut revision = [0; 8];
    revision.copy_from_slice(&framed[2..10]);
    let mut length = [0; 4];
    length.copy_from_slice(&framed[10..HEAD]);
    let content = &framed[HEAD..];
    if usize::try_from(u32::from_be_bytes(length)) != Ok(content.len()) {
        return Err(damaged("wrong length"));
    }
    Ok(Record { version: framed[0], revision: u64::from_be_bytes(revision), content })
}

/// The revision that a value says it is of, whether or not it is sound; 0 where it is too short.
pub(super) fn revision_of(value: &[u8]) -> u64 {
    value.get(2..10).and_then(|bytes| bytes.try_into().ok()).map_or(0, u64::from_be_bytes)
}

/// The error for a record, named by its key.
pub(super) fn damaged(key: &[u8], why: &str) -> StoreError {
    StoreError::Damaged { what: format!("{}: {why}", keys::describe(key)) }
}

//! What a set of records is, in 64 bits that change when one of them is replaced by another or an older one of the same key.
//!
//! sled takes a damaged message in its log for the end of a segment and goes on with the next: the pages behind it are
//! then those of an earlier time, each sound in itself. So a map's state carries a digest of its blocks, windows and
//! sensors, and the record of the last write one of all states.
//!
//! A digest is the exclusive or of one number for each record, so what replaces a record is told by the two alone.

use crate::quadtree::BlockAddress;

/// The digest of a set of records.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub(super) struct Digest(pub(super) u64);

/// The finaliser of splitmix64.
fn mix(number: u64) -> u64 {
    let mut x = number.wrapping_add(0x9e37_79b9_7f4a_7c15);
    x = (x ^ (x >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    x = (x ^ (x >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    x ^ (x >> 31)
}

impl Digest {
    /// Takes a block in, or out again, by its address and the revision of its record.
    pub(super) fn toggle_block(&mut self, address: BlockAddress, revision: u64) {
        self.0 ^= mix(mix(address.morton()) ^ revision);
    }

    /// Takes a framed record in, or out again, by its checksum, which covers its key, revision and content.
    pub(super) fn toggle_record(&mut self, value: &[u8]) {
        if let Some(sum) = value.last_chunk::<4>() {
            self.0 ^= mix(u64::from(u32::from_be_bytes(*sum)));
        }
    }

    /// The digest of framed records.
    pub(super) fn of_records<'a>(values: impl IntoIterator<Item = &'a [u8]>) -> Self {
        let mut digest = Self::default();
        values.into_iter().for_each(|value| digest.toggle_record(value));
        digest
    }
}

//! The number of the last write that was acknowledged, in a small file beside the database.
//!
//! sled takes a damaged record in the last segment of its log for the log's end: it opens, and everything behind is gone
//! without a word. So every batch writes its number into the database, and the number of the last durable one is noted
//! in `DIR/acknowledged`, after the sync and before the answer. A database whose number is below the noted one has lost
//! acknowledged writes. The file is not synced at every write (a power cut may leave an older number, which sees less
//! but accuses nothing falsely); it is when the store is closed.
//!
//! 12 bytes: the number, and the CRC32C of its 8 bytes.

use std::fs::File;
use std::io::{self, Read, Seek, SeekFrom, Write};
use std::path::Path;

/// The file's name in the data directory.
pub(super) const MARK: &str = "acknowledged";

/// The file, open for writing.
#[derive(Debug)]
pub(super) struct Mark {
    file: File,
}

impl Mark {
    /// Opens the file, or makes it, and reads the number; `None` where there is none or it is not whole.
    pub(super) fn open(directory: &Path) -> io::Result<(Self, Option<u64>)> {
        let path = directory.join(MARK);
        let mut file = File::options().read(true).write(true).create(true).truncate(false).open(path)?;
        let mut bytes = Vec::new();
        (&mut file).take(13).read_to_end(&mut bytes)?;
        if bytes.len() > 12 {
            file.set_len(12)?;
        }
        Ok((Self { file }, parse(&bytes)))
    }

    /// Notes a number.
    pub(super) fn note(&mut self, number: u64) -> io::Result<()> {
        let number = number.to_be_bytes();
        let mut bytes = [0; 12];
        bytes[..8].copy_from_slice(&number);
        bytes[8..].copy_from_slice(&crc32c::crc32c(&number).to_be_bytes());
        self.file.seek(SeekFrom::Start(0))?;
        self.file.write_all(&bytes)
    }

    /// Makes the last number durable.
    pub(super) fn sync(&self) -> io::Result<()> {
        self.file.sync_all()
    }
}

impl Drop for Mark {
    fn drop(&mut self) {
        // An older number that stays is harmless.
        let _ = self.sync();
    }
}

fn parse(bytes: &[u8]) -> Option<u64> {
    let (number, sum) = bytes.split_at_checked(8)?;
    (crc32c::crc32c(number).to_be_bytes() == *sum).then_some(number)?.try_into().ok().map(u64::from_be_bytes)
}

//! One file of a bag, as a stream of its messages.

use super::mcap_file::McapFile;
use super::messages::Kind;
use super::sqlite_file::SqliteFile;
use std::fs::File;
use std::io::{BufReader, Read};
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

/// Longest record and chunk of a file, and longest message, bytes: held in memory as a whole.
pub(super) const LONGEST_RECORD: usize = 256 << 20;

/// Longest name of a topic or a type that is told apart, bytes.
pub(super) const LONGEST_TOPIC: usize = 1024;

/// Most topics of one file.
pub(super) const MOST_TOPICS: usize = 65_536;

/// What a file begins with.
pub(super) const MCAP_MAGIC: [u8; 8] = *b"\x89MCAP0\r\n";
pub(super) const SQLITE_MAGIC: [u8; 16] = *b"SQLite format 3\0";
pub(super) const ZSTD_MAGIC: [u8; 4] = [0x28, 0xb5, 0x2f, 0xfd];

/// A topic of a bag.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Topic {
    pub(super) name: String,
    pub(super) type_name: String,
    /// `None` for a type that is not read, and for an encoding other than CDR.
    pub(super) kind: Option<Kind>,
    /// `cdr` in ROS 2.
    pub(super) encoding: String,
}

impl Topic {
    pub(super) fn new(name: &str, type_name: &str, encoding: &str) -> Self {
        let short = |text: &str| text.chars().take(LONGEST_TOPIC).collect::<String>();
        let kind = Kind::of(type_name).filter(|_| encoding == "cdr");
        Self { name: short(name), type_name: short(type_name), kind, encoding: short(encoding) }
    }
}

/// A message of a type that is read.
#[derive(Debug)]
pub(super) struct Message {
    pub(super) topic: Arc<Topic>,
    pub(super) kind: Kind,
    pub(super) data: Vec<u8>,
}

/// A file, by its form.
pub(super) enum BagFile {
    Mcap(Box<McapFile>),
    Sqlite(SqliteFile),
}

/// Reads, and counts what is read.
pub(super) struct Counted<R> {
    inner: R,
    count: Arc<AtomicU64>,
}

impl<R: Read> Read for Counted<R> {
    fn read(&mut self, into: &mut [u8]) -> std::io::Result<usize> {
        let count = self.inner.read(into)?;
        self.count.fetch_add(count as u64, Ordering::Relaxed);
        Ok(count)
    }
}

/// The first bytes of a file.
pub(super) fn head(path: &Path) -> std::io::Result<Vec<u8>> {
    let mut head = Vec::new();
    File::open(path)?.take(SQLITE_MAGIC.len() as u64).read_to_end(&mut head)?;
    Ok(head)
}

impl BagFile {
    /// Opens a file; `count` grows by the bytes that are read of it.
    ///
    /// # Errors
    /// A sentence: it cannot be opened, or is none of the forms.
    pub(super) fn open(path: &Path, count: Arc<AtomicU64>) -> Result<Self, String> {
        let head = head(path).map_err(|error| error.to_string())?;
        if head.starts_with(&SQLITE_MAGIC) {
            return SqliteFile::open(path, count).map(Self::Sqlite);
        }
        let counted = || File::open(path).map(|inner| Counted { inner, count }).map_err(|error| error.to_string());
        if head.starts_with(&MCAP_MAGIC) {
            return Ok(Self::Mcap(Box::new(McapFile::new(counted()?))));
        }
        if head.starts_with(&ZSTD_MAGIC) {
            let mut plain = zstd::Decoder::new(counted()?).map_err(|error| error.to_string())?;
            // A window beyond 128 MiB is not what a recorder writes.
            plain.window_log_max(27).map_err(|error| error.to_string())?;
            let mut plain = BufReader::new(plain);
            let mut inner = Vec::new();
            (&mut plain).take(MCAP_MAGIC.len() as u64).read_to_end(&mut inner).map_err(|error| error.to_string())?;
            if inner == MCAP_MAGIC {
                return Ok(Self::Mcap(Box::new(McapFile::new(std::io::Cursor::new(inner).chain(plain)))));
            }
            return Err("holds no MCAP file under its compression; a compressed .db3 must be unpacked first: zstd -d"
                .to_owned());
        }
        Err("is neither an MCAP file nor a SQLite database".to_owned())
    }

    /// The next message of a type that is read; `None` at the end.
    ///
    /// # Errors
    /// What is damaged.
    pub(super) fn next_message(&mut self) -> Result<Option<Message>, String> {
        let message = match self {
            Self::Mcap(file) => file.next_message(),
            Self::Sqlite(file) => file.next_message(),
        }?;
        message.map(unpacked).transpose()
    }

    /// The topics seen so far, and those that the file lists.
    pub(super) fn topics(&self) -> Vec<Arc<Topic>> {
        match self {
            Self::Mcap(file) => file.topics(),
            Self::Sqlite(file) => file.topics(),
        }
    }
}

/// A recorder may compress each message by itself. No message begins like compressed data otherwise.
fn unpacked(message: Message) -> Result<Message, String> {
    if !message.data.starts_with(&ZSTD_MAGIC) {
        return Ok(message);
    }
    let failed = |error: std::io::Error| format!("a message of {} cannot be unpacked: {error}", message.topic.name);
    let mut plain = zstd::Decoder::new(message.data.as_slice()).map_err(failed)?;
    plain.window_log_max(27).map_err(failed)?;
    let mut data = Vec::new();
    plain.take(LONGEST_RECORD as u64 + 1).read_to_end(&mut data).map_err(failed)?;
    if data.len() > LONGEST_RECORD {
        return Err(format!("a message of {} is longer than {LONGEST_RECORD} bytes", message.topic.name));
    }
    Ok(Message { data, ..message })
}

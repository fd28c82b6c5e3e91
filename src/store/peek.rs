//! A look at a data directory that changes nothing in it, and may be taken while a server has it open.
//!
//! sled cannot open a database without writing to it, so the store's format is told from the bytes of its log: the header
//! is a framed record with a checksum of its own, and a log has every header that it ever had. Formats only go up, so the
//! highest is the store's.

use super::config_record::Header;
use super::keys::{self, Kind};
use super::migrate::STORE_FORMAT;
use super::record;
use super::sled_generations::{Generation, decide};
use super::sled_open::{check_blank, io, no_store};
use super::{SledStore, StoreError};
use std::fs::{self, File, TryLockError};
use std::io::{ErrorKind, Read};
use std::path::{Path, PathBuf};

/// How much of a database is read in search of its header, bytes.
const MOST_BYTES: u64 = 1 << 30;

/// Bytes read at a time.
const PIECE: usize = 1 << 20;

/// No header is longer, bytes.
const LONGEST_HEADER: usize = 300;

/// What a data directory holds.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Peek {
    /// No store: one is made when a server starts. The directory may be missing as well.
    None {
        /// The directory, or the nearest above it that is there.
        nearest: PathBuf,
    },
    /// A store.
    Store {
        /// The version of its format; `None` where its header was not found within the first GiB.
        format: Option<u32>,
        /// Another process has it open.
        in_use: bool,
    },
}

impl SledStore {
    /// Looks at a data directory without opening or changing what is in it.
    ///
    /// # Errors
    /// [`StoreError::NoStore`] for what cannot be told, [`StoreError::NewerFormat`], [`StoreError::Io`].
    pub fn peek(directory: &Path) -> Result<Peek, StoreError> {
        match fs::metadata(directory) {
            Ok(there) if there.is_dir() => {}
            Ok(_) => return Err(no_store(directory, "it is no directory")),
            Err(error) if [ErrorKind::NotFound, ErrorKind::NotADirectory].contains(&error.kind()) => {
                let nearest =
                    directory.ancestors().skip(1).find(|above| above.as_os_str().is_empty() || above.exists());
                let nearest = nearest.filter(|above| !above.as_os_str().is_empty()).unwrap_or(Path::new("."));
                if !nearest.is_dir() {
                    return Err(no_store(directory, &format!("{} is no directory", nearest.display())));
                }
                return Ok(Peek::None { nearest: nearest.to_owned() });
            }
            Err(source) => return Err(io(directory, "looking for", source)),
        }
        let Some((generation, _)) = decide(directory)? else {
            check_blank(directory)?;
            return Ok(Peek::None { nearest: directory.to_owned() });
        };
        let format = format_of(directory, generation)?;
        if let Some(found) = format.filter(|format| *format > STORE_FORMAT) {
            return Err(StoreError::NewerFormat { what: "the store".to_owned(), found, supported: STORE_FORMAT });
        }
        Ok(Peek::Store { format, in_use: in_use(directory)? })
    }
}

/// Is the lock taken? It is asked for shared, and let go at once.
fn in_use(directory: &Path) -> Result<bool, StoreError> {
    let path = directory.join("lock");
    let file = match File::open(&path) {
        Ok(file) => file,
        Err(error) if error.kind() == ErrorKind::NotFound => return Ok(false),
        Err(source) => return Err(io(&path, "opening", source)),
    };
    match file.try_lock_shared() {
        Ok(()) => Ok(false),
        Err(TryLockError::WouldBlock) => Ok(true),
        Err(TryLockError::Error(source)) => Err(io(&path, "locking", source)),
    }
}

/// The highest format of a header in the database's log.
fn format_of(directory: &Path, generation: Generation) -> Result<Option<u32>, StoreError> {
    let path = generation.path(directory).join("db");
    let failed = |source| io(&path, "reading", source);
    let mut file = File::open(&path).map_err(failed)?.take(MOST_BYTES);
    let mut bytes = Vec::new();
    let mut highest = None;
    loop {
        let count = (&mut file).take(PIECE as u64).read_to_end(&mut bytes).map_err(failed)?;
        for start in 0..bytes.len() {
            highest = highest.max(header_at(&bytes[start..])?);
        }
        if count == 0 {
            return Ok(highest);
        }
        // A header may lie across two pieces.
        bytes.drain(..bytes.len().saturating_sub(LONGEST_HEADER));
    }
}

/// The format of the header that begins here; `None` where none does.
fn header_at(bytes: &[u8]) -> Result<Option<u32>, StoreError> {
    // Version, kind, revision 0, and a length whose two high bytes are 0: see [`record`].
    let Some([_, kind, rest @ .., low]) = bytes.first_chunk::<14>() else { return Ok(None) };
    if *kind != Kind::Header as u8 || rest[..10] != [0; 10] {
        return Ok(None);
    }
    let length = 14 + usize::from(u16::from_be_bytes([rest[10], *low])) + 4;
    let Some(value) = bytes.get(..length).filter(|_| length <= LONGEST_HEADER) else { return Ok(None) };
    match record::open(&keys::HEADER, Kind::Header, value) {
        Ok(header) => Ok(Header::format_of(header.content).ok()),
        Err(newer @ StoreError::NewerFormat { .. }) => Err(newer),
        Err(_) => Ok(None),
    }
}

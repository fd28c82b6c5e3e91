//! Which of the databases in a data directory is the store.
//!
//! A database grows and is rewritten into a new directory now and then (see [`super::sled_rewrite`]): each such copy is a
//! *generation*. The first lives in `DIR/sled`, generation `N` in `DIR/sled-N`. `DIR/current` names the one that is the
//! store; before the first rewrite there is no such file. sled writes some of its files by their path, so a
//! directory that it has open is never renamed: the file that names it is replaced instead, which is atomic.
//!
//! 8 bytes: the generation (u32), and the CRC32C of its 4 bytes.

use super::StoreError;
use super::sled_open::{io, no_store, sync_directory};
use std::fs::{self, File};
use std::io::{ErrorKind, Read, Write};
use std::path::{Path, PathBuf};
use std::time::Duration;

/// The file that names the generation that is the store.
pub(super) const CURRENT: &str = "current";

/// The name of that file while it is written.
const WRITING: &str = "current.writing";

/// The database's directory in the first generation, and what the others' begin with.
pub(super) const DATABASE: &str = "sled";

/// How often the removal of a directory is tried: a thread of sled may write a last file into it.
const REMOVALS: usize = 100;

/// How long to wait between two tries.
const REMOVAL_PAUSE: Duration = Duration::from_millis(10);

/// One of the databases that a directory holds or held, counted from 1.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(super) struct Generation(u32);

impl Generation {
    /// That of a new store.
    pub(super) const FIRST: Self = Self(1);

    /// The one after it; `None` after the last number.
    pub(super) fn next(self) -> Option<Self> {
        self.0.checked_add(1).map(Self)
    }

    /// The name of its directory.
    pub(super) fn name(self) -> String {
        if self == Self::FIRST { DATABASE.to_owned() } else { format!("{DATABASE}-{}", self.0) }
    }

    /// Its directory.
    pub(super) fn path(self, directory: &Path) -> PathBuf {
        directory.join(self.name())
    }

    fn of_name(name: &str) -> Option<Self> {
        if name == DATABASE {
            return Some(Self::FIRST);
        }
        let number = name.strip_prefix(DATABASE)?.strip_prefix('-')?.parse().ok().map(Self)?;
        // Only the one form that is written; sled-1 and sled-02 are not ours.
        (number > Self::FIRST && number.name() == name).then_some(number)
    }
}

/// What `current` says.
enum Pointer {
    Absent,
    Damaged,
    Names(Generation),
}

fn read_pointer(directory: &Path) -> Result<Pointer, StoreError> {
    let path = directory.join(CURRENT);
    let mut bytes = Vec::new();
    match File::open(&path).and_then(|file| file.take(9).read_to_end(&mut bytes)) {
        Err(error) if error.kind() == ErrorKind::NotFound => return Ok(Pointer::Absent),
        Err(source) => return Err(io(&path, "reading", source)),
        Ok(_) => {}
    }
    let whole = bytes.split_first_chunk::<4>().filter(|(number, sum)| crc32c::crc32c(*number).to_be_bytes() == **sum);
    let number = whole.map_or(0, |(number, _)| u32::from_be_bytes(*number));
    Ok(if number == 0 { Pointer::Damaged } else { Pointer::Names(Generation(number)) })
}

/// The generations that have a directory, in order.
fn present(directory: &Path) -> Result<Vec<Generation>, StoreError> {
    let mut found = Vec::new();
    for entry in fs::read_dir(directory).map_err(|source| io(directory, "reading", source))? {
        let entry = entry.map_err(|source| io(directory, "reading", source))?;
        found.extend(entry.file_name().to_str().and_then(Generation::of_name));
    }
    found.sort();
    Ok(found)
}

/// True when there is a database in the directory, whichever it is.
pub(super) fn is_in(directory: &Path) -> Result<bool, StoreError> {
    Ok(directory.is_dir() && !present(directory)?.is_empty())
}

/// The generation that is the store; `None` where there is none at all. Where `current` does not say it and it can be told
/// all the same, `current` does from now on.
///
/// # Errors
/// [`StoreError::NoStore`] when it cannot be told which one it is.
pub(super) fn find(directory: &Path) -> Result<Option<Generation>, StoreError> {
    let Some((generation, fault)) = decide(directory)? else { return Ok(None) };
    if let Some(what) = fault {
        tracing::warn!(
            directory = %directory.display(),
            "the file {CURRENT:?} {what}; {} is the only database there, so it is the store", generation.name()
        );
        point_to(directory, generation).map_err(Pointing::into_error)?;
    }
    Ok(Some(generation))
}

/// The generation that is the store, and what is wrong with `current`. What that does not say is decided only where there is
/// one answer: an older generation served in silence would be maps that have gone back. Nothing is changed.
///
/// # Errors
/// [`StoreError::NoStore`] when it cannot be told which one it is.
pub(super) fn decide(directory: &Path) -> Result<Option<(Generation, Option<&'static str>)>, StoreError> {
    let present = present(directory)?;
    let names = || present.iter().map(|generation| generation.name()).collect::<Vec<_>>().join(", ");
    let what = match read_pointer(directory)? {
        Pointer::Names(generation) if present.contains(&generation) => return Ok(Some((generation, None))),
        Pointer::Names(generation) => {
            let name = generation.name();
            let why =
                format!("the file {CURRENT:?} names the database {name}, which is not there; restore the directory");
            return Err(no_store(directory, &why));
        }
        // It is written when the first rewrite begins.
        Pointer::Absent if present.is_empty() || present == [Generation::FIRST] => {
            return Ok(present.first().map(|first| (*first, None)));
        }
        Pointer::Absent => "is missing",
        Pointer::Damaged => "is damaged",
    };
    match present[..] {
        // A generation is removed only when `current` names another durably: the last one left is the store.
        [only] => Ok(Some((only, Some(what)))),
        [] => Err(no_store(
            directory,
            &format!("the file {CURRENT:?} {what} and there is no database; restore the directory"),
        )),
        _ => Err(no_store(
            directory,
            &format!(
                "the file {CURRENT:?}, which tells the store's database, {what}, and there are {}: it cannot be told \
                 which of them is the latest. Restore a backup, or keep a copy of the directory and leave only one of them",
                names()
            ),
        )),
    }
}

/// Why `current` was not replaced.
#[derive(Debug)]
pub(super) enum Pointing {
    /// It names what it named before.
    NotDone(StoreError),
    /// After a power cut it may name either.
    InDoubt(StoreError),
}

impl Pointing {
    /// The reason.
    pub(super) fn into_error(self) -> StoreError {
        let (Self::NotDone(error) | Self::InDoubt(error)) = self;
        error
    }
}

/// Makes a generation the store, durably. Its directory must be durable before.
pub(super) fn point_to(directory: &Path, generation: Generation) -> Result<(), Pointing> {
    let (writing, path) = (directory.join(WRITING), directory.join(CURRENT));
    let number = generation.0.to_be_bytes();
    let bytes = [number, crc32c::crc32c(&number).to_be_bytes()].concat();
    let written = File::create(&writing).and_then(|mut file| {
        file.write_all(&bytes)?;
        file.sync_all()
    });
    written.map_err(|source| Pointing::NotDone(io(&writing, "writing", source)))?;
    fs::rename(&writing, &path).map_err(|source| Pointing::NotDone(io(&writing, "renaming", source)))?;
    sync_directory(directory).map_err(Pointing::InDoubt)
}

/// Removes what is left of other generations than the store's. One that is older is kept where `keep_older` says so. What
/// cannot be removed is left for the next time.
pub(super) fn remove_others(directory: &Path, current: Generation, keep_older: bool) {
    let others = present(directory).unwrap_or_default();
    let unwanted = others.into_iter().filter(|other| *other > current || (*other < current && !keep_older));
    for other in unwanted {
        let path = other.path(directory);
        match remove_directory(&path) {
            Ok(()) => {
                tracing::info!(path = %path.display(), "removed a database that is not the store any more, or never was");
            }
            Err(error) => tracing::warn!("a database that is not the store is left: {error}"),
        }
    }
    // Written again before it is used.
    let _ = fs::remove_file(directory.join(WRITING));
}

/// Removes a database's directory, if there is one. Nothing may have it open but sled's last threads.
pub(super) fn remove_directory(path: &Path) -> Result<(), StoreError> {
    let mut tries = REMOVALS;
    loop {
        tries -= 1;
        match fs::remove_dir_all(path) {
            Ok(()) => return Ok(()),
            Err(error) if error.kind() == ErrorKind::NotFound && !path.exists() => return Ok(()),
            Err(source) if tries == 0 || !passes(&source) => return Err(io(path, "removing", source)),
            Err(_) => std::thread::sleep(REMOVAL_PAUSE),
        }
    }
}

/// True for what a file that comes or goes during a removal looks like.
fn passes(error: &std::io::Error) -> bool {
    matches!(error.kind(), ErrorKind::NotFound | ErrorKind::DirectoryNotEmpty)
}

/// Bytes of all files below a directory. A file that goes meanwhile counts as none.
pub(super) fn bytes_in(directory: &Path) -> std::io::Result<u64> {
    let mut bytes = 0;
    for entry in fs::read_dir(directory)? {
        let entry = entry?;
        match entry.metadata() {
            Ok(metadata) if metadata.is_dir() => bytes += bytes_in(&entry.path()).unwrap_or(0),
            Ok(metadata) => bytes += metadata.len(),
            Err(error) if error.kind() == ErrorKind::NotFound => {}
            Err(error) => return Err(error),
        }
    }
    Ok(bytes)
}

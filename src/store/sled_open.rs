//! Creating and opening the directory of a store, so that what is there after a power cut is a whole store or none.
//!
//! `DIR/lock` is locked while a store is open. `DIR/acknowledged` has the number of the last write that was acknowledged
//! (see [`super::mark`]). `DIR/sled` is the database of a new store ([`super::sled_generations`] has what comes after it).
//! It is made as `DIR/sled.creating`, synced with everything in it, and only then renamed: a directory of the final name is
//! never half made.

use super::config_record::Header;
use super::copies::COPIES;
use super::digest::Digest;
use super::durability::{FileSyncer, Syncer};
use super::kept::{Before, KEPT};
use super::keys::{self, Kind};
use super::mark::{MARK, Mark};
use super::migrate::{STORE_FORMAT, migrate};
use super::sled_catalogue::{last_write_of, states_of};
use super::sled_generations::{CURRENT, DATABASE, Generation, find};
use super::sled_writes::last_write as record_of_write;
use super::{StoreError, record};
use std::fs::{self, File, TryLockError};
use std::ops::Deref;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::Path;
use std::time::{Duration, Instant, SystemTime};

/// The name of a new store's database while it is being made.
const CREATING: &str = "sled.creating";

/// How long to wait for the lock of a directory or database that was just closed: sled's own threads let go of its file
/// a little after its handle, and a child process that was being started meanwhile a little after that.
const LOCK_PATIENCE: Duration = Duration::from_secs(2);

/// How long to wait before the next attempt.
const LOCK_RETRY: Duration = Duration::from_millis(5);

/// Settings of a store on disk.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SledOptions {
    /// Bytes of memory for sled's page cache; while the database is rewritten the new one has as much.
    pub cache_bytes: u64,
    /// When the database is rewritten.
    pub rewrite: RewriteOptions,
}

impl Default for SledOptions {
    /// 64 MiB: maps are held in memory by the service, so pages are seldom read twice.
    fn default() -> Self {
        Self { cache_bytes: 64 << 20, rewrite: RewriteOptions::default() }
    }
}

/// When the database is rewritten into a new directory.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RewriteOptions {
    /// When its files take more than so many times the bytes of what it holds.
    pub factor: f64,
    /// Never while its files take fewer bytes than this.
    pub least_bytes: u64,
    /// How often its size is looked at.
    pub check: Duration,
}

impl Default for RewriteOptions {
    /// Under steady replacement sled settles at 4 to 6 times what it holds, and a fresh copy takes 1.8 to 2.8 times: 8 is
    /// reached only when something else has grown it. Every 10 seconds: looking costs a reading of a directory.
    fn default() -> Self {
        Self { factor: 8.0, least_bytes: 64 << 20, check: Duration::from_secs(10) }
    }
}

impl RewriteOptions {
    /// The most bytes that the files of a database may take before it is rewritten, if it holds `live` bytes of keys and
    /// values.
    #[must_use]
    pub fn limit(&self, live: u64) -> u64 {
        self.least_bytes.max((self.factor * live as f64) as u64)
    }
}

/// A handle of the database that survives a failing close: sled's last handle syncs when it is dropped and panics when
/// that fails.
#[derive(Clone)]
pub(super) struct Database(Option<sled::Db>);

impl Deref for Database {
    type Target = sled::Db;

    fn deref(&self) -> &sled::Db {
        self.0.as_ref().expect("taken in drop alone")
    }
}

impl Drop for Database {
    fn drop(&mut self) {
        let db = self.0.take();
        let _ = catch_unwind(AssertUnwindSafe(move || drop(db)));
    }
}

/// A directory that is open.
pub(super) struct Opened {
    pub(super) db: Database,
    pub(super) generation: Generation,
    pub(super) syncer: Box<dyn Syncer>,
    pub(super) mark: Mark,
    /// The number of the last write.
    pub(super) last_write: u64,
    /// The digest of the states of all maps.
    pub(super) states: Digest,
    pub(super) lock: File,
}

/// Opens the store in `directory`, or makes one where there is none.
pub(super) fn open_directory(directory: &Path, options: SledOptions) -> Result<Opened, StoreError> {
    create_directories(directory)?;
    let lock = lock_directory(directory)?;
    let found = find(directory)?;
    let fresh = found.is_none();
    if fresh {
        create_store(directory, options)?;
    }
    let generation = found.unwrap_or(Generation::FIRST);
    let path = generation.path(directory);
    if !exists(&path.join("db"))? {
        let why = format!("its database has lost its data file {}/db; restore the directory", generation.name());
        return Err(no_store(directory, &why));
    }
    let before = Before::keep(directory, &path);
    match open_existing(directory, &path, fresh, options) {
        Ok(Whole { db, syncer, mark, last_write, states }) => {
            before.opened();
            Ok(Opened { db, generation, syncer, mark, last_write, states, lock })
        }
        Err(error) => Err(before.refused(error)),
    }
}

/// A database that is whole.
struct Whole {
    db: Database,
    syncer: Box<dyn Syncer>,
    mark: Mark,
    last_write: u64,
    states: Digest,
}

/// Opens the database, and holds that it is whole: it has a header, and all that was acknowledged.
fn open_existing(directory: &Path, path: &Path, fresh: bool, options: SledOptions) -> Result<Whole, StoreError> {
    remove_unfinished_snapshots(path)?;
    let db = open_database(path, options)?;
    // Opening may have written: the log's tail is cleared, a snapshot file renamed.
    sync_database(path)?;
    check_header(directory, path, &db)?;
    let (last_write, told) = last_write(&db)?;
    let (mark, noted) = check_mark(directory, last_write, fresh)?;
    let states = check_states(directory, &db, told, noted)?;
    mark.sync().map_err(|source| io(&directory.join(MARK), "noting the last write in", source))?;
    sync_directory(directory)?;
    let data = path.join("db");
    let syncer = File::open(&data).map_err(|source| io(&data, "opening", source))?;
    Ok(Whole { db, syncer: Box::new(FileSyncer(syncer)), mark, last_write, states })
}

pub(super) fn io(path: &Path, doing: &str, source: std::io::Error) -> StoreError {
    StoreError::Io { what: format!("{doing} {}", path.display()), source }
}

pub(super) fn no_store(directory: &Path, why: &str) -> StoreError {
    StoreError::NoStore { directory: directory.display().to_string(), why: why.to_owned() }
}

fn exists(path: &Path) -> Result<bool, StoreError> {
    path.try_exists().map_err(|source| io(path, "looking for", source))
}

/// Makes a directory and those above it, and syncs the entry of each that it made.
fn create_directories(directory: &Path) -> Result<(), StoreError> {
    let mut missing: Vec<&Path> = Vec::new();
    let mut here = Some(directory).filter(|path| !path.as_os_str().is_empty());
    while let Some(path) = here {
        if exists(path)? {
            break;
        }
        missing.push(path);
        here = path.parent().filter(|parent| !parent.as_os_str().is_empty());
    }
    for path in missing.into_iter().rev() {
        match fs::create_dir(path) {
            Err(error) if error.kind() != std::io::ErrorKind::AlreadyExists => {
                return Err(io(path, "creating", error));
            }
            _ => sync_directory(parent_of(path))?,
        }
    }
    Ok(())
}

fn parent_of(path: &Path) -> &Path {
    path.parent().filter(|parent| !parent.as_os_str().is_empty()).unwrap_or(Path::new("."))
}

pub(super) fn sync_directory(path: &Path) -> Result<(), StoreError> {
    File::open(path).and_then(|file| file.sync_all()).map_err(|source| io(path, "syncing", source))
}

/// Syncs every file of a database and the directories that name them.
pub(super) fn sync_database(path: &Path) -> Result<(), StoreError> {
    for entry in fs::read_dir(path).map_err(|source| io(path, "reading", source))? {
        let entry = entry.map_err(|source| io(path, "reading", source))?.path();
        sync_directory(&entry)?;
    }
    sync_directory(path)
}

fn lock_directory(directory: &Path) -> Result<File, StoreError> {
    let path = directory.join("lock");
    let file = File::options()
        .create(true)
        .truncate(false)
        .write(true)
        .open(&path)
        .map_err(|source| io(&path, "opening", source))?;
    let deadline = Instant::now() + LOCK_PATIENCE;
    loop {
        match file.try_lock() {
            Ok(()) => return Ok(file),
            // A child process that is just being started holds what its parent had open until it becomes another program.
            Err(TryLockError::WouldBlock) if Instant::now() < deadline => std::thread::sleep(LOCK_RETRY),
            Err(TryLockError::WouldBlock) => {
                return Err(StoreError::Locked { directory: directory.display().to_string() });
            }
            Err(TryLockError::Error(source)) => return Err(io(&path, "locking", source)),
        }
    }
}

/// Refuses a directory without a database that looks as if it had held one.
pub(super) fn check_blank(directory: &Path) -> Result<(), StoreError> {
    for entry in fs::read_dir(directory).map_err(|source| io(directory, "reading", source))? {
        let name = entry.map_err(|source| io(directory, "reading", source))?.file_name();
        let name = name.to_string_lossy();
        let telling =
            [MARK, CURRENT, KEPT, COPIES, "db", "conf", "blobs"].contains(&&*name) || name.starts_with("snap.");
        if telling || (name.starts_with(DATABASE) && name != CREATING) {
            return Err(no_store(
                directory,
                &format!(
                    "it holds {name:?} but no store in sled/: a new store is not started beside what is left of one"
                ),
            ));
        }
    }
    Ok(())
}

/// Makes an empty store. Refuses a directory that looks as if it had held one.
fn create_store(directory: &Path, options: SledOptions) -> Result<(), StoreError> {
    check_blank(directory)?;
    let creating = directory.join(CREATING);
    if exists(&creating)? {
        // Left by a process that ended while it made the store; nothing was accepted into it yet.
        fs::remove_dir_all(&creating).map_err(|source| io(&creating, "removing", source))?;
    }
    let created = SystemTime::now().duration_since(SystemTime::UNIX_EPOCH).map_or(0.0, |since| since.as_secs_f64());
    let program = format!("ubbmap {}", env!("CARGO_PKG_VERSION"));
    let header = Header { format: STORE_FORMAT, created, program };
    {
        let db = open_database(&creating, options)?;
        let write = |key: &[u8], content: &[u8]| {
            guarded("writing the store's header", || db.insert(key, record::seal(key, 0, content)))
        };
        write(&keys::HEADER, &header.encode())?;
        write(&keys::NEXT_MAP, &1_u32.to_be_bytes())?;
        guarded("writing the store's header", || db.insert(keys::LAST_WRITE, record_of_write(0, Digest::default())))?;
        guarded("flushing the new store", || db.flush())?;
        sync_database(&creating)?;
    }
    let path = directory.join(DATABASE);
    // Again after the close, which may have written.
    sync_database(&creating)?;
    fs::rename(&creating, &path).map_err(|source| io(&creating, "renaming", source))?;
    sync_directory(directory)?;
    tracing::info!(directory = %directory.display(), format = STORE_FORMAT, "created an empty store");
    Ok(())
}

/// sled takes a snapshot of its page table when it opens, as `snap.N.generating`, and renames it when it is whole. What an
/// opening that was cut off has left of one would be taken for the newest snapshot, and refused as damaged. The one
/// before it is still there, or the whole log.
fn remove_unfinished_snapshots(path: &Path) -> Result<(), StoreError> {
    for entry in fs::read_dir(path).map_err(|source| io(path, "reading", source))? {
        let name = entry.map_err(|source| io(path, "reading", source))?.file_name();
        let text = name.to_string_lossy();
        if text.starts_with("snap.") && text.ends_with(".generating") {
            let unfinished = path.join(&name);
            fs::remove_file(&unfinished).map_err(|source| io(&unfinished, "removing", source))?;
            tracing::warn!(file = %unfinished.display(), "removed what an opening that was cut off had left");
        }
    }
    Ok(())
}

/// Opens a database. Damage can make sled panic: that is an error here, and the directory stays as it is.
pub(super) fn open_database(path: &Path, options: SledOptions) -> Result<Database, StoreError> {
    let deadline = Instant::now() + LOCK_PATIENCE;
    loop {
        let config = sled::Config::new().path(path).cache_capacity(options.cache_bytes).flush_every_ms(None);
        match catch_unwind(AssertUnwindSafe(|| config.open())) {
            Ok(Ok(db)) => return Ok(Database(Some(db))),
            Ok(Err(sled::Error::Io(error))) if error.to_string().contains("could not acquire lock") => {
                if Instant::now() > deadline {
                    return Err(StoreError::Locked { directory: path.display().to_string() });
                }
                std::thread::sleep(LOCK_RETRY);
            }
            Ok(Err(sled::Error::Io(source))) => return Err(io(path, "opening", source)),
            Ok(Err(error)) => return Err(damaged_database(path, &error.to_string())),
            Err(panic) => return Err(damaged_database(path, &panic_text(panic.as_ref()))),
        }
    }
}

fn damaged_database(path: &Path, why: &str) -> StoreError {
    StoreError::Damaged {
        what: format!(
            "{}: the database cannot be opened ({why}); keep a copy of the directory and restore a backup",
            path.display()
        ),
    }
}

fn panic_text(panic: &(dyn std::any::Any + Send)) -> String {
    let text = panic.downcast_ref::<String>().map(String::as_str).or_else(|| panic.downcast_ref::<&str>().copied());
    text.unwrap_or("sled panicked").chars().take(300).collect()
}

/// Calls sled: its errors and panics become the store's errors.
pub(super) fn guarded<T>(what: &str, call: impl FnOnce() -> sled::Result<T>) -> Result<T, StoreError> {
    match catch_unwind(AssertUnwindSafe(call)) {
        Ok(Ok(value)) => Ok(value),
        Ok(Err(sled::Error::Io(source))) => Err(StoreError::Io { what: what.to_owned(), source }),
        Ok(Err(error)) => Err(StoreError::Damaged { what: format!("{what}: {error}") }),
        Err(panic) => Err(StoreError::Damaged { what: format!("{what}: {}", panic_text(panic.as_ref())) }),
    }
}

/// Wakes what hangs in a database in which a write has failed: see [`super::nudge`].
pub(super) fn wake(db: &sled::Db) {
    if db.context.global_error().is_err() {
        // It fails as the one that hangs should have, and wakes that one.
        let _ = guarded("waking a flush", || db.flush());
    }
}

/// A database without a sound header is not taken for an empty store.
fn check_header(directory: &Path, path: &Path, db: &Database) -> Result<(), StoreError> {
    let value = guarded("reading the store's header", || db.get(keys::HEADER))?.ok_or_else(|| {
        no_store(directory, "its database has no header: it is damaged or not a store; restore the directory")
    })?;
    let content = record::open(&keys::HEADER, Kind::Header, &value)?.content;
    let found = Header::format_of(content).map_err(|why| record::damaged(&keys::HEADER, &why.to_string()))?;
    migrate(db, found, &mut |format| {
        let mut content = content.to_vec();
        content[..4].copy_from_slice(&format.to_be_bytes());
        guarded("writing the store's header", || {
            db.insert(keys::HEADER, record::seal(&keys::HEADER, 0, &content))?;
            db.flush()
        })?;
        sync_database(path)
    })
}

/// The number of the last write in the database, and the digest of the maps' states with it.
fn last_write(db: &Database) -> Result<(u64, Option<Digest>), StoreError> {
    let key = keys::LAST_WRITE;
    let value = guarded("reading the number of the last write", || db.get(key))?
        .ok_or_else(|| record::damaged(&key, "missing"))?;
    last_write_of(&value)
}

/// Refuses a database in which the state of a map is one of earlier: sled can lose what a part of its log had, in the
/// middle too. A store whose number of the last acknowledged write was removed is taken as it is.
fn check_states(directory: &Path, db: &Database, told: Option<Digest>, noted: bool) -> Result<Digest, StoreError> {
    let found = states_of(db)?;
    match (told, found) {
        (Some(told), Some(found)) if told != found && noted => Err(StoreError::Damaged {
            what: format!(
                "{}: the revision of a map is not the one that the number of the last write goes with: a part of the log is \
                 lost, and a map has gone back to an earlier revision. Keep a copy of the directory and restore a backup; to \
                 go on with what is left, remove the file {MARK:?}",
                directory.display()
            ),
        }),
        (_, Some(found)) => Ok(found),
        // The states that are damaged are told of by themselves; what is left goes with the number from now on.
        (told, None) => Ok(told.unwrap_or_default()),
    }
}

/// Refuses a database that has lost writes that were acknowledged.
///
/// Tells whether there was a number to hold it against.
fn check_mark(directory: &Path, last_write: u64, fresh: bool) -> Result<(Mark, bool), StoreError> {
    let failed = |source| io(&directory.join(MARK), "noting the last write in", source);
    let (mut mark, noted) = Mark::open(directory).map_err(failed)?;
    match noted {
        Some(noted) if noted > last_write => {
            return Err(StoreError::Damaged {
                what: format!(
                    "{}: the database ends with write {last_write}, but {noted} were acknowledged: the later ones are \
                     lost, maps have gone back to earlier revisions. Keep a copy of the directory and restore a backup; \
                     to go on with what is left, remove the file {MARK:?}",
                    directory.display()
                ),
            });
        }
        None if !fresh => tracing::warn!(
            directory = %directory.display(),
            "no number of the last acknowledged write: a loss of writes could not have been seen"
        ),
        _ => {}
    }
    mark.note(last_write).map_err(failed)?;
    Ok((mark, noted.is_some()))
}

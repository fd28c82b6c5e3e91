//! The last snapshot of each map as a file beside the database: what is left when the database cannot be opened at all.
//!
//! `DIR/copies/MAP.ubbmap` is a map file as an export writes it. It is written after the snapshot is durable, under
//! another name first, and replaces that of an earlier snapshot.

use super::{LoadedMap, MapName, StoreError, map_file};
use crate::mapping::MapConfig;
use std::fs::{self, File};
use std::io::{self, BufReader};
use std::path::{Path, PathBuf};

/// The directory within the data directory.
pub(super) const COPIES: &str = "copies";

const ENDING: &str = ".ubbmap";

fn failed(path: &Path, doing: &str, source: io::Error) -> StoreError {
    StoreError::Io { what: format!("{doing} {}", path.display()), source }
}

fn path_of(directory: &Path, name: &MapName) -> PathBuf {
    directory.join(COPIES).join(format!("{name}{ENDING}"))
}

/// Writes a map's file in place of the one before.
pub(super) fn keep(directory: &Path, name: &MapName, config: &MapConfig, map: &LoadedMap) -> Result<(), StoreError> {
    let folder = directory.join(COPIES);
    let made = match fs::create_dir(&folder) {
        Err(error) if error.kind() == io::ErrorKind::AlreadyExists => Ok(()),
        Err(error) => Err(error),
        Ok(()) => File::open(directory).and_then(|directory| directory.sync_all()),
    };
    made.map_err(|source| failed(&folder, "creating", source))?;
    // No map's name begins so.
    let writing = folder.join(format!(".{name}.writing"));
    let written = (|| {
        let mut file = io::BufWriter::new(File::create(&writing)?);
        map_file::write_map_file(&mut file, config, map).map_err(io::Error::other)?;
        file.into_inner().map_err(io::IntoInnerError::into_error)?.sync_all()?;
        fs::rename(&writing, path_of(directory, name))?;
        File::open(&folder)?.sync_all()
    })();
    written.map_err(|source| {
        let _ = fs::remove_file(&writing);
        failed(&path_of(directory, name), "writing", source)
    })
}

/// Removes the file of a map that is deleted.
pub(super) fn remove(directory: &Path, name: &MapName) {
    let path = path_of(directory, name);
    match fs::remove_file(&path) {
        Err(error) if error.kind() != io::ErrorKind::NotFound => {
            tracing::warn!("the copy of a deleted map is left, {}: {error}", path.display());
        }
        _ => {}
    }
}

/// What a store that does not open says, with the copies that there are.
pub(super) fn offer(directory: &Path, error: StoreError) -> StoreError {
    let told = |why: String| match sound(directory) {
        copies if copies.is_empty() => why,
        copies => format!(
            "{why}; sound copies of snapshots are in {}: {}. To go on with them, start with another data directory and \
             import each: ubbmap map import NAME FILE",
            directory.join(COPIES).display(),
            copies.join(", ")
        ),
    };
    match error {
        StoreError::Damaged { what } => StoreError::Damaged { what: told(what) },
        StoreError::NoStore { directory, why } => StoreError::NoStore { directory, why: told(why) },
        other => other,
    }
}

/// The copies that can be read, each with its revision.
fn sound(directory: &Path) -> Vec<String> {
    let Ok(files) = fs::read_dir(directory.join(COPIES)) else { return Vec::new() };
    let read = |path: PathBuf| {
        let file = path.file_name()?.to_str()?.to_owned();
        let name = MapName::new(file.strip_suffix(ENDING)?).ok()?;
        let (_, map) = map_file::read_map_file(&mut BufReader::new(File::open(&path).ok()?)).ok()?;
        Some(format!("{name} at revision {}", map.revision))
    };
    let mut copies: Vec<_> = files.flatten().filter_map(|file| read(file.path())).collect();
    copies.sort();
    copies
}

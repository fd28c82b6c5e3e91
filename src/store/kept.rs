//! What a database was before it is opened.
//!
//! Opening writes: sled clears its log behind the first message that it cannot read, whatever stands there. If that was
//! damage and not the log's end, the later commits, sound so far, would go with it. So the files are copied before they
//! are opened. The copy goes when the store has opened with all that was acknowledged; else it stays as `DIR/damaged`.

use super::StoreError;
use std::fs;
use std::io;
use std::path::{Path, PathBuf};

/// The name under which the files of a database that did not open are kept.
pub(super) const KEPT: &str = "damaged";

/// The copy while the database is being opened, and while the copy is being made.
const COPY: &str = "before-opening";
const COPYING: &str = "before-opening.copying";

/// Larger databases are not copied: the time and the room would be felt.
const MOST_BYTES: u64 = 256 << 20;

/// A database's files as they were.
pub(super) struct Before {
    directory: PathBuf,
    copied: bool,
}

impl Before {
    /// Copies a database of the data directory. Without room for it the database is opened all the same: a full disk
    /// is no reason not to serve what is on it.
    pub(super) fn keep(directory: &Path, database: &Path) -> Self {
        let copied = copy_once(directory, database).unwrap_or_else(|error| {
            tracing::warn!(directory = %directory.display(), %error, "opened without a copy of what it was before");
            let _ = fs::remove_dir_all(directory.join(COPYING));
            false
        });
        Self { directory: directory.to_owned(), copied }
    }

    /// The store has opened: the copy goes.
    pub(super) fn opened(self) {
        if let Err(error) = fs::remove_dir_all(self.directory.join(COPY))
            && error.kind() != io::ErrorKind::NotFound
        {
            tracing::warn!(directory = %self.directory.display(), %error, "a copy of the database is left");
        }
        let kept = self.directory.join(KEPT);
        if kept.exists() {
            tracing::warn!(directory = %kept.display(), "kept from an opening that failed: remove it when it is not needed");
        }
    }

    /// The store did not open: where it is damaged, the copy is kept, and the error tells where.
    pub(super) fn refused(self, error: StoreError) -> StoreError {
        let kept = self.directory.join(KEPT);
        let there = || {
            if self.copied && !kept.exists() {
                fs::rename(self.directory.join(COPY), &kept).is_ok()
            } else {
                kept.exists()
            }
        };
        let told =
            |why: String| format!("{why}; its files as they were before they were opened are in {}", kept.display());
        match error {
            StoreError::Damaged { what } if there() => StoreError::Damaged { what: told(what) },
            StoreError::NoStore { directory, why } if there() => StoreError::NoStore { directory, why: told(why) },
            other => other,
        }
    }
}

/// True when there is a copy of the database as it was before the first opening that did not come to its end.
fn copy_once(directory: &Path, database: &Path) -> io::Result<bool> {
    let (copy, copying) = (directory.join(COPY), directory.join(COPYING));
    if directory.join(KEPT).exists() {
        return Ok(false);
    }
    if copy.exists() {
        return Ok(true);
    }
    if copying.exists() {
        fs::remove_dir_all(&copying)?;
    }
    let files = fs::read_dir(database)?.collect::<io::Result<Vec<_>>>()?;
    let mut bytes = 0;
    for file in &files {
        bytes += file.metadata()?.len();
    }
    if bytes > MOST_BYTES {
        return Ok(false);
    }
    fs::create_dir(&copying)?;
    for file in files {
        // `blobs`, the one directory, stays empty.
        if file.file_type()?.is_file() {
            fs::copy(file.path(), copying.join(file.file_name()))?;
        }
    }
    fs::rename(&copying, &copy)?;
    Ok(true)
}

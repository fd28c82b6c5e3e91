//! The text of a file of tokens, changed by one entry. Everything else in it stays as people wrote it.

use crate::cli::output::write_private;
use crate::transport::access::{Grant, Roll, TokenHash};
use anyhow::{Context, bail};
use serde::Serialize;
use std::fs::File;
use std::path::{Path, PathBuf};
use std::time::SystemTime;

/// What a file begins with that is made.
const HEAD: &str = "# Who may do what on an ubbmap server: docs/access.md. Only hashes of tokens are here.\n\
    # The server takes changes over while it runs.\n";

/// Beginnings of entries.
const HEADERS: [&str; 2] = ["[[token]]", "[[certificate]]"];

/// A file of tokens.
#[derive(Debug)]
pub(super) struct TokenFile {
    path: PathBuf,
    text: String,
    roll: Roll,
    /// Held from the reading to the writing, so that of two who change a file at a time neither undoes the other.
    _alone: Option<File>,
}

#[derive(Serialize)]
struct Written<'a> {
    name: &'a str,
    sha256: String,
    role: &'a str,
    maps: &'a [String],
    #[serde(skip_serializing_if = "Option::is_none")]
    robot: Option<&'a str>,
    #[serde(skip_serializing_if = "Option::is_none")]
    expires: Option<String>,
}

#[derive(Serialize)]
struct Document<'a> {
    token: [Written<'a>; 1],
}

fn text(path: &Path) -> anyhow::Result<String> {
    std::fs::read_to_string(path).with_context(|| format!("cannot read {}", path.display()))
}

/// Waits until nobody else changes the file. The file itself is replaced when it is changed, so the lock is on one beside it,
/// which stays: who takes it away may leave two with a lock.
fn lock(path: &Path) -> anyhow::Result<File> {
    let followed = std::fs::canonicalize(path);
    let mut name = followed.as_deref().unwrap_or(path).as_os_str().to_owned();
    name.push(".lock");
    let lock = PathBuf::from(name);
    let mut options = File::options();
    options.create(true).truncate(false).write(true);
    #[cfg(unix)]
    std::os::unix::fs::OpenOptionsExt::mode(&mut options, 0o600);
    let file = options.open(&lock).and_then(|file| file.lock().map(|()| file));
    file.with_context(|| format!("cannot lock {}, which keeps two changes apart", lock.display()))
}

/// The lines of an entry.
///
/// # Errors
/// None for an entry that can be read again.
pub(super) fn entry(name: &str, hash: &TokenHash, grant: &Grant) -> anyhow::Result<String> {
    let written = Written {
        name,
        sha256: hash.to_string(),
        role: grant.role.word(),
        maps: grant.maps.patterns(),
        robot: grant.robot.as_ref().map(|robot| robot.as_str()),
        expires: grant.expires.map(time),
    };
    Ok(toml::to_string(&Document { token: [written] })?)
}

/// A time as the file has it.
pub(super) fn time(at: SystemTime) -> String {
    humantime::format_rfc3339_seconds(at).to_string()
}

impl TokenFile {
    /// Reads a file.
    ///
    /// # Errors
    /// That it is not there or not valid, and where.
    pub(super) fn read(path: &Path) -> anyhow::Result<Self> {
        Self::of(path, text(path)?, None)
    }

    /// Reads a file that is to be changed. Waits until nobody else changes it.
    ///
    /// # Errors
    /// As [`TokenFile::read`], and where it cannot be locked.
    pub(super) fn read_to_change(path: &Path) -> anyhow::Result<Self> {
        // What is not there needs no lock, and gets none beside it.
        text(path)?;
        let alone = lock(path)?;
        Self::of(path, text(path)?, Some(alone))
    }

    /// Reads a file that is to be changed, or begins one.
    ///
    /// # Errors
    /// As [`TokenFile::read_to_change`], but for a file that is not there.
    pub(super) fn read_or_begin(path: &Path) -> anyhow::Result<Self> {
        let alone = lock(path)?;
        // A link that leads nowhere is there, and would be written through: it is read, which says what is wrong.
        if path.symlink_metadata().is_err_and(|error| error.kind() == std::io::ErrorKind::NotFound) {
            return Self::of(path, HEAD.to_owned(), Some(alone));
        }
        Self::of(path, text(path)?, Some(alone))
    }

    fn of(path: &Path, text: String, alone: Option<File>) -> anyhow::Result<Self> {
        let roll =
            Roll::parse(&text).map_err(|problem| anyhow::anyhow!("{} is not valid: {problem}", path.display()))?;
        Ok(Self { path: path.to_owned(), text, roll, _alone: alone })
    }

    /// Its entries.
    pub(super) fn roll(&self) -> &Roll {
        &self.roll
    }

    /// Has it an entry of this name?
    pub(super) fn has(&self, name: &str) -> bool {
        self.names().any(|known| known == name)
    }

    fn names(&self) -> impl Iterator<Item = &str> {
        self.roll.entries().iter().map(|entry| entry.caller.name())
    }

    /// Adds an entry behind the others.
    ///
    /// # Errors
    /// When the file would not be valid, or cannot be written.
    pub(super) fn add(mut self, entry: &str) -> anyhow::Result<()> {
        if !self.text.is_empty() && !self.text.ends_with('\n') {
            self.text.push('\n');
        }
        self.text.push('\n');
        self.text.push_str(entry);
        self.write()
    }

    /// Takes an entry out, with the blank lines behind it.
    ///
    /// # Errors
    /// When it is not there or not to be told from its neighbours, or the file cannot be written.
    pub(super) fn remove(mut self, name: &str) -> anyhow::Result<()> {
        if !self.has(name) {
            bail!("{} has no entry {name:?}; `ubbmap token list` shows those there are", self.path.display());
        }
        let kept: Vec<String> = self.names().filter(|known| *known != name).map(str::to_owned).collect();
        let lines: Vec<&str> = self.text.split_inclusive('\n').collect();
        let begins = |line: &&str| line.trim_start().starts_with('[');
        for (start, line) in lines.iter().enumerate() {
            if !HEADERS.iter().any(|header| line.trim_start().starts_with(header)) {
                continue;
            }
            let end = lines[start + 1..].iter().position(begins).map_or(lines.len(), |at| start + 1 + at);
            // What stands above the next entry as a comment is about that one.
            let comments =
                lines[start + 1..end].iter().rev().take_while(|line| line.trim_start().starts_with('#')).count();
            let end = if end == lines.len() { end } else { end - comments };
            let without = [&lines[..start], &lines[end..]].concat().concat();
            // That the right lines went is proven by what is left.
            if Roll::parse(&without).is_ok_and(|roll| roll.entries().iter().map(|e| e.caller.name()).eq(kept.iter())) {
                self.text = without;
                return self.write();
            }
        }
        bail!("the lines of {name:?} in {} cannot be told from the others: take them out by hand", self.path.display())
    }

    fn write(self) -> anyhow::Result<()> {
        // The server must not be given a file that it refuses.
        let invalid = |problem| anyhow::anyhow!("the new {} would not be valid: {problem}", self.path.display());
        Roll::parse(&self.text).map_err(invalid)?;
        write_private(&self.path, self.text.as_bytes()).with_context(|| format!("cannot write {}", self.path.display()))
    }
}

//! Names of maps, robots and snapshots.

use crate::mapping::is_name;
use std::fmt;
use thiserror::Error;

/// A name that breaks the rule.
#[derive(Debug, Clone, PartialEq, Eq, Error)]
#[error("{what} name {name:?} is not allowed: it must match {rule}")]
pub struct NameError {
    /// `map`, `robot` or `snapshot`.
    pub what: &'static str,
    /// What was given.
    pub name: String,
    /// The rule, a regular expression.
    pub rule: &'static str,
}

/// A map's name: `[a-z0-9][a-z0-9_-]{0,62}`.
#[derive(Debug, Clone, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct MapName(String);

impl MapName {
    /// Checks a name.
    ///
    /// # Errors
    /// [`NameError`] when it breaks the rule.
    pub fn new(name: &str) -> Result<Self, NameError> {
        if is_name(name) {
            Ok(Self(name.to_owned()))
        } else {
            Err(NameError { what: "map", name: name.chars().take(80).collect(), rule: "[a-z0-9][a-z0-9_-]{0,62}" })
        }
    }

    /// The name.
    #[must_use]
    pub fn as_str(&self) -> &str {
        &self.0
    }
}

impl fmt::Display for MapName {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0)
    }
}

/// A robot's name: `[A-Za-z0-9][A-Za-z0-9_.-]{0,62}`, one chunk of a Zenoh key.
#[derive(Debug, Clone, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct RobotName(String);

impl RobotName {
    /// Checks a name.
    ///
    /// # Errors
    /// [`NameError`] when it breaks the rule.
    pub fn new(name: &str) -> Result<Self, NameError> {
        loose(name, "robot").map(Self)
    }

    /// The name.
    #[must_use]
    pub fn as_str(&self) -> &str {
        &self.0
    }
}

impl fmt::Display for RobotName {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0)
    }
}

/// The rule of names that people write: one chunk of a Zenoh key, one segment of a path.
fn loose(name: &str, what: &'static str) -> Result<String, NameError> {
    let bytes = name.as_bytes();
    let fits = (1..=63).contains(&bytes.len())
        && bytes[0].is_ascii_alphanumeric()
        && bytes.iter().all(|b| b.is_ascii_alphanumeric() || b"_.-".contains(b));
    if fits {
        Ok(name.to_owned())
    } else {
        Err(NameError { what, name: name.chars().take(80).collect(), rule: "[A-Za-z0-9][A-Za-z0-9_.-]{0,62}" })
    }
}

/// A snapshot's name: `[A-Za-z0-9][A-Za-z0-9_.-]{0,62}`.
#[derive(Debug, Clone, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct SnapshotName(String);

impl SnapshotName {
    /// Checks a name.
    ///
    /// # Errors
    /// [`NameError`] when it breaks the rule.
    pub fn new(name: &str) -> Result<Self, NameError> {
        loose(name, "snapshot").map(Self)
    }

    /// The name.
    #[must_use]
    pub fn as_str(&self) -> &str {
        &self.0
    }
}

impl fmt::Display for SnapshotName {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0)
    }
}

//! Who may connect to the server's own router, by user name and password: a file that people write.
//!
//! Zenoh proves a password without sending it, which takes the password itself on both sides. So it cannot be kept as a hash, and the
//! file is for the server's user alone.

use crate::store::RobotName;
use crate::transport::access::{Grant, MapScope, Role, unquoted};
use serde::Deserialize;
use std::collections::BTreeSet;
use std::io::Read;
use std::path::Path;

/// Largest file, bytes.
const MOST_BYTES: u64 = 1 << 20;

/// Most users: Zenoh looks through the rules of all of them for every connection.
const MOST_USERS: usize = 10_000;

/// Shortest password, characters: without TLS, whoever listens may try passwords at home.
const LEAST_PASSWORD: usize = 12;

/// Longest password, bytes.
const MOST_PASSWORD: usize = 256;

/// What stands for any robot.
const ANY: &str = "*";

/// One who may connect.
#[derive(Clone, PartialEq, Eq)]
pub struct User {
    /// The name.
    pub name: String,
    /// The password.
    pub password: String,
    /// What they may do.
    pub grant: Grant,
}

impl std::fmt::Debug for User {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("User").field("name", &self.name).field("grant", &self.grant).finish_non_exhaustive()
    }
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Document {
    #[serde(default)]
    user: Vec<Written>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Written {
    name: String,
    password: String,
    role: String,
    maps: Vec<String>,
    robot: Option<String>,
}

/// Reads a file of users. Blocks.
///
/// # Errors
/// What is wrong with it, as a sentence that quotes no password.
pub fn read(path: &Path) -> Result<Vec<User>, String> {
    let failed = |error: std::io::Error| format!("cannot read {}: {error}", path.display());
    let known = std::fs::metadata(path).map_err(failed)?;
    if !known.is_file() {
        return Err(format!("{} is no file: a pipe or a device would be read without end", path.display()));
    }
    // It may grow after it was looked at.
    let mut text = String::new();
    let file = std::fs::File::open(path).map_err(failed)?;
    file.take(MOST_BYTES + 1).read_to_string(&mut text).map_err(failed)?;
    if text.len() as u64 > MOST_BYTES {
        return Err(format!("{} has more than {MOST_BYTES} bytes, the limit", path.display()));
    }
    let users = parse(&text).map_err(|problem| format!("{}: {problem}", path.display()))?;
    warn_if_readable(path, &known);
    Ok(users)
}

/// The users of a text.
///
/// # Errors
/// The line or the user, and what is wrong; no password is quoted.
pub fn parse(text: &str) -> Result<Vec<User>, String> {
    let document: Document = toml::from_str(text).map_err(|error| {
        let line = error.span().map(|span| 1 + text.bytes().take(span.start).filter(|byte| *byte == b'\n').count());
        let at = line.map(|line| format!("line {line}: ")).unwrap_or_default();
        // The library's own words quote the value, which may be the password.
        let words = error.message();
        let names_a_field = ["unknown field", "missing field", "duplicate key"].iter().any(|&w| words.starts_with(w));
        let why = if names_a_field { words.lines().next().unwrap_or(words) } else { "this is not TOML of users" };
        // A field may have a password for its name.
        let why = unquoted(why);
        format!("{at}{why}")
    })?;
    if document.user.is_empty() {
        return Err("names nobody: it takes a table [[user]] with name, password, role and maps for each".to_owned());
    }
    if document.user.len() > MOST_USERS {
        return Err(format!("has {} users, the limit is {MOST_USERS}", document.user.len()));
    }
    let (mut users, mut names) = (Vec::new(), BTreeSet::new());
    for (index, written) in document.user.into_iter().enumerate() {
        let name: String = written.name.chars().take(80).collect();
        let user = written.user().map_err(|problem| format!("user {} ({name:?}): {problem}", index + 1))?;
        if !names.insert(user.name.clone()) {
            return Err(format!("two users have the name {name:?}"));
        }
        users.push(user);
    }
    Ok(users)
}

impl Written {
    fn user(self) -> Result<User, String> {
        // The rule of robots' names: a chunk of a key, and nothing that Zenoh's own file of passwords would take apart.
        let name = RobotName::new(&self.name).map_err(|_| {
            "name must be letters, digits, _, . and -, at most 63, with a letter or digit first".to_owned()
        })?;
        if self.password.chars().count() < LEAST_PASSWORD || self.password.len() > MOST_PASSWORD {
            return Err(format!(
                "password must have {LEAST_PASSWORD} characters at least, and {MOST_PASSWORD} bytes at most"
            ));
        }
        if self.password.chars().any(char::is_control) || self.password.trim() != self.password {
            return Err("password must have no blank at either end, and no line breaks or tabs".to_owned());
        }
        let role: Role = self.role.parse()?;
        let maps = MapScope::new(&self.maps)?;
        let robot = match (role, self.robot.as_deref()) {
            (Role::Read, Some(_)) => return Err("robot is for those who send scans, not for the role read".to_owned()),
            (Role::Read | Role::Admin, None) | (_, Some(ANY)) => None,
            (Role::Write, None) => Some(name.clone()),
            (_, Some(robot)) => Some(RobotName::new(robot).map_err(|error| error.to_string())?),
        };
        let grant = Grant { role, maps, robot, expires: None };
        Ok(User { name: name.to_string(), password: self.password, grant })
    }
}

/// Passwords that everybody on the machine can read are worth a line.
#[cfg(unix)]
fn warn_if_readable(path: &Path, known: &std::fs::Metadata) {
    use std::os::unix::fs::PermissionsExt;
    if known.permissions().mode() & 0o004 != 0 {
        tracing::warn!("everybody on this machine can read the passwords in {}: chmod 600", path.display());
    }
}

#[cfg(not(unix))]
fn warn_if_readable(_: &Path, _: &std::fs::Metadata) {}

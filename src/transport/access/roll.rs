//! The file that says who may do what: one entry for each token or client certificate.

use super::caller::{Caller, Grant, MapScope, Role};
use super::token::{PREFIX, TokenHash};
use crate::store::RobotName;
use crate::transport::tls::Named;
use serde::Deserialize;
use std::collections::{BTreeMap, BTreeSet};
use std::path::PathBuf;
use std::time::SystemTime;
use thiserror::Error;

/// Largest file, bytes.
pub(super) const MOST_BYTES: u64 = 4 << 20;

/// Most entries: each request is compared with all of them.
const MOST_ENTRIES: usize = 10_000;

/// What stands for any robot where a certificate's own is what is meant by saying nothing.
const ANY_ROBOT: &str = "*";

/// Longest name of a field that a message tells, characters. What is longer may be a secret.
const LONGEST_FIELD: usize = 16;

/// Longest name of an entry, characters.
const LONGEST_NAME: usize = 80;

/// Why a file of tokens is not taken.
#[derive(Debug, Error)]
pub enum RollError {
    /// It cannot be read.
    #[error("cannot read the file of tokens {path}: {source}")]
    File {
        /// The file.
        path: PathBuf,
        /// Why.
        source: std::io::Error,
    },
    /// What it says makes no sense.
    #[error("the file of tokens {path} is not valid: {problem}")]
    Content {
        /// The file.
        path: PathBuf,
        /// Where and what. It quotes nothing that may be a token.
        problem: String,
    },
}

/// What an entry proves itself by.
#[derive(Debug, Clone)]
pub enum Proof {
    /// A token with this hash.
    Token(TokenHash),
    /// A client certificate with this name, signed by the authority that the listener trusts.
    Certificate {
        /// The name, or the beginning of names with `*` behind it.
        name: String,
        /// It sends scans of the robot of the certificate's own name.
        own_robot: bool,
    },
}

impl Proof {
    fn equals(&self, other: &Self) -> bool {
        match (self, other) {
            (Self::Token(own), Self::Token(other)) => own.equals(other),
            (Self::Certificate { name, own_robot }, Self::Certificate { name: other, own_robot: its }) => {
                name == other && own_robot == its
            }
            _ => false,
        }
    }
}

/// One entry.
#[derive(Debug, Clone)]
pub struct Entry {
    /// How it is shown.
    pub proof: Proof,
    /// Who that is.
    pub caller: Caller,
}

/// All entries of a file.
#[derive(Debug, Default)]
pub struct Roll {
    entries: Vec<Entry>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Document {
    #[serde(default)]
    token: Vec<Written>,
    #[serde(default)]
    certificate: Vec<Written>,
}

/// An entry as it is written.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Written {
    name: String,
    sha256: Option<String>,
    role: String,
    maps: Vec<String>,
    /// A text, or a time as TOML has it.
    expires: Option<toml::Value>,
    robot: Option<String>,
}

impl Roll {
    /// Reads the text of a file.
    ///
    /// # Errors
    /// The line or the entry, and what is wrong with it; nothing that it quotes may be a token.
    pub fn parse(text: &str) -> Result<Self, String> {
        let document: Document = toml::from_str(text).map_err(|error| {
            // The library's own text quotes the line, which may hold a token that somebody put there by mistake.
            let line = error.span().map(|span| 1 + text.bytes().take(span.start).filter(|byte| *byte == b'\n').count());
            let at = line.map(|line| format!("line {line}: ")).unwrap_or_default();
            format!("{at}{}", unquoted(error.message()))
        })?;
        Self::of(document).map_err(|problem| without_tokens(&problem))
    }

    fn of(document: Document) -> Result<Self, String> {
        if document.token.len() + document.certificate.len() > MOST_ENTRIES {
            return Err(format!("it has more than {MOST_ENTRIES} entries, the limit"));
        }
        let mut entries = Vec::new();
        for (kind, written) in [("token", document.token), ("certificate", document.certificate)] {
            for (index, written) in written.into_iter().enumerate() {
                let name = written.name.clone();
                let entry = written.entry(kind == "token");
                entries.push(entry.map_err(|problem| format!("{kind} {} ({name:?}): {problem}", index + 1))?);
            }
        }
        let (mut names, mut hashes) = (BTreeSet::new(), BTreeMap::new());
        for entry in &entries {
            let name = entry.caller.name();
            if !names.insert(name) {
                return Err(format!("two entries have the name {name:?}"));
            }
            if let Proof::Token(hash) = &entry.proof
                && let Some(other) = hashes.insert(hash.to_string(), name)
            {
                return Err(format!(
                    "the entries {other:?} and {name:?} have the same sha256: one token is of one holder"
                ));
            }
        }
        Ok(Self { entries })
    }

    /// The entries.
    #[must_use]
    pub fn entries(&self) -> &[Entry] {
        &self.entries
    }

    /// The caller that shows this token. Every entry is compared, and each in constant time.
    #[must_use]
    pub fn by_token(&self, token: &str) -> Option<&Caller> {
        let hash = TokenHash::of(token);
        let mut found = None;
        for entry in &self.entries {
            if matches!(&entry.proof, Proof::Token(known) if known.equals(&hash)) {
                found = Some(&entry.caller);
            }
        }
        found
    }

    /// The caller that shows a certificate: by the entry of its whole name, else by that of its longest beginning. What it may do
    /// ends when the certificate runs out, if not before.
    #[must_use]
    pub fn by_certificate(&self, shown: &Named) -> Option<Caller> {
        let fit = |entry: &Entry| match &entry.proof {
            Proof::Certificate { name, .. } if **name == *shown.name => Some(usize::MAX),
            Proof::Certificate { name, .. } => {
                let beginning = name.strip_suffix('*')?;
                shown.name.starts_with(beginning).then_some(beginning.len())
            }
            Proof::Token(_) => None,
        };
        let (entry, _) =
            self.entries.iter().filter_map(|entry| Some((entry, fit(entry)?))).max_by_key(|(_, length)| *length)?;
        let mut grant = entry.caller.grant().clone();
        if matches!(&entry.proof, Proof::Certificate { own_robot: true, .. }) {
            // A name that no robot can have is not taken for any robot's.
            grant.robot = Some(RobotName::new(&shown.name).ok()?);
        }
        grant.expires = Some(grant.expires.map_or(shown.until, |expires| expires.min(shown.until)));
        Some(entry.caller.shown_as(&*shown.name, grant))
    }

    /// Certificates by their whole names, with what each may do.
    #[must_use]
    pub fn certificates(&self) -> Vec<(String, Grant)> {
        let mut whole = Vec::new();
        for entry in &self.entries {
            let Proof::Certificate { name, own_robot } = &entry.proof else { continue };
            let mut grant = entry.caller.grant().clone();
            if name.ends_with('*') || entry.caller.live().is_err() {
                tracing::warn!(name, "not over Zenoh: it knows certificates by whole names, and until a restart");
                continue;
            }
            if *own_robot {
                let Ok(robot) = RobotName::new(name) else { continue };
                grant.robot = Some(robot);
            }
            whole.push((name.clone(), grant));
        }
        whole
    }

    /// Takes the place of an earlier roll: entries that are as they were keep their caller, so their streams go on. Returns the
    /// others of the earlier one, which are to be revoked once this one is in force: before that, who has a changed entry would
    /// be refused.
    #[must_use]
    pub fn succeed(&mut self, earlier: &Self) -> Vec<Caller> {
        let mut gone = Vec::new();
        for old in &earlier.entries {
            let same = self.entries.iter_mut().find(|new| {
                new.caller.name() == old.caller.name()
                    && new.caller.grant() == old.caller.grant()
                    && new.proof.equals(&old.proof)
            });
            match same {
                Some(new) => new.caller = old.caller.clone(),
                None => gone.push(old.caller.clone()),
            }
        }
        gone
    }
}

impl Written {
    fn entry(self, token: bool) -> Result<Entry, String> {
        let role: Role = self.role.parse()?;
        // A certificate's name is that of the robot, if nothing else is said.
        let own_robot = !token && role == Role::Write && self.robot.is_none();
        let proof = match (token, &self.sha256) {
            (true, Some(hash)) => Proof::Token(hash.parse().map_err(|problem| format!("sha256 {problem}"))?),
            (true, None) => return Err("sha256 is missing".to_owned()),
            (false, None) => Proof::Certificate { name: self.name.clone(), own_robot },
            (false, Some(_)) => return Err("sha256 is for tokens: a certificate is known by its name".to_owned()),
        };
        entry_name(&self.name)?;
        if own_robot && !self.name.ends_with('*') && RobotName::new(&self.name).is_err() {
            return Err("its name is no robot's name: say whose scans it sends with robot, or \"*\" for any".to_owned());
        }
        let maps = MapScope::new(&self.maps)?;
        let robot = self.robot.filter(|robot| token || robot != ANY_ROBOT);
        let robot = robot.map(|robot| RobotName::new(&robot)).transpose().map_err(|error| error.to_string())?;
        let expires = self.expires.map(|time| expiry(&written(time))).transpose()?;
        Ok(Entry { proof, caller: Caller::new(self.name, Grant { role, maps, robot, expires }) })
    }
}

fn written(time: toml::Value) -> String {
    match time {
        toml::Value::String(text) => text,
        other => other.to_string(),
    }
}

/// Checks the name of an entry: what logs and refusals call it by.
///
/// # Errors
/// The rule that it breaks.
pub fn entry_name(name: &str) -> Result<(), String> {
    let fits = !name.is_empty() && name.chars().count() <= LONGEST_NAME && !name.chars().any(char::is_control);
    if fits { Ok(()) } else { Err(format!("name must have 1 to {LONGEST_NAME} characters, none of them for control")) }
}

/// A time of RFC 3339.
///
/// # Errors
/// That it is none.
pub fn expiry(text: &str) -> Result<SystemTime, String> {
    // What it is instead is not quoted: it may be a token in the wrong place.
    humantime::parse_rfc3339(text).map_err(|_| "expires must be a time as in \"2027-01-31T00:00:00Z\"".to_owned())
}

/// A message without what it quotes of the file: values stand between quotes, the names of fields between backquotes. Of those
/// only what looks like a field's name stays: a token may stand where one should.
pub fn unquoted(message: &str) -> String {
    let mut out = String::new();
    let mut quoted: Option<(char, String)> = None;
    for c in message.chars().filter(|c| *c != '\n') {
        match &mut quoted {
            None if c == '"' || c == '`' => quoted = Some((c, String::new())),
            None => out.push(c),
            Some((mark, text)) if c == *mark => {
                let is_word =
                    text.len() <= LONGEST_FIELD && text.bytes().all(|byte| byte.is_ascii_lowercase() || byte == b'_');
                let shown = if (*mark == '`' && is_word) || text == "sha256" { text } else { "…" };
                out.push(*mark);
                out.push_str(shown);
                out.push(*mark);
                quoted = None;
            }
            Some((_, text)) => text.push(c),
        }
    }
    out
}

/// A message without the tokens in it, as of one that stands where a name should.
fn without_tokens(message: &str) -> String {
    let mut parts = message.split(PREFIX);
    let mut out = parts.next().unwrap_or_default().to_owned();
    for part in parts {
        let rest = part.trim_start_matches(|c: char| c.is_ascii_alphanumeric() || c == '_' || c == '-');
        out.extend([PREFIX, "…", rest]);
    }
    out
}

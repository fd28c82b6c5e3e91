//! Who asks, and what they may do.

use super::operation::{Operation, Reach};
use super::refusals::{Reason, Refused};
use crate::store::{MapName, RobotName};
use std::fmt;
use std::str::FromStr;
use std::sync::Arc;
use std::time::{Duration, SystemTime};
use tokio_util::sync::CancellationToken;

/// Longest sleep until an expiry: the clock that it goes by may be set meanwhile.
const LONGEST_SLEEP: Duration = Duration::from_secs(30);

/// Most patterns of maps of one caller.
const MOST_PATTERNS: usize = 1000;

/// What a caller may do; each may what the ones before may.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Role {
    /// Reads maps.
    Read,
    /// Sends scans as well.
    Write,
    /// Creates, deletes and replaces maps, and keeps snapshots as well.
    Admin,
}

impl Role {
    /// Its word.
    #[must_use]
    pub fn word(self) -> &'static str {
        match self {
            Self::Read => "read",
            Self::Write => "write",
            Self::Admin => "admin",
        }
    }
}

impl fmt::Display for Role {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.word())
    }
}

impl FromStr for Role {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let known = [Self::Read, Self::Write, Self::Admin].into_iter().find(|role| role.word() == text);
        // What it is instead is not quoted: it may be a token in the wrong place.
        known.ok_or_else(|| "role must be read, write or admin".to_owned())
    }
}

/// The maps of a caller: exact names, beginnings of names (`hall-*`), or all (`*`).
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct MapScope(Vec<String>);

impl MapScope {
    /// All maps.
    #[must_use]
    pub fn all() -> Self {
        Self(vec!["*".to_owned()])
    }

    /// The maps that patterns name.
    ///
    /// # Errors
    /// Which pattern could match no map, that there are none, or that there are more than 1000.
    pub fn new<S: AsRef<str>>(patterns: &[S]) -> Result<Self, String> {
        if patterns.is_empty() {
            return Err("maps names no map: write [\"*\"] for all".to_owned());
        }
        if patterns.len() > MOST_PATTERNS {
            return Err(format!("maps has {} patterns, the limit is {MOST_PATTERNS}", patterns.len()));
        }
        for pattern in patterns.iter().map(AsRef::as_ref) {
            let beginning = pattern.strip_suffix('*').unwrap_or(pattern);
            if pattern != "*" && MapName::new(beginning).is_err() {
                let pattern: String = pattern.chars().take(80).collect();
                return Err(format!(
                    "maps: {pattern:?} must be a map's name, the beginning of names as in \"hall-*\", or \"*\""
                ));
            }
        }
        Ok(Self(patterns.iter().map(|pattern| pattern.as_ref().to_owned()).collect()))
    }

    /// Is a map among them?
    #[must_use]
    pub fn holds(&self, map: &MapName) -> bool {
        self.0.iter().any(|pattern| match pattern.strip_suffix('*') {
            Some(beginning) => map.as_str().starts_with(beginning),
            None => map.as_str() == pattern,
        })
    }

    /// Is every map, also those to come, among them?
    #[must_use]
    pub fn is_all(&self) -> bool {
        self.0.iter().any(|pattern| pattern == "*")
    }

    /// The patterns.
    #[must_use]
    pub fn patterns(&self) -> &[String] {
        &self.0
    }
}

impl fmt::Display for MapScope {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0.join(", "))
    }
}

/// What is granted to one caller.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Grant {
    /// What they may do.
    pub role: Role,
    /// With which maps.
    pub maps: MapScope,
    /// The one robot whose scans they may send; any where there is none.
    pub robot: Option<RobotName>,
    /// Until when; for ever where there is none.
    pub expires: Option<SystemTime>,
}

impl Grant {
    /// Everything, for ever.
    #[must_use]
    pub fn everything() -> Self {
        Self { role: Role::Admin, maps: MapScope::all(), robot: None, expires: None }
    }
}

/// One caller as the transports pass it on: whoever showed a token, a client certificate, or came where nothing is asked
/// for. Cheap to clone.
#[derive(Debug, Clone)]
pub struct Caller {
    identity: Arc<Identity>,
    /// False where administration has a listener of its own and this is not it.
    administers: bool,
}

#[derive(Debug)]
struct Identity {
    name: String,
    grant: Grant,
    /// Cancelled when the grant is taken back or changed.
    revoked: CancellationToken,
}

impl Caller {
    /// A caller with a grant. Its name is what logs and refusals call it by.
    #[must_use]
    pub fn new(name: impl Into<String>, grant: Grant) -> Self {
        let identity = Identity { name: name.into(), grant, revoked: CancellationToken::new() };
        Self { identity: Arc::new(identity), administers: true }
    }

    /// Somebody who comes in by this caller's entry, by a name and with a grant of their own: both end together.
    #[must_use]
    pub fn shown_as(&self, name: impl Into<String>, grant: Grant) -> Self {
        let revoked = self.identity.revoked.child_token();
        let identity = Identity { name: name.into(), grant, revoked };
        Self { identity: Arc::new(identity), administers: self.administers }
    }

    /// Whoever comes to a server that asks for nothing.
    #[must_use]
    pub fn anyone(name: impl Into<String>) -> Self {
        Self::new(name, Grant::everything())
    }

    /// The same caller on a listener that is not for administration.
    #[must_use]
    pub fn without_administration(self) -> Self {
        Self { administers: false, ..self }
    }

    /// What logs call it by.
    #[must_use]
    pub fn name(&self) -> &str {
        &self.identity.name
    }

    /// What it may do.
    #[must_use]
    pub fn grant(&self) -> &Grant {
        &self.identity.grant
    }

    /// What it may do where it came in: its role, less administration where that has another address.
    #[must_use]
    pub fn role_here(&self) -> Role {
        if self.administers { self.grant().role } else { self.grant().role.min(Role::Write) }
    }

    /// Takes the grant back: what is refused from now on is told so, and open streams end.
    pub fn revoke(&self) {
        self.identity.revoked.cancel();
    }

    /// May it do this, with this map? For operations on one map.
    ///
    /// # Errors
    /// [`Refused`], as a sentence that names the caller, what it lacks and the way out.
    pub fn may(&self, operation: Operation, map: &MapName) -> Result<(), Refused> {
        self.may_at_all(operation)?;
        if !self.grant().maps.holds(map) {
            let detail = format!(
                "{:?} may not {} {:?}: its maps are {}",
                self.name(),
                operation.words(),
                map.as_str(),
                self.grant().maps
            );
            return Err(Refused::denied(Reason::Map, detail).at("map"));
        }
        Ok(())
    }

    /// May it do this with any map? What is known before a request has named its map.
    ///
    /// # Errors
    /// As [`Caller::may`].
    pub fn may_at_all(&self, operation: Operation) -> Result<(), Refused> {
        self.live()?;
        let (role, reach) = operation.needs();
        let (name, grant) = (self.name(), self.grant());
        if grant.role < role {
            let detail =
                format!("{name:?} has the role {} and may not {}: that takes {role}", grant.role, operation.words());
            return Err(Refused::denied(Reason::Role, detail));
        }
        if role == Role::Admin && !self.administers {
            let detail = format!(
                "nobody may {} at this address: administration has one of its own (the server's setting admin_listen)",
                operation.words()
            );
            return Err(Refused::denied(Reason::Listener, detail));
        }
        if reach == Reach::Everything && !grant.maps.is_all() {
            let detail = format!("{name:?} may not {}: its maps are {}", operation.words(), grant.maps);
            return Err(Refused::denied(Reason::Map, detail));
        }
        Ok(())
    }

    /// May it send scans of this robot?
    ///
    /// # Errors
    /// As [`Caller::may`].
    pub fn may_send_for(&self, robot: &str) -> Result<(), Refused> {
        match &self.grant().robot {
            Some(own) if own.as_str() != robot => {
                let robot: String = robot.chars().take(80).collect();
                let detail =
                    format!("{:?} sends scans of robot {:?} alone, not of {robot:?}", self.name(), own.as_str());
                Err(Refused::denied(Reason::Robot, detail).at("robot"))
            }
            _ => Ok(()),
        }
    }

    /// Is the grant still there?
    ///
    /// # Errors
    /// [`Refused`]: it was revoked, or has expired.
    pub fn live(&self) -> Result<(), Refused> {
        if self.identity.revoked.is_cancelled() {
            let detail = format!("the access of {:?} was revoked or changed: authenticate again", self.name());
            return Err(Refused::unknown(Reason::Revoked, detail));
        }
        match self.grant().expires {
            Some(expires) if expires <= SystemTime::now() => {
                let when = humantime::format_rfc3339_seconds(expires);
                let detail = format!("the access of {:?} expired at {when}", self.name());
                Err(Refused::unknown(Reason::Expired, detail))
            }
            _ => Ok(()),
        }
    }

    /// Waits until the grant ends: what an open stream is told then.
    pub async fn ended(&self) -> Refused {
        loop {
            if let Err(refused) = self.live() {
                return refused;
            }
            let sleep = match self.grant().expires {
                Some(expires) => {
                    expires.duration_since(SystemTime::now()).unwrap_or_default().clamp(SHORTEST_SLEEP, LONGEST_SLEEP)
                }
                None => {
                    self.identity.revoked.cancelled().await;
                    continue;
                }
            };
            tokio::select! {
                () = self.identity.revoked.cancelled() => {}
                () = tokio::time::sleep(sleep) => {}
            }
        }
    }
}

/// A sleep of nothing would spin where the two clocks differ by less than their steps.
const SHORTEST_SLEEP: Duration = Duration::from_millis(1);

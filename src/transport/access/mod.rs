//! Who asks, and what they may do: one place for all transports.
//!
//! A transport learns what was shown (a token, a client certificate) and gets an [`OnBehalf`] for it: the service as that
//! caller may use it. It has no other way to the service, so no route can forget to ask. What an operation needs is one
//! table, [`Operation::needs`].

mod audit;
mod caller;
mod guarded;
mod operation;
mod refusals;
mod roll;
mod token;

use crate::service::ServiceError;
use crate::transport::tls::Named;
use arc_swap::ArcSwap;
use metrics::{describe_gauge, gauge};
use refusals::Refusals;
use std::fs::File;
use std::io::Read;
use std::net::SocketAddr;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};

pub use caller::{Caller, Grant, MapScope, Role};
pub use guarded::{Guarded, OnBehalf, Origin};
pub use operation::{Operation, Reach};
pub use refusals::{Reason, Refused};
pub use roll::{Entry, Proof, Roll, RollError, entry_name, expiry, unquoted};
pub use token::{PREFIX, Secret, TokenHash, bearer};

const ENTRIES: &str = "ubbmap_access_entries";
const STALE: &str = "ubbmap_access_stale";

/// Tells the recorder what each metric means. Call it once, after the recorder is installed.
pub fn describe_metrics() {
    describe_gauge!(ENTRIES, "Entries of the file of tokens that are in force");
    describe_gauge!(
        STALE,
        "1 while the file of tokens cannot be read or is not valid, so that an earlier one is in force"
    );
    refusals::describe_metrics();
}

/// Which of the server's addresses somebody came to.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Listener {
    /// The only one: everything is there.
    #[default]
    Only,
    /// The one for everybody, where administration has one of its own.
    Public,
    /// The one for administration and metrics.
    Administration,
}

/// Where a request comes from, as its connection knows it.
#[derive(Debug, Clone, Default)]
pub struct Peer {
    /// The other end.
    pub address: Option<SocketAddr>,
    /// Whom the certificate names that the other end has proven to hold.
    pub certificate: Option<Named>,
    /// Where it came in.
    pub listener: Listener,
}

/// What was shown with a request.
#[derive(Clone, Copy, Default)]
pub enum Shown<'a> {
    /// Nothing.
    #[default]
    Nothing,
    /// A token.
    Token(&'a str),
    /// Something that is no token.
    Other,
}

impl<'a> Shown<'a> {
    /// What the values of the header `authorization` show.
    pub fn in_headers(mut values: impl Iterator<Item = &'a [u8]>) -> Self {
        match (values.next(), values.next()) {
            (None, _) => Self::Nothing,
            (Some(value), None) => bearer(value).map_or(Self::Other, Self::Token),
            (Some(_), Some(_)) => Self::Other,
        }
    }
}

impl std::fmt::Debug for Shown<'_> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            Self::Nothing => "Nothing",
            Self::Token(_) => "Token(..)",
            Self::Other => "Other",
        })
    }
}

/// Who may come in. Cheap to clone.
#[derive(Debug, Clone)]
pub struct Access(Arc<Inner>);

#[derive(Debug)]
struct Inner {
    mode: Mode,
    refusals: Refusals,
}

#[derive(Debug)]
enum Mode {
    /// Whoever comes may do everything.
    Open { caller: Caller, insecure: bool },
    /// Those of a file.
    File(FromFile),
}

#[derive(Debug)]
struct FromFile {
    path: PathBuf,
    roll: ArcSwap<Roll>,
    /// Held while it is read and taken over.
    reading: Mutex<()>,
}

impl Access {
    /// Everybody may do everything. `insecure`: although strangers reach the server.
    #[must_use]
    pub fn open(insecure: bool) -> Self {
        let caller = Caller::anyone(if insecure { "anyone" } else { "local" });
        Self::of(Mode::Open { caller, insecure })
    }

    /// Those of a file.
    ///
    /// # Errors
    /// [`RollError`]
    pub fn from_file(path: &Path) -> Result<Self, RollError> {
        let roll = ArcSwap::from_pointee(load(path)?);
        Ok(Self::of(Mode::File(FromFile { path: path.to_owned(), roll, reading: Mutex::new(()) })))
    }

    fn of(mode: Mode) -> Self {
        let entries = match &mode {
            Mode::Open { .. } => 0,
            Mode::File(file) => file.roll.load().entries().len(),
        };
        gauge!(ENTRIES).set(entries as f64);
        gauge!(STALE).set(0.0);
        refusals::show_metrics();
        Self(Arc::new(Inner { mode, refusals: Refusals::default() }))
    }

    /// What holders of certificates may do, by their whole names: for an access control that cannot ask for each message. Entries
    /// for beginnings of names, and those that have expired, are not among them, which is said in the log. None without a file.
    #[must_use]
    pub fn certificates(&self) -> Option<Vec<(String, Grant)>> {
        match &self.0.mode {
            Mode::Open { .. } => None,
            Mode::File(file) => Some(file.roll.load().certificates()),
        }
    }

    /// True where strangers reach the server and nothing is asked of them.
    #[must_use]
    pub fn is_insecure(&self) -> bool {
        matches!(self.0.mode, Mode::Open { insecure: true, .. })
    }

    /// Who that is.
    ///
    /// # Errors
    /// [`crate::service::ErrorKind::Unauthenticated`]
    pub fn identify(&self, shown: Shown<'_>, peer: &Peer) -> Result<Caller, ServiceError> {
        let caller = match &self.0.mode {
            Mode::Open { caller, .. } => Ok(match &peer.certificate {
                None => caller.clone(),
                Some(shown) => {
                    let grant = Grant { expires: Some(shown.until), ..Grant::everything() };
                    caller.shown_as(&*shown.name, grant)
                }
            }),
            Mode::File(file) => file.identify(shown, peer),
        };
        let caller = caller.map_err(|refused| self.note(refused, peer))?;
        Ok(if peer.listener == Listener::Public { caller.without_administration() } else { caller })
    }

    /// Counts a refusal, logs it now and then, and makes it the client's error.
    pub fn note(&self, refused: Refused, peer: &Peer) -> ServiceError {
        self.0.refusals.note(refused, peer)
    }

    /// Reads the file again, if there is one. One that cannot be read or is not valid changes nothing: what was in force
    /// stays so. Blocks.
    ///
    /// # Errors
    /// What is wrong with the file.
    pub fn reload(&self) -> Result<String, String> {
        match &self.0.mode {
            Mode::Open { .. } => Ok("there is no file of tokens".to_owned()),
            Mode::File(file) => file.reload(),
        }
    }
}

impl FromFile {
    fn identify(&self, shown: Shown<'_>, peer: &Peer) -> Result<Caller, Refused> {
        let roll = self.roll.load();
        let found: Result<Caller, Refused> = match (shown, &peer.certificate) {
            (Shown::Token(token), _) => roll.by_token(token).cloned().ok_or_else(|| {
                Refused::unknown(Reason::Unknown, "the token is not known to this server").at("authorization")
            }),
            (Shown::Other, _) => Err(Refused::unknown(
                Reason::Malformed,
                format!("the header authorization must be one line \"Bearer {PREFIX}...\""),
            )
            .at("authorization")),
            (Shown::Nothing, Some(named)) => roll.by_certificate(named).ok_or_else(|| {
                let name: String = named.name.chars().take(80).collect();
                Refused::unknown(
                    Reason::Unknown,
                    format!("the certificate's name {name:?} is not known to this server"),
                )
            }),
            (Shown::Nothing, None) => Err(Refused::unknown(
                Reason::Missing,
                "this server asks for a token: send the header \"Authorization: Bearer TOKEN\" (ubbmap --token, UBBMAP_TOKEN)",
            )),
        };
        let caller = found?;
        caller.live().map_err(|refused| refused.at("authorization"))?;
        Ok(caller)
    }

    fn reload(&self) -> Result<String, String> {
        let _alone = self.reading.lock().unwrap_or_else(PoisonError::into_inner);
        let read = load(&self.path);
        gauge!(STALE).set(if read.is_ok() { 0.0 } else { 1.0 });
        let mut roll = read.map_err(|error| error.to_string())?;
        let entries = roll.entries().len();
        let gone = roll.succeed(&self.roll.load());
        self.roll.store(Arc::new(roll));
        gone.iter().for_each(Caller::revoke);
        gauge!(ENTRIES).set(entries as f64);
        Ok(format!("{entries} entries of {}", self.path.display()))
    }
}

fn load(path: &Path) -> Result<Roll, RollError> {
    let text = read(path).map_err(|source| RollError::File { path: path.to_owned(), source })?;
    Roll::parse(&text).map_err(|problem| RollError::Content { path: path.to_owned(), problem })
}

/// The text of a file, if it is not too large.
fn read(path: &Path) -> std::io::Result<String> {
    let mut text = String::new();
    File::open(path)?.take(roll::MOST_BYTES + 1).read_to_string(&mut text)?;
    if text.len() as u64 > roll::MOST_BYTES {
        return Err(std::io::Error::other(format!("it is larger than {} bytes", roll::MOST_BYTES)));
    }
    Ok(text)
}

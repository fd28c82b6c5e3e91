//! The one HTTP client of the command line: protobuf bodies over REST, blocking.

use super::output::Failure;
use super::secure::{self, SecureOptions};
use crate::mapping::MapConfig;
use crate::store::{MapName, SnapshotName};
use crate::transport::http::Problem;
use crate::wire::{to_wire_config, v1};
use clap::Args;
use prost::Message;
use std::fs::File;
use std::io::Read;
use std::path::{Path, PathBuf};
use std::str::FromStr;
use std::time::{Duration, Instant};
use thiserror::Error;

const PROTOBUF: &str = "application/x-protobuf";

/// Where a server is looked for by default: that of `ubbmap serve` without flags.
const DEFAULT_SERVER: &str = "http://127.0.0.1:8080";

/// Largest answer that is read, bytes.
const MAX_ANSWER_BYTES: u64 = 256 << 20;

/// Longest time for one request, seconds.
const REQUEST_TIMEOUT: Duration = Duration::from_secs(60);

/// Bytes of a file of a token that are read.
const LONGEST_TOKEN_FILE: u64 = 4096;

/// Names farther apart than this are not offered.
const LEAST_SIMILARITY: f64 = 0.7;

/// First pause before a request is sent again; it doubles up to [`LONGEST_PAUSE`].
const FIRST_PAUSE: Duration = Duration::from_millis(50);

const LONGEST_PAUSE: Duration = Duration::from_secs(2);

/// An answer as it comes.
pub(super) type Answer = ureq::http::Response<ureq::Body>;

/// Which server is asked.
#[derive(Debug, Clone, Args)]
#[command(next_help_heading = "Server")]
pub(super) struct ServerOptions {
    /// The server [default: $UBBMAP_SERVER, or http://127.0.0.1:8080]
    #[arg(long, value_name = "URL")]
    server: Option<String>,
    /// The token for it; others on this machine see what stands on a command line [default: $UBBMAP_TOKEN]
    #[arg(long, value_name = "TOKEN", conflicts_with = "token_file")]
    token: Option<Token>,
    /// A file that holds the token [default: $UBBMAP_TOKEN_FILE]
    #[arg(long, value_name = "FILE")]
    token_file: Option<PathBuf>,
    #[command(flatten)]
    secure: SecureOptions,
}

/// A token for the server. It is in no message of an error and in no debug form.
#[derive(Clone)]
struct Token(String);

impl FromStr for Token {
    type Err = &'static str;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        let text = text.trim();
        let fits = !text.is_empty() && text.bytes().all(|byte| byte.is_ascii_graphic());
        if fits { Ok(Self(text.to_owned())) } else { Err("is no token: it must be one word") }
    }
}

impl std::fmt::Debug for Token {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("Token")
    }
}

impl ServerOptions {
    /// The token that the flags name, else the environment.
    fn token(&self) -> Result<Option<Token>, Failure> {
        if self.token.is_some() {
            return Ok(self.token.clone());
        }
        if let Some(file) = &self.token_file {
            return read_token(file, "--token-file").map(Some);
        }
        // An empty variable is none.
        let variable = |name: &str| std::env::var_os(name).filter(|value| !value.is_empty());
        if let Some(token) = variable("UBBMAP_TOKEN") {
            let token = token.to_str().unwrap_or_default().parse();
            return token.map(Some).map_err(|problem| Failure::Usage(format!("UBBMAP_TOKEN {problem}")));
        }
        variable("UBBMAP_TOKEN_FILE").map(|file| read_token(Path::new(&file), "UBBMAP_TOKEN_FILE")).transpose()
    }
}

fn read_token(file: &Path, named_by: &str) -> Result<Token, Failure> {
    let (mut text, path) = (String::new(), file.display());
    let read = File::open(file).and_then(|file| file.take(LONGEST_TOKEN_FILE).read_to_string(&mut text));
    read.map_err(|error| Failure::Usage(format!("{named_by}: cannot read {path}: {error}")))?;
    text.parse().map_err(|problem| Failure::Usage(format!("{named_by}: what {path} holds {problem}")))
}

/// Why a request failed.
#[derive(Debug, Clone, Error)]
pub(super) enum ClientError {
    /// No answer came.
    #[error("cannot reach the server at {server}: {why}")]
    Unreachable {
        /// Its address.
        server: String,
        /// Why.
        why: String,
    },
    /// No connection that both sides trust.
    #[error("no trusted connection to {server}: {why}")]
    NotTrusted {
        /// Its address.
        server: String,
        /// Why.
        why: String,
    },
    /// The server refused.
    #[error("{detail} ({code})")]
    Refused {
        /// HTTP status.
        status: u16,
        /// The stable word.
        code: String,
        /// A sentence.
        detail: String,
        /// How long to wait before another try.
        retry_after: Option<Duration>,
    },
    /// The answer is not one of this interface.
    #[error("{0}: is it an ubbmap server?")]
    NotUnderstood(String),
}

impl ClientError {
    /// True where the same request may succeed later.
    pub(super) fn is_passing(&self) -> bool {
        match self {
            Self::Unreachable { .. } => true,
            Self::Refused { status, .. } => matches!(status, 429 | 502..=504),
            Self::NotTrusted { .. } | Self::NotUnderstood(_) => false,
        }
    }

    fn retry_after(&self) -> Option<Duration> {
        match self {
            Self::Refused { retry_after, .. } => *retry_after,
            _ => None,
        }
    }

    pub(super) fn is(&self, word: &str) -> bool {
        matches!(self, Self::Refused { code, .. } if code == word)
    }
}

/// A connection to one server. Cheap to clone; clones share connections.
#[derive(Debug, Clone)]
pub(super) struct Client {
    agent: ureq::Agent,
    server: String,
    token: Option<Token>,
}

impl Client {
    /// A client of the server that the flags or the environment name.
    pub(super) fn new(options: &ServerOptions) -> Result<Self, Failure> {
        let server = options.server.clone().or_else(|| std::env::var("UBBMAP_SERVER").ok());
        let server = server.as_deref().unwrap_or(DEFAULT_SERVER);
        if options.secure.any() && server.starts_with("http://") {
            let problem = format!("--ca, --cert and --key are for a server of https://, and this is {server}");
            return Err(Failure::Usage(problem));
        }
        let client = Self::with(server, &options.secure.with_environment())?;
        Ok(Self { token: options.token()?, ..client })
    }

    /// A client of a server without TLS and without a token.
    ///
    /// # Errors
    /// Bad usage for what is no URL.
    pub(super) fn of(server: &str) -> Result<Self, Failure> {
        Self::with(server, &SecureOptions::default())
    }

    fn with(server: &str, secure: &SecureOptions) -> Result<Self, Failure> {
        let server = server.trim_end_matches('/');
        let tls = server.starts_with("https://");
        if !tls && !server.starts_with("http://") {
            let problem = format!("--server {server:?} must be a URL that begins with http:// or https://");
            return Err(Failure::Usage(problem));
        }
        let mut config = ureq::Agent::config_builder();
        if tls {
            config = config.tls_config(secure.config()?);
        }
        let config = config
            .http_status_as_error(false)
            .timeout_global(Some(REQUEST_TIMEOUT))
            .timeout_connect(Some(Duration::from_secs(5)))
            .user_agent(concat!("ubbmap/", env!("CARGO_PKG_VERSION")))
            .build();
        Ok(Self { agent: config.into(), server: server.to_owned(), token: None })
    }

    /// Creates a map, or finds it there with this configuration.
    pub(super) fn create_map(&self, map: &MapName, config: &MapConfig) -> Result<v1::CreateMapResponse, ClientError> {
        let request = v1::CreateMapRequest { map: map.as_str().to_owned(), config: Some(to_wire_config(config)) };
        self.call("PUT", &format!("/v1/maps/{map}"), Some(request.encode_to_vec()))
    }

    /// Describes a map.
    pub(super) fn map(&self, map: &MapName) -> Result<v1::GetMapResponse, ClientError> {
        self.call("GET", &format!("/v1/maps/{map}"), None)
    }

    /// Lists the maps.
    pub(super) fn maps(&self) -> Result<v1::ListMapsResponse, ClientError> {
        self.call("GET", "/v1/maps", None)
    }

    /// Asks whether the server takes work.
    pub(super) fn ready(&self) -> Result<(), ClientError> {
        self.exchange("GET", "/readyz", None).map(drop)
    }

    /// The server's address.
    pub(super) fn server(&self) -> &str {
        &self.server
    }

    /// Deletes a map.
    pub(super) fn delete_map(&self, map: &MapName) -> Result<v1::DeleteMapResponse, ClientError> {
        self.call("DELETE", &format!("/v1/maps/{map}"), None)
    }

    /// Inserts scans; they are durable when the answer is there.
    pub(super) fn insert(&self, map: &MapName, scans: &[v1::Scan]) -> Result<v1::InsertScansResponse, ClientError> {
        let request = v1::InsertScansRequest { map: map.as_str().to_owned(), scans: scans.to_vec() };
        self.call("POST", &format!("/v1/maps/{map}/scans"), Some(request.encode_to_vec()))
    }

    /// Asks whether regions are guaranteed free, in the map or in one of its snapshots.
    pub(super) fn check(
        &self,
        map: &MapName,
        snapshot: Option<&SnapshotName>,
        regions: Vec<v1::Region>,
        tolerance: u32,
    ) -> Result<v1::CheckGuaranteedFreeResponse, ClientError> {
        let snapshot = snapshot.map(SnapshotName::to_string).unwrap_or_default();
        let request = v1::CheckGuaranteedFreeRequest { map: map.as_str().to_owned(), regions, tolerance, snapshot };
        self.call("POST", &format!("/v1/maps/{map}/guaranteed-free"), Some(request.encode_to_vec()))
    }

    /// Turns a failed request about a map into the command's failure; an unknown map comes with the nearest known.
    pub(super) fn explain(&self, map: &MapName, error: ClientError) -> Failure {
        if error.is("MAP_NOT_FOUND") {
            let known = self.maps().map(|list| list.maps).unwrap_or_default();
            let hint = match nearest(known.iter().map(|known| known.name.as_str()), map.as_str()) {
                Some(name) => format!("did you mean '{name}'?"),
                None if known.is_empty() => "the server has no maps yet".to_owned(),
                None => "`ubbmap map list` shows those there are".to_owned(),
            };
            return Failure::Failed(anyhow::anyhow!("no map '{map}'; {hint}"));
        }
        Failure::Failed(error.into())
    }

    /// The same of a request about a snapshot; an unknown one comes with the nearest known.
    pub(super) fn explain_snapshot(&self, map: &MapName, name: &SnapshotName, error: ClientError) -> Failure {
        if !error.is("SNAPSHOT_NOT_FOUND") {
            return self.explain(map, error);
        }
        let known = self.snapshots(map).map(|list| list.snapshots).unwrap_or_default();
        let hint = match nearest(known.iter().map(|known| known.name.as_str()), name.as_str()) {
            Some(name) => format!("did you mean '{name}'?"),
            None if known.is_empty() => "the map has no snapshots".to_owned(),
            None => format!("`ubbmap map snapshots {map}` shows those there are"),
        };
        Failure::Failed(anyhow::anyhow!("no snapshot '{name}'; {hint}"))
    }

    /// Does `request` until it succeeds, fails for good, `stop` says so, or nothing has come for `patience`. `waiting` is
    /// told the attempts so far and the error of each that is followed by another.
    pub(super) fn patiently<T>(
        patience: Duration,
        stop: impl Fn() -> bool,
        waiting: impl Fn(u32, &ClientError),
        request: impl Fn() -> Result<T, ClientError>,
    ) -> Result<T, ClientError> {
        let started = Instant::now();
        let mut pause = FIRST_PAUSE;
        for attempt in 1_u32.. {
            match request() {
                Err(error) if error.is_passing() && !stop() => {
                    let wait = error.retry_after().map_or(pause, |asked| asked.min(LONGEST_PAUSE));
                    if started.elapsed() + wait > patience {
                        return Err(error);
                    }
                    waiting(attempt, &error);
                    std::thread::sleep(wait);
                    pause = (2 * pause).min(LONGEST_PAUSE);
                }
                other => return other,
            }
        }
        request()
    }

    /// Keeps a map's last revision under a name.
    pub(super) fn take_snapshot(
        &self,
        map: &MapName,
        name: &SnapshotName,
    ) -> Result<v1::CreateSnapshotResponse, ClientError> {
        let request = v1::CreateSnapshotRequest { map: map.as_str().to_owned(), name: name.to_string() };
        self.call("POST", &format!("/v1/maps/{map}/snapshots"), Some(request.encode_to_vec()))
    }

    /// Lists the snapshots of a map.
    pub(super) fn snapshots(&self, map: &MapName) -> Result<v1::ListSnapshotsResponse, ClientError> {
        self.call("GET", &format!("/v1/maps/{map}/snapshots"), None)
    }

    /// Makes a snapshot's content the map's.
    pub(super) fn restore(
        &self,
        map: &MapName,
        name: &SnapshotName,
    ) -> Result<v1::RestoreSnapshotResponse, ClientError> {
        self.call("POST", &format!("/v1/maps/{map}/snapshots/{name}/restore"), None)
    }

    /// Removes a snapshot.
    pub(super) fn delete_snapshot(
        &self,
        map: &MapName,
        name: &SnapshotName,
    ) -> Result<v1::DeleteSnapshotResponse, ClientError> {
        self.call("DELETE", &format!("/v1/maps/{map}/snapshots/{name}"), None)
    }

    fn call<T: Message + Default>(&self, method: &str, path: &str, body: Option<Vec<u8>>) -> Result<T, ClientError> {
        let bytes = self.exchange(method, path, body)?;
        T::decode(bytes.as_slice())
            .map_err(|error| ClientError::NotUnderstood(format!("{} answered {path} with {error}", self.server)))
    }

    fn exchange(&self, method: &str, path: &str, body: Option<Vec<u8>>) -> Result<Vec<u8>, ClientError> {
        let request = self.head(method, path).header("accept", format!("{PROTOBUF}, application/problem+json"));
        let answer = match body {
            Some(body) => {
                self.agent.run(request.header("content-type", PROTOBUF).body(body).map_err(|e| self.unreachable(&e))?)
            }
            None => self.agent.run(request.body(()).map_err(|e| self.unreachable(&e))?),
        };
        self.answered(path, answer.map_err(|error| self.unreachable(&error))?)
    }

    /// The head of a request, with what every request has.
    pub(super) fn head(&self, method: &str, path: &str) -> ureq::http::request::Builder {
        let request = ureq::http::Request::builder().method(method).uri(format!("{}{path}", self.server));
        match &self.token {
            Some(Token(token)) => request.header("authorization", format!("Bearer {token}")),
            None => request,
        }
    }

    pub(super) fn agent(&self) -> &ureq::Agent {
        &self.agent
    }

    pub(super) fn unreachable(&self, why: &(dyn std::error::Error + 'static)) -> ClientError {
        if let Some(why) = secure::fault(why) {
            return ClientError::NotTrusted { server: self.server.clone(), why };
        }
        ClientError::Unreachable { server: self.server.clone(), why: why.to_string() }
    }

    /// The bytes of an answer, or the error that it tells.
    pub(super) fn answered(&self, path: &str, mut answer: Answer) -> Result<Vec<u8>, ClientError> {
        let status = answer.status().as_u16();
        let retry_after = answer
            .headers()
            .get("retry-after")
            .and_then(|value| value.to_str().ok()?.parse().ok())
            .map(Duration::from_secs);
        let bytes = answer
            .body_mut()
            .with_config()
            .limit(MAX_ANSWER_BYTES)
            .read_to_vec()
            .map_err(|error| self.unreachable(&error))?;
        if (200..300).contains(&status) {
            return Ok(bytes);
        }
        Err(match serde_json::from_slice::<Problem>(&bytes) {
            Ok(problem) => {
                // Most sentences begin with the field already.
                let field = problem.field.filter(|field| !problem.detail.starts_with(field.as_str()));
                let field = field.map(|field| format!("{field}: ")).unwrap_or_default();
                let detail = format!("{field}{}", problem.detail);
                ClientError::Refused { status, code: problem.code, detail, retry_after }
            }
            // A proxy between, perhaps: its status still tells whether to try again.
            Err(_) if matches!(status, 429 | 502..=504) => {
                let detail = format!("{} answered with status {status}", self.server);
                ClientError::Refused { status, code: "HTTP".to_owned(), detail, retry_after }
            }
            Err(_) => ClientError::NotUnderstood(format!("{} answered {path} with status {status}", self.server)),
        })
    }
}

/// The known name that is nearest to a wrong one, if any is near.
fn nearest<'a>(known: impl Iterator<Item = &'a str>, wrong: &str) -> Option<&'a str> {
    known
        .map(|known| (strsim::jaro_winkler(known, wrong), known))
        .filter(|(similarity, _)| *similarity >= LEAST_SIMILARITY)
        .max_by(|a, b| a.0.total_cmp(&b.0))
        .map(|(_, name)| name)
}

/// Checks a map's name from the command line.
///
/// # Errors
/// The rule that it breaks.
pub(super) fn map_name(text: &str) -> Result<MapName, String> {
    MapName::new(text).map_err(|error| error.to_string())
}

/// Checks a snapshot's name from the command line.
///
/// # Errors
/// The rule that it breaks.
pub(super) fn snapshot_name(text: &str) -> Result<SnapshotName, String> {
    SnapshotName::new(text).map_err(|error| error.to_string())
}

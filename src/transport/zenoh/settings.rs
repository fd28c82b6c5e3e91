//! The settings of a session: ours, and Zenoh's defaults where they do not suit a server.

use super::ZenohError;
use super::guard::{Guard, Passwords};
use super::users::User;
use crate::transport::access::Grant;
use ::zenoh::Config;
use serde_json::{Value, json};
use std::path::PathBuf;

/// What part the server takes in a network of Zenoh.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Mode {
    /// Connects to peers and routers, and lets them connect.
    Peer,
    /// Connects to a router, which does the rest.
    Client,
    /// Is the router itself.
    Router,
}

/// The settings of this transport.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ZenohSettings {
    /// The server's part.
    pub mode: Mode,
    /// Endpoints to listen on, such as `tcp/127.0.0.1:7447`; a client listens on none.
    pub listen: Vec<String>,
    /// Endpoints to connect to.
    pub connect: Vec<String>,
    /// What all keys begin with.
    pub prefix: String,
    /// A file of Zenoh's own settings (JSON5), for TLS, users and access control; ours stand above it.
    pub file: Option<PathBuf>,
    /// The files of TLS for endpoints that speak it.
    pub tls: Option<ZenohTls>,
    /// Who may connect, by user and password; empty where no passwords are asked for.
    pub users: Vec<User>,
    /// What holders of certificates may do, by common name; none where all may do everything.
    pub certificates: Option<Vec<(String, Grant)>>,
    /// Largest message, bytes.
    pub message_bytes: usize,
    /// Queries that may wait, and insertions likewise, and best-effort scans.
    pub queue: usize,
    /// Queries worked on at once, and insertions likewise.
    pub in_flight: usize,
}

/// TLS of the endpoints that are listened on.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ZenohTls {
    /// The server's certificate, in PEM.
    pub cert: PathBuf,
    /// Its key, in PEM.
    pub key: PathBuf,
    /// Authorities of clients, without whose certificates none connects.
    pub client_ca: Option<PathBuf>,
}

/// How long a client that does not read holds up what is sent to it before its connection is closed, microseconds.
const UNREAD: u64 = 1_000_000;

/// Bytes of a message beside its payload, more than ever needed.
const HEAD_BYTES: usize = 64 << 10;

/// The configuration of the server's session, and what must live until it is open.
///
/// # Errors
/// [`ZenohError::Settings`], [`ZenohError::Session`]
pub fn session(settings: &ZenohSettings, guard: &Guard) -> Result<(Config, Option<Passwords>), ZenohError> {
    let mode = match settings.mode {
        Mode::Peer => "peer",
        Mode::Client => "client",
        Mode::Router => "router",
    };
    let listen: Vec<&str> = match settings.mode {
        Mode::Client => Vec::new(),
        _ => settings.listen.iter().map(String::as_str).chain(guard.inner()).collect(),
    };
    let mut config = base(settings)?;
    set(&mut config, "mode", &json!(mode))?;
    set(&mut config, "listen/endpoints", &json!(listen))?;
    set(&mut config, "connect/endpoints", &json!(settings.connect))?;
    let passwords = guard.of_server(settings, &mut config)?;
    Ok((config, passwords))
}

/// The configuration of a client of the server: what its health check connects with.
///
/// # Errors
/// [`ZenohError::Settings`]
pub fn client(settings: &ZenohSettings, guard: &Guard, endpoints: &[String]) -> Result<Config, ZenohError> {
    let mut config = base(settings)?;
    set(&mut config, "mode", &json!("client"))?;
    set(&mut config, "listen/endpoints", &json!([]))?;
    set(&mut config, "connect/endpoints", &json!(endpoints))?;
    guard.of_probe(&mut config)?;
    Ok(config)
}

fn base(settings: &ZenohSettings) -> Result<Config, ZenohError> {
    let mut config = match &settings.file {
        Some(path) => Config::from_file(path).map_err(|error| ZenohError::Settings(error.to_string()))?,
        None => Config::default(),
    };
    // By default a session looks for others by multicast and lets others tell it whom to connect to, answers anyone who asks about its
    // inside, and puts together messages of up to a gigabyte.
    let limit = settings.message_bytes.saturating_add(HEAD_BYTES);
    set(&mut config, "transport/link/rx/max_message_size", &json!(limit))?;
    set(&mut config, "transport/link/tx/queue/congestion_control/block/wait_before_close", &json!(UNREAD))?;
    if settings.file.is_none() {
        set(&mut config, "scouting/multicast/enabled", &json!(false))?;
        set(&mut config, "scouting/gossip/enabled", &json!(false))?;
        set(&mut config, "transport/shared_memory/enabled", &json!(false))?;
        set(&mut config, "adminspace/enabled", &json!(false))?;
    }
    Ok(config)
}

/// Sets one value, or a whole section.
///
/// # Errors
/// [`ZenohError::Settings`]
pub fn set(config: &mut Config, key: &str, value: &Value) -> Result<(), ZenohError> {
    config
        .insert_json5(key, &value.to_string())
        .map_err(|error| ZenohError::Settings(format!("{key} = {value}: {error}")))
}

//! Settings of the transport over Zenoh.

use super::tls::ClientCertificates;
use super::{Config, ConfigError};
use crate::transport::zenoh::{Mode, User, ZenohSettings, ZenohTls, read_users};
use serde::{Deserialize, Serialize};
use std::net::IpAddr;
use std::path::{Path, PathBuf};

/// What part the server takes in a network of Zenoh.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase", try_from = "String")]
pub enum ZenohMode {
    /// None.
    Off,
    /// Connects to peers and routers, and lets them connect.
    Peer,
    /// Connects to a router.
    Client,
    /// Is a router itself.
    Router,
}

/// Zenoh.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Zenoh {
    /// The server's part.
    pub mode: ZenohMode,
    /// Endpoints to listen on, with commas between.
    pub listen: String,
    /// Endpoints to connect to, with commas between.
    pub connect: String,
    /// What all keys begin with.
    pub prefix: String,
    /// Who may connect, by user and password; empty for whoever reaches the endpoint.
    pub users: String,
    /// A file of Zenoh's own settings; empty for none.
    pub file: String,
    /// Queries that may wait; likewise insertions, and best-effort scans.
    pub queue: usize,
    /// Queries worked on at once; likewise insertions, and best-effort scans.
    pub in_flight: usize,
}

impl Default for Zenoh {
    fn default() -> Self {
        Self {
            mode: ZenohMode::Off,
            listen: "tcp/127.0.0.1:7447".to_owned(),
            connect: String::new(),
            prefix: "ubbmap".to_owned(),
            users: String::new(),
            file: String::new(),
            queue: 1024,
            in_flight: 256,
        }
    }
}

/// The endpoints of a list.
fn endpoints(list: &str) -> Vec<String> {
    list.split(',').map(str::trim).filter(|endpoint| !endpoint.is_empty()).map(str::to_owned).collect()
}

/// Is this an endpoint that strangers do not reach? Names are taken for what they may become: an address of others.
fn is_loopback(endpoint: &str) -> bool {
    let address = endpoint.split_once('/').map_or("", |(_, rest)| rest);
    let address = address.split(['?', '#']).next().unwrap_or_default();
    let host = address.rsplit_once(':').map_or(address, |(host, _)| host);
    let host = host.trim_start_matches('[').trim_end_matches(']');
    host == "localhost" || host.parse::<IpAddr>().is_ok_and(|ip| ip.to_canonical().is_loopback())
}

/// Is this a prefix of keys: chunks without wildcards?
fn is_prefix(prefix: &str) -> bool {
    !prefix.is_empty()
        && prefix.split('/').all(|chunk| {
            !chunk.is_empty()
                && !chunk.starts_with('@')
                && !chunk.contains(|c: char| "*$?#".contains(c) || c.is_whitespace())
        })
}

impl Zenoh {
    /// Checks the values.
    ///
    /// # Errors
    /// [`ConfigError::Value`] at the setting.
    pub(super) fn check(&self, insecure: bool, client_auth: Option<ClientCertificates>) -> Result<(), ConfigError> {
        if !is_prefix(&self.prefix) {
            return bad("prefix", format!("must be a key without wildcards such as \"ubbmap\", got {:?}", self.prefix));
        }
        if self.mode == ZenohMode::Off {
            return Ok(());
        }
        let needed = match self.mode {
            ZenohMode::Client => ("connect", &self.connect),
            _ => ("listen", &self.listen),
        };
        if endpoints(needed.1).is_empty() {
            return bad(needed.0, "names no endpoint, such as tcp/127.0.0.1:7447".to_owned());
        }
        self.check_users()?;
        if !self.file.is_empty() || insecure {
            return self.check_tls(client_auth);
        }
        let open = |list: &str| endpoints(list).into_iter().find(|endpoint| !is_loopback(endpoint));
        if let Some(open) = open(&self.connect) {
            let problem = format!(
                "{open} would let anyone on that network read and change every map: use a loopback address, name a file \
                 of Zenoh's settings with the server's own credentials (zenoh.file), or say --insecure"
            );
            return bad("connect", problem);
        }
        let required = client_auth == Some(ClientCertificates::Required);
        let unguarded = endpoints(&self.listen).into_iter().find(|endpoint| {
            !is_loopback(endpoint) && self.users.is_empty() && !(required && endpoint.starts_with("tls/"))
        });
        if let Some(open) = unguarded.filter(|_| self.mode != ZenohMode::Client) {
            let problem = format!(
                "{open} would let anyone on that network read and change every map: use a loopback address, say who may \
                 connect (zenoh.users, or tls/ with tls.client_auth = \"required\"), name a file of Zenoh's settings with \
                 its access control (zenoh.file), or say --insecure"
            );
            return bad("listen", problem);
        }
        self.check_tls(client_auth)
    }

    /// Users are for those who connect to a router of our own, and for nothing else.
    fn check_users(&self) -> Result<(), ConfigError> {
        if self.users.is_empty() {
            return Ok(());
        }
        if !self.file.is_empty() {
            return bad("users", "and zenoh.file both say who may connect: leave one out".to_owned());
        }
        if self.mode == ZenohMode::Client || !endpoints(&self.connect).is_empty() {
            let problem = "are for those who connect to this server: with zenoh.connect, who may do what is the affair of \
                           the router there, and zenoh.file has the server's own credentials for it";
            return bad("users", problem.to_owned());
        }
        Ok(())
    }

    /// Endpoints that speak TLS need a certificate.
    fn check_tls(&self, client_auth: Option<ClientCertificates>) -> Result<(), ConfigError> {
        let tls = endpoints(&self.listen).into_iter().find(|endpoint| endpoint.starts_with("tls/"));
        match tls.filter(|_| self.mode != ZenohMode::Client && self.file.is_empty() && client_auth.is_none()) {
            Some(endpoint) => bad("listen", format!("{endpoint} speaks TLS and needs tls.cert and tls.key")),
            None => Ok(()),
        }
    }
}

/// A refusal at a setting of this section.
fn bad(key: &str, problem: String) -> Result<(), ConfigError> {
    Err(ConfigError::Value { key: format!("zenoh.{key}"), problem })
}

impl Config {
    /// The part that the transport over Zenoh takes; `None` where it is off. Who may connect is in files and not read here.
    #[must_use]
    pub fn zenoh_settings(&self) -> Option<ZenohSettings> {
        let zenoh = &self.zenoh;
        let mode = match zenoh.mode {
            ZenohMode::Off => return None,
            ZenohMode::Peer => Mode::Peer,
            ZenohMode::Client => Mode::Client,
            ZenohMode::Router => Mode::Router,
        };
        Some(ZenohSettings {
            mode,
            listen: endpoints(&zenoh.listen),
            connect: endpoints(&zenoh.connect),
            prefix: zenoh.prefix.clone(),
            file: (!zenoh.file.is_empty()).then(|| PathBuf::from(&zenoh.file)),
            tls: self.zenoh_tls(),
            users: Vec::new(),
            certificates: None,
            message_bytes: self.limits.body_bytes,
            queue: zenoh.queue,
            in_flight: zenoh.in_flight,
        })
    }

    /// The certificate of [`super::Tls`] for Zenoh's endpoints that speak TLS.
    fn zenoh_tls(&self) -> Option<ZenohTls> {
        let zenoh = &self.zenoh;
        let speaks = zenoh.mode != ZenohMode::Client && endpoints(&zenoh.listen).iter().any(|e| e.starts_with("tls/"));
        let tls = self.tls_settings().filter(|_| speaks && zenoh.file.is_empty())?;
        // Zenoh asks for a certificate and means it, or asks for none.
        let required = self.tls.client_auth == ClientCertificates::Required;
        Some(ZenohTls { cert: tls.cert, key: tls.key, client_ca: tls.client_ca.filter(|_| required) })
    }

    /// The file of who may connect, where there is one and Zenoh is on.
    #[must_use]
    pub fn zenoh_users_file(&self) -> Option<&Path> {
        let used = self.zenoh.mode != ZenohMode::Off && !self.zenoh.users.is_empty();
        used.then(|| Path::new(&self.zenoh.users))
    }

    /// Reads who may connect. Blocks.
    ///
    /// # Errors
    /// [`ConfigError::Value`] at `zenoh.users`.
    pub fn zenoh_users(&self) -> Result<Vec<User>, ConfigError> {
        let Some(path) = self.zenoh_users_file() else { return Ok(Vec::new()) };
        read_users(path).map_err(|problem| ConfigError::Value { key: "zenoh.users".to_owned(), problem })
    }
}

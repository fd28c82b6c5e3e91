//! Settings of the transport over Zenoh.

use super::{Config, ConfigError};
use crate::transport::zenoh::{Mode, ZenohSettings};
use serde::{Deserialize, Serialize};
use std::net::IpAddr;
use std::path::PathBuf;

/// What part the server takes in a network of Zenoh.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
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
    pub(super) fn check(&self, insecure: bool) -> Result<(), ConfigError> {
        let bad = |key: &str, problem: String| Err(ConfigError::Value { key: format!("zenoh.{key}"), problem });
        if !is_prefix(&self.prefix) {
            return bad("prefix", format!("must be a key without wildcards such as \"ubbmap\", got {:?}", self.prefix));
        }
        if self.mode == ZenohMode::Off {
            return Ok(());
        }
        for (key, list) in [("listen", &self.listen), ("connect", &self.connect)] {
            let open = endpoints(list).into_iter().find(|endpoint| !is_loopback(endpoint));
            if let Some(open) = open.filter(|_| !insecure && self.file.is_empty()) {
                let problem = format!(
                    "{open} would let anyone on that network read and change every map: use a loopback address, name a \
                     file of Zenoh's settings with its access control (zenoh.file), or say --insecure"
                );
                return bad(key, problem);
            }
        }
        let needed = match self.mode {
            ZenohMode::Client => ("connect", &self.connect),
            _ => ("listen", &self.listen),
        };
        if endpoints(needed.1).is_empty() {
            return bad(needed.0, "names no endpoint, such as tcp/127.0.0.1:7447".to_owned());
        }
        Ok(())
    }
}

impl Config {
    /// The part that the transport over Zenoh takes; `None` where it is off.
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
            message_bytes: self.limits.body_bytes,
            queue: zenoh.queue,
            in_flight: zenoh.in_flight,
        })
    }
}

//! Values that are one of a few words, and addresses: read so that a refusal says what would do.

use super::{ClientCertificates, LogFormat, StoreKind, ZenohMode};
use std::net::{Ipv4Addr, SocketAddr};

/// The value of a word.
fn value<T: Copy>(word: &str, known: &[(&str, T)]) -> Result<T, String> {
    let found = known.iter().find(|(name, _)| name.eq_ignore_ascii_case(word));
    found.map(|(_, value)| *value).ok_or_else(|| {
        let names: Vec<&str> = known.iter().map(|(name, _)| *name).collect();
        format!("must be one of {}, got {word:?}", names.join(", "))
    })
}

impl TryFrom<String> for StoreKind {
    type Error = String;

    fn try_from(word: String) -> Result<Self, String> {
        value(&word, &[("sled", Self::Sled), ("memory", Self::Memory)])
    }
}

impl TryFrom<String> for LogFormat {
    type Error = String;

    fn try_from(word: String) -> Result<Self, String> {
        value(&word, &[("text", Self::Text), ("json", Self::Json)])
    }
}

impl TryFrom<String> for ClientCertificates {
    type Error = String;

    fn try_from(word: String) -> Result<Self, String> {
        value(&word, &[("off", Self::Off), ("optional", Self::Optional), ("required", Self::Required)])
    }
}

impl TryFrom<String> for ZenohMode {
    type Error = String;

    fn try_from(word: String) -> Result<Self, String> {
        let known = [("off", Self::Off), ("peer", Self::Peer), ("client", Self::Client), ("router", Self::Router)];
        value(&word, &known)
    }
}

/// An address to listen on: an IP address and a port, or `localhost` and a port, which is 127.0.0.1.
///
/// # Errors
/// What an address looks like.
pub(crate) fn address(text: &str) -> Result<SocketAddr, String> {
    let text = text.trim();
    let local = text.rsplit_once(':').filter(|(host, _)| host.eq_ignore_ascii_case("localhost"));
    let read = match local {
        Some((_, port)) => port.parse().ok().map(|port: u16| SocketAddr::from((Ipv4Addr::LOCALHOST, port))),
        None => text.parse().ok(),
    };
    read.ok_or_else(|| {
        format!(
            "must be an IP address and a port, such as 127.0.0.1:8080, localhost:8080, [::1]:8080, or 0.0.0.0:8080 for all \
             of this machine's, got {text:?}"
        )
    })
}

/// [`address`] of a setting.
pub(super) fn of_setting<'de, D: serde::Deserializer<'de>>(from: D) -> Result<SocketAddr, D::Error> {
    let text = <String as serde::Deserialize>::deserialize(from)?;
    address(&text).map_err(serde::de::Error::custom)
}

//! Settings of TLS.

use super::{Config, ConfigError};
use crate::transport::tls::{ClientAuth, TlsError, TlsSettings};
use serde::{Deserialize, Serialize};
use std::path::PathBuf;

/// Whether clients show certificates.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase", try_from = "String")]
pub enum ClientCertificates {
    /// They are not asked.
    Off,
    /// Who shows one must show a good one.
    Optional,
    /// Without a good one there is no connection.
    Required,
}

/// TLS of the listener; off without a certificate.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Tls {
    /// The server's certificate in PEM, with those between it and an authority behind it; empty for none.
    pub cert: String,
    /// Its key in PEM.
    pub key: String,
    /// Authorities that sign clients' certificates, in PEM; empty for none.
    pub client_ca: String,
    /// Whether clients show certificates.
    pub client_auth: ClientCertificates,
}

impl Default for Tls {
    fn default() -> Self {
        Self { cert: String::new(), key: String::new(), client_ca: String::new(), client_auth: ClientCertificates::Off }
    }
}

impl Tls {
    /// Checks what the files are for; what is in them is seen when they are read.
    ///
    /// # Errors
    /// [`ConfigError::Value`] at the setting.
    pub(super) fn check(&self) -> Result<(), ConfigError> {
        let bad = |key: &str, problem: &str| {
            Err(ConfigError::Value { key: format!("tls.{key}"), problem: problem.to_owned() })
        };
        match (self.cert.is_empty(), self.key.is_empty()) {
            (false, true) => return bad("key", "names no file, and tls.cert does: a certificate needs its key"),
            (true, false) => return bad("cert", "names no file, and tls.key does: a key needs its certificate"),
            _ => {}
        }
        let asked = self.client_auth != ClientCertificates::Off;
        if asked && self.cert.is_empty() {
            return bad("client_auth", "asks for clients' certificates, which needs TLS: name tls.cert and tls.key");
        }
        if asked && self.client_ca.is_empty() {
            return bad("client_ca", "names no file: who signs the certificates that tls.client_auth asks for?");
        }
        if !asked && !self.client_ca.is_empty() {
            return bad("client_auth", "is off, and tls.client_ca names a file: say \"optional\" or \"required\"");
        }
        Ok(())
    }
}

impl From<TlsError> for ConfigError {
    fn from(error: TlsError) -> Self {
        Self::Value { key: error.setting.to_owned(), problem: error.problem }
    }
}

impl Config {
    /// The files of TLS; `None` where it is off.
    #[must_use]
    pub fn tls_settings(&self) -> Option<TlsSettings> {
        let Tls { cert, key, client_ca, client_auth } = &self.tls;
        if cert.is_empty() {
            return None;
        }
        Some(TlsSettings {
            cert: PathBuf::from(cert),
            key: PathBuf::from(key),
            client_ca: (!client_ca.is_empty()).then(|| PathBuf::from(client_ca)),
            client_auth: match client_auth {
                ClientCertificates::Off => ClientAuth::Off,
                ClientCertificates::Optional => ClientAuth::Optional,
                ClientCertificates::Required => ClientAuth::Required,
            },
        })
    }
}

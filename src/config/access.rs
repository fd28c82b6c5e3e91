//! Settings of who may come in.

use super::{ClientCertificates, Config, ConfigError};
use crate::transport::access::{Access as Guard, RollError};
use serde::{Deserialize, Serialize};
use std::net::SocketAddr;
use std::path::{Path, PathBuf};

/// Access.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, Default)]
#[serde(default, deny_unknown_fields)]
pub struct Access {
    /// The file of tokens; empty for none.
    pub tokens: PathBuf,
}

impl Config {
    /// Checks that strangers do not come in unasked.
    ///
    /// # Errors
    /// [`ConfigError::NotLoopback`], [`ConfigError::Value`] at the setting.
    pub(super) fn check_access(&self) -> Result<(), ConfigError> {
        let administration = self.administration()?;
        for address in std::iter::once(self.listen).chain(administration) {
            if !is_loopback(address) && !self.insecure && self.tokens_file().is_none() && !self.wants_certificates() {
                return Err(ConfigError::NotLoopback(address));
            }
        }
        if administration.is_some_and(|address| address == self.listen && address.port() != 0) {
            let problem =
                "is the address of `listen`: administration needs one of its own, or \"\" for none".to_owned();
            return Err(ConfigError::Value { key: "admin_listen".to_owned(), problem });
        }
        Ok(())
    }

    /// The address of administration and metrics, where they have one of their own.
    ///
    /// # Errors
    /// [`ConfigError::Value`] for what is no address.
    pub fn administration(&self) -> Result<Option<SocketAddr>, ConfigError> {
        if self.admin_listen.is_empty() {
            return Ok(None);
        }
        let read = super::address(&self.admin_listen).map(Some);
        read.map_err(|problem| ConfigError::Value { key: "admin_listen".to_owned(), problem })
    }

    /// Reads who may come in.
    ///
    /// # Errors
    /// [`ConfigError::Tokens`]
    pub fn access(&self) -> Result<Guard, ConfigError> {
        match self.tokens_file() {
            Some(file) => Guard::from_file(file).map_err(ConfigError::Tokens),
            None => {
                let administration = self.administration()?;
                let beyond = std::iter::once(self.listen).chain(administration).any(|address| !is_loopback(address));
                Ok(Guard::open(beyond && !self.wants_certificates()))
            }
        }
    }

    /// True where nobody comes in without a certificate.
    fn wants_certificates(&self) -> bool {
        self.tls.client_auth == ClientCertificates::Required
    }

    /// The file of tokens, where there is one.
    #[must_use]
    pub fn tokens_file(&self) -> Option<&Path> {
        let file = self.access.tokens.as_path();
        (!file.as_os_str().is_empty()).then_some(file)
    }
}

fn is_loopback(address: SocketAddr) -> bool {
    address.ip().to_canonical().is_loopback()
}

impl From<RollError> for ConfigError {
    fn from(error: RollError) -> Self {
        Self::Tokens(error)
    }
}

//! Why a configuration is refused.

use crate::transport::access::RollError;
use std::net::SocketAddr;
use std::path::PathBuf;
use thiserror::Error;

/// A configuration that the server does not start with; the process ends with code 64.
#[derive(Debug, Error)]
pub enum ConfigError {
    /// The file cannot be read.
    #[error("cannot read the configuration file {path}: {source}")]
    File {
        /// The file.
        path: PathBuf,
        /// Why.
        source: std::io::Error,
    },
    /// The file is not TOML.
    #[error("the configuration file {path} is not valid TOML: {problem}")]
    Syntax {
        /// The file.
        path: PathBuf,
        /// Where and what.
        problem: String,
    },
    /// A key that no setting has.
    #[error("unknown setting `{key}` {origin}{}", nearest.as_ref().map(|key| format!("; did you mean `{key}`?")).unwrap_or_default())]
    UnknownKey {
        /// The key as given, with its tables.
        key: String,
        /// Where it was given, such as `in the environment (UBBMAP_LISTN)`.
        origin: String,
        /// The nearest known key.
        nearest: Option<String>,
    },
    /// A value that does not fit its setting.
    #[error("setting `{key}`: {problem}")]
    Value {
        /// The key.
        key: String,
        /// What is wrong.
        problem: String,
    },
    /// An address beyond loopback, and nothing that keeps strangers out.
    #[error(
        "listening on {0} would let anyone who reaches it read and change every map: listen on a loopback address such \
         as 127.0.0.1, say who may come in (`ubbmap token create --file F`, setting `access.tokens = \"F\"`), ask for certificates (setting `tls.client_auth = \"required\"`), or say --insecure \
         (setting `insecure = true`) if the network itself is trusted"
    )]
    NotLoopback(SocketAddr),
    /// The file of tokens.
    #[error("setting `access.tokens`: {0}")]
    Tokens(RollError),
}

//! TLS of the command line's client: whom it trusts, who it says it is, and what went wrong, in words.

use super::output::Failure;
use crate::transport::tls::{TlsError, certificates, identity, provider};
use clap::Args;
use rustls::{AlertDescription, CertificateError, Error as RustlsError};
use std::error::Error;
use std::path::PathBuf;
use std::sync::Arc;
use ureq::tls::{Certificate, ClientCert, PrivateKey, RootCerts, TlsConfig, TlsProvider};

/// Files for a server whose address begins with `https://`.
#[derive(Debug, Clone, Default, Args)]
pub(super) struct SecureOptions {
    /// Authorities that are trusted to sign the server's certificate, in PEM [default: $UBBMAP_CA, or those of the web]
    #[arg(long, value_name = "FILE")]
    ca: Option<PathBuf>,
    /// Certificate for a server that asks for one, in PEM [default: $UBBMAP_CERT, or none]
    #[arg(long, value_name = "FILE")]
    cert: Option<PathBuf>,
    /// Key of the certificate, in PEM [default: $UBBMAP_KEY]
    #[arg(long, value_name = "FILE")]
    key: Option<PathBuf>,
}

impl SecureOptions {
    /// What the flags and the environment say together.
    pub(super) fn with_environment(&self) -> Self {
        let or = |flag: &Option<PathBuf>, variable: &str| {
            flag.clone().or_else(|| std::env::var_os(variable).filter(|value| !value.is_empty()).map(PathBuf::from))
        };
        Self { ca: or(&self.ca, "UBBMAP_CA"), cert: or(&self.cert, "UBBMAP_CERT"), key: or(&self.key, "UBBMAP_KEY") }
    }

    /// True where a flag was given.
    pub(super) fn any(&self) -> bool {
        self.ca.is_some() || self.cert.is_some() || self.key.is_some()
    }

    /// Reads the files.
    ///
    /// # Errors
    /// Bad usage at the flag whose file cannot be used.
    pub(super) fn config(&self) -> Result<TlsConfig, Failure> {
        let bad = |error: TlsError| Failure::Usage(format!("{}: {}", error.setting, error.problem));
        let mut builder = TlsConfig::builder()
            .provider(TlsProvider::Rustls)
            .unversioned_rustls_crypto_provider(provider())
            .root_certs(RootCerts::WebPki);
        if let Some(path) = &self.ca {
            let trusted = certificates("--ca", path).map_err(bad)?;
            let trusted: Vec<_> = trusted.iter().map(|one| Certificate::from_der(one).to_owned()).collect();
            builder = builder.root_certs(RootCerts::Specific(Arc::new(trusted)));
        }
        match (&self.cert, &self.key) {
            (None, None) => {}
            (Some(cert), Some(key)) => {
                let own = identity(("--cert", cert), ("--key", key)).map_err(bad)?;
                let chain: Vec<_> = own.chain.iter().map(|one| Certificate::from_der(one).to_owned()).collect();
                // It has been read once, so it is there and in PEM.
                let key = PrivateKey::from_pem(&std::fs::read(key)?)
                    .map_err(|error| Failure::Usage(format!("--key: {} cannot be used: {error}", key.display())))?;
                builder = builder.client_cert(Some(ClientCert::new_with_certs(&chain, key)));
            }
            (Some(_), None) => return Err(Failure::Usage("--cert needs --key, the file of its key".to_owned())),
            (None, Some(_)) => {
                return Err(Failure::Usage("--key needs --cert, the file of its certificate".to_owned()));
            }
        }
        Ok(builder.build())
    }
}

/// What went wrong with TLS and what to do; `None` where TLS is not at fault.
pub(super) fn fault(error: &(dyn Error + 'static)) -> Option<String> {
    let rustls = rustls_error(error)?;
    let advice = match rustls {
        RustlsError::InvalidCertificate(why) => match why {
            CertificateError::UnknownIssuer => {
                "nobody who is trusted signed its certificate: name the authority's file with --ca or UBBMAP_CA"
            }
            CertificateError::Expired | CertificateError::ExpiredContext { .. } => "its certificate has run out",
            CertificateError::NotValidYet | CertificateError::NotValidYetContext { .. } => {
                "its certificate is not valid yet: is this machine's clock right?"
            }
            CertificateError::NotValidForName | CertificateError::NotValidForNameContext { .. } => {
                "its certificate is for another name: use a name that stands in it"
            }
            _ => "its certificate is not good",
        },
        RustlsError::InvalidMessage(_) => "it does not speak TLS: does its address begin with http://?",
        RustlsError::AlertReceived(alert) => match alert {
            AlertDescription::CertificateRequired => "it asks for a certificate: --cert and --key",
            AlertDescription::UnknownCA
            | AlertDescription::BadCertificate
            | AlertDescription::CertificateExpired
            | AlertDescription::CertificateUnknown
            | AlertDescription::CertificateRevoked
            | AlertDescription::DecryptError
            | AlertDescription::AccessDenied
            | AlertDescription::UnsupportedCertificate => "it refused the certificate of --cert",
            _ => "it ended the handshake",
        },
        _ => "TLS with it failed",
    };
    Some(format!("{advice} ({rustls})"))
}

/// The error of rustls within another, where there is one.
fn rustls_error<'a>(error: &'a (dyn Error + 'static)) -> Option<&'a RustlsError> {
    let mut next = Some(error);
    while let Some(error) = next {
        if let Some(found) = error.downcast_ref::<RustlsError>() {
            return Some(found);
        }
        next = match error.downcast_ref::<ureq::Error>() {
            Some(ureq::Error::Rustls(found)) => return Some(found),
            Some(ureq::Error::Io(io)) => Some(io),
            _ => match error.downcast_ref::<std::io::Error>() {
                Some(io) => io.get_ref().map(|inner| inner as &(dyn Error + 'static)),
                None => error.source(),
            },
        };
    }
    None
}

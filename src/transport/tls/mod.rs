//! TLS for REST and gRPC: certificates from files, read anew while the server runs, and the names in clients' certificates.
//!
//! A connection keeps what it was opened with; what was read anew is for those that come after it.

mod files;
mod handshake;
mod names;

use arc_swap::ArcSwap;
use metrics::{counter, describe_counter, describe_gauge, gauge};
use rustls::ServerConfig;
use rustls::pki_types::CertificateDer;
use rustls::server::{NoServerSessionStorage, WebPkiClientVerifier};
use std::path::PathBuf;
use std::sync::Arc;
use std::time::{Duration, SystemTime};
use thiserror::Error;

pub use files::{Identity, authorities, certificates, identity, provider};
pub use handshake::{Opened, Outcome, Secure, linger};
pub use names::{Named, named};

const HANDSHAKES: &str = "ubbmap_tls_handshakes_total";
const EXPIRY: &str = "ubbmap_tls_certificate_expiry_seconds";

/// A certificate that runs out within this time is worth a warning at the start and when it is read anew.
const SOON: Duration = Duration::from_secs(14 * 86_400);

/// Tells the recorder what each metric means. Call it once, after the recorder is installed.
pub fn describe_metrics() {
    describe_counter!(
        HANDSHAKES,
        "Connections by what became of their handshake: done; plain (no TLS was spoken); late (not done in time); failed"
    );
    describe_gauge!(EXPIRY, "Seconds until the server's certificate runs out; below zero it has");
}

fn count(outcome: &'static str) {
    counter!(HANDSHAKES, "outcome" => outcome).increment(1);
}

/// Whether clients show certificates.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ClientAuth {
    /// They are not asked.
    Off,
    /// Who shows one must show a good one.
    Optional,
    /// Without a good one there is no connection.
    Required,
}

/// Where the certificates are.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct TlsSettings {
    /// The server's certificate and those between it and an authority, in PEM, its own first.
    pub cert: PathBuf,
    /// The key of the first of them, in PEM.
    pub key: PathBuf,
    /// Authorities that sign clients' certificates, in PEM.
    pub client_ca: Option<PathBuf>,
    /// Whether clients show certificates.
    pub client_auth: ClientAuth,
}

impl TlsSettings {
    /// All files.
    #[must_use]
    pub fn files(&self) -> Vec<PathBuf> {
        [Some(&self.cert), Some(&self.key), self.client_ca.as_ref()].into_iter().flatten().cloned().collect()
    }
}

/// A file that cannot be used.
#[derive(Debug, Clone, PartialEq, Eq, Error)]
#[error("setting `{setting}`: {problem}")]
pub struct TlsError {
    /// The setting or flag that names it, such as `tls.cert`.
    pub setting: &'static str,
    /// What is wrong, with the file's name and the way out.
    pub problem: String,
}

impl TlsError {
    fn new(setting: &'static str, problem: String) -> Self {
        Self { setting, problem }
    }
}

/// What new connections are opened with. Clones share it.
#[derive(Debug, Clone)]
pub struct Tls(Arc<Inner>);

#[derive(Debug)]
struct Inner {
    settings: TlsSettings,
    current: ArcSwap<Current>,
}

#[derive(Debug)]
struct Current {
    config: Arc<ServerConfig>,
    /// When the first certificate of the chain runs out.
    until: SystemTime,
}

impl Tls {
    /// Reads the files. Blocks.
    ///
    /// # Errors
    /// [`TlsError`] at the setting whose file cannot be used. A certificate that has run out can be: clients decide.
    pub fn load(settings: TlsSettings) -> Result<Self, TlsError> {
        let current = ArcSwap::from_pointee(read(&settings)?);
        let tls = Self(Arc::new(Inner { settings, current }));
        for outcome in ["done", "plain", "late", "failed"] {
            counter!(HANDSHAKES, "outcome" => outcome).increment(0);
        }
        tls.note_metrics();
        Ok(tls)
    }

    /// Reads the files anew for connections to come; what cannot be used changes nothing. Blocks. A word for the log.
    ///
    /// # Errors
    /// [`TlsError`]
    pub fn reload(&self) -> Result<String, TlsError> {
        let current = read(&self.0.settings)?;
        let until = humantime::format_rfc3339_seconds(current.until);
        self.0.current.store(Arc::new(current));
        self.note_metrics();
        Ok(format!("the certificate of {}, good until {until}", self.0.settings.cert.display()))
    }

    /// Seconds until the server's certificate, or one between it and an authority, runs out; below zero one has.
    #[must_use]
    pub fn seconds_left(&self) -> f64 {
        let until = self.0.current.load().until;
        let left = until.duration_since(SystemTime::now());
        left.map_or_else(|late| -late.duration().as_secs_f64(), |left| left.as_secs_f64())
    }

    /// Brings the gauge of the certificate's time up to now.
    pub fn note_metrics(&self) {
        gauge!(EXPIRY).set(self.seconds_left());
    }

    /// Whether no client comes in without a certificate.
    #[must_use]
    pub fn keeps_strangers_out(&self) -> bool {
        self.0.settings.client_auth == ClientAuth::Required
    }

    fn config(&self) -> Arc<ServerConfig> {
        Arc::clone(&self.0.current.load().config)
    }
}

/// What the files hold.
fn read(settings: &TlsSettings) -> Result<Current, TlsError> {
    let identity = identity(("tls.cert", &settings.cert), ("tls.key", &settings.key))?;
    let until = validity(&identity.chain, settings);
    let builder = ServerConfig::builder_with_provider(provider())
        .with_safe_default_protocol_versions()
        .map_err(|error| TlsError::new("tls.cert", error.to_string()))?;
    let builder = match (&settings.client_ca, settings.client_auth) {
        (Some(path), auth @ (ClientAuth::Optional | ClientAuth::Required)) => {
            let roots = authorities("tls.client_ca", path)?;
            let verifier = WebPkiClientVerifier::builder_with_provider(Arc::new(roots), provider());
            let verifier = if auth == ClientAuth::Optional { verifier.allow_unauthenticated() } else { verifier };
            let verifier = verifier.build().map_err(|error| TlsError::new("tls.client_ca", error.to_string()))?;
            builder.with_client_cert_verifier(verifier)
        }
        _ => builder.with_no_client_auth(),
    };
    let mut config = builder
        .with_single_cert(identity.chain, identity.key)
        .map_err(|error| TlsError::new("tls.cert", format!("{}: {error}", settings.cert.display())))?;
    config.alpn_protocols = vec![b"h2".to_vec(), b"http/1.1".to_vec()];
    if settings.client_auth != ClientAuth::Off {
        // A session that is taken up again is not asked for its certificate: one that has run out would still open doors.
        config.session_storage = Arc::new(NoServerSessionStorage {});
        config.send_tls13_tickets = 0;
    }
    Ok(Current { config: Arc::new(config), until })
}

/// When the chain runs out; what is out of its time is said in the log.
fn validity(chain: &[CertificateDer<'_>], settings: &TlsSettings) -> SystemTime {
    let now = SystemTime::now();
    let file = settings.cert.display();
    let times: Vec<_> = chain.iter().filter_map(|certificate| names::times(certificate)).collect();
    // Without a certificate that can be read there is no server: this is never the default.
    let until = times.iter().map(|(_, until)| *until).min().unwrap_or(SystemTime::UNIX_EPOCH);
    let date = humantime::format_rfc3339_seconds(until);
    if times.iter().any(|(from, _)| *from > now) {
        tracing::warn!(setting = "tls.cert", "the certificate in {file} is not valid yet: clients refuse it");
    }
    if until <= now {
        tracing::warn!(setting = "tls.cert", "the certificate in {file} ran out at {date}: clients refuse it");
    } else if until.duration_since(now).is_ok_and(|left| left < SOON) {
        tracing::warn!(setting = "tls.cert", "the certificate in {file} runs out at {date}");
    }
    until
}

//! Authorities and certificates of our own, and clients that trust them.

#![allow(clippy::unwrap_used, reason = "a test may end where its ground is not as it should be")]

use crate::grpc_support::Client;
use crate::http_support::Site;
use hyper_util::rt::TokioIo;
use rcgen::{BasicConstraints, CertificateParams, DnType, IsCa, Issuer, KeyPair};
use rustls::pki_types::pem::PemObject;
use rustls::pki_types::{CertificateDer, PrivateKeyDer, ServerName};
use rustls::{ClientConfig, RootCertStore};
use std::io::{Read, Write};
use std::net::{SocketAddr, TcpStream};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;
use tempfile::TempDir;
use tokio_rustls::TlsConnector;
use tonic::transport::Endpoint;
use ubbmap::config::{ClientCertificates, Config};
use ubbmap::transport::grpc::generated::map_service_client::MapServiceClient;
use ubbmap::transport::tls::provider;

/// What stands in a certificate.
#[derive(Clone)]
pub struct Leaf {
    pub common: Option<&'static str>,
    pub names: Vec<&'static str>,
    /// First and last year.
    pub years: (i32, i32),
}

impl Leaf {
    /// A certificate for these names or addresses, valid for long.
    pub fn of(names: &[&'static str]) -> Self {
        Self { common: None, names: names.to_vec(), years: (2020, 2090) }
    }

    /// A certificate for a server on loopback.
    pub fn server() -> Self {
        Self::of(&["localhost", "127.0.0.1"])
    }
}

/// A certificate and its key in PEM.
#[derive(Clone)]
pub struct Pair {
    pub cert: String,
    pub key: String,
}

/// Who signs certificates.
pub struct Authority {
    issuer: Issuer<'static, KeyPair>,
    pub pem: String,
}

impl Authority {
    pub fn new(name: &str) -> Self {
        let mut params = CertificateParams::default();
        params.distinguished_name.push(DnType::CommonName, name);
        params.is_ca = IsCa::Ca(BasicConstraints::Unconstrained);
        let key = KeyPair::generate().unwrap();
        let pem = params.self_signed(&key).unwrap().pem();
        Self { issuer: Issuer::new(params, key), pem }
    }

    pub fn sign(&self, leaf: &Leaf) -> Pair {
        let names: Vec<String> = leaf.names.iter().map(|name| (*name).to_owned()).collect();
        let mut params = CertificateParams::new(names).unwrap();
        params.distinguished_name = rcgen::DistinguishedName::new();
        if let Some(common) = leaf.common {
            params.distinguished_name.push(DnType::CommonName, common);
        }
        params.not_before = rcgen::date_time_ymd(leaf.years.0, 1, 1);
        params.not_after = rcgen::date_time_ymd(leaf.years.1, 1, 1);
        let key = KeyPair::generate().unwrap();
        let cert = params.signed_by(&key, &self.issuer).unwrap().pem();
        Pair { cert, key: key.serialize_pem() }
    }
}

/// A folder with the files of a server: `server.pem`, `server.key`, `ca.pem` (its authority) and `robots.pem` (another, of
/// clients).
pub struct Office {
    pub folder: TempDir,
    pub ca: Authority,
    pub robots: Authority,
}

impl Office {
    pub fn new() -> Self {
        let office =
            Self { folder: tempfile::tempdir().unwrap(), ca: Authority::new("site"), robots: Authority::new("robots") };
        office.write("ca.pem", &office.ca.pem);
        office.write("robots.pem", &office.robots.pem);
        office.put(&office.ca.sign(&Leaf::server()));
        office
    }

    pub fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    pub fn text(&self, name: &str) -> String {
        self.path(name).to_str().unwrap().to_owned()
    }

    pub fn write(&self, name: &str, text: &str) -> PathBuf {
        let path = self.path(name);
        std::fs::write(&path, text).unwrap();
        path
    }

    /// Makes it the server's certificate.
    pub fn put(&self, pair: &Pair) {
        self.write("server.pem", &pair.cert);
        self.write("server.key", &pair.key);
    }

    /// The settings of a server with the certificate in the folder.
    pub fn settings(&self, config: &mut Config, client_auth: ClientCertificates) {
        config.tls.cert = self.text("server.pem");
        config.tls.key = self.text("server.key");
        config.tls.client_auth = client_auth;
        if client_auth != ClientCertificates::Off {
            config.tls.client_ca = self.text("robots.pem");
        }
    }

    /// A server, and an agent of it that trusts the authority.
    pub fn site(&self, client_auth: ClientCertificates) -> Site {
        let mut site = Site::with(|config| self.settings(config, client_auth));
        site.agent = agent(&self.ca.pem, None);
        site
    }

    /// What a client needs to trust the server, with a certificate to show or without.
    pub fn client(&self, own: Option<&Pair>, protocols: &[&str]) -> Arc<ClientConfig> {
        client(&self.ca.pem, own, protocols)
    }
}

fn chain(pem: &str) -> Vec<CertificateDer<'static>> {
    CertificateDer::pem_slice_iter(pem.as_bytes()).map(Result::unwrap).collect()
}

/// The settings of a client that trusts `ca`.
pub fn client(ca: &str, own: Option<&Pair>, protocols: &[&str]) -> Arc<ClientConfig> {
    let mut roots = RootCertStore::empty();
    for one in chain(ca) {
        roots.add(one).unwrap();
    }
    let builder = ClientConfig::builder_with_provider(provider())
        .with_safe_default_protocol_versions()
        .unwrap()
        .with_root_certificates(roots);
    let mut config = match own {
        Some(own) => {
            let key = PrivateKeyDer::from_pem_slice(own.key.as_bytes()).unwrap();
            builder.with_client_auth_cert(chain(&own.cert), key).unwrap()
        }
        None => builder.with_no_client_auth(),
    };
    config.alpn_protocols = protocols.iter().map(|name| name.as_bytes().to_vec()).collect();
    Arc::new(config)
}

/// An agent of HTTP/1.1 that trusts `ca`.
pub fn agent(ca: &str, own: Option<&Pair>) -> ureq::Agent {
    use ureq::tls::{Certificate, ClientCert, PrivateKey, RootCerts, TlsConfig};
    let roots = vec![Certificate::from_pem(ca.as_bytes()).unwrap()];
    let mut tls = TlsConfig::builder().root_certs(RootCerts::Specific(Arc::new(roots)));
    if let Some(own) = own {
        let chain = [Certificate::from_pem(own.cert.as_bytes()).unwrap()];
        let key = PrivateKey::from_pem(own.key.as_bytes()).unwrap();
        tls = tls.client_cert(Some(ClientCert::new_with_certs(&chain, key)));
    }
    ureq::Agent::config_builder()
        .http_status_as_error(false)
        .tls_config(tls.build())
        .timeout_global(Some(Duration::from_secs(60)))
        .build()
        .into()
}

/// A connection whose handshake is done as far as the client sees, blocking.
pub type Spoken = rustls::StreamOwned<rustls::ClientConnection, TcpStream>;

/// Opens a connection and does the handshake.
///
/// # Errors
/// What the server or the client has against it.
pub fn speak(address: SocketAddr, config: Arc<ClientConfig>) -> std::io::Result<Spoken> {
    let name = ServerName::try_from("localhost").unwrap();
    let connection = rustls::ClientConnection::new(config, name).unwrap();
    let stream = TcpStream::connect(address)?;
    stream.set_read_timeout(Some(Duration::from_secs(20)))?;
    let mut spoken = rustls::StreamOwned::new(connection, stream);
    while spoken.conn.is_handshaking() {
        spoken.conn.complete_io(&mut spoken.sock)?;
    }
    Ok(spoken)
}

/// One request over HTTP/1.1 on a connection; the answer's status line.
///
/// # Errors
/// When the connection ends before an answer.
pub fn status_line(stream: &mut Spoken, path: &str) -> std::io::Result<String> {
    write!(stream, "GET {path} HTTP/1.1\r\nhost: localhost\r\n\r\n")?;
    let mut head = Vec::new();
    while !head.ends_with(b"\r\n\r\n") {
        let mut byte = [0];
        stream.read_exact(&mut byte)?;
        head.push(byte[0]);
    }
    let head = String::from_utf8(head).unwrap();
    let length = head.lines().find_map(|line| line.to_lowercase().strip_prefix("content-length: ").map(str::to_owned));
    let mut body = vec![0; length.unwrap().parse().unwrap()];
    stream.read_exact(&mut body)?;
    Ok(head.lines().next().unwrap().to_owned())
}

impl Site {
    pub fn address(&self) -> SocketAddr {
        self.server.as_ref().unwrap().address()
    }

    /// A client of gRPC over TLS.
    pub async fn rpc_over(&self, config: Arc<ClientConfig>) -> Result<Client, tonic::transport::Error> {
        let address = self.address();
        let connect = tower::service_fn(move |_| {
            let config = Arc::clone(&config);
            async move {
                let stream = tokio::net::TcpStream::connect(address).await?;
                let name = ServerName::try_from("localhost").unwrap();
                TlsConnector::from(config).connect(name, stream).await.map(TokioIo::new)
            }
        });
        let channel = Endpoint::from_static("https://localhost").connect_with_connector(connect).await?;
        Ok(MapServiceClient::new(channel))
    }
}

/// Waits until something holds; it must within some seconds.
pub fn until(what: &str, mut holds: impl FnMut() -> bool) {
    for _ in 0..1000 {
        if holds() {
            return;
        }
        std::thread::sleep(Duration::from_millis(20));
    }
    panic!("never: {what}");
}

/// Puts a text under a path as `mv` does.
pub fn replace(path: &Path, text: &str) {
    let other = path.with_extension("new");
    std::fs::write(&other, text).unwrap();
    std::fs::rename(other, path).unwrap();
}

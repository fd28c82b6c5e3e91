//! Certificates and keys in PEM files, and what people get wrong about them.

use super::{TlsError, names};
use rustls::RootCertStore;
use rustls::crypto::CryptoProvider;
use rustls::pki_types::pem::{Error as PemError, PemObject};
use rustls::pki_types::{CertificateDer, PrivateKeyDer};
use rustls::sign::CertifiedKey;
use std::path::Path;
use std::sync::Arc;

/// Largest file, bytes: the authorities of a whole system take a quarter of it.
const MOST_BYTES: u64 = 1 << 20;

/// A certificate with what stands between it and an authority, and its key.
#[derive(Debug)]
pub struct Identity {
    /// The certificates, the own one first.
    pub chain: Vec<CertificateDer<'static>>,
    /// The key of the first.
    pub key: PrivateKeyDer<'static>,
}

/// The one provider of cryptography.
#[must_use]
pub fn provider() -> Arc<CryptoProvider> {
    Arc::new(rustls::crypto::ring::default_provider())
}

/// Reads a certificate and its key, and makes sure that they belong together. Each file comes with the setting that names
/// it.
///
/// # Errors
/// [`TlsError`] at one of the two settings.
pub fn identity(cert: (&'static str, &Path), key: (&'static str, &Path)) -> Result<Identity, TlsError> {
    let chain = certificates(cert.0, cert.1)?;
    let (setting, path) = key;
    let bad = |problem: String| TlsError::new(setting, format!("{} {problem}", path.display()));
    let key = private_key(setting, path, cert.0)?;
    let signing = provider().key_provider.load_private_key(key.clone_key()).map_err(|error| {
        bad(format!(
            "holds a key that cannot be used ({error}): RSA from 2048 bits, ECDSA on P-256 or P-384, and Ed25519 can"
        ))
    })?;
    match CertifiedKey::new(chain.clone(), Arc::clone(&signing)).keys_match() {
        // A key that does not tell its public half is tried by the first client.
        Ok(()) | Err(rustls::Error::InconsistentKeys(rustls::InconsistentKeys::Unknown)) => Ok(Identity { chain, key }),
        Err(rustls::Error::InconsistentKeys(_)) => {
            let of_another = |one: &CertificateDer<'static>| CertifiedKey::new(vec![one.clone()], Arc::clone(&signing));
            let file = cert.1.display();
            Err(bad(if chain.iter().skip(1).any(|one| of_another(one).keys_match().is_ok()) {
                format!("is not the key of the first certificate in {file} but of a later one: put that one first")
            } else {
                format!("is not the key of the certificate in {file}")
            }))
        }
        Err(error) => Err(TlsError::new(cert.0, format!("{}: {error}", cert.1.display()))),
    }
}

/// Reads the certificates of a file, at least one.
///
/// # Errors
/// [`TlsError`]
pub fn certificates(setting: &'static str, path: &Path) -> Result<Vec<CertificateDer<'static>>, TlsError> {
    let bad = |problem: String| TlsError::new(setting, format!("{} {problem}", path.display()));
    let bytes = read(setting, path)?;
    let found: Result<Vec<_>, PemError> = CertificateDer::pem_slice_iter(&bytes).collect();
    let found = found.map_err(|error| bad(format!("is not in PEM: {error}")))?;
    if found.is_empty() {
        return Err(bad(if has(&bytes, "PRIVATE KEY-----") {
            "holds a key and no certificate: are the two files mixed up?".to_owned()
        } else if bytes.first() == Some(&0x30) {
            format!("is in DER, not in PEM: openssl x509 -inform der -in {} -out FILE", path.display())
        } else if bytes.iter().all(u8::is_ascii_whitespace) {
            "is empty: it must hold a certificate in PEM".to_owned()
        } else {
            "holds no certificate in PEM (-----BEGIN CERTIFICATE-----)".to_owned()
        }));
    }
    for (at, certificate) in found.iter().enumerate() {
        if names::times(certificate).is_none() {
            return Err(bad(format!("is damaged: certificate {} of {} cannot be read", at + 1, found.len())));
        }
    }
    Ok(found)
}

/// Reads authorities: certificates that sign others.
///
/// # Errors
/// [`TlsError`]
pub fn authorities(setting: &'static str, path: &Path) -> Result<RootCertStore, TlsError> {
    let mut roots = RootCertStore::empty();
    for certificate in certificates(setting, path)? {
        roots.add(certificate).map_err(|error| {
            let problem = format!("{} holds a certificate that cannot be an authority: {error}", path.display());
            TlsError::new(setting, problem)
        })?;
    }
    Ok(roots)
}

fn private_key(
    setting: &'static str,
    path: &Path,
    cert_setting: &'static str,
) -> Result<PrivateKeyDer<'static>, TlsError> {
    let bad = |problem: String| TlsError::new(setting, format!("{} {problem}", path.display()));
    let bytes = read(setting, path)?;
    if has(&bytes, "ENCRYPTED") {
        return Err(bad(format!(
            "holds a key that is encrypted with a passphrase, and nobody is there to type it: openssl pkey -in {} -out \
             FILE, and keep FILE readable by its user alone",
            path.display()
        )));
    }
    PrivateKeyDer::from_pem_slice(&bytes).map_err(|error| {
        bad(match error {
            PemError::NoItemsFound if has(&bytes, "-----BEGIN CERTIFICATE") => {
                format!("holds a certificate and no key: is it the file for {cert_setting}?")
            }
            PemError::NoItemsFound if bytes.first() == Some(&0x30) => {
                format!("is in DER, not in PEM: openssl pkey -inform der -in {} -out FILE", path.display())
            }
            PemError::NoItemsFound => "holds no key in PEM (-----BEGIN PRIVATE KEY-----)".to_owned(),
            error => format!("is not in PEM: {error}"),
        })
    })
}

fn has(bytes: &[u8], word: &str) -> bool {
    bytes.windows(word.len()).any(|window| window == word.as_bytes())
}

fn read(setting: &'static str, path: &Path) -> Result<Vec<u8>, TlsError> {
    let failed = |error: std::io::Error| TlsError::new(setting, format!("cannot read {}: {error}", path.display()));
    let known = std::fs::metadata(path).map_err(failed)?;
    if !known.is_file() {
        return Err(TlsError::new(setting, format!("{} is not a file", path.display())));
    }
    if known.len() > MOST_BYTES {
        let problem = format!("{} has {} bytes, at most {MOST_BYTES} are read", path.display(), known.len());
        return Err(TlsError::new(setting, problem));
    }
    std::fs::read(path).map_err(failed)
}

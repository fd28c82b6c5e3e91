//! What stands in a certificate: whom it names, and its time.

use rustls::pki_types::CertificateDer;
use std::sync::Arc;
use std::time::{Duration, SystemTime};
use x509_parser::certificate::X509Certificate;
use x509_parser::extensions::GeneralName;
use x509_parser::prelude::FromDer;
use x509_parser::time::ASN1Time;

/// Longest name that is taken from a certificate, bytes.
const MOST_NAME: usize = 256;

/// Whom a client's certificate names, and until when.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Named {
    /// The first DNS name among its alternative names; without one, its common name.
    pub name: Arc<str>,
    /// When it runs out.
    pub until: SystemTime,
}

/// Whom a certificate names; `None` where it names nobody, or not in printable characters.
#[must_use]
pub fn named(certificate: &CertificateDer<'_>) -> Option<Named> {
    let (_, parsed) = X509Certificate::from_der(certificate).ok()?;
    let alternatives = parsed.subject_alternative_name().ok().flatten();
    let dns = alternatives.as_ref().and_then(|names| {
        names.value.general_names.iter().find_map(|name| match name {
            GeneralName::DNSName(name) => Some(*name),
            _ => None,
        })
    });
    let common = || parsed.subject().iter_common_name().next().and_then(|name| name.as_str().ok());
    let name = dns.or_else(common)?;
    let fits = !name.is_empty() && name.len() <= MOST_NAME && !name.chars().any(char::is_control);
    fits.then(|| Named { name: name.into(), until: time(parsed.validity().not_after) })
}

/// From when to when a certificate is valid; `None` for what is no certificate.
#[must_use]
pub fn times(certificate: &CertificateDer<'_>) -> Option<(SystemTime, SystemTime)> {
    let (_, parsed) = X509Certificate::from_der(certificate).ok()?;
    let validity = parsed.validity();
    Some((time(validity.not_before), time(validity.not_after)))
}

/// Times before 1970 become its beginning.
fn time(time: ASN1Time) -> SystemTime {
    SystemTime::UNIX_EPOCH + Duration::from_secs(u64::try_from(time.timestamp()).unwrap_or(0))
}

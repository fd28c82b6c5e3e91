//! What the server reads from files: certificates, who may come in, who may connect by Zenoh; and how it is read anew.
//!
//! A watch is always made before the first reading, so that nothing changes unseen between the two.

use super::AppError;
use crate::config::{Config, ConfigError};
use crate::reload::Watched;
use crate::transport::access::Access;
use crate::transport::tls::{Tls, TlsError};
use crate::transport::zenoh::ZenohSettings;
use std::sync::{Arc, OnceLock};

/// The certificates, where the settings name any.
pub(super) async fn tls(config: &Config) -> Result<(Option<Tls>, Vec<Watched>), AppError> {
    let Some(settings) = config.tls_settings() else { return Ok((None, Vec::new())) };
    // Zenoh reads its certificate by itself, when its listener opens.
    let zenoh = config.zenoh_settings().is_some_and(|zenoh| zenoh.tls.is_some());
    let read = move || {
        let reading: Arc<OnceLock<Tls>> = Arc::default();
        let again = Arc::clone(&reading);
        let watched = Watched::new("tls", settings.files(), move || {
            let word =
                again.get().map_or(Ok("nothing yet".to_owned()), Tls::reload).map_err(|error| error.to_string())?;
            if zenoh {
                tracing::warn!("Zenoh's own listener keeps the certificate that it started with until a restart");
            }
            Ok(word)
        });
        let tls = Tls::load(settings)?;
        Ok((reading.get_or_init(|| tls).clone(), watched))
    };
    let loaded: Result<_, TlsError> = tokio::task::spawn_blocking(read).await.map_err(|_| AppError::Files)?;
    let (tls, watched) = loaded.map_err(ConfigError::from)?;
    Ok((Some(tls), vec![watched]))
}

/// Who may come in.
pub(super) fn access(config: &Config) -> Result<(Access, Vec<Watched>), AppError> {
    let reading: Arc<OnceLock<Access>> = Arc::default();
    let read = Arc::clone(&reading);
    let watched = config.tokens_file().map(|file| {
        let reload = move || read.get().map_or(Ok("nothing yet".to_owned()), Access::reload);
        Watched::new("tokens", vec![file.to_owned()], reload)
    });
    let access = config.access()?;
    let access = reading.get_or_init(|| access).clone();
    Ok((access, watched.into_iter().collect()))
}

/// The transport over Zenoh with who may connect to it; `None` where it is off.
pub(super) fn zenoh(config: &Config, access: &Access) -> Result<Option<(ZenohSettings, Vec<Watched>)>, AppError> {
    let Some(mut settings) = config.zenoh_settings() else { return Ok(None) };
    let used: Arc<OnceLock<Vec<_>>> = Arc::default();
    let (known, again) = (Arc::clone(&used), config.clone());
    let watched = config.zenoh_users_file().map(|file| {
        Watched::new("zenoh users", vec![file.to_owned()], move || {
            let read = again.zenoh_users().map_err(|error| error.to_string())?;
            if known.get() == Some(&read) {
                return Ok("as before".to_owned());
            }
            Err("Zenoh takes its users at the start: restart the server for those that changed".to_owned())
        })
    });
    let users = config.zenoh_users()?;
    settings.users = used.get_or_init(|| users).clone();
    if settings.tls.as_ref().is_some_and(|tls| tls.client_ca.is_some()) {
        settings.certificates = access.certificates();
    }
    Ok(Some((settings, watched.into_iter().collect())))
}

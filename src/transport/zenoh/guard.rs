//! Who may connect to the server's own router and what passes from whom: users, certificates, and the server's own health check.

use super::ZenohError;
use super::rules::{Right, Subject, access_control};
use super::settings::{ZenohSettings, set};
use ::zenoh::Config;
use serde_json::json;
use std::fs::File;

/// The health check's user. No user of a file can have this name.
const PROBE: &str = "@server";

/// Random bytes of its password.
const PROBE_BYTES: usize = 32;

/// Where the health check connects when all other endpoints speak TLS: the server's certificate is for another name and another
/// authority's affair, and clients' certificates may be asked for.
const INNER: &str = "tcp/127.0.0.1:0";

/// What guards a router; nothing where all may do everything.
#[derive(Debug, Default)]
pub struct Guard {
    subjects: Vec<(Subject, Right)>,
    /// The password of the health check, where users are asked for theirs.
    password: Option<String>,
    inner: bool,
}

/// The passwords, in the form and the place that Zenoh reads them from. Nothing of it is on a disk.
#[derive(Debug)]
pub struct Passwords {
    file: File,
}

impl Guard {
    /// What the settings ask for.
    ///
    /// # Errors
    /// [`ZenohError::Session`] where the system has no random numbers.
    pub fn new(settings: &ZenohSettings) -> Result<Self, ZenohError> {
        let tls = settings.listen.iter().filter(|endpoint| is_tls(endpoint)).count();
        let inner = settings.tls.is_some() && tls > 0 && tls == settings.listen.len();
        let mut guard = Self { subjects: Vec::new(), password: None, inner };
        let asks = !settings.users.is_empty() || settings.certificates.is_some();
        if !asks && !inner {
            return Ok(guard);
        }
        for user in &settings.users {
            guard
                .subjects
                .push((Subject::User { name: user.name.clone(), tls: inner }, Right::Granted(user.grant.clone())));
        }
        for (name, grant) in settings.certificates.iter().flatten() {
            guard.subjects.push((Subject::Certificate(name.clone()), Right::Granted(grant.clone())));
        }
        if !asks {
            guard.subjects.push((Subject::Tls, Right::Everything));
        }
        if settings.users.is_empty() {
            // Anybody on this machine may ask how the server is.
            guard.subjects.push((Subject::Tcp, Right::Health));
        } else {
            guard.password = Some(password()?);
            guard.subjects.push((Subject::User { name: PROBE.to_owned(), tls: false }, Right::Health));
        }
        Ok(guard)
    }

    /// The endpoint that the server opens for its health check alone.
    pub fn inner(&self) -> Option<&'static str> {
        self.inner.then_some(INNER)
    }

    /// Writes it into the configuration of the server's session. What comes back must live until the session is open.
    ///
    /// # Errors
    /// [`ZenohError::Settings`], [`ZenohError::Session`]
    pub fn of_server(&self, settings: &ZenohSettings, config: &mut Config) -> Result<Option<Passwords>, ZenohError> {
        if let Some(tls) = &settings.tls {
            set(config, "transport/link/tls/listen_certificate", &json!(tls.cert))?;
            set(config, "transport/link/tls/listen_private_key", &json!(tls.key))?;
            if let Some(authorities) = &tls.client_ca {
                set(config, "transport/link/tls/root_ca_certificate", &json!(authorities))?;
                set(config, "transport/link/tls/enable_mtls", &json!(true))?;
                set(config, "transport/link/tls/close_link_on_expiration", &json!(true))?;
            }
        }
        if !self.subjects.is_empty() {
            set(config, "access_control", &access_control(&settings.prefix, &self.subjects))?;
        }
        let Some(own) = &self.password else { return Ok(None) };
        let users = settings.users.iter().map(|user| (user.name.as_str(), user.password.as_str()));
        let lines = users.chain([(PROBE, own.as_str())]).map(|(name, password)| format!("{name}:{password}\n"));
        let passwords = Passwords::write(&lines.collect::<String>())?;
        set(config, "transport/auth/usrpwd/dictionary_file", &json!(passwords.path()))?;
        Ok(Some(passwords))
    }

    /// Writes the health check's own password into the configuration of its session.
    ///
    /// # Errors
    /// [`ZenohError::Settings`]
    pub fn of_probe(&self, config: &mut Config) -> Result<(), ZenohError> {
        if let Some(password) = &self.password {
            set(config, "transport/auth/usrpwd/user", &json!(PROBE))?;
            set(config, "transport/auth/usrpwd/password", &json!(password))?;
        }
        Ok(())
    }
}

/// Does an endpoint speak TLS?
pub fn is_tls(endpoint: &str) -> bool {
    endpoint.starts_with("tls/")
}

fn password() -> Result<String, ZenohError> {
    let mut bytes = [0_u8; PROBE_BYTES];
    getrandom::fill(&mut bytes).map_err(|error| ZenohError::Session(format!("no random numbers: {error}")))?;
    Ok(bytes.iter().map(|byte| format!("{byte:02x}")).collect())
}

impl Passwords {
    /// A file in memory that has no name on any disk and goes with the process.
    #[cfg(target_os = "linux")]
    fn write(text: &str) -> Result<Self, ZenohError> {
        use rustix::fs::{MemfdFlags, memfd_create};
        use std::io::Write;
        let failed = |error: std::io::Error| ZenohError::Session(format!("no file in memory for passwords: {error}"));
        let mut file =
            File::from(memfd_create("ubbmap-users", MemfdFlags::CLOEXEC).map_err(|error| failed(error.into()))?);
        file.write_all(text.as_bytes()).map_err(failed)?;
        Ok(Self { file })
    }

    #[cfg(not(target_os = "linux"))]
    fn write(_: &str) -> Result<Self, ZenohError> {
        Err(ZenohError::Settings("zenoh.users needs files in memory, which only Linux has".to_owned()))
    }

    fn path(&self) -> String {
        use std::os::fd::AsRawFd;
        format!("/proc/self/fd/{}", self.file.as_raw_fd())
    }
}

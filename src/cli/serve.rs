//! `ubbmap serve`: the server.

use super::output::{Failure, say};
use super::preflight;
use crate::app::{self, AppError};
use crate::config::{Config, ConfigError, Origins, address};
use crate::telemetry::{self, Traces};
use clap::Args;
use std::net::SocketAddr;
use std::path::PathBuf;

/// Runs the server; prints one line with its address when it is ready, and ends on SIGTERM when all is durable.
#[derive(Debug, Args)]
#[command(
    after_help = "Flags stand above the environment (UBBMAP_LISTEN, UBBMAP_LIMITS__MAPS, ..), and that above the file.\n\n\
    Example:\n  ubbmap serve --check --listen 127.0.0.1:8080 --data maps\n  \
    ubbmap serve --listen 127.0.0.1:8080 --data maps"
)]
pub(super) struct Serve {
    /// Settings in TOML [default: $UBBMAP_CONFIG, or none]
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
    /// Address to listen on; port 0 takes a free one [default: 127.0.0.1:8080]
    #[arg(long, value_name = "ADDRESS", value_parser = address)]
    listen: Option<SocketAddr>,
    /// Directory of the store [default: ubbmap-data]
    #[arg(long, value_name = "DIR")]
    data: Option<PathBuf>,
    /// Where maps are kept: sled, or memory, which forgets them at the end [default: sled]
    #[arg(long, value_name = "KIND")]
    store: Option<String>,
    /// Level or filter of the log on stderr, such as warn or ubbmap=debug [default: info]
    #[arg(long, value_name = "FILTER")]
    log: Option<String>,
    /// File of tokens: who may do what; `ubbmap token create` writes it [default: none, and everything is open]
    #[arg(long, value_name = "FILE")]
    tokens: Option<PathBuf>,
    /// Address of its own for administration and /metrics [default: none, they are at --listen]
    #[arg(long, value_name = "ADDRESS", value_parser = address)]
    admin_listen: Option<SocketAddr>,
    /// Allow an address beyond loopback although everyone who reaches it may read and change every map
    #[arg(long)]
    insecure: bool,
    /// Start nothing: check the settings, the address and the store, and print every setting with where it was given; exit
    /// code 64 when the server would not start
    #[arg(long, help_heading = "Check")]
    check: bool,
    /// Print what --check finds as one JSON object
    #[arg(long, requires = "check", help_heading = "Check")]
    json: bool,
}

impl Serve {
    /// Runs the command.
    pub(super) fn run(self) -> Result<(), Failure> {
        let loaded = self.settings();
        if self.check {
            return preflight::check(loaded, self.json);
        }
        let (config, _) = loaded.map_err(|error| Failure::Configuration(error.to_string()))?;
        let runtime = tokio::runtime::Builder::new_multi_thread().enable_all().build()?;
        let scheme = if config.tls_settings().is_some() { "https" } else { "http" };
        let traces = {
            let _inside = runtime.enter();
            Traces::start(&config.telemetry).map_err(Failure::Configuration)?
        };
        telemetry::init(&config.log, config.log_format, traces.as_ref());
        let served = runtime.block_on(app::serve(config, |address| {
            // Without a reader of the line the server serves all the same.
            let _ = say(&format!("ubbmap listening on {scheme}://{address}"));
        }));
        if let Some(traces) = traces {
            traces.end();
        }
        match served {
            Ok(()) => Ok(()),
            Err(AppError::Config(error)) => Err(Failure::Configuration(error.to_string())),
            Err(error) => Err(error.into()),
        }
    }

    fn settings(&self) -> Result<(Config, Origins), ConfigError> {
        let mut overrides = Vec::new();
        if let Some(listen) = self.listen {
            overrides.push(("listen", listen.to_string()));
        }
        if let Some(data) = &self.data {
            overrides.push(("data_dir", data.display().to_string()));
        }
        if let Some(store) = &self.store {
            overrides.push(("store", store.clone()));
        }
        if let Some(log) = &self.log {
            overrides.push(("log", log.clone()));
        }
        if let Some(tokens) = &self.tokens {
            overrides.push(("access.tokens", tokens.display().to_string()));
        }
        if let Some(address) = self.admin_listen {
            overrides.push(("admin_listen", address.to_string()));
        }
        if self.insecure {
            overrides.push(("insecure", "true".to_owned()));
        }
        let file = self.config.clone().or_else(|| std::env::var_os("UBBMAP_CONFIG").map(PathBuf::from));
        // Variables that are not text cannot be settings of ours.
        let environment = std::env::vars_os().filter_map(|(k, v)| Some((k.into_string().ok()?, v.into_string().ok()?)));
        Config::load_with_origins(file.as_deref(), environment, &overrides)
    }
}

//! Reading the settings: file, then environment, then flags, and the checks.

use super::{Config, ConfigError};
use config::{File, FileFormat, Map, Source, Value, ValueKind};
use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

/// Variables of the environment that begin with the prefix and belong to other parts of the program; `UBBMAP_DATA` is where
/// tests find recorded logs, `UBBMAP_VIEWER` a switch of the build.
const OTHER_VARIABLES: [&str; 9] = [
    "UBBMAP_CA",
    "UBBMAP_CERT",
    "UBBMAP_CONFIG",
    "UBBMAP_DATA",
    "UBBMAP_KEY",
    "UBBMAP_SERVER",
    "UBBMAP_TOKEN",
    "UBBMAP_TOKEN_FILE",
    "UBBMAP_VIEWER",
];

/// What variables of the environment begin with.
const PREFIX: &str = "UBBMAP_";

/// Largest count: that of the counters of permits and of 32-bit lengths.
const MOST_COUNT: usize = 1 << 28;

/// Largest number of bytes for scans under way.
const MOST_BYTES: usize = 1 << 40;

/// Least bytes of a cache.
const LEAST_CACHE: usize = 1 << 20;

/// Least factor of the store's size: a database that was just rewritten takes up to 3 times what it holds, and one that is
/// written to settles at 6.
const LEAST_FACTOR: f64 = 4.0;

/// Largest factor of the store's size.
const MOST_FACTOR: f64 = 1e6;

/// Most threads for evidence.
const MOST_THREADS: usize = 1024;

/// Least room for the head of a request, bytes: what browsers and proxies send.
const LEAST_HEAD: usize = 1024;

/// Most of it: heads are read no farther.
const MOST_HEAD: usize = 64 << 10;

/// Deepest quadtree that there is.
const MOST_DEPTH: usize = 24;

/// Longest name by the rules of names, bytes.
const MOST_NAME: usize = 63;

/// Names farther away than this share of their letters are not offered.
const LEAST_SIMILARITY: f64 = 0.7;

/// Where settings were given, by their keys: a file's path, a variable of the environment, or the command line. Those that
/// are not named are at their defaults.
pub type Origins = BTreeMap<String, String>;

impl Config {
    /// Reads the settings. `env` is the process's environment (variables that do not begin with `UBBMAP_` are passed
    /// over; `__` separates a table from its key); `overrides` are flags as `(key, value)`, such as
    /// `("limits.maps", "10")`.
    ///
    /// # Errors
    /// [`ConfigError`] naming the setting, where it was given, and for an unknown one the nearest known.
    pub fn load(
        file: Option<&Path>,
        env: impl IntoIterator<Item = (String, String)>,
        overrides: &[(&str, String)],
    ) -> Result<Self, ConfigError> {
        Ok(Self::load_with_origins(file, env, overrides)?.0)
    }

    /// The same, and where each setting that is not at its default was given.
    ///
    /// # Errors
    /// As [`Config::load`].
    pub fn load_with_origins(
        file: Option<&Path>,
        env: impl IntoIterator<Item = (String, String)>,
        overrides: &[(&str, String)],
    ) -> Result<(Self, Origins), ConfigError> {
        let known = known_keys()?;
        let mut origins = Origins::new();
        let mut builder = config::Config::builder();
        if let Some(path) = file {
            let values = read_file(path)?;
            for key in flatten(&values) {
                check_key(&known, &key, || format!("in {}", path.display()))?;
                origins.insert(key, path.display().to_string());
            }
            builder = builder.add_source(Layer(values));
        }
        for (variable, value) in env {
            let Some(name) = variable.strip_prefix(PREFIX) else { continue };
            if OTHER_VARIABLES.contains(&variable.as_str()) {
                continue;
            }
            let key = name.to_lowercase().replace("__", ".");
            check_key(&known, &key, || format!("in the environment ({variable})"))?;
            builder = set(builder, &key, value)?;
            origins.insert(key, variable);
        }
        for (key, value) in overrides {
            check_key(&known, key, || "on the command line".to_owned())?;
            origins.insert((*key).to_owned(), "the command line".to_owned());
            builder = set(builder, key, value.clone())?;
        }
        let loaded = builder.build().and_then(config::Config::try_deserialize).map_err(|error| value_error(&error));
        let checked = loaded.and_then(|loaded: Self| loaded.check().map(|()| loaded));
        match checked {
            Ok(loaded) => Ok((loaded, origins)),
            Err(error) => Err(error.given(&origins)),
        }
    }

    /// Checks the values against each other and their ranges.
    ///
    /// # Errors
    /// [`ConfigError::Value`] and [`ConfigError::NotLoopback`].
    pub fn check(&self) -> Result<(), ConfigError> {
        self.check_counts()?;
        let limits = &self.limits;
        let numbers = [
            ("limits.pose_width", limits.pose_width, 1e6),
            ("limits.pose_heading_degrees", limits.pose_heading_degrees, 360.0),
            ("limits.request_seconds", limits.request_seconds, 86_400.0),
            ("limits.transfer_seconds", limits.transfer_seconds, 86_400.0),
            ("limits.header_seconds", limits.header_seconds, 86_400.0),
            ("limits.idle_seconds", limits.idle_seconds, 86_400.0),
        ];
        for (key, value, most) in numbers {
            if !(value > 0.0 && value <= most) {
                return Err(bad(key, format!("must be above 0 and at most {most}, got {value}")));
            }
        }
        self.check_rewrite()?;
        let grace = self.shutdown.grace_seconds;
        if !(0.0..=86_400.0).contains(&grace) {
            return Err(bad("shutdown.grace_seconds", format!("must be between 0 and 86400, got {grace}")));
        }
        if let Err(problem) = crate::telemetry::check_filter(&self.log) {
            return Err(bad("log", problem));
        }
        self.check_origins()?;
        self.telemetry.check()?;
        self.tls.check()?;
        let client_auth = (!self.tls.cert.is_empty()).then_some(self.tls.client_auth);
        self.zenoh.check(self.insecure, client_auth)?;
        self.check_access()
    }
}

impl Config {
    /// The origins whose pages may use this server.
    pub(crate) fn origins(&self) -> Vec<&str> {
        self.cors_origins.split(',').map(str::trim).filter(|origin| !origin.is_empty()).collect()
    }

    fn check_origins(&self) -> Result<(), ConfigError> {
        for origin in self.origins() {
            let host = origin.strip_prefix("https://").or_else(|| origin.strip_prefix("http://"));
            let named = host.is_some_and(|host| {
                !host.is_empty() && host.bytes().all(|byte| byte.is_ascii_graphic() && !b"/?#@*".contains(&byte))
            });
            if origin != "*" && !named {
                let problem = format!("must be origins such as https://app.example.org, or \"*\", got {origin:?}");
                return Err(bad("cors_origins", problem));
            }
        }
        Ok(())
    }

    fn check_rewrite(&self) -> Result<(), ConfigError> {
        let rewrite = &self.rewrite;
        if !(LEAST_FACTOR..=MOST_FACTOR).contains(&rewrite.factor) {
            let problem = format!("must be between {LEAST_FACTOR} and {MOST_FACTOR}, got {}", rewrite.factor);
            return Err(bad("rewrite.factor", problem));
        }
        if !(rewrite.check_seconds > 0.0 && rewrite.check_seconds <= 86_400.0) {
            let problem = format!("must be above 0 and at most 86400, got {}", rewrite.check_seconds);
            return Err(bad("rewrite.check_seconds", problem));
        }
        Ok(())
    }

    fn check_counts(&self) -> Result<(), ConfigError> {
        let limits = &self.limits;
        let counts = [
            ("limits.body_bytes", limits.body_bytes),
            ("limits.config_bytes", limits.config_bytes),
            ("limits.import_bytes", limits.import_bytes),
            ("limits.scans_per_request", limits.scans_per_request),
            ("limits.beams_per_scan", limits.beams_per_scan),
            ("limits.points_per_query", limits.points_per_query),
            ("limits.regions_per_query", limits.regions_per_query),
            ("limits.points_per_region", limits.points_per_region),
            ("limits.leaves_per_answer", limits.leaves_per_answer),
            ("limits.cells_per_answer", limits.cells_per_answer),
            ("limits.maps", limits.maps),
            ("limits.robots_per_map", limits.robots_per_map),
            ("limits.snapshots", limits.snapshots),
            ("limits.connections", limits.connections),
            ("limits.connections_per_client", limits.connections_per_client),
            ("limits.requests_per_connection", limits.requests_per_connection),
            ("limits.requests", limits.requests),
            ("limits.insertions", limits.insertions),
            ("limits.streams_per_client", limits.streams_per_client),
            ("limits.streams", limits.streams),
            ("limits.transfers", limits.transfers),
            ("limits.scans_per_stream", limits.scans_per_stream),
            ("limits.queries", limits.queries),
            ("zenoh.queue", self.zenoh.queue),
            ("zenoh.in_flight", self.zenoh.in_flight),
            ("writer.changes", self.writer.changes),
            ("writer.queue", self.writer.queue),
            ("writer.scans_per_commit", self.writer.scans_per_commit),
        ];
        let bytes = (limits.insert_bytes, limits.body_bytes, MOST_BYTES);
        let threads = (self.writer.evidence_threads, 0, MOST_THREADS);
        let blocks = (self.cache.block_bytes, LEAST_CACHE, MOST_BYTES);
        let snapshots = (self.cache.snapshot_bytes, 0, MOST_BYTES);
        let pages = (usize::try_from(self.cache.page_bytes).unwrap_or(usize::MAX), LEAST_CACHE, MOST_BYTES);
        let rewritten = (usize::try_from(self.rewrite.least_bytes).unwrap_or(usize::MAX), LEAST_CACHE, MOST_BYTES);
        let ranges = counts.into_iter().map(|(key, value)| (key, (value, 1, MOST_COUNT)));
        let others = [
            ("limits.insert_bytes", bytes),
            ("limits.incoming_bytes", (limits.incoming_bytes, limits.body_bytes, MOST_BYTES)),
            ("limits.answer_bytes", (limits.answer_bytes, LEAST_CACHE, MOST_BYTES)),
            ("limits.header_bytes", (limits.header_bytes, LEAST_HEAD, MOST_HEAD)),
            ("limits.depth", (limits.depth, 1, MOST_DEPTH)),
            ("limits.name_bytes", (limits.name_bytes, 1, MOST_NAME)),
            ("writer.evidence_threads", threads),
            ("cache.block_bytes", blocks),
            ("cache.snapshot_bytes", snapshots),
            ("cache.page_bytes", pages),
            ("rewrite.least_bytes", rewritten),
        ];
        for (key, (value, least, most)) in ranges.chain(others) {
            if !(least..=most).contains(&value) {
                return Err(bad(key, format!("must be between {least} and {most}, got {value}")));
            }
        }
        Ok(())
    }
}

/// Values that were read already, as a source of the builder.
#[derive(Debug, Clone)]
struct Layer(Map<String, Value>);

impl Source for Layer {
    fn clone_into_box(&self) -> Box<dyn Source + Send + Sync> {
        Box::new(self.clone())
    }

    fn collect(&self) -> Result<Map<String, Value>, config::ConfigError> {
        Ok(self.0.clone())
    }
}

fn read_file(path: &Path) -> Result<Map<String, Value>, ConfigError> {
    let text = std::fs::read_to_string(path).map_err(|source| ConfigError::File { path: path.to_owned(), source })?;
    File::from_str(&text, FileFormat::Toml)
        .collect()
        .map_err(|error| ConfigError::Syntax { path: path.to_owned(), problem: error.to_string().trim().to_owned() })
}

/// Every setting's key, taken from the default configuration.
pub(super) fn known_keys() -> Result<BTreeSet<String>, ConfigError> {
    let defaults = config::Config::try_from(&Config::default()).map_err(|error| value_error(&error))?;
    let values = defaults.collect().map_err(|error| value_error(&error))?;
    Ok(flatten(&values).into_iter().collect())
}

/// The keys of all values that are not tables, with their tables before them.
fn flatten(values: &Map<String, Value>) -> Vec<String> {
    let mut keys = Vec::new();
    for (name, value) in values {
        match &value.kind {
            ValueKind::Table(inner) if !inner.is_empty() => {
                keys.extend(flatten(inner).into_iter().map(|key| format!("{name}.{key}")));
            }
            _ => keys.push(name.clone()),
        }
    }
    keys.sort();
    keys
}

fn check_key(known: &BTreeSet<String>, key: &str, origin: impl Fn() -> String) -> Result<(), ConfigError> {
    if known.contains(key) {
        return Ok(());
    }
    // A table given as a value, or an empty one, is of no use but no riddle either.
    if known.iter().any(|name| name.strip_prefix(key).is_some_and(|rest| rest.starts_with('.'))) {
        return Err(bad(key, "is a table of settings, not a value".to_owned()));
    }
    let last = |name: &str| name.rsplit('.').next().unwrap_or_default().to_owned();
    let similarity = |name: &String| {
        // The right name in the wrong table is near as well.
        strsim::jaro_winkler(key, name).max(strsim::jaro_winkler(&last(key), &last(name)))
    };
    // Of two such names the one in the right table is nearer.
    let whole = |name: &String| strsim::jaro_winkler(key, name);
    let nearest = known
        .iter()
        .max_by(|a, b| similarity(a).total_cmp(&similarity(b)).then(whole(a).total_cmp(&whole(b))))
        .filter(|name| similarity(name) >= LEAST_SIMILARITY)
        .cloned();
    Err(ConfigError::UnknownKey { key: key.to_owned(), origin: origin(), nearest })
}

type Builder = config::ConfigBuilder<config::builder::DefaultState>;

fn set(builder: Builder, key: &str, value: String) -> Result<Builder, ConfigError> {
    builder.set_override(key, value).map_err(|error| bad(key, error.to_string()))
}

impl ConfigError {
    /// The same with where the value at fault was given, where that is known.
    fn given(self, origins: &Origins) -> Self {
        match self {
            Self::Value { key, problem } => {
                let from = origins.get(&key).map(|origin| format!(" (given in {origin})")).unwrap_or_default();
                Self::Value { key, problem: format!("{problem}{from}") }
            }
            other => other,
        }
    }
}

fn bad(key: &str, problem: String) -> ConfigError {
    ConfigError::Value { key: key.to_owned(), problem }
}

fn value_error(error: &config::ConfigError) -> ConfigError {
    match error {
        config::ConfigError::Type { unexpected, expected, key, .. } => ConfigError::Value {
            key: key.clone().unwrap_or_else(|| "(unnamed)".to_owned()),
            problem: format!("invalid value {unexpected}, expected {expected}"),
        },
        config::ConfigError::At { error, key, .. } => match value_error(error) {
            ConfigError::Value { problem, .. } => {
                ConfigError::Value { key: key.clone().unwrap_or_else(|| "(unnamed)".to_owned()), problem }
            }
            other => other,
        },
        other => ConfigError::Value { key: "(unnamed)".to_owned(), problem: other.to_string() },
    }
}

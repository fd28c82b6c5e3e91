//! `ubbmap serve --check`: everything that can be told before the server starts, without starting it.

use super::output::{Failure, say, say_json};
use crate::app::way_out;
use crate::config::{Config, ConfigError, Origins, StoreKind};
use crate::store::{Peek, SledStore};
use crate::transport::tls::Tls;
use rustix::fs::{Access, access};
use serde_json::{Value, json};
use std::net::TcpListener;
use std::path::Path;

/// What was looked at: a fact, or a problem that would keep the server from starting.
type Finding = (&'static str, Result<String, String>);

/// Checks the settings, and prints them with where each was given.
///
/// # Errors
/// [`Failure::Configuration`] that says what would keep the server from starting.
pub(super) fn check(loaded: Result<(Config, Origins), ConfigError>, json: bool) -> Result<(), Failure> {
    let (config, origins) = match loaded {
        Ok(loaded) => loaded,
        Err(error) => {
            if json {
                say_json(&json!({ "ok": false, "problems": [error.to_string()] }))?;
            }
            return Err(Failure::Configuration(error.to_string()));
        }
    };
    let settings = settings(&config, &origins)?;
    let findings = [
        ("address", address(&config)),
        ("tls", tls(&config)),
        ("access", who_may(&config)),
        ("store", store(&config)),
        ("zenoh", zenoh(&config)),
    ];
    let problems: Vec<&str> =
        findings.iter().filter_map(|(_, found)| found.as_ref().err().map(String::as_str)).collect();
    if json {
        let settings: serde_json::Map<String, Value> =
            settings.into_iter().map(|(key, value, origin)| (key, json!({ "value": value, "from": origin }))).collect();
        say_json(&json!({ "ok": problems.is_empty(), "problems": problems, "settings": settings }))?;
    } else {
        print(&settings, &findings)?;
    }
    match problems[..] {
        [] => Ok(()),
        _ => Err(Failure::Configuration(format!("the server would not start: {}", problems.join("; ")))),
    }
}

fn print(settings: &[(String, Value, String)], findings: &[Finding]) -> Result<(), Failure> {
    let shown: Vec<(String, &str)> =
        settings.iter().map(|(key, value, origin)| (format!("{key} = {value}"), origin.as_str())).collect();
    let widest = shown.iter().map(|(text, _)| text.chars().count()).max().unwrap_or(0);
    for (text, origin) in &shown {
        say(&format!("{text:<widest$}  # {origin}"))?;
    }
    for (what, found) in findings {
        if let Ok(fact) = found {
            say(&format!("{what}: {fact}"))?;
        }
    }
    Ok(())
}

/// Every setting with its value and where that was given. None is a secret: those are in files.
fn settings(config: &Config, origins: &Origins) -> anyhow::Result<Vec<(String, Value, String)>> {
    let mut all = Vec::new();
    flatten("", &serde_json::to_value(config)?, &mut all);
    let with_origin = |(key, value): (String, Value)| {
        let origin = origins.get(&key).map_or("default", String::as_str).to_owned();
        (key, value, origin)
    };
    Ok(all.into_iter().map(with_origin).collect())
}

fn flatten(table: &str, value: &Value, out: &mut Vec<(String, Value)>) {
    match value {
        Value::Object(inner) if table.is_empty() || !inner.is_empty() => {
            for (name, value) in inner {
                let key = if table.is_empty() { name.clone() } else { format!("{table}.{name}") };
                flatten(&key, value, out);
            }
        }
        value => out.push((table.to_owned(), value.clone())),
    }
}

/// Who may come in.
fn who_may(config: &Config) -> Result<String, String> {
    let access = config.access().map_err(|error| error.to_string())?;
    Ok(match config.tokens_file() {
        Some(file) => format!("by the tokens in {}", file.display()),
        None if access.is_insecure() => "everybody who reaches the server (insecure)".to_owned(),
        None => "without tokens".to_owned(),
    })
}

fn address(config: &Config) -> Result<String, String> {
    match TcpListener::bind(config.listen) {
        Ok(_) => Ok(format!("{} is free", config.listen)),
        Err(error) => Err(format!("cannot listen on {}: {error}{}", config.listen, way_out(&error))),
    }
}

fn tls(config: &Config) -> Result<String, String> {
    let Some(settings) = config.tls_settings() else { return Ok("off".to_owned()) };
    Tls::load(settings).map(|tls| tls.describe()).map_err(|error| ConfigError::from(error).to_string())
}

fn store(config: &Config) -> Result<String, String> {
    let directory = &config.data_dir;
    if config.store == StoreKind::Memory {
        return Ok("in memory: nothing outlives the server".to_owned());
    }
    match SledStore::peek(directory).map_err(|error| error.to_string())? {
        Peek::None { nearest } => {
            writable(&nearest)?;
            Ok(format!("there is none in {} yet: an empty one is made", directory.display()))
        }
        Peek::Store { in_use: true, .. } => Err(format!("{}: another ubbmap has this store open", directory.display())),
        Peek::Store { format, in_use: false } => {
            writable(directory)?;
            let format = format.map_or_else(|| "a format that was not found".to_owned(), |n| format!("format {n}"));
            Ok(format!("{} holds one of {format}", directory.display()))
        }
    }
}

fn writable(directory: &Path) -> Result<(), String> {
    access(directory, Access::WRITE_OK | Access::EXEC_OK)
        .map_err(|error| format!("{} cannot be written to: {error}", directory.display()))
}

fn zenoh(config: &Config) -> Result<String, String> {
    let Some(settings) = config.zenoh_settings() else { return Ok("off".to_owned()) };
    match settings.file {
        Some(file) => match std::fs::File::open(&file).and_then(|mut file| {
            let mut text = String::new();
            std::io::Read::read_to_string(&mut file, &mut text)
        }) {
            Ok(_) => Ok(format!("on, with the settings of {}", file.display())),
            Err(error) => Err(format!("cannot read {} (zenoh.file): {error}", file.display())),
        },
        None => match config.zenoh_users() {
            Ok(users) if users.is_empty() => Ok("on".to_owned()),
            Ok(users) => Ok(format!("on, for {} users", users.len())),
            Err(error) => Err(error.to_string()),
        },
    }
}

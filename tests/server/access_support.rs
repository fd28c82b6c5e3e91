//! A server with a file of tokens, and a token for every kind of caller.

#![allow(clippy::unwrap_used, reason = "a test may end where its ground is not as it should be")]

use crate::http_support::{Answer, Site};
use std::fmt::Write as _;
use std::path::PathBuf;
use tempfile::TempDir;
use ubbmap::config::Config;
use ubbmap::transport::access::{Secret, TokenHash};

/// An entry of the file, and its token.
pub struct Holder {
    pub name: &'static str,
    pub token: String,
    pub entry: String,
}

/// A token with an entry.
pub fn holder(name: &'static str, role: &str, maps: &str, more: &str) -> Holder {
    let token = Secret::generate().unwrap().reveal().to_owned();
    let hash = TokenHash::of(&token);
    let entry =
        format!("[[token]]\nname = \"{name}\"\nsha256 = \"{hash}\"\nrole = \"{role}\"\nmaps = [{maps}]\n{more}\n\n");
    Holder { name, token, entry }
}

/// A server whose map `hall` and others are there, with tokens.
pub struct Gate {
    pub site: Site,
    pub folder: TempDir,
    pub holders: Vec<Holder>,
}

impl Gate {
    pub fn new() -> Self {
        Self::with(|_| {})
    }

    pub fn with(change: impl FnOnce(&mut Config)) -> Self {
        let holders = vec![
            holder("reader", "read", "\"*\"", ""),
            holder("writer", "write", "\"*\"", ""),
            holder("admin", "admin", "\"*\"", ""),
            holder("elsewhere", "admin", "\"attic\", \"cellar-*\"", ""),
            holder("visitor", "read", "\"*\"", ""),
            holder("late", "admin", "\"*\"", "expires = \"2020-01-01T00:00:00Z\""),
            holder("amr-7", "write", "\"hall\"", "robot = \"amr-7\""),
        ];
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("tokens.toml");
        std::fs::write(&file, text(&holders)).unwrap();
        let site = Site::with(|config| {
            config.access.tokens = file;
            change(config);
        });
        let gate = Self { site, folder, holders };
        for map in ["hall", "attic", "cellar-1"] {
            let body = r#"{"depth": 8, "min_obstacle_width": 0.1, "sensors": {"default": {"range_max": 10}}}"#;
            let made =
                gate.send_to(&gate.administration(), "admin", "PUT", &format!("/v1/maps/{map}"), &[], body.as_bytes());
            assert_eq!(made.status, 201, "{made:?}");
        }
        gate
    }

    /// Where administration is: at its own address, or at the only one.
    pub fn administration(&self) -> String {
        let own = self.site.server.as_ref().unwrap().administration();
        own.map_or_else(|| self.site.url(), |address| format!("http://{address}"))
    }

    pub fn file(&self) -> PathBuf {
        self.folder.path().join("tokens.toml")
    }

    /// Writes the file anew with these holders alone, and has the server read it.
    pub fn keep(&self, names: &[&str]) {
        let kept: String = self.holders.iter().filter(|h| names.contains(&h.name)).map(|h| h.entry.as_str()).collect();
        std::fs::write(self.file(), kept).unwrap();
        self.site.server.as_ref().unwrap().access().reload().unwrap();
    }

    pub fn token(&self, name: &str) -> &str {
        &self.holders.iter().find(|holder| holder.name == name).unwrap().token
    }

    /// A request by a holder; by nobody where the name is empty.
    pub fn send(&self, name: &str, method: &str, path: &str, body: &[u8]) -> Answer {
        self.send_to(&self.site.url(), name, method, path, &[], body)
    }

    pub fn send_to(
        &self,
        url: &str,
        name: &str,
        method: &str,
        path: &str,
        headers: &[(&str, &str)],
        body: &[u8],
    ) -> Answer {
        let mut all = vec![("content-type", "application/json")];
        all.retain(|(known, _)| !headers.iter().any(|(given, _)| given == known));
        all.extend(headers);
        let bearer = if name.is_empty() { String::new() } else { format!("Bearer {}", self.token(name)) };
        if !name.is_empty() {
            all.push(("authorization", &bearer));
        }
        crate::http_support::send(&crate::http_support::agent(), method, &format!("{url}{path}"), &all, body)
    }
}

fn text(holders: &[Holder]) -> String {
    holders.iter().fold(String::new(), |mut text, holder| {
        write!(text, "{}", holder.entry).unwrap();
        text
    })
}

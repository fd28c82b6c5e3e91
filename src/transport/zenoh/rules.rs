//! Zenoh's own access control, written from grants: which messages about which keys pass from whom, and to whom.
//!
//! A query does not say who sent it, so this is the only place where a robot of Zenoh can be held to its name. What is not
//! allowed here is dropped by the router, and its sender is told nothing: a query ends without a reply.

use crate::store::RobotName;
use crate::transport::access::{Grant, Role};
use serde_json::{Value, json};

/// All kinds of messages that access control knows.
const EVERYTHING: [&str; 9] = [
    "put",
    "delete",
    "declare_subscriber",
    "query",
    "reply",
    "declare_queryable",
    "liveliness_token",
    "liveliness_query",
    "declare_liveliness_subscriber",
];

/// Operations that read one map, as what follows its name in a key.
const READS: [&str; 7] = ["classes", "region", "grid", "tiles/*/*/*", "guaranteed-free", "changes", "robots"];

/// Whose connection it is.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Subject {
    /// Who proved to be this user; with TLS alone, or by any way.
    User { name: String, tls: bool },
    /// Whose certificate has this common name.
    Certificate(String),
    /// Whoever came by TLS.
    Tls,
    /// Whoever came by TCP.
    Tcp,
}

impl Subject {
    fn properties(&self) -> Value {
        match self {
            Self::User { name, tls: false } => json!({ "usernames": [name] }),
            Self::User { name, tls: true } => json!({ "usernames": [name], "link_protocols": ["tls"] }),
            Self::Certificate(name) => json!({ "cert_common_names": [name] }),
            Self::Tls => json!({ "link_protocols": ["tls"] }),
            Self::Tcp => json!({ "link_protocols": ["tcp"] }),
        }
    }
}

/// What one subject may do.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Right {
    /// What is granted.
    Granted(Grant),
    /// Everything, also beside the server's keys.
    Everything,
    /// Ask the server how it is.
    Health,
}

/// The section `access_control` of Zenoh's settings: what these may do, and others nothing.
pub fn access_control(prefix: &str, subjects: &[(Subject, Right)]) -> Value {
    let mut rules = vec![known(prefix)];
    let (mut written, mut policies) = (Vec::new(), Vec::new());
    for (at, (subject, right)) in subjects.iter().enumerate() {
        let own: Vec<Value> = match right {
            Right::Granted(grant) => granted(prefix, grant),
            Right::Everything => vec![rule(&EVERYTHING, BOTH, vec!["**".to_owned(), format!("{prefix}/@server/**")])],
            Right::Health => {
                let key = || vec![format!("{prefix}/@server/*/health")];
                vec![rule(&["query"], IN, key()), rule(&["reply"], OUT, key())]
            }
        };
        let mut ids = vec!["known".to_owned()];
        for (number, mut rule) in own.into_iter().enumerate() {
            let id = format!("{at}.{number}");
            rule["id"] = json!(id);
            ids.push(id);
            rules.push(rule);
        }
        let mut properties = subject.properties();
        properties["id"] = json!(at.to_string());
        written.push(properties);
        policies.push(json!({ "rules": ids, "subjects": [at.to_string()] }));
    }
    json!({
        "enabled": true, "default_permission": "deny", "rules": rules, "subjects": written, "policies": policies,
    })
}

/// Into the server, out of it.
const IN: &[&str] = &["ingress"];
const OUT: &[&str] = &["egress"];
const BOTH: &[&str] = &["ingress", "egress"];

/// Allows messages about keys.
fn rule(messages: &[&str], flows: &[&str], keys: impl Into<Value>) -> Value {
    let keys: Value = keys.into();
    json!({ "messages": messages, "flows": flows, "permission": "allow", "key_exprs": keys })
}

/// What everybody may know: that the server answers and takes scans under its keys. Publishers and queriers that were not told so
/// send nothing.
fn known(prefix: &str) -> Value {
    let keys = vec![format!("{prefix}/**"), format!("{prefix}/@server/*/health")];
    let mut rule = rule(&["declare_queryable", "declare_subscriber"], OUT, keys);
    rule["id"] = json!("known");
    rule
}

fn granted(prefix: &str, grant: &Grant) -> Vec<Value> {
    let maps: Vec<String> = grant.maps.patterns().iter().map(|pattern| chunk(pattern)).collect();
    let below = |endings: &[String]| -> Vec<String> {
        maps.iter().flat_map(|map| endings.iter().map(move |end| format!("{prefix}/{map}/{end}"))).collect()
    };
    let mut asked = below(&READS.map(str::to_owned));
    asked.extend(maps.iter().map(|map| format!("{prefix}/{map}")));
    if grant.maps.is_all() {
        // The list of all maps: it cannot be cut down to those that somebody may see, so it is for those who may see all.
        asked.push(prefix.to_owned());
    }
    let server = format!("{prefix}/@server/*");
    asked.push(format!("{server}/health"));
    let mut rules = Vec::new();
    if grant.role >= Role::Write {
        let robot = grant.robot.as_ref().map_or("*", RobotName::as_str);
        asked.extend(below(&[format!("insert/{robot}")]));
        rules.push(rule(&["put"], IN, below(&[format!("scans/{robot}")])));
    }
    if grant.role >= Role::Admin {
        asked.extend(below(&["create".to_owned(), "delete".to_owned()]));
    }
    rules.push(rule(&["query"], IN, asked.clone()));
    rules.push(rule(&["reply"], OUT, asked));
    let changes = below(&["changes".to_owned()]);
    rules.push(rule(&["declare_subscriber"], IN, changes.clone()));
    rules.push(rule(&["put"], OUT, changes));
    rules.push(rule(&["liveliness_query", "declare_liveliness_subscriber"], IN, vec![server.clone()]));
    rules.push(rule(&["liveliness_token"], OUT, vec![server]));
    rules
}

/// A pattern of maps as a chunk of a key.
fn chunk(pattern: &str) -> String {
    match pattern.strip_suffix('*') {
        Some("") => "*".to_owned(),
        Some(beginning) => format!("{beginning}$*"),
        None => pattern.to_owned(),
    }
}

//! A server over a store in memory, and a client that shows answers as they are.

#![allow(clippy::unwrap_used, reason = "a test may end where its ground is not as it should be")]

use crate::service_support::TestStore;
use flate2::Compression;
use flate2::write::GzEncoder;
use serde_json::Value;
use std::io::{Read, Write};
use std::net::TcpStream;
use std::sync::Arc;
use std::time::Duration;
use tokio::runtime::Runtime;
use ubbmap::app::Server;
use ubbmap::config::Config;
use ubbmap::store::MapStore;
use ureq::Agent;

/// A server on a free port of loopback with a runtime of its own.
pub struct Site {
    pub store: Arc<TestStore>,
    pub runtime: Runtime,
    pub server: Option<Server>,
    pub agent: Agent,
    url: String,
}

/// An answer as it came.
#[derive(Debug, Clone)]
pub struct Answer {
    pub status: u16,
    pub headers: Vec<(String, String)>,
    pub body: Vec<u8>,
}

impl Answer {
    pub fn header(&self, name: &str) -> Option<&str> {
        self.headers.iter().find(|(known, _)| known == name).map(|(_, value)| value.as_str())
    }

    pub fn json(&self) -> Value {
        serde_json::from_slice(&self.body)
            .unwrap_or_else(|error| panic!("{error}: {:?}", String::from_utf8_lossy(&self.body)))
    }

    /// Holds that this is a problem of this kind, and gives its field (or nothing) and its detail.
    #[track_caller]
    pub fn problem(&self, status: u16, code: &str) -> (String, String) {
        assert_eq!(self.status, status, "{}", String::from_utf8_lossy(&self.body));
        assert_eq!(self.header("content-type"), Some("application/problem+json"));
        let value = self.json();
        assert_eq!(value["code"], code, "{value}");
        assert_eq!(value["status"], status, "{value}");
        let kind = format!("urn:ubbmap:problem:{}", code.to_lowercase().replace('_', "-"));
        assert_eq!(value["type"], kind, "{value}");
        assert!(!value["title"].as_str().unwrap().is_empty() && !value["detail"].as_str().unwrap().is_empty());
        let text = |name: &str| value[name].as_str().unwrap_or_default().to_owned();
        (text("field"), text("detail"))
    }
}

impl Site {
    pub fn new() -> Self {
        Self::with(|_| {})
    }

    /// A server with other settings.
    pub fn with(change: impl FnOnce(&mut Config)) -> Self {
        Self::over(TestStore::new(), change)
    }

    /// The same over a store that may hold maps.
    pub fn over(store: Arc<TestStore>, change: impl FnOnce(&mut Config)) -> Self {
        let mut config = Config { listen: "127.0.0.1:0".parse().unwrap(), ..Config::default() };
        change(&mut config);
        let runtime = tokio::runtime::Builder::new_multi_thread().worker_threads(2).enable_all().build().unwrap();
        let server = runtime.block_on(Server::start(&config, Arc::clone(&store) as Arc<dyn MapStore>)).unwrap();
        let url = server.url();
        let agent = agent();
        Self { store, runtime, server: Some(server), agent, url }
    }

    /// A server with the map `hall` of 25.6 m about (0, 0).
    pub fn hall() -> Self {
        Self::new().with_hall()
    }

    pub fn with_hall(self) -> Self {
        self.make_hall();
        self
    }

    pub fn make_hall(&self) {
        let answer = self.put(
            "/v1/maps/hall",
            r#"{"depth": 8, "min_obstacle_width": 0.1, "sensors": {"default": {"range_max": 10}}}"#,
        );
        assert_eq!(answer.status, 201, "{}", String::from_utf8_lossy(&answer.body));
    }

    pub fn url(&self) -> String {
        self.url.clone()
    }

    pub fn get(&self, path: &str) -> Answer {
        self.send("GET", path, &[], b"")
    }

    pub fn put(&self, path: &str, json: &str) -> Answer {
        self.send("PUT", path, &[("content-type", "application/json")], json.as_bytes())
    }

    pub fn post(&self, path: &str, json: &str) -> Answer {
        self.send("POST", path, &[("content-type", "application/json")], json.as_bytes())
    }

    pub fn send(&self, method: &str, path: &str, headers: &[(&str, &str)], body: &[u8]) -> Answer {
        send(&self.agent, method, &format!("{}{path}", self.url), headers, body)
    }

    /// Sends bytes as they are on a connection of its own, and reads until the server closes it.
    pub fn raw(&self, bytes: &[u8]) -> Vec<u8> {
        let mut stream = TcpStream::connect(self.server.as_ref().unwrap().address()).unwrap();
        stream.set_read_timeout(Some(Duration::from_secs(20))).unwrap();
        stream.write_all(bytes).unwrap();
        let mut answer = Vec::new();
        // A connection that is reset has told all that it will.
        let _ = stream.read_to_end(&mut answer);
        answer
    }

    pub fn shut_down(&mut self) {
        if let Some(server) = self.server.take() {
            self.runtime.block_on(server.shutdown()).unwrap();
        }
    }
}

impl Drop for Site {
    fn drop(&mut self) {
        self.store.release();
        self.shut_down();
    }
}

pub fn agent() -> Agent {
    Agent::config_builder()
        .http_status_as_error(false)
        .max_redirects(0)
        .timeout_global(Some(Duration::from_secs(60)))
        .build()
        .into()
}

pub fn send(agent: &Agent, method: &str, url: &str, headers: &[(&str, &str)], body: &[u8]) -> Answer {
    let mut request = ureq::http::Request::builder().method(method).uri(url);
    for (name, value) in headers {
        request = request.header(*name, *value);
    }
    let response = if method == "GET" || method == "DELETE" || method == "HEAD" {
        agent.run(request.body(()).unwrap())
    } else {
        agent.run(request.body(body).unwrap())
    };
    let mut response = response.unwrap_or_else(|error| panic!("{method} {url}: {error}"));
    let headers = response
        .headers()
        .iter()
        .map(|(name, value)| (name.as_str().to_owned(), value.to_str().unwrap().to_owned()))
        .collect();
    let status = response.status().as_u16();
    let body = response.body_mut().with_config().limit(1 << 30).read_to_vec().unwrap();
    Answer { status, headers, body }
}

pub fn gzip(bytes: &[u8]) -> Vec<u8> {
    let mut encoder = GzEncoder::new(Vec::new(), Compression::fast());
    encoder.write_all(bytes).unwrap();
    encoder.finish().unwrap()
}

/// A scan of a round wall 3 m about the robot, in the interface's JSON.
pub fn ring(robot: &str, sequence: Option<u64>) -> Value {
    let mut scan = serde_json::json!({
        "robot": robot,
        "pose": {"x": {"min": 0, "max": 0}, "y": {"min": 0, "max": 0}, "theta": {"min": 0, "max": 0}},
        "angle_min": 0.0, "angle_increment": std::f64::consts::TAU / 360.0, "ranges": vec![3.0; 360],
    });
    if let Some(sequence) = sequence {
        scan["sequence"] = Value::from(sequence.to_string());
    }
    scan
}

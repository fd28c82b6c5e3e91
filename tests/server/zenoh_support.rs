//! A server with an embedded router on a free port, and clients of it.

#![allow(clippy::unwrap_used, reason = "a test may end where its ground is not as it should be")]

use crate::http_support::Site;
use prost::Message;
use std::time::Duration;
use ubbmap::config::{Config, ZenohMode};
use ubbmap::wire::v1;
use zenoh::query::ReplyError;
use zenoh::{Config as ZenohConfig, Session};

/// How long a reply may take.
const PATIENCE: Duration = Duration::from_secs(20);

/// An embedded router on a free port of loopback.
pub fn router(config: &mut Config) {
    config.zenoh.mode = ZenohMode::Router;
    config.zenoh.listen = "tcp/127.0.0.1:0".to_owned();
}

/// The settings of a client that knows one endpoint and looks for nobody.
pub fn client_config(endpoint: &str) -> ZenohConfig {
    let mut config = ZenohConfig::default();
    for (key, value) in [
        ("mode", "\"client\"".to_owned()),
        ("connect/endpoints", format!("[{endpoint:?}]")),
        ("scouting/multicast/enabled", "false".to_owned()),
        ("connect/retry", "{ period_init_ms: 50, period_max_ms: 200, period_increase_factor: 2 }".to_owned()),
    ] {
        config.insert_json5(key, &value).unwrap();
    }
    config
}

/// What came back: a payload, or the error's message; nothing when nobody answered.
pub type Answered = Option<Result<Vec<u8>, v1::Error>>;

pub async fn open(endpoint: &str) -> Session {
    zenoh::open(client_config(endpoint)).await.unwrap()
}

/// Asks with a message as the payload; the one reply.
pub async fn ask(session: &Session, selector: &str, payload: &[u8]) -> Answered {
    let replies = session.get(selector).payload(payload).timeout(PATIENCE).await.unwrap();
    let reply = replies.recv_async().await.ok()?;
    assert!(replies.recv_async().await.is_err(), "more than one reply to {selector}");
    Some(match reply.result() {
        Ok(sample) => Ok(sample.payload().to_bytes().into_owned()),
        Err(error) => Err(decode_error(error)),
    })
}

fn decode_error(error: &ReplyError) -> v1::Error {
    v1::Error::decode(&*error.payload().to_bytes()).unwrap()
}

/// Asks and decodes the answer.
pub async fn answer<T: Message + Default>(session: &Session, selector: &str, request: &impl Message) -> T {
    let bytes = ask(session, selector, &request.encode_to_vec()).await.expect("nobody answered");
    T::decode(&bytes.unwrap_or_else(|error| panic!("{selector}: {error:?}"))[..]).unwrap()
}

/// Asks, and the error that comes back.
pub async fn refusal(session: &Session, selector: &str, payload: &[u8]) -> v1::Error {
    ask(session, selector, payload).await.expect("nobody answered").unwrap_err()
}

impl Site {
    /// A server with a router and the map `hall`.
    pub fn on_zenoh(change: impl FnOnce(&mut Config)) -> Self {
        let site = Self::with(|config| {
            router(config);
            change(config);
        });
        site.make_hall();
        site
    }

    /// Where the server's router listens.
    pub fn endpoint(&self) -> String {
        self.server.as_ref().unwrap().zenoh().unwrap().locators()[0].clone()
    }

    pub fn session(&self) -> Session {
        self.run(open(&self.endpoint()))
    }
}

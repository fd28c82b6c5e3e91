//! Replies: a message with its name as the encoding's schema, or an error reply that carries an `ubbmap.v1.Error`.

use crate::service::ServiceError;
use crate::transport::status::{ZenohReply, status};
use crate::wire::v1;
use ::zenoh::Wait;
use ::zenoh::bytes::Encoding;
use ::zenoh::query::Query;
use prost::Message;
use std::sync::mpsc::{SyncSender, TrySendError, sync_channel};
use std::thread::JoinHandle;

/// Replies up to this many bytes are small.
const SMALL: usize = 4096;

/// Small replies that wait for their thread.
const LANE: usize = 256;

/// A message as bytes, and its name; none for a reply that says that there is one.
#[derive(Debug)]
pub struct Reply {
    name: Option<&'static str>,
    bytes: Vec<u8>,
}

impl Reply {
    /// A message of the package `ubbmap.v1`.
    pub fn new(name: &'static str, message: &impl Message) -> Self {
        Self { name: Some(name), bytes: message.encode_to_vec() }
    }

    /// A reply without a payload.
    pub fn empty() -> Self {
        Self { name: None, bytes: Vec::new() }
    }
}

/// The encoding of a message of the package `ubbmap.v1`.
pub fn encoding(name: &str) -> Encoding {
    Encoding::APPLICATION_PROTOBUF.with_schema(format!("ubbmap.v1.{name}"))
}

/// The message of an error reply.
pub fn error_message(error: &ServiceError) -> v1::Error {
    let row = status(error.kind);
    let advice = match row.zenoh {
        ZenohReply::Refused => v1::Advice::Refused,
        ZenohReply::Retry => v1::Advice::Retry,
        ZenohReply::Failed => v1::Advice::Failed,
    };
    v1::Error {
        code: error.kind.code().to_owned(),
        title: row.title.to_owned(),
        detail: error.detail.clone(),
        field: error.field.clone(),
        advice: advice.into(),
        retry_after: row.retry_after,
    }
}

/// Sends replies. Zenoh waits where a client does not read, until the client's connection is closed for it; so replies
/// are sent on threads that may wait: small ones on one thread for all, since waking a thread for each costs more than
/// sending it, large ones and those for which that thread has no room each on its own.
#[derive(Debug)]
pub struct Replies {
    lane: SyncSender<Outgoing>,
}

type Outgoing = (Query, Result<Reply, ServiceError>);

impl Replies {
    /// Starts the thread for small replies. It ends when this is dropped and all it was given is sent.
    ///
    /// # Errors
    /// When the system gives no thread.
    pub fn start() -> std::io::Result<(Self, JoinHandle<()>)> {
        let (lane, outgoing) = sync_channel::<Outgoing>(LANE);
        let send_all = move || outgoing.into_iter().for_each(|(query, answer)| send_now(&query, answer));
        let thread = std::thread::Builder::new().name("zenoh-replies".to_owned()).spawn(send_all)?;
        Ok((Self { lane }, thread))
    }

    /// Answers a query.
    pub async fn send(&self, query: Query, answer: Result<Reply, ServiceError>) {
        let large = answer.as_ref().is_ok_and(|reply| reply.bytes.len() > SMALL);
        if large {
            return apart(query, answer).await;
        }
        match self.lane.try_send((query, answer)) {
            Ok(()) => {}
            Err(TrySendError::Full((query, answer)) | TrySendError::Disconnected((query, answer))) => {
                apart(query, answer).await;
            }
        }
    }
}

async fn apart(query: Query, answer: Result<Reply, ServiceError>) {
    if let Err(error) = tokio::task::spawn_blocking(move || send_now(&query, answer)).await {
        tracing::error!(%error, "sending a reply failed");
    }
}

fn send_now(query: &Query, answer: Result<Reply, ServiceError>) {
    let sent = match answer {
        Ok(reply) => {
            let encoding = reply.name.map(encoding).unwrap_or_default();
            query.reply(query.key_expr(), reply.bytes).encoding(encoding).wait()
        }
        Err(error) => query.reply_err(error_message(&error).encode_to_vec()).encoding(encoding("Error")).wait(),
    };
    if let Err(error) = sent {
        // A client that has gone is told nothing.
        tracing::debug!(%error, "a reply could not be sent");
    }
}

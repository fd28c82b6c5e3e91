//! Replies: a message with its name as the encoding's schema, or an error reply that carries an `ubbmap.v1.Error`.

use crate::service::ServiceError;
use crate::transport::status::{ZenohReply, status};
use crate::wire::v1;
use ::zenoh::Wait;
use ::zenoh::bytes::Encoding;
use ::zenoh::query::Query;
use prost::Message;

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

/// Answers a query on a thread that may wait: a client that does not read holds a reply up until its connection is
/// closed for it.
pub async fn send(query: Query, answer: Result<Reply, ServiceError>) {
    let sent = tokio::task::spawn_blocking(move || send_now(&query, answer)).await;
    match sent {
        Ok(Ok(())) => {}
        // A client that has gone is told nothing.
        Ok(Err(error)) => tracing::debug!(%error, "a reply could not be sent"),
        Err(error) => tracing::error!(%error, "sending a reply failed"),
    }
}

fn send_now(query: &Query, answer: Result<Reply, ServiceError>) -> ::zenoh::Result<()> {
    match answer {
        Ok(reply) => {
            let encoding = reply.name.map(encoding).unwrap_or_default();
            query.reply(query.key_expr(), reply.bytes).encoding(encoding).wait()
        }
        Err(error) => query.reply_err(error_message(&error).encode_to_vec()).encoding(encoding("Error")).wait(),
    }
}

//! A client of gRPC for the tests, and calls by gRPC-Web whose bytes are written by hand.

#![allow(clippy::unwrap_used, reason = "a test may end where its ground is not as it should be")]

use crate::http_support::Site;
use std::collections::BTreeMap;
use std::time::Duration;
use tonic::transport::Channel;
use tonic::{Code, Status};
use tonic_types::StatusExt;
use ubbmap::transport::grpc::generated::map_service_client::MapServiceClient;
use ubbmap::wire::v1;

pub type Client = MapServiceClient<Channel>;

/// Largest answer that the client takes, bytes.
const ANSWER_BYTES: usize = 64 << 20;

impl Site {
    pub fn rpc(&self) -> Client {
        self.run(MapServiceClient::connect(self.url())).unwrap().max_decoding_message_size(ANSWER_BYTES)
    }

    /// Runs to its end, which must come within some seconds.
    pub fn run<T>(&self, work: impl Future<Output = T>) -> T {
        self.runtime.block_on(async { tokio::time::timeout(Duration::from_secs(60), work).await.unwrap() })
    }

    /// A call by gRPC-Web over HTTP/1.1: the message's bytes and the trailers.
    pub fn web(&self, method: &str, message: &[u8]) -> (Vec<u8>, BTreeMap<String, String>) {
        let path = format!("/ubbmap.v1.MapService/{method}");
        let body = [&[0], &u32::try_from(message.len()).unwrap().to_be_bytes()[..], message].concat();
        let answer = self.send("POST", &path, &[("content-type", "application/grpc-web+proto")], &body);
        assert_eq!(answer.status, 200, "{answer:?}");
        let mut trailers: BTreeMap<String, String> =
            answer.headers.iter().filter(|(name, _)| name.starts_with("grpc-")).cloned().collect();
        let (mut payload, mut rest) = (Vec::new(), &answer.body[..]);
        while let [flag, a, b, c, d, frames @ ..] = rest {
            let (frame, more) = frames.split_at(u32::from_be_bytes([*a, *b, *c, *d]) as usize);
            if flag & 0x80 == 0 {
                payload.extend_from_slice(frame);
            } else {
                let text = String::from_utf8(frame.to_vec()).unwrap();
                let lines = text.lines().filter_map(|line| line.split_once(':'));
                trailers.extend(lines.map(|(name, value)| (name.trim().to_owned(), value.trim().to_owned())));
            }
            rest = more;
        }
        (payload, trailers)
    }
}

/// Holds that this is an error of this kind, and gives its field (or nothing) and its detail.
#[track_caller]
pub fn refused<T: std::fmt::Debug>(answer: Result<T, Status>, code: Code, word: &str) -> (String, String) {
    let status = answer.unwrap_err();
    assert_eq!(status.code(), code, "{status:?}");
    let details = status.get_error_details();
    let info = details.error_info().unwrap();
    assert_eq!((info.reason.as_str(), info.domain.as_str()), (word, "ubbmap"), "{status:?}");
    let violations = details.bad_request().map(|request| request.field_violations.clone()).unwrap_or_default();
    let field = violations.first().map(|violation| violation.field.clone()).unwrap_or_default();
    (field, status.message().to_owned())
}

/// The same scan as [`crate::http_support::ring`].
pub fn ring(robot: &str, sequence: Option<u64>) -> v1::Scan {
    serde_json::from_value(crate::http_support::ring(robot, sequence)).unwrap()
}

/// A message of a stream.
pub fn message(map: &str, scan: v1::Scan) -> v1::StreamScansRequest {
    v1::StreamScansRequest { map: map.to_owned(), scan: Some(scan) }
}

//! Every error as a status of gRPC, with the details of `google.rpc` (AIP-193): the code word, the field, when to retry.

use crate::service::{ErrorKind, ServiceError, setting};
use crate::transport::status::status;
use std::time::Duration;
use tonic::{Code, Status};
use tonic_types::{ErrorDetails, StatusExt};

/// The domain of the code words in `google.rpc.ErrorInfo`.
pub const DOMAIN: &str = "ubbmap";

/// The status of an error.
#[must_use]
pub fn to_status(error: &ServiceError) -> Status {
    let row = status(error.kind);
    let mut details = ErrorDetails::new();
    details.set_error_info(error.kind.code(), DOMAIN, std::collections::HashMap::new());
    if let Some(field) = &error.field {
        details.add_bad_request_violation(field, &error.detail);
    }
    if let Some(seconds) = row.retry_after {
        details.set_retry_info(Some(Duration::from_secs(seconds.into())));
    }
    Status::with_error_details(Code::from(row.grpc as i32), &error.detail, details)
}

/// What the library itself says of a message that is larger than the limit.
#[must_use]
pub fn too_large(limit: usize) -> ServiceError {
    let detail = format!("the message is larger than {limit} bytes, the limit: send less at a time");
    ServiceError::over(ErrorKind::BodyTooLarge, setting::BODY_BYTES, detail).at("body")
}

/// An error that came with a stream's message: one of the codec, the limit of messages, or a client that has gone.
#[must_use]
pub fn from_status(status: &Status, limit: usize) -> ServiceError {
    match status.code() {
        Code::OutOfRange => too_large(limit),
        // The server's memory for what comes in; counted where it was refused.
        Code::ResourceExhausted => ServiceError::new(ErrorKind::Busy, status.message()),
        // A message that did not end; counted likewise.
        Code::DeadlineExceeded => ServiceError::new(ErrorKind::Timeout, status.message()),
        Code::InvalidArgument => ServiceError::new(ErrorKind::InvalidRequest, status.message()),
        _ => ServiceError::new(ErrorKind::InvalidRequest, "the stream broke off"),
    }
}

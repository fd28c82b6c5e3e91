//! The one table of what an error is on each transport.

use crate::service::ErrorKind;

/// A status code of gRPC.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[expect(missing_docs, reason = "the names are those of gRPC")]
pub enum GrpcCode {
    InvalidArgument = 3,
    DeadlineExceeded = 4,
    NotFound = 5,
    AlreadyExists = 6,
    PermissionDenied = 7,
    ResourceExhausted = 8,
    OutOfRange = 11,
    Unimplemented = 12,
    Internal = 13,
    Unavailable = 14,
    DataLoss = 15,
    Unauthenticated = 16,
}

/// What the error reply of a Zenoh query tells the sender to do.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ZenohReply {
    /// The query itself is wrong: the same again fails again.
    Refused,
    /// The same again may succeed, later.
    Retry,
    /// The server is at fault.
    Failed,
}

/// One row of the table.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Status {
    /// Status code of HTTP.
    pub http: u16,
    /// Title of the problem, the same for every occurrence.
    pub title: &'static str,
    /// Status code of gRPC.
    pub grpc: GrpcCode,
    /// Kind of Zenoh reply.
    pub zenoh: ZenohReply,
    /// After how many seconds the same request may be tried again, where that makes sense.
    pub retry_after: Option<u32>,
}

/// The row of an error.
#[must_use]
pub fn status(kind: ErrorKind) -> Status {
    use GrpcCode as Grpc;
    match kind {
        ErrorKind::MapNotFound => refused(404, "There is no such map", Grpc::NotFound),
        ErrorKind::MapExists => refused(409, "The map exists", Grpc::AlreadyExists),
        ErrorKind::SnapshotNotFound => refused(404, "There is no such snapshot", Grpc::NotFound),
        ErrorKind::SnapshotExists => refused(409, "The snapshot exists", Grpc::AlreadyExists),
        ErrorKind::InvalidName => refused(400, "The name is not allowed", Grpc::InvalidArgument),
        ErrorKind::InvalidConfig => refused(400, "The map configuration is not valid", Grpc::InvalidArgument),
        ErrorKind::InvalidRequest => refused(400, "The request is not valid", Grpc::InvalidArgument),
        ErrorKind::InvalidRegion => refused(400, "The region is not valid", Grpc::InvalidArgument),
        ErrorKind::InvalidPoint => refused(400, "The point is not valid", Grpc::InvalidArgument),
        ErrorKind::DepthOutOfRange => refused(400, "The depth is out of range", Grpc::OutOfRange),
        ErrorKind::TileOutOfRange => refused(404, "There is no such tile", Grpc::OutOfRange),
        ErrorKind::RegionTooLarge => refused(400, "The answer would be too large", Grpc::OutOfRange),
        ErrorKind::TooManyPoints => refused(400, "Too many points", Grpc::InvalidArgument),
        ErrorKind::TooManyRegions => refused(400, "Too many regions", Grpc::InvalidArgument),
        ErrorKind::TooManyScans => refused(400, "Too many scans", Grpc::InvalidArgument),
        ErrorKind::TooManyMaps => refused(409, "Too many maps", Grpc::ResourceExhausted),
        ErrorKind::TooManySnapshots => refused(409, "Too many snapshots", Grpc::ResourceExhausted),
        ErrorKind::InvalidFile => refused(400, "The map file is not valid", Grpc::InvalidArgument),
        ErrorKind::BodyTooLarge => refused(413, "The body is too large", Grpc::ResourceExhausted),
        ErrorKind::ToleranceTooHigh => refused(400, "The tolerance can never be met", Grpc::OutOfRange),
        ErrorKind::UnsupportedMediaType => refused(415, "The form of the body is not known", Grpc::InvalidArgument),
        ErrorKind::NotAcceptable => refused(406, "The answer has no such form", Grpc::InvalidArgument),
        ErrorKind::MethodNotAllowed => refused(405, "The method is not allowed here", Grpc::Unimplemented),
        ErrorKind::RouteNotFound => refused(404, "There is nothing at this path", Grpc::Unimplemented),
        ErrorKind::Unauthenticated => refused(401, "It is not known who asks", Grpc::Unauthenticated),
        ErrorKind::PermissionDenied => refused(403, "This caller may not do that", Grpc::PermissionDenied),
        ErrorKind::Busy => retry(429, "The server is busy", Grpc::ResourceExhausted, 1),
        ErrorKind::ShuttingDown => retry(503, "The server is shutting down", Grpc::Unavailable, 5),
        ErrorKind::Timeout => retry(503, "The request took too long", Grpc::DeadlineExceeded, 1),
        ErrorKind::AnotherServer => retry(503, "Another server is on the same keys", Grpc::Unavailable, 5),
        ErrorKind::TlsRequired => refused(400, "TLS is required", Grpc::Unavailable),
        ErrorKind::MapDamaged => failed("The map's stored data is damaged", Grpc::DataLoss),
        ErrorKind::StoreFailed => failed("The store failed", Grpc::Internal),
        ErrorKind::Internal => failed("The server failed", Grpc::Internal),
    }
}

fn refused(http: u16, title: &'static str, grpc: GrpcCode) -> Status {
    Status { http, title, grpc, zenoh: ZenohReply::Refused, retry_after: None }
}

fn retry(http: u16, title: &'static str, grpc: GrpcCode, seconds: u32) -> Status {
    Status { http, title, grpc, zenoh: ZenohReply::Retry, retry_after: Some(seconds) }
}

fn failed(title: &'static str, grpc: GrpcCode) -> Status {
    Status { http: 500, title, grpc, zenoh: ZenohReply::Failed, retry_after: None }
}

//! Floor 5: the transports. They translate, and hold no logic. What they have in common stands beside them: the
//! operations from message to message, the streams, the door that all pass, who may do what, and the table of errors.

pub mod access;
pub mod client;
pub mod door;
pub mod files;
pub mod grpc;
pub mod guard;
pub mod http;
pub mod intake;
pub mod operations;
pub mod outgoing;
pub mod parameters;
mod scan_stream;
pub mod status;
pub mod tls;
mod watching;
pub mod zenoh;

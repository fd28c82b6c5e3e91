//! What the service runs on: tasks, threads that may block, the pool for evidence, and the channels between them.
//!
//! They are those of tokio and rayon. With the feature `shuttle`, for tests alone, they run on its scheduler, see
//! [`crate::sync`].

#[cfg(feature = "shuttle")]
mod modelled;

#[cfg(feature = "shuttle")]
pub(super) use modelled::{
    CancellationToken, JoinError, OnceCell, Pool, each, mpsc, oneshot, sleep, spawn, spawn_blocking, watch,
};

#[cfg(not(feature = "shuttle"))]
mod real;

#[cfg(not(feature = "shuttle"))]
pub(super) use real::{Pool, each};

#[cfg(not(feature = "shuttle"))]
pub(super) use {
    tokio::sync::{OnceCell, mpsc, oneshot, watch},
    tokio::task::{JoinError, spawn, spawn_blocking},
    tokio::time::sleep,
    tokio_util::sync::CancellationToken,
};

//! Files on their way to and from clients. A client may be as slow as it likes, up to the time that a transfer may take:
//! what it holds up is its own transfer, never a map.

use super::door::{Door, Place};
use crate::service::{ErrorKind, ServiceError};
use bytes::Bytes;
use futures_util::stream::{self, Stream};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;
use tokio_util::sync::{CancellationToken, DropGuard};

/// Bytes of a piece.
const PIECE: usize = 64 << 10;

/// A file and its place among the transfers; both are given back when the file has gone out or its time is up.
struct Waiting {
    file: Bytes,
    _place: Place,
}

/// What is left of a transfer.
struct Outgoing {
    waiting: Arc<Mutex<Option<Waiting>>>,
    at: usize,
    over: bool,
    limit: Duration,
    /// Ends the clock with the transfer.
    _running: DropGuard,
}

/// A file piece by piece. When its time is up, the last piece is an error.
pub fn outgoing(file: Bytes, place: Place, door: &Door) -> impl Stream<Item = Result<Bytes, ServiceError>> + use<> {
    let waiting = Arc::new(Mutex::new(Some(Waiting { file, _place: place })));
    let (limit, running) = (door.transfer_timeout(), CancellationToken::new());
    let (clock, held) = (running.clone(), Arc::clone(&waiting));
    tokio::spawn(async move {
        tokio::select! {
            () = clock.cancelled() => {}
            () = tokio::time::sleep(limit) => drop(held.lock().unwrap_or_else(PoisonError::into_inner).take()),
        }
    });
    let outgoing = Outgoing { waiting, at: 0, over: false, limit, _running: running.drop_guard() };
    stream::unfold(outgoing, |mut outgoing| async move { outgoing.next().map(|piece| (piece, outgoing)) })
}

impl Outgoing {
    fn next(&mut self) -> Option<Result<Bytes, ServiceError>> {
        if self.over {
            return None;
        }
        let mut waiting = self.waiting.lock().unwrap_or_else(PoisonError::into_inner);
        let Some(Waiting { file, .. }) = waiting.as_ref() else {
            self.over = true;
            return Some(Err(out_of_time(self.limit)));
        };
        let end = file.len().min(self.at + PIECE);
        // A copy: a part of the file would keep the whole of it in memory.
        let piece = Bytes::copy_from_slice(&file[self.at..end]);
        self.at = end;
        self.over = end == file.len();
        if self.over {
            *waiting = None;
        }
        Some(Ok(piece))
    }
}

/// A file as its pieces come.
#[derive(Debug, Default)]
pub struct Incoming {
    bytes: Vec<u8>,
}

impl Incoming {
    /// Takes the next piece.
    ///
    /// # Errors
    /// [`ErrorKind::BodyTooLarge`] when there is more than `limit`.
    pub fn take(&mut self, piece: &[u8], limit: usize) -> Result<(), ServiceError> {
        if piece.len() > limit.saturating_sub(self.bytes.len()) {
            return Err(too_large(limit));
        }
        self.bytes.extend_from_slice(piece);
        Ok(())
    }

    /// The whole file.
    #[must_use]
    pub fn done(self) -> Vec<u8> {
        self.bytes
    }
}

/// What a file is told that is larger than is taken: whoever runs the server can take more.
#[must_use]
pub fn too_large(limit: usize) -> ServiceError {
    let detail =
        format!("the file is larger than {limit} bytes, the limit (the server's setting `limits.import_bytes`)");
    ServiceError::new(ErrorKind::BodyTooLarge, detail).at("body")
}

/// What a transfer is told that took too long.
#[must_use]
pub fn out_of_time(limit: Duration) -> ServiceError {
    let detail = format!("the file was not transferred within {} s", limit.as_secs_f64());
    ServiceError::new(ErrorKind::Timeout, detail)
}

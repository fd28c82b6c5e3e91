//! A thread that wakes what hangs in sled on a write that failed.
//!
//! sled can miss the signal that a write failed (the disk is full, say), and a `flush` or a batch under way waits for ever
//! then. A `flush` after it fails at once and wakes them. Whoever waits cannot do that, so a thread beside them does.

use super::StoreError;
use super::stop::Stop;
use std::sync::Arc;
use std::thread::JoinHandle;
use std::time::Duration;

/// How often it is looked whether a write has failed.
const EVERY: Duration = Duration::from_millis(200);

/// The thread; it ends when this is dropped.
pub(super) struct Nudge {
    stop: Arc<Stop>,
    thread: Option<JoinHandle<()>>,
}

impl Nudge {
    /// Starts a thread that calls `wake` now and then, which must not panic nor block for long, and does something only
    /// when a write has failed.
    pub(super) fn start(wake: impl Fn() + Send + 'static) -> Result<Self, StoreError> {
        let stop = Arc::<Stop>::default();
        let of_thread = Arc::clone(&stop);
        let run = move || {
            while !of_thread.within(EVERY) {
                wake();
            }
        };
        let thread = std::thread::Builder::new().name("store-nudge".to_owned()).spawn(run);
        let thread = thread.map_err(|source| StoreError::Io { what: "starting a thread".to_owned(), source })?;
        Ok(Self { stop, thread: Some(thread) })
    }
}

impl Drop for Nudge {
    fn drop(&mut self) {
        self.stop.ask();
        if let Some(thread) = self.thread.take() {
            // What it calls does not panic.
            let _ = thread.join();
        }
    }
}

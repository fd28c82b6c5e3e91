//! One thread makes everything durable that was applied since it last looked, so that commits of many maps that wait
//! at the same time cost one flush and one sync.

use crate::sync::thread::{Builder, JoinHandle};
use crate::sync::{Condvar, Mutex, lock};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::{Arc, PoisonError};
use std::time::Duration;

/// Makes the bytes that were written to the data file durable: `fdatasync`. A trait so that tests can count, delay and
/// fail it.
pub trait Syncer: Send + Sync + 'static {
    /// Returns when everything written to the file before is on the medium.
    ///
    /// # Errors
    /// When the system says that it is not. It must not be asked again then: the pages that failed may be marked clean.
    fn sync(&self) -> std::io::Result<()>;
}

/// The data file itself.
#[derive(Debug)]
pub(super) struct FileSyncer(pub(super) std::fs::File);

impl Syncer for FileSyncer {
    fn sync(&self) -> std::io::Result<()> {
        self.0.sync_data()
    }
}

/// Proof that a change was applied, to wait for.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(super) struct Ticket(u64);

#[derive(Debug, Default)]
struct State {
    applied: u64,
    durable: u64,
    failed: Option<String>,
    closing: bool,
    ended: bool,
}

#[derive(Debug, Default)]
struct Shared {
    state: Mutex<State>,
    work: Condvar,
    done: Condvar,
}

/// How long a waiter waits before it looks whether the flush hangs on an error.
const PATIENCE: Duration = Duration::from_millis(500);

/// The thread, and what is known to be durable. After one failure nothing is tried again.
pub(super) struct Durability {
    shared: Arc<Shared>,
    thread: Option<JoinHandle<()>>,
    nudge: Box<dyn Fn() + Send + Sync>,
}

impl Durability {
    /// Starts the thread; `last` is the number of the last change of all so far, which is durable. `make_durable` is
    /// given the number of the last change applied, and returns when it and all before it are durable. `nudge` is called
    /// from waiting threads while that takes long: sled's `flush` can miss the signal that a write failed, and a second
    /// call wakes it.
    pub(super) fn start(
        last: u64,
        make_durable: impl FnMut(u64) -> Result<(), String> + Send + 'static,
        nudge: impl Fn() + Send + Sync + 'static,
    ) -> std::io::Result<Self> {
        let state = State { applied: last, durable: last, ..State::default() };
        let shared = Arc::new(Shared { state: Mutex::new(state), ..Shared::default() });
        let of_thread = Arc::clone(&shared);
        let thread = Builder::new().name("store-sync".to_owned()).spawn(move || run(&of_thread, make_durable))?;
        Ok(Self { shared, thread: Some(thread), nudge: Box::new(nudge) })
    }

    /// To be called when a change has been applied: the next round of the thread covers it. Changes are numbered in the
    /// order of these calls.
    pub(super) fn applied(&self) -> Ticket {
        let mut state = lock(&self.shared.state);
        state.applied += 1;
        let ticket = Ticket(state.applied);
        drop(state);
        self.shared.work.notify_one();
        ticket
    }

    /// Waits until the change is durable; the reason when it is not.
    pub(super) fn wait(&self, ticket: Ticket) -> Result<(), String> {
        let mut state = lock(&self.shared.state);
        loop {
            if state.durable >= ticket.0 {
                return Ok(());
            }
            if let Some(reason) = &state.failed {
                return Err(reason.clone());
            }
            let (guard, waited) =
                self.shared.done.wait_timeout(state, PATIENCE).unwrap_or_else(PoisonError::into_inner);
            state = guard;
            if waited.timed_out() {
                drop(state);
                (self.nudge)();
                state = lock(&self.shared.state);
            }
        }
    }

    /// Why nothing is made durable any more.
    pub(super) fn failure(&self) -> Option<String> {
        lock(&self.shared.state).failed.clone()
    }

    /// Stops for good; the first reason stays.
    pub(super) fn fail(&self, reason: &str) {
        lock(&self.shared.state).failed.get_or_insert_with(|| reason.to_owned());
        self.shared.done.notify_all();
        self.shared.work.notify_all();
    }
}

impl Drop for Durability {
    fn drop(&mut self) {
        let mut state = lock(&self.shared.state);
        state.closing = true;
        self.shared.work.notify_all();
        while !state.ended {
            let (guard, waited) =
                self.shared.done.wait_timeout(state, PATIENCE).unwrap_or_else(PoisonError::into_inner);
            state = guard;
            if waited.timed_out() {
                drop(state);
                (self.nudge)();
                state = lock(&self.shared.state);
            }
        }
        drop(state);
        if let Some(thread) = self.thread.take() {
            // It ends without a panic: the call that could is caught in it.
            let _ = thread.join();
        }
    }
}

fn run(shared: &Shared, mut make_durable: impl FnMut(u64) -> Result<(), String>) {
    let mut state = lock(&shared.state);
    loop {
        if state.failed.is_some() || (state.closing && state.durable == state.applied) {
            break;
        }
        if state.durable == state.applied {
            state = shared.work.wait(state).unwrap_or_else(PoisonError::into_inner);
            continue;
        }
        let covered = state.applied;
        drop(state);
        let outcome = catch_unwind(AssertUnwindSafe(|| make_durable(covered)))
            .unwrap_or_else(|_| Err("the flush panicked".to_owned()));
        state = lock(&shared.state);
        match outcome {
            // A failure noted meanwhile (of an apply) stays: nothing after it may be acknowledged.
            Ok(()) => state.durable = covered,
            Err(reason) => {
                state.failed.get_or_insert(reason);
            }
        }
        shared.done.notify_all();
    }
    state.ended = true;
    drop(state);
    shared.done.notify_all();
}

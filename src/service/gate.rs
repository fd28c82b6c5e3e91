//! Who may still write: open until the service drains, and a count of the writes under way.

use super::tasks::watch;
use super::{ErrorKind, ServiceError};
use std::sync::Arc;

/// Lets writes in until it is closed, and knows when the last of them is done.
pub(super) struct Gate {
    state: watch::Sender<State>,
}

#[derive(Debug, Clone, Copy)]
struct State {
    open: bool,
    inside: usize,
}

/// One write under way: it goes with the write until that is durable or refused.
pub(super) struct Inside {
    gate: Arc<Gate>,
}

impl Gate {
    pub(super) fn new() -> Self {
        Self { state: watch::Sender::new(State { open: true, inside: 0 }) }
    }

    /// Lets one write in.
    ///
    /// # Errors
    /// [`ErrorKind::ShuttingDown`] once the gate is closed.
    pub(super) fn enter(self: &Arc<Self>) -> Result<Inside, ServiceError> {
        let mut entered = false;
        // Nobody waits for writes to begin, so nobody is woken.
        self.state.send_if_modified(|state| {
            entered = state.open;
            state.inside += usize::from(entered);
            false
        });
        if entered {
            Ok(Inside { gate: Arc::clone(self) })
        } else {
            Err(ServiceError::new(ErrorKind::ShuttingDown, "the server is shutting down and takes no more writes"))
        }
    }

    pub(super) fn is_open(&self) -> bool {
        self.state.borrow().open
    }

    /// Lets nobody in from now on and waits until all are out.
    pub(super) async fn close(&self) {
        self.state.send_modify(|state| state.open = false);
        // The only error is a dropped sender, and `self` holds it.
        let _ = self.state.subscribe().wait_for(|state| state.inside == 0).await;
    }
}

impl Drop for Inside {
    fn drop(&mut self) {
        self.gate.state.send_if_modified(|state| {
            state.inside -= 1;
            state.inside == 0 && !state.open
        });
    }
}

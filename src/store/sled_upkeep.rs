//! A thread that looks at the size of the store now and then, and has it rewritten when it is over its limit.

use super::StoreError;
use super::sled_rewrite::{RewriteStep, Rewriter};
use super::stop::Stop;
use std::sync::Arc;
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

/// After failures in a row the next attempt waits at most so many times as long as a check.
const MOST_PATIENCE: u32 = 256;

/// Longest rest between two pieces of work.
const LONGEST_REST: Duration = Duration::from_secs(1);

/// The thread; it ends when this is dropped, and a rewrite that is under way is given up.
#[derive(Debug)]
pub(super) struct Upkeep {
    stop: Arc<Stop>,
    thread: Option<JoinHandle<()>>,
}

impl Upkeep {
    /// Starts the thread, which looks once in every `check`.
    pub(super) fn start(rewriter: Arc<Rewriter>, check: Duration) -> std::io::Result<Self> {
        let stop = Arc::<Stop>::default();
        let of_thread = Arc::clone(&stop);
        let thread = std::thread::Builder::new()
            .name("store-upkeep".to_owned())
            .spawn(move || run(&rewriter, check, &of_thread))?;
        Ok(Self { stop, thread: Some(thread) })
    }
}

impl Drop for Upkeep {
    fn drop(&mut self) {
        self.stop.ask();
        if let Some(thread) = self.thread.take() {
            // What could panic in it is caught where sled is called.
            let _ = thread.join();
        }
    }
}

fn run(rewriter: &Rewriter, check: Duration, stop: &Stop) {
    let mut patience = 1_u32;
    while !stop.within(check.saturating_mul(patience)) {
        match look(rewriter, stop) {
            Ok(()) => patience = 1,
            Err(_) if stop.within(Duration::ZERO) => return,
            Err(error) => {
                patience = (patience * 2).min(MOST_PATIENCE);
                tracing::warn!("the database is left as it is, it could not be measured or rewritten: {error}");
            }
        }
    }
}

fn look(rewriter: &Rewriter, stop: &Stop) -> Result<(), StoreError> {
    let mut resumed = Instant::now();
    // Rests as long as it works, so that it takes half of a core and of the disk at most.
    let mut watch = |step| {
        let rest = match step {
            RewriteStep::Copying(_) | RewriteStep::Comparing(_) => resumed.elapsed().min(LONGEST_REST),
            _ => Duration::ZERO,
        };
        let asked = stop.within(rest);
        resumed = Instant::now();
        if asked { Err(StoreError::Refused("the store is being closed".to_owned())) } else { Ok(()) }
    };
    if rewriter.measure(&mut watch)? {
        rewriter.bring_below(&mut watch)?;
    }
    Ok(())
}

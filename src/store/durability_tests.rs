//! The sync thread: nothing is acknowledged that it has not covered, waiters share a round, a failure is for good.

#![allow(clippy::unwrap_used, clippy::panic, reason = "a test fails by panicking")]

use super::durability::Durability;
use super::nudge::Nudge;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::mpsc::{Receiver, Sender, channel};
use std::sync::{Arc, Mutex};
use std::time::Duration;

/// A `make_durable` that says when a round begins and waits for its outcome.
struct Rounds {
    begun: Receiver<()>,
    outcomes: Sender<Result<(), String>>,
}

fn durability(nudges: Arc<AtomicU64>) -> (Durability, Rounds) {
    let (begin, begun) = channel();
    let (outcomes, outcome) = channel::<Result<(), String>>();
    let make_durable = move |_| {
        begin.send(()).unwrap();
        outcome.recv().unwrap()
    };
    let nudge = move || {
        nudges.fetch_add(1, Ordering::SeqCst);
    };
    (Durability::start(0, make_durable, nudge).unwrap(), Rounds { begun, outcomes })
}

#[test]
fn a_change_applied_during_a_round_waits_for_the_next() {
    let (durability, rounds) = durability(Arc::default());
    let first = durability.applied();
    rounds.begun.recv().unwrap();
    let during = [durability.applied(), durability.applied(), durability.applied()];
    let answered = Mutex::new(0);
    std::thread::scope(|scope| {
        for ticket in during {
            let (durability, answered) = (&durability, &answered);
            scope.spawn(move || {
                durability.wait(ticket).unwrap();
                *answered.lock().unwrap() += 1;
            });
        }
        rounds.outcomes.send(Ok(())).unwrap();
        durability.wait(first).unwrap();
        rounds.begun.recv().unwrap();
        assert_eq!(*answered.lock().unwrap(), 0, "the first round did not cover them");
        rounds.outcomes.send(Ok(())).unwrap();
    });
    assert_eq!(*answered.lock().unwrap(), 3);
    assert!(rounds.begun.try_recv().is_err(), "three waiters shared one round");
}

#[test]
fn after_a_failure_nothing_is_tried_or_acknowledged() {
    let (durability, rounds) = durability(Arc::default());
    let durable = durability.applied();
    rounds.outcomes.send(Ok(())).unwrap();
    durability.wait(durable).unwrap();
    let lost = durability.applied();
    rounds.outcomes.send(Err("no space".to_owned())).unwrap();
    assert_eq!(durability.wait(lost), Err("no space".to_owned()));
    let later = durability.applied();
    let _ = rounds.outcomes.send(Ok(()));
    assert_eq!(durability.wait(later), Err("no space".to_owned()));
    assert_eq!(durability.wait(durable), Ok(()), "what was durable stays so");
    assert_eq!(durability.failure(), Some("no space".to_owned()));
}

#[test]
fn a_round_is_told_the_last_change_that_it_covers() {
    let (tell, told) = channel();
    let durability =
        Durability::start(40, move |last| tell.send(last).map_err(|error| error.to_string()), || ()).unwrap();
    for number in 41..=50 {
        durability.wait(durability.applied()).unwrap();
        assert_eq!(told.recv().unwrap(), number);
    }
}

#[test]
fn a_panic_in_the_flush_is_a_failure() {
    let durability = Durability::start(7, |_| panic!("planted"), || ()).unwrap();
    let ticket = durability.applied();
    assert!(durability.wait(ticket).unwrap_err().contains("panicked"));
}

#[test]
fn a_batch_that_hung_on_a_failed_write_was_woken_by_nobody() {
    let (wake, woken) = channel();
    let nudge = Nudge::start(move || wake.send(()).unwrap_or_default()).unwrap();
    // Nobody waits for a round: what hangs has not got so far.
    woken.recv().unwrap();
    drop(nudge);
    while woken.try_recv().is_ok() {}
    assert!(woken.recv().is_err(), "the thread has ended");
}

#[test]
fn a_flush_that_hangs_is_nudged_and_closing_waits_for_what_was_applied() {
    let nudges = Arc::new(AtomicU64::new(0));
    let (durability, rounds) = durability(Arc::clone(&nudges));
    let ticket = durability.applied();
    rounds.begun.recv().unwrap();
    std::thread::scope(|scope| {
        scope.spawn(|| durability.wait(ticket).unwrap());
        while nudges.load(Ordering::SeqCst) == 0 {
            std::thread::sleep(Duration::from_millis(10));
        }
        rounds.outcomes.send(Ok(())).unwrap();
    });
    durability.applied();
    rounds.outcomes.send(Ok(())).unwrap();
    drop(durability);
    assert_eq!(rounds.begun.try_iter().count(), 1, "the last change was made durable before the end");
}

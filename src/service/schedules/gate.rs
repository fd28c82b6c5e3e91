//! The gate: nobody gets in behind the end, and the end waits for all who are in.

#![allow(clippy::unwrap_used, reason = "a test fails by panicking")]

use crate::service::gate::Gate;
use crate::sync::explore::{exhaust, explore};
use crate::sync::{AtomicBool, AtomicUsize, thread};
use shuttle::future::block_on;
use std::sync::Arc;
use std::sync::atomic::Ordering::SeqCst;

fn writes(gate: &Arc<Gate>, inside: &AtomicUsize, ended: &AtomicBool) {
    let Ok(ticket) = gate.enter() else { return };
    inside.fetch_add(1, SeqCst);
    assert!(!ended.load(SeqCst), "a write behind the end");
    inside.fetch_sub(1, SeqCst);
    drop(ticket);
}

fn ends(gate: &Gate, inside: &AtomicUsize, ended: &AtomicBool) {
    block_on(gate.close());
    ended.store(true, SeqCst);
    assert_eq!(inside.load(SeqCst), 0, "the end did not wait for a write");
    assert!(!gate.is_open());
}

fn scene(writers: usize, ends_at_once: usize) {
    let gate = Arc::new(Gate::new());
    let shared = Arc::new((AtomicUsize::new(0), AtomicBool::new(false)));
    let spawn = |work: fn(&Arc<Gate>, &AtomicUsize, &AtomicBool)| {
        let (gate, shared) = (Arc::clone(&gate), Arc::clone(&shared));
        thread::spawn(move || work(&gate, &shared.0, &shared.1))
    };
    let mut threads: Vec<_> = (0..writers).map(|_| spawn(writes)).collect();
    threads.extend((1..ends_at_once).map(|_| spawn(|gate, inside, ended| ends(gate, inside, ended))));
    ends(&gate, &shared.0, &shared.1);
    threads.into_iter().for_each(|thread| thread.join().unwrap());
    assert!(gate.enter().is_err());
}

#[test]
fn one_write_and_the_end_in_every_order() {
    exhaust(20, || scene(1, 1));
}

#[test]
fn the_end_waits_for_those_inside_and_nobody_gets_in_behind_it() {
    explore(500, || scene(3, 2));
}

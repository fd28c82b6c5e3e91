//! The memory for scans: never more out than there is, and all of it comes back.

#![allow(clippy::unwrap_used, reason = "a test fails by panicking")]

use crate::service::budget::Budget;
use crate::sync::explore::explore;
use crate::sync::thread;
use std::sync::Arc;

#[test]
fn never_more_than_the_limit_is_out_and_all_comes_back() {
    explore(500, || {
        let budget = Arc::new(Budget::new(100));
        let threads: Vec<_> = ["a", "a", "b"]
            .into_iter()
            .map(|robot| {
                let budget = Arc::clone(&budget);
                thread::spawn(move || {
                    // Scans of one request are computed at once, and each takes memory.
                    let reservation = Arc::new(budget.reservation(robot));
                    let beside = Arc::clone(&reservation);
                    let scan = thread::spawn(move || beside.grow(30).is_ok());
                    let mine = reservation.grow(30).is_ok();
                    assert!(budget.used() <= 100, "more than there is");
                    let _ = (mine, scan.join().unwrap());
                })
            })
            .collect();
        threads.into_iter().for_each(|thread| thread.join().unwrap());
        assert_eq!(budget.used(), 0);
        budget.reservation("c").grow(100).unwrap();
    });
}

//! The memory budget: what is given out comes back, and who waits for nothing is told so.

#![allow(clippy::unwrap_used, reason = "tests")]

use super::ErrorKind;
use super::budget::Budget;
use std::sync::Arc;

#[test]
fn others_in_the_way_are_busy_and_a_request_of_its_own_size_is_too_large() {
    let budget = Arc::new(Budget::new(100));
    let (first, second) = (budget.reservation("a"), budget.reservation("b"));
    first.grow(60).unwrap();
    second.grow(40).unwrap();
    assert_eq!(second.grow(1).unwrap_err().kind, ErrorKind::Busy);
    assert_eq!(second.grow(61).unwrap_err().kind, ErrorKind::TooManyScans);
    assert_eq!(second.grow(usize::MAX).unwrap_err().kind, ErrorKind::TooManyScans);
    assert_eq!(budget.used(), 100);
    drop(first);
    second.grow(60).unwrap();
    assert_eq!(budget.used(), 100);
    drop(second);
    assert_eq!(budget.used(), 0);
}

#[test]
fn many_threads_never_hold_more_than_the_limit() {
    let budget = Arc::new(Budget::new(1000));
    std::thread::scope(|scope| {
        for thread in 1..=4_usize {
            let budget = &budget;
            scope.spawn(move || {
                for i in 0..20_000 {
                    let reservation = budget.reservation(&format!("r{}", thread % 2));
                    for _ in 0..3 {
                        let _ = reservation.grow(100 * thread + i % 50);
                    }
                    assert!(budget.used() <= 1000);
                }
            });
        }
    });
    assert_eq!(budget.used(), 0);
}

#[test]
fn over_half_used_a_robot_keeps_to_its_share_of_the_memory() {
    let budget = Arc::new(Budget::new(100));
    let greedy: Vec<_> = (0..5).map(|_| budget.reservation("greedy")).collect();
    greedy.iter().for_each(|reservation| reservation.grow(10).unwrap());
    let other = budget.reservation("b");
    other.grow(20).unwrap();
    // Two robots: half each, and the greedy one has it.
    let more = budget.reservation("greedy");
    let refused = more.grow(1).unwrap_err();
    assert_eq!(refused.kind, ErrorKind::Busy);
    assert!(refused.detail.contains("\"greedy\"") && refused.detail.contains("limits.insert_bytes"), "{refused}");
    // A robot's only request may take what there is.
    other.grow(30).unwrap();
    assert_eq!(budget.used(), 100);
    drop((greedy, other));
    more.grow(100).unwrap();
}

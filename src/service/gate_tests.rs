//! The gate: open until closed, and closed only when all are out.

#![allow(clippy::unwrap_used, reason = "tests")]

use super::ErrorKind;
use super::gate::Gate;
use std::sync::Arc;

#[tokio::test]
async fn closing_waits_for_those_inside_and_lets_nobody_in() {
    let gate = Arc::new(Gate::new());
    let (first, second) = (gate.enter().unwrap(), gate.enter().unwrap());
    let closing = tokio::spawn({
        let gate = Arc::clone(&gate);
        async move { gate.close().await }
    });
    while gate.is_open() {
        tokio::task::yield_now().await;
    }
    assert_eq!(gate.enter().map(|_| ()).unwrap_err().kind, ErrorKind::ShuttingDown);
    drop(first);
    for _ in 0..100 {
        tokio::task::yield_now().await;
    }
    assert!(!closing.is_finished());
    drop(second);
    closing.await.unwrap();
    gate.close().await;
}

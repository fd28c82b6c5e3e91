//! Shares of clients, and when a connection is idle.

#![allow(clippy::unwrap_used, reason = "tests")]

use super::{PerClient, connected, network};
use std::time::Duration;

#[test]
fn a_client_of_ipv6_is_its_network() {
    assert_eq!(network("2001:db8::1".parse().unwrap()), network("2001:db8::ffff:2".parse().unwrap()));
    assert_ne!(network("2001:db8::1".parse().unwrap()), network("2001:db8:0:1::1".parse().unwrap()));
    assert_eq!(network("::ffff:10.0.0.1".parse().unwrap()), network("10.0.0.1".parse().unwrap()));
    assert_ne!(network("10.0.0.1".parse().unwrap()), network("10.0.0.2".parse().unwrap()));
}

#[test]
fn a_client_beyond_its_share_is_told_and_beyond_that_closed_and_others_are_let_in() {
    let connections = PerClient::new(2);
    let address = "10.0.0.1".parse().unwrap();
    let mut open: Vec<_> = (0..2).map(|_| connected(&connections, address).unwrap()).collect();
    assert!(open.iter().all(|(client, _)| !client.is_refused()));
    for _ in 0..super::TOLD {
        open.push(connected(&connections, address).unwrap());
        assert!(open.last().unwrap().0.is_refused());
    }
    assert!(connected(&connections, address).is_none());
    assert!(!connected(&connections, "10.0.0.2".parse().unwrap()).unwrap().0.is_refused());
    drop(open);
    assert!(!connected(&connections, address).unwrap().0.is_refused());
}

#[tokio::test]
async fn a_connection_is_idle_only_while_nothing_is_under_way_on_it() {
    let (client, _share) = connected(&PerClient::new(1), "10.0.0.1".parse().unwrap()).unwrap();
    let limit = Duration::from_millis(20);
    let (one, two) = (client.begin(), client.begin());
    let idle = tokio::spawn({
        let client = client.clone();
        async move { client.idle(limit).await }
    });
    tokio::time::sleep(limit * 5).await;
    assert!(!idle.is_finished());
    drop(one);
    tokio::time::sleep(limit * 5).await;
    assert!(!idle.is_finished());
    drop(two);
    idle.await.unwrap();
}

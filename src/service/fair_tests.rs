//! Shares of a queue: whoever is alone has it all, whoever sends most does not keep the others out.

#![allow(clippy::unwrap_used, clippy::panic, reason = "tests")]

use super::ErrorKind;
use super::fair::{Place, Places};
use std::future::Future;
use std::pin::pin;
use std::sync::Arc;
use std::task::{Context, Poll, Waker};

fn now<F: Future>(future: F) -> Poll<F::Output> {
    pin!(future).poll(&mut Context::from_waker(Waker::noop()))
}

#[test]
fn a_robot_that_is_alone_has_all_but_what_is_kept_for_others() {
    let places = Places::new(8);
    let held: Vec<Place> = (0..6).map(|_| places.take("a").unwrap()).collect();
    let refused = places.take("a").unwrap_err();
    assert_eq!(refused.kind, ErrorKind::Busy);
    assert!(refused.detail.contains("\"a\" has 6") && refused.detail.contains("writer.queue"), "{}", refused.detail);
    let others = ["b", "c"].map(|robot| places.take(robot).unwrap());
    assert!(places.full());
    let refused = places.take("d").unwrap_err();
    assert!(refused.kind == ErrorKind::Busy && refused.detail.contains("writer.queue"), "{}", refused.detail);
    drop((held, others));
    assert!(!places.full() && places.take("d").is_ok());
}

#[test]
fn over_half_full_a_robot_keeps_to_its_share_and_others_find_room() {
    let places = Places::new(16);
    let mut greedy: Vec<Place> = (0..8).map(|_| places.take("greedy").unwrap()).collect();
    let first = places.take("b").unwrap();
    // Two robots: eight places each.
    let refused = places.take("greedy").unwrap_err();
    assert!(refused.detail.contains("\"greedy\" has 8"), "{}", refused.detail);
    let (second, third) = (places.take("c").unwrap(), places.take("d").unwrap());
    let fourth = places.take("b").unwrap();
    assert!(places.take("greedy").is_err());
    // With four robots the share is four: the greedy one gets no more until it has fewer.
    greedy.truncate(5);
    assert!(places.take("greedy").is_err());
    greedy.truncate(3);
    assert!(places.take("greedy").is_ok());
    drop((first, second, third, fourth, greedy));
    assert!((0..12).map(|_| places.take("e")).collect::<Vec<_>>().iter().all(Result::is_ok));
}

#[test]
fn those_that_wait_are_let_in_by_turns_of_robots() {
    let places = Places::new(2);
    let (one, two) = (places.take("a").unwrap(), places.take("b").unwrap());
    let mut waiting: Vec<_> =
        ["a", "a", "a", "b", "c"].into_iter().map(|robot| (robot, Box::pin(places.wait(robot)))).collect();
    let mut order = Vec::new();
    let mut context = Context::from_waker(Waker::noop());
    let mut look = |order: &mut Vec<&'static str>| {
        let mut got = Vec::new();
        waiting.retain_mut(|(robot, future)| match future.as_mut().poll(&mut context) {
            Poll::Ready(place) => {
                order.push(*robot);
                got.push(place.unwrap());
                false
            }
            Poll::Pending => true,
        });
        got
    };
    assert!(look(&mut order).is_empty());
    drop(one);
    let mut held = look(&mut order);
    drop(two);
    held.extend(look(&mut order));
    while !held.is_empty() {
        held.remove(0);
        held.extend(look(&mut order));
    }
    // Each robot once before the first has its second.
    assert_eq!(order.len(), 5);
    let mut first_three = order[..3].to_vec();
    first_three.sort_unstable();
    assert_eq!(first_three, ["a", "b", "c"], "{order:?}");
    assert!(places.take("z").is_ok());
}

#[test]
fn who_waits_no_longer_is_passed_over() {
    let places = Places::new(1);
    let held = places.take("a").unwrap();
    {
        let mut gone = Box::pin(places.wait("b"));
        assert!(gone.as_mut().poll(&mut Context::from_waker(Waker::noop())).is_pending());
    }
    let mut next = Box::pin(places.wait("c"));
    assert!(next.as_mut().poll(&mut Context::from_waker(Waker::noop())).is_pending());
    drop(held);
    let Poll::Ready(Some(place)) = now(next) else { panic!("the place was lost") };
    drop(place);
    assert!(places.take("d").is_ok());
}

#[test]
fn no_place_is_lost_among_many_threads() {
    let places = Places::new(4);
    std::thread::scope(|scope| {
        for robot in 0..4 {
            let places = Arc::clone(&places);
            scope.spawn(move || {
                let runtime = tokio::runtime::Builder::new_current_thread().build().unwrap();
                for turn in 0..2000 {
                    match turn % 3 {
                        0 => drop(places.take(&format!("r{robot}"))),
                        1 => drop(runtime.block_on(places.wait(&format!("r{robot}"))).unwrap()),
                        // Asked for and given up.
                        _ => drop(now(places.wait(&format!("r{robot}")))),
                    }
                }
            });
        }
    });
    let all: Vec<Place> = (0..4).map(|last| places.take(&format!("last-{last}")).unwrap()).collect();
    assert!(places.full());
    drop(all);
}

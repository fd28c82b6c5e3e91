//! Places of a queue: never more out than there are, none lost, and who waits is let in at last.

#![allow(clippy::unwrap_used, clippy::panic, reason = "a test fails by panicking")]

use crate::service::fair::{Place, Places};
use crate::sync::explore::{exhaust, explore};
use crate::sync::{AtomicUsize, point, thread};
use shuttle::future::{block_on, spawn};
use std::future::Future;
use std::pin::pin;
use std::sync::Arc;
use std::sync::atomic::Ordering::SeqCst;
use std::task::{Context, Poll};

/// Who is in, counted beside the places.
#[derive(Default)]
struct Inside(AtomicUsize);

impl Inside {
    /// Holds a place for a while.
    fn stay(&self, place: Place, capacity: usize) {
        assert!(self.0.fetch_add(1, SeqCst) < capacity, "more places are out than there are");
        self.0.fetch_sub(1, SeqCst);
        drop(place);
    }
}

/// All places are there again: as many robots as there are places can each have one, and no more.
fn all_are_back(places: &Arc<Places>, capacity: usize) {
    let all: Vec<Place> = (0..capacity).map(|last| places.take(&format!("last-{last}")).unwrap()).collect();
    assert!(places.full() && places.take("one-too-many").is_err());
    drop(all);
    assert!(!places.full());
}

/// Waits for a place and gives up after so many looks.
async fn wait_and_give_up(places: &Arc<Places>, robot: &str, looks: usize) -> Option<Place> {
    let mut waiting = pin!(places.wait(robot));
    let mut left = looks;
    std::future::poll_fn(move |context: &mut Context<'_>| match waiting.as_mut().poll(context) {
        Poll::Ready(place) => Poll::Ready(place),
        Poll::Pending if left == 0 => Poll::Ready(None),
        Poll::Pending => {
            left -= 1;
            context.waker().wake_by_ref();
            Poll::Pending
        }
    })
    .await
}

#[test]
fn of_two_that_want_the_only_place_both_have_it_in_every_order() {
    exhaust(50, || {
        let (places, inside) = (Places::new(1), Arc::<Inside>::default());
        let other = {
            let (places, inside) = (Arc::clone(&places), Arc::clone(&inside));
            thread::spawn(move || inside.stay(block_on(places.wait("b")).unwrap(), 1))
        };
        inside.stay(block_on(places.wait("a")).unwrap(), 1);
        other.join().unwrap();
        all_are_back(&places, 1);
    });
}

#[test]
fn a_place_that_is_given_to_one_who_leaves_is_not_lost_in_any_order() {
    exhaust(50, || {
        let places = Places::new(1);
        let held = places.take("a").unwrap();
        let leaver = {
            let places = Arc::clone(&places);
            thread::spawn(move || {
                let mut gone = Box::pin(places.wait("b"));
                let _ = gone.as_mut().poll(&mut Context::from_waker(std::task::Waker::noop()));
                point();
                drop(gone);
            })
        };
        drop(held);
        drop(block_on(places.wait("c")).unwrap());
        leaver.join().unwrap();
        all_are_back(&places, 1);
    });
}

#[test]
fn everybody_who_waits_is_let_in_and_who_leaves_takes_nothing_along() {
    for capacity in [1, 2, 4] {
        explore(300, move || {
            let (places, inside) = (Places::new(capacity), Arc::<Inside>::default());
            let tasks: Vec<_> = ["a", "a", "b", "c", "a"]
                .into_iter()
                .enumerate()
                .map(|(number, robot)| {
                    let (places, inside) = (Arc::clone(&places), Arc::clone(&inside));
                    spawn(async move {
                        match number {
                            // One asks and is refused, or not.
                            3 => {
                                if let Ok(place) = places.take(robot) {
                                    inside.stay(place, capacity);
                                }
                            }
                            4 => {
                                if let Some(place) = wait_and_give_up(&places, robot, 1).await {
                                    inside.stay(place, capacity);
                                }
                            }
                            _ => {
                                for _ in 0..2 {
                                    let place = places.wait(robot).await.expect("the places are there");
                                    inside.stay(place, capacity);
                                }
                            }
                        }
                    })
                })
                .collect();
            for task in tasks {
                block_on(task).unwrap();
            }
            all_are_back(&places, capacity);
        });
    }
}

#[test]
fn the_last_quarter_is_there_for_a_robot_that_has_none() {
    explore(300, || {
        let places = Places::new(4);
        let greedy: Vec<_> = (0..2)
            .map(|_| {
                let places = Arc::clone(&places);
                thread::spawn(move || (0..3).filter_map(|_| places.take("greedy").ok()).collect::<Vec<_>>())
            })
            .collect();
        // However much the other asks for, one place is left.
        let mine = places.take("modest").unwrap();
        let theirs: Vec<Place> = greedy.into_iter().flat_map(|thread| thread.join().unwrap()).collect();
        assert!(theirs.len() <= 3, "{} places of 4", theirs.len());
        drop((mine, theirs));
        all_are_back(&places, 4);
    });
}

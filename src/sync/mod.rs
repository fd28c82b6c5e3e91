//! Floor 0: the locks, atomics and cells of what runs at once, from one place.
//!
//! They are those of `std` and `arc-swap`. With the feature `shuttle`, which is for tests alone, they are those of
//! `shuttle`: its scheduler decides at each of them which task goes on, so that a test goes through thousands of
//! orders and can do one again. What a thread shares with another and a test of schedules is to see, is from here.

#[cfg(feature = "shuttle")]
mod modelled;

#[cfg(all(test, feature = "shuttle"))]
pub(crate) mod explore;

#[cfg(not(feature = "shuttle"))]
pub(crate) use {
    arc_swap::ArcSwapOption,
    std::sync::atomic::{AtomicBool, AtomicU64, AtomicUsize},
    std::sync::{Mutex, MutexGuard},
};

#[cfg(all(feature = "service", not(feature = "shuttle")))]
pub(crate) use {
    arc_swap::ArcSwap,
    std::sync::{Condvar, RwLock},
    std::thread,
};

#[cfg(feature = "shuttle")]
pub(crate) use {
    modelled::{ArcSwap, ArcSwapOption, point},
    shuttle::sync::atomic::{AtomicBool, AtomicU64, AtomicUsize},
    shuttle::sync::{Condvar, Mutex, MutexGuard, RwLock},
    shuttle::thread,
};

#[cfg(feature = "service")]
use std::sync::PoisonError;

/// The lock of a mutex whether or not a thread panicked with it: no state here is left half changed by a panic.
#[cfg(feature = "service")]
pub(crate) fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

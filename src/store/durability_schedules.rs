//! The sync thread under schedules: what is acknowledged was covered by a round that began after it was applied, nobody
//! waits for ever, and a failure is told to all that it concerns.

#![allow(clippy::unwrap_used, reason = "a test fails by panicking")]

use super::durability::Durability;
use crate::sync::explore::explore;
use crate::sync::{AtomicBool, AtomicU64, thread};
use std::sync::Arc;
use std::sync::atomic::Ordering::SeqCst;

/// A file: what was written to it, and up to where it is on the medium.
#[derive(Default)]
struct Disk {
    written: AtomicU64,
    durable: AtomicU64,
    broken: AtomicBool,
}

impl Disk {
    fn flush(&self, covered: u64) -> Result<(), String> {
        // What is written while this goes on is not in it.
        let written = self.written.load(SeqCst);
        assert!(written >= covered, "a round covers what is not written yet");
        if self.broken.load(SeqCst) {
            return Err("no space".to_owned());
        }
        self.durable.fetch_max(written, SeqCst);
        Ok(())
    }
}

fn disk() -> (Arc<Disk>, Arc<Durability>) {
    let disk = Arc::<Disk>::default();
    let flushed = Arc::clone(&disk);
    let durability = Durability::start(0, move |covered| flushed.flush(covered), || ()).unwrap();
    (disk, Arc::new(durability))
}

/// Writes, and waits for it; what it wrote must be on the medium then.
fn write_one(disk: &Disk, durability: &Durability) -> Result<(), String> {
    let mine = disk.written.fetch_add(1, SeqCst) + 1;
    let ticket = durability.applied();
    durability.wait(ticket)?;
    assert!(disk.durable.load(SeqCst) >= mine, "acknowledged before it was durable");
    Ok(())
}

#[test]
fn what_is_acknowledged_is_durable_and_nobody_waits_for_ever() {
    explore(500, || {
        let (disk, durability) = disk();
        let writers: Vec<_> = (0..3)
            .map(|_| {
                let (disk, durability) = (Arc::clone(&disk), Arc::clone(&durability));
                thread::spawn(move || (0..2).for_each(|_| write_one(&disk, &durability).unwrap()))
            })
            .collect();
        writers.into_iter().for_each(|writer| writer.join().unwrap());
    });
}

#[test]
fn the_end_waits_for_what_was_applied() {
    explore(500, || {
        let (disk, durability) = disk();
        let writer = {
            let (disk, durability) = (Arc::clone(&disk), Arc::clone(&durability));
            thread::spawn(move || {
                disk.written.fetch_add(1, SeqCst);
                durability.applied();
            })
        };
        disk.written.fetch_add(1, SeqCst);
        durability.applied();
        writer.join().unwrap();
        drop(durability);
        assert_eq!(disk.durable.load(SeqCst), 2);
    });
}

#[test]
fn after_a_failure_everybody_is_told_and_nothing_is_acknowledged() {
    explore(500, || {
        let (disk, durability) = disk();
        let writers: Vec<_> = (0..2)
            .map(|_| {
                let (disk, durability) = (Arc::clone(&disk), Arc::clone(&durability));
                thread::spawn(move || (0..2).map(|_| write_one(&disk, &durability).is_ok()).collect::<Vec<_>>())
            })
            .collect();
        disk.broken.store(true, SeqCst);
        // A write that failed by itself ends it as well.
        durability.fail("no space");
        for writer in writers {
            let acknowledged = writer.join().unwrap();
            assert!(acknowledged[0] || !acknowledged[1], "acknowledged after a failure");
        }
        assert!(write_one(&disk, &durability).is_err());
        assert_eq!(durability.failure().as_deref(), Some("no space"));
    });
}

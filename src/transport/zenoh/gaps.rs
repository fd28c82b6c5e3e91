//! Which numbered scans of a robot did not come: best effort is counted, since nobody is told.

use std::collections::HashMap;
use std::collections::hash_map::Entry;

/// Most robots whose numbers are followed; more are not counted.
const MOST_ROBOTS: usize = 10_000;

/// The last number of each robot of each map.
#[derive(Debug, Default)]
pub struct Gaps {
    last: HashMap<(String, String), u64>,
}

/// What a number says about those before it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Came {
    /// It is the next, the first, or there is no telling.
    InOrder,
    /// So many before it did not come, at least not yet.
    After(u64),
    /// It is not above the last one: late, or sent again.
    Late,
}

impl Gaps {
    /// Takes note of a scan's number.
    pub fn note(&mut self, map: &str, robot: &str, sequence: u64) -> Came {
        let full = self.last.len() >= MOST_ROBOTS;
        match self.last.entry((map.to_owned(), robot.to_owned())) {
            Entry::Vacant(_) if full => Came::InOrder,
            Entry::Vacant(entry) => {
                entry.insert(sequence);
                Came::InOrder
            }
            Entry::Occupied(mut entry) => {
                let last = *entry.get();
                if sequence <= last {
                    return Came::Late;
                }
                entry.insert(sequence);
                match sequence - last - 1 {
                    0 => Came::InOrder,
                    missing => Came::After(missing),
                }
            }
        }
    }
}

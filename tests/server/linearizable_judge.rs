//! Says whether a recorded history of a map is one that could have been: see `linearizable`. And that it tells wrong ones.

#![allow(clippy::unwrap_used, clippy::panic, reason = "tests")]

use crate::linearizable::scan_of;
use crate::service_support::applied_to;
use std::collections::{BTreeMap, BTreeSet};
use std::time::Instant;
use ubbmap::mapping::{MapConfig, Surveyor};
use ubbmap::quadtree::{NodeAddress, OccupancyTree};

/// A scan by its client and number.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub struct Scanned {
    pub client: usize,
    pub sequence: u64,
}

/// What a client did, and what it was answered.
#[derive(Debug, Clone)]
pub enum Did {
    /// The scans that were not refused, in order.
    Insert {
        scans: Vec<Scanned>,
        applied: u64,
        duplicates: u64,
        revision: u64,
    },
    Snapshot {
        name: String,
        revision: u64,
    },
    Restore {
        name: String,
        revision: u64,
    },
    /// All leaves, row after row.
    Read {
        revision: u64,
        classes: Vec<u8>,
    },
}

#[derive(Debug, Clone)]
pub struct Op {
    pub client: usize,
    pub begun: Instant,
    pub ended: Instant,
    pub did: Did,
}

pub type History = Vec<Op>;

/// How much a history held.
#[derive(Debug, Clone, Copy, Default)]
pub struct Summary {
    pub reads: u64,
    pub applied: u64,
    pub duplicates: u64,
    pub restores: u64,
    /// Scans that were applied once more, after a restore had taken them back.
    pub again: u64,
}

/// The map at one revision, by the engine alone.
#[derive(Clone)]
struct State {
    tree: OccupancyTree,
    applied: BTreeSet<Scanned>,
}

impl Did {
    fn revision(&self) -> u64 {
        match self {
            Self::Insert { revision, .. }
            | Self::Snapshot { revision, .. }
            | Self::Restore { revision, .. }
            | Self::Read { revision, .. } => *revision,
        }
    }
}

/// The configuration that the map of these tests has.
fn config() -> MapConfig {
    let json = r#"{"depth": 8, "min_obstacle_width": 0.1, "sensors": {"default": {"range_max": 10}}}"#;
    ubbmap::wire::map_config(serde_json::from_str(json).unwrap()).unwrap()
}

/// What the history held.
///
/// # Errors
/// What no map could have answered.
pub fn judge(history: &[Op]) -> Result<Summary, String> {
    in_time(history)?;
    let (states, summary) = replay(history)?;
    for op in history {
        let state = states.get(&op.did.revision()).ok_or_else(|| format!("{}: nobody made that", told(op)))?;
        match &op.did {
            Did::Insert { scans, .. } => {
                if let Some(missing) = scans.iter().find(|scan| !state.applied.contains(scan)) {
                    return Err(format!("{}: {missing:?} is not in the map of that revision", told(op)));
                }
            }
            Did::Read { classes, .. } => same(state, classes).map_err(|wrong| format!("{}: {wrong}", told(op)))?,
            Did::Snapshot { .. } | Did::Restore { .. } => {}
        }
    }
    let reads = history.iter().filter(|op| matches!(op.did, Did::Read { .. })).count() as u64;
    Ok(Summary { reads, ..summary })
}

fn told(op: &Op) -> String {
    let did = match &op.did {
        Did::Read { .. } => "Read".to_owned(),
        other => format!("{other:?}"),
    };
    format!("client {}, revision {}, {did}", op.client, op.did.revision())
}

/// No answer is of an earlier revision than one that had come before its call.
fn in_time(history: &[Op]) -> Result<(), String> {
    let mut ended: Vec<&Op> = history.iter().collect();
    ended.sort_by_key(|op| op.ended);
    let mut begun: Vec<&Op> = history.iter().collect();
    begun.sort_by_key(|op| op.begun);
    let mut known: Option<&Op> = None;
    let mut came = ended.into_iter().peekable();
    for op in begun {
        while let Some(earlier) = came.next_if(|earlier| earlier.ended <= op.begun) {
            if known.is_none_or(|known| known.did.revision() < earlier.did.revision()) {
                known = Some(earlier);
            }
        }
        if let Some(known) = known.filter(|known| known.did.revision() > op.did.revision()) {
            return Err(format!("{} was answered after {}", told(op), told(known)));
        }
    }
    Ok(())
}

/// The map at every revision. A scan is applied at the revision of its answer unless it was there before.
fn replay(history: &[Op]) -> Result<(BTreeMap<u64, State>, Summary), String> {
    let config = config();
    let mut surveyor = Surveyor::new();
    let tree = OccupancyTree::new(config.grid().depth(), config.scale());
    let mut state = State { tree, applied: BTreeSet::new() };
    let mut states = BTreeMap::from([(0, state.clone())]);
    let mut summary = Summary::default();
    let mut ever = BTreeSet::new();
    let mut by_revision: BTreeMap<u64, Vec<&Op>> = BTreeMap::new();
    for op in history.iter().filter(|op| !matches!(op.did, Did::Read { .. })) {
        by_revision.entry(op.did.revision()).or_default().push(op);
    }
    let snapshots: BTreeMap<&str, u64> = history
        .iter()
        .filter_map(|op| match &op.did {
            Did::Snapshot { name, revision } => Some((name.as_str(), *revision)),
            _ => None,
        })
        .collect();
    for (revision, ops) in by_revision {
        for op in &ops {
            let Did::Restore { name, .. } = &op.did else { continue };
            let kept = snapshots[name.as_str()];
            state = states.get(&kept).ok_or_else(|| format!("{}: of revision {kept}", told(op)))?.clone();
            summary.restores += 1;
        }
        let restored = ops.iter().any(|op| matches!(op.did, Did::Restore { .. }));
        for op in &ops {
            let Did::Insert { scans, applied, duplicates, .. } = &op.did else { continue };
            if applied + duplicates != scans.len() as u64 {
                return Err(format!("{}: the numbers do not add up", told(op)));
            }
            let new: Vec<&Scanned> = scans.iter().filter(|scan| !state.applied.contains(scan)).collect();
            if new.len() as u64 != *applied || (restored && *applied > 0) {
                return Err(format!("{}: {} of its scans were not in the map before", told(op), new.len()));
            }
            for scan in new {
                applied_to(&mut state.tree, &mut surveyor, &config, &scan_of(scan.client, scan.sequence));
                state.applied.insert(*scan);
                summary.again += u64::from(!ever.insert(*scan));
            }
            summary.applied += applied;
            summary.duplicates += duplicates;
        }
        if states.last_key_value().is_some_and(|(last, _)| revision > last + 1) {
            return Err(format!("{}: nobody made the revisions before it", told(ops[0])));
        }
        states.insert(revision, state.clone());
    }
    Ok((states, summary))
}

fn same(state: &State, classes: &[u8]) -> Result<(), String> {
    let side = 1_u32 << state.tree.depth();
    if classes.len() != (side * side) as usize {
        return Err(format!("{} leaves", classes.len()));
    }
    for (at, class) in (0..).zip(classes) {
        let leaf = NodeAddress { depth: state.tree.depth(), x: at % side, y: at / side };
        let expected = state.tree.max_class(leaf);
        if *class != expected {
            return Err(format!("leaf ({}, {}) is {class} and not {expected}", leaf.x, leaf.y));
        }
    }
    Ok(())
}

/// A small history that is right: two scans, a read of each revision, a snapshot, a restore, and the second scan again.
fn right() -> History {
    let start = Instant::now();
    let config = config();
    let scanned = |sequence| Scanned { client: 0, sequence };
    let map = |sequences: &[u64]| {
        let mut tree = OccupancyTree::new(config.grid().depth(), config.scale());
        for sequence in sequences {
            applied_to(&mut tree, &mut Surveyor::new(), &config, &scan_of(0, *sequence));
        }
        let side = 1_u32 << tree.depth();
        let leaf = |at| NodeAddress { depth: tree.depth(), x: at % side, y: at / side };
        (0..side * side).map(|at| tree.max_class(leaf(at))).collect::<Vec<u8>>()
    };
    let insert = |sequence, applied, revision| Did::Insert {
        scans: vec![scanned(sequence)],
        applied,
        duplicates: 1 - applied,
        revision,
    };
    let read = |revision, sequences: &[u64]| Did::Read { revision, classes: map(sequences) };
    let steps = vec![
        insert(1, 1, 1),
        read(1, &[1]),
        Did::Snapshot { name: "a".to_owned(), revision: 1 },
        insert(2, 1, 2),
        insert(2, 0, 2),
        read(2, &[1, 2]),
        Did::Restore { name: "a".to_owned(), revision: 3 },
        read(3, &[1]),
        insert(2, 1, 4),
        read(4, &[1, 2]),
    ];
    let at = |millis| start + std::time::Duration::from_millis(millis);
    (0..).zip(steps).map(|(step, did)| Op { client: 0, begun: at(2 * step), ended: at(2 * step + 1), did }).collect()
}

#[test]
fn a_right_history_is_taken_for_right() {
    let summary = judge(&right()).unwrap();
    assert_eq!((summary.applied, summary.duplicates, summary.again, summary.reads), (3, 1, 1, 4));
}

#[test]
fn wrong_histories_are_told() {
    /// Each change makes the right history one that no map could have had.
    type Wrong = (&'static str, fn(&mut History));
    let wrongs: [Wrong; 7] = [
        ("an acknowledged scan is missing from a later read", |history| {
            let Did::Read { classes, .. } = history[1].did.clone() else { panic!() };
            history[5].did = Did::Read { revision: 2, classes };
        }),
        ("a read goes back", |history| {
            let Did::Read { classes, .. } = history[1].did.clone() else { panic!() };
            history[5].did = Did::Read { revision: 1, classes };
        }),
        ("a read of two revisions at once", |history| {
            let Did::Read { classes: older, .. } = history[1].did.clone() else { panic!() };
            let Did::Read { classes, .. } = &mut history[5].did else { panic!() };
            let half = classes.len() / 2;
            classes[..half].copy_from_slice(&older[..half]);
        }),
        ("a duplicate was applied twice", |history| {
            let Did::Insert { applied, duplicates, .. } = &mut history[4].did else { panic!() };
            (*applied, *duplicates) = (1, 0);
        }),
        ("a scan that was taken back is called a duplicate", |history| {
            let Did::Insert { applied, duplicates, .. } = &mut history[8].did else { panic!() };
            (*applied, *duplicates) = (0, 1);
        }),
        ("a restore did nothing", |history| {
            let Did::Read { classes, .. } = history[5].did.clone() else { panic!() };
            history[7].did = Did::Read { revision: 3, classes };
        }),
        ("a revision that nobody made", |history| {
            let Did::Read { classes, .. } = history[9].did.clone() else { panic!() };
            history[9].did = Did::Read { revision: 5, classes };
        }),
    ];
    for (what, change) in wrongs {
        let mut history = right();
        change(&mut history);
        assert!(judge(&history).is_err(), "not told: {what}");
    }
}

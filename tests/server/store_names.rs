//! Names and sequence windows: the small types that a store keeps.

use proptest::prelude::*;
use std::collections::BTreeSet;
use ubbmap::store::{MapName, RobotName, SequenceVerdict, SequenceWindow, WINDOW_LENGTH};

/// The definition, with every number remembered.
#[derive(Default)]
struct Model {
    applied: BTreeSet<u64>,
}

impl Model {
    fn verdict(&self, sequence: u64) -> SequenceVerdict {
        match self.applied.last() {
            Some(highest) if highest.saturating_sub(sequence) >= WINDOW_LENGTH => SequenceVerdict::TooOld,
            _ if self.applied.contains(&sequence) => SequenceVerdict::Duplicate,
            _ => SequenceVerdict::New,
        }
    }

    fn record(&mut self, sequence: u64) -> SequenceVerdict {
        let verdict = self.verdict(sequence);
        if verdict == SequenceVerdict::New {
            self.applied.insert(sequence);
        }
        verdict
    }
}

/// Steps from the highest number: small ones both ways, about a window's length, and far.
fn steps() -> impl Strategy<Value = Vec<i64>> {
    let step = prop_oneof![
        8 => -20_i64..20,
        4 => -1100_i64..-900,
        3 => 900_i64..1200,
        1 => 1_i64..1 << 40,
        1 => Just(i64::MAX),
    ];
    prop::collection::vec(step, 0..300)
}

proptest! {
    #[test]
    fn a_window_agrees_with_remembering_all(first in prop_oneof![0_u64..3000, any::<u64>(), u64::MAX - 2000..], steps in steps()) {
        let (mut window, mut model) = (SequenceWindow::default(), Model::default());
        let mut highest = first;
        for step in std::iter::once(0).chain(steps) {
            let sequence = highest.saturating_add_signed(step);
            prop_assert_eq!(window.verdict(sequence), model.verdict(sequence));
            prop_assert_eq!(window.record(sequence), model.record(sequence), "{}", sequence);
            highest = window.highest().unwrap();
            prop_assert_eq!(Some(&highest), model.applied.last());
            prop_assert_eq!(window.count(), model.applied.len() as u64);
            for near in [0, 1, 2, 511, 512, 1022, 1023, 1024, 1025].map(|back| highest.saturating_sub(back)) {
                prop_assert_eq!(window.verdict(near), model.verdict(near), "{} below {}", near, highest);
            }
            let again = SequenceWindow::from_parts(window.highest(), *window.bits(), window.count());
            prop_assert_eq!(again.as_ref(), Some(&window));
        }
    }

    #[test]
    fn parts_that_contradict_each_other_are_no_window(highest: Option<u64>, bits: [u64; 16], count: u64) {
        if let Some(window) = SequenceWindow::from_parts(highest, bits, count) {
            let marked: u64 = bits.iter().map(|word| u64::from(word.count_ones())).sum();
            prop_assert!(marked <= count);
            prop_assert_eq!(highest.is_none(), marked == 0);
            if let Some(highest) = highest {
                prop_assert_eq!(window.verdict(highest), SequenceVerdict::Duplicate);
            }
        }
    }

    #[test]
    fn names_follow_their_patterns(text in "[a-zA-Z0-9_.\\-/ é]{0,66}") {
        let is = |first: &str, rest: &str| {
            let mut chars = text.chars();
            (1..=63).contains(&text.len())
                && chars.next().is_some_and(|c| first.contains(c))
                && chars.all(|c| rest.contains(c))
        };
        let lower = "abcdefghijklmnopqrstuvwxyz0123456789";
        let upper = "ABCDEFGHIJKLMNOPQRSTUVWXYZ";
        prop_assert_eq!(MapName::new(&text).is_ok(), is(lower, &format!("{lower}_-")));
        prop_assert_eq!(RobotName::new(&text).is_ok(), is(&format!("{lower}{upper}"), &format!("{lower}{upper}_.-")));
    }
}

#[test]
fn the_last_number_of_all_is_applied_once() {
    let mut window = SequenceWindow::default();
    assert_eq!(window.record(u64::MAX), SequenceVerdict::New);
    assert_eq!(window.record(u64::MAX), SequenceVerdict::Duplicate);
    assert_eq!(window.record(u64::MAX - 1023), SequenceVerdict::New);
    assert_eq!(window.record(u64::MAX - 1024), SequenceVerdict::TooOld);
    assert_eq!(window.record(0), SequenceVerdict::TooOld);
}

#[test]
fn a_jump_ahead_forgets_exactly_what_falls_out() {
    let mut window = SequenceWindow::default();
    for sequence in 0..1024 {
        window.record(sequence);
    }
    assert_eq!(window.record(1500), SequenceVerdict::New);
    for sequence in 0..=1500 {
        let expected = match sequence {
            0..=476 => SequenceVerdict::TooOld,
            477..=1023 | 1500 => SequenceVerdict::Duplicate,
            _ => SequenceVerdict::New,
        };
        assert_eq!(window.verdict(sequence), expected, "{sequence}");
    }
}

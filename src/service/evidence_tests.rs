//! A panic of the engine is one scan's, and the thread's next scan finds a surveyor as good as new.

use super::ScanInput;
use super::evidence::{counted_as, input_bytes, shielded, with_surveyor};
use crate::sensor::Angles;

#[test]
fn a_panic_is_caught_and_the_thread_goes_on() {
    let panics = || with_surveyor(|_| -> u32 { std::panic::resume_unwind(Box::new("planted")) });
    assert_eq!(shielded(panics), None);
    assert_eq!(shielded(|| with_surveyor(|_| 7)), Some(7));
}

#[test]
fn a_robot_s_name_that_is_none_was_kept_as_it_came() {
    let scan = |robot: String| ScanInput {
        robot,
        sequence: None,
        stamp: 0.0,
        sensor: String::new(),
        pose: None,
        angles: Angles::Uniform { min: 0.0, increment: 0.01 },
        ranges: vec![1.0; 2],
        footprint_radius: 0.0,
        sweep_rotation: 0.0,
        sweep_translation: 0.0,
    };
    assert_eq!(counted_as(&[scan("amr-7".to_owned()), scan("b".to_owned())]), "amr-7");
    assert_eq!(counted_as(&[scan("a".repeat(1 << 20))]), "");
    assert_eq!(counted_as(&[]), "");
    assert!(input_bytes(&[scan("a".repeat(1 << 20))]) > 1 << 20);
}

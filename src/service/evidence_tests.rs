//! A panic of the engine is one scan's, and the thread's next scan finds a surveyor as good as new.

use super::evidence::{shielded, with_surveyor};

#[test]
fn a_panic_is_caught_and_the_thread_goes_on() {
    let panics = || with_surveyor(|_| -> u32 { std::panic::resume_unwind(Box::new("planted")) });
    assert_eq!(shielded(panics), None);
    assert_eq!(shielded(|| with_surveyor(|_| 7)), Some(7));
}

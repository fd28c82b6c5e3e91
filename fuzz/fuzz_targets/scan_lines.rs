//! Scans as JSON lines: an error names a line that is there.
#![no_main]

use libfuzzer_sys::fuzz_target;
use ubbmap::wire::{self, Batch};

fuzz_target!(|bytes: &[u8]| {
    let lines = bytes.split(|byte| *byte == b'\n').count();
    match wire::scan_lines(bytes, 64) {
        Ok(scans) => {
            assert!(scans.len() <= 64);
            drop(Batch::new(scans).take_scans());
        }
        Err(error) => {
            let named = error.detail.strip_prefix("line ").and_then(|rest| rest.split(':').next());
            if let Some(number) = named.and_then(|number| number.parse::<usize>().ok()) {
                assert!((1..=lines).contains(&number), "{}", error.detail);
            }
        }
    }
});

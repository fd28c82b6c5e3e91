//! Contents of the store's records behind frames that are right: each is refused, or is written again as it was.
#![no_main]

use libfuzzer_sys::fuzz_target;

fuzz_target!(|bytes: &[u8]| {
    if let Some((kind, content)) = bytes.split_first() {
        ubbmap::store::fuzzing::record(*kind, content);
    }
});

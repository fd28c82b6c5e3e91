//! ROS 2 bags: the first byte chooses the form, MCAP or SQLite, the rest is the file.
#![no_main]

use libfuzzer_sys::fuzz_target;
use ubbmap::logs::LogReader;
use ubbmap_fuzz::{limits, read_to_end};

fuzz_target!(|bytes: &[u8]| {
    let Some((form, bytes)) = bytes.split_first() else { return };
    let ending = if form % 4 == 0 { "db3" } else { "mcap" };
    let path = std::env::temp_dir().join(format!("ubbmap-fuzz-{}.{ending}", std::process::id()));
    std::fs::write(&path, bytes).expect("the folder of temporary files can be written");
    match LogReader::open(&path, limits()) {
        Ok(reader) => read_to_end(reader),
        Err(error) => assert!(!error.to_string().is_empty()),
    }
});

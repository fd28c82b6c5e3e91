//! Laser logs, CARMEN and JSON lines, plain and gzip: an error ends the iteration and names a line.
#![no_main]

use libfuzzer_sys::fuzz_target;
use std::io::Cursor;
use ubbmap::logs::LogReader;
use ubbmap::sensor::ScanLimits;

fuzz_target!(|bytes: &[u8]| {
    let mut reader = LogReader::new(Cursor::new(bytes.to_vec()), ScanLimits { max_beams: 4096 });
    let mut failed = false;
    for scan in reader.by_ref() {
        assert!(!failed, "a scan behind an error");
        match scan {
            Ok(scan) => assert!(scan.ranges.len() <= 4096),
            Err(error) => {
                failed = true;
                assert!(!error.to_string().is_empty());
            }
        }
    }
});

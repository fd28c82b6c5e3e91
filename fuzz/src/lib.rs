//! What several targets do.

use ubbmap::logs::LogReader;
use ubbmap::sensor::ScanLimits;

/// Most beams of a scan.
const BEAMS: usize = 4096;

/// The limits that logs are read with.
pub fn limits() -> ScanLimits {
    ScanLimits { max_beams: BEAMS }
}

/// Reads a log to its end: scans keep to the limit, and nothing comes behind an error, which says why.
pub fn read_to_end(reader: LogReader) {
    let mut failed = false;
    for scan in reader {
        assert!(!failed, "a scan behind an error");
        match scan {
            Ok(scan) => assert!(scan.ranges.len() <= BEAMS),
            Err(error) => {
                failed = true;
                assert!(!error.to_string().is_empty());
            }
        }
    }
}

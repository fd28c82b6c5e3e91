//! ROS 2 bags: the first byte chooses the form, MCAP or SQLite, the rest is the file. An error ends the reading and says why.
#![no_main]

use libfuzzer_sys::fuzz_target;
use std::path::PathBuf;
use ubbmap::logs::LogReader;
use ubbmap::sensor::ScanLimits;

fn path(ending: &str) -> PathBuf {
    std::env::temp_dir().join(format!("ubbmap-fuzz-{}.{ending}", std::process::id()))
}

fuzz_target!(|bytes: &[u8]| {
    let Some((form, bytes)) = bytes.split_first() else { return };
    let path = path(if form % 4 == 0 { "db3" } else { "mcap" });
    std::fs::write(&path, bytes).expect("the folder of temporary files can be written");
    let mut failed = false;
    match LogReader::open(&path, ScanLimits { max_beams: 4096 }) {
        Ok(reader) => {
            for scan in reader {
                assert!(!failed, "a scan behind an error");
                match scan {
                    Ok(scan) => assert!(scan.ranges.len() <= 4096),
                    Err(error) => {
                        failed = true;
                        assert!(!error.to_string().is_empty());
                    }
                }
            }
        }
        Err(error) => assert!(!error.to_string().is_empty()),
    }
});

//! Log readers on the real logs: the CARMEN log and the JSON lines of one recording give the same scans.

#![allow(clippy::unwrap_used, clippy::panic, clippy::print_stderr, reason = "tests")]

use std::path::{Path, PathBuf};
use ubbmap::logs::{LogReader, LogScan, LogSensor};
use ubbmap::sensor::ScanLimits;

/// The folder of the real logs: `$UBBMAP_DATA`, else `../shared/data` beside the repository; says so when it is missing.
pub fn data() -> Option<PathBuf> {
    let folder = std::env::var_os("UBBMAP_DATA")
        .map_or_else(|| Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared/data"), PathBuf::from);
    if folder.join("fr079").is_dir() {
        return Some(folder);
    }
    eprintln!("SKIPPED: no real logs in {} (set UBBMAP_DATA)", folder.display());
    None
}

fn is_gzip(path: &Path) -> bool {
    std::fs::read(path).is_ok_and(|bytes| bytes.starts_with(&[0x1f, 0x8b]))
}

fn read(path: &Path) -> (LogSensor, Vec<LogScan>) {
    let reader = LogReader::open(path, ScanLimits::default()).unwrap();
    (*reader.sensor(), reader.map(Result::unwrap).collect())
}

#[test]
fn both_readers_give_the_same_scans() {
    let Some(data) = data() else { return };
    for (name, carmen, scans, beams) in [
        ("fr079", "freiburg-079-corrected.log.gz", 4791, 360),
        ("intel", "intel-corrected.log.gz", 910, 180),
        ("mit-csail", "csail-corrected.log.gz", 406, 361),
        ("aces3", "aces-corrected.log.gz", 440, 180),
    ] {
        let json = data.join(name).join(format!("{name}.jsonl.gz"));
        if !is_gzip(&json) {
            eprintln!("SKIPPED: {} is no gzip file", json.display());
            continue;
        }
        let (json_sensor, json) = read(&json);
        let (carmen_sensor, carmen) = read(&data.join(name).join(carmen));
        assert_eq!((json.len(), carmen.len()), (scans, scans), "{name}");
        let limits = (json_sensor.range_max.unwrap() as f32, carmen_sensor.range_max.unwrap() as f32);
        for (a, b) in json.iter().zip(&carmen) {
            assert_eq!(a.ranges.len(), beams, "{name}");
            let at = (name, a.line, b.line);
            assert_eq!((&a.pose, &a.angles, &a.ranges), (&b.pose, &b.angles, &b.ranges), "{at:?}");
            // The largest range differs, and what is a return does not.
            assert!(a.ranges.iter().all(|range| (*range >= limits.0) == (*range >= limits.1)), "{at:?}");
            // CARMEN writes 6 digits: a Unix time is worth nothing there.
            assert!(name == "mit-csail" || a.stamp == b.stamp, "{at:?}");
        }
    }
}

//! Keys and parameters of Zenoh queries, and the names in them.
#![no_main]

use libfuzzer_sys::fuzz_target;
use ubbmap::store::{MapName, RobotName, SnapshotName};
use ubbmap::transport::parameters::Parameters;
use ubbmap::transport::zenoh::keys::{self, Target};

fuzz_target!(|text: &str| {
    let (key, parameters) = text.split_once('?').unwrap_or((text, ""));
    for prefix in ["ubbmap", "site/a"] {
        if let Some(Ok(Target::Map(map) | Target::Operation(map, _))) = keys::target(prefix, key) {
            assert!(key.contains(map.as_str()));
            assert!(MapName::new(map.as_str()).is_ok());
        }
        if let Some((map, robot)) = keys::scans(prefix, key) {
            assert!(!map.contains('/') && !robot.contains('/'));
        }
    }
    let _ = (RobotName::new(key), SnapshotName::new(key));
    let pairs = parameters
        .split(';')
        .map(|pair| pair.split_once('=').unwrap_or((pair, "")))
        .map(|(name, value)| (name.to_owned(), value.to_owned()))
        .collect();
    let known = ["min_x", "min_y", "max_x", "max_y", "depth", "since", "format"];
    if let Ok(parameters) = Parameters::new(pairs, &known) {
        let _ = (parameters.box_query(), parameters.number::<u64>("since", "a revision"), parameters.flag("format"));
    }
});

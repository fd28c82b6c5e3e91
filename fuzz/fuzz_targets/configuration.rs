//! Settings from a file, the environment and flags: refused with a reason, or ones that hold together.
#![no_main]

use libfuzzer_sys::fuzz_target;
use std::io::Write;
use ubbmap::config::Config;

fuzz_target!(|text: &str| {
    // What stands before the mark is the file; lines behind it are variables of the environment.
    let (file, environment) = text.split_once('\0').unwrap_or((text, ""));
    let path = std::env::temp_dir().join(format!("ubbmap-fuzz-{}.toml", std::process::id()));
    let mut out = std::fs::File::create(&path).expect("the folder of temporary files can be written");
    out.write_all(file.as_bytes()).expect("the folder of temporary files can be written");
    let environment: Vec<(String, String)> = environment
        .lines()
        .filter_map(|line| line.split_once('='))
        .map(|(name, value)| (format!("UBBMAP_{name}"), value.to_owned()))
        .collect();
    match Config::load(Some(&path), environment, &[]) {
        Ok(config) => {
            config.check().expect("settings that were loaded hold");
            let _ = (config.service_settings(), config.rewrite_options(), config.grace());
        }
        Err(error) => assert!(!error.to_string().is_empty()),
    }
});

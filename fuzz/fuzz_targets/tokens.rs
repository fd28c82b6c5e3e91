//! Files of tokens: refused with a reason that shows no token, or taken.
#![no_main]

use libfuzzer_sys::fuzz_target;
use ubbmap::transport::access::Access;

fuzz_target!(|text: &str| {
    let path = std::env::temp_dir().join(format!("ubbmap-fuzz-{}.tokens", std::process::id()));
    std::fs::write(&path, text).expect("the folder of temporary files can be written");
    match Access::from_file(&path) {
        Ok(access) => assert!(!access.is_insecure()),
        Err(error) => assert!(!error.to_string().is_empty()),
    }
});

//! Laser logs, CARMEN and JSON lines, plain and gzip.
#![no_main]

use libfuzzer_sys::fuzz_target;
use std::io::Cursor;
use ubbmap::logs::LogReader;
use ubbmap_fuzz::{limits, read_to_end};

fuzz_target!(|bytes: &[u8]| read_to_end(LogReader::new(Cursor::new(bytes.to_vec()), limits())));

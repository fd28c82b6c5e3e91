//! Numbers of JSON are read as the doubles nearest to them: a bound that a client rounded outward stays where it is.

#![allow(clippy::unwrap_used, reason = "tests")]

use proptest::prelude::*;
use std::io::Cursor;
use ubbmap::logs::{LogPose, LogReader};
use ubbmap::sensor::ScanLimits;
use ubbmap::wire::{self, Encoding};

fn of_a_request(text: &str) -> f64 {
    let request = format!(r#"{{"points":[{{"x":{text},"y":0}}]}}"#);
    wire::classes_request(request.as_bytes(), Encoding::Json, 1).unwrap().points[0].x.unwrap()
}

fn of_a_log(text: &str) -> f64 {
    let log = format!(
        "{{\"beams\":1,\"angle_min\":0,\"angle_increment\":1}}\n{{\"t\":0,\"x\":{text},\"y\":0,\"theta\":0,\"ranges\":[1]}}\n"
    );
    let scan = LogReader::new(Cursor::new(log.into_bytes()), ScanLimits::default()).next().unwrap().unwrap();
    let LogPose::Point { x, .. } = scan.pose else { unreachable!("the log has a point") };
    x
}

#[track_caller]
fn is_read(text: &str) {
    let nearest: f64 = text.parse().unwrap();
    assert_eq!(of_a_request(text).to_bits(), nearest.to_bits(), "{text} in a request");
    assert_eq!(of_a_log(text).to_bits(), nearest.to_bits(), "{text} in a log");
}

#[test]
fn a_decimal_is_not_read_as_a_double_near_by() {
    // Found by fuzzing: what was written was read as the next double but one.
    is_read("15555.555555555555");
    is_read(&format!("15555.{}", "5".repeat(90)));
    is_read("9007199254740993");
    is_read("1e-320");
}

proptest! {
    #[test]
    fn every_double_is_read_as_it_was_written(bits in any::<u64>(), near in -200.0..200.0_f64) {
        for value in [f64::from_bits(bits), near] {
            if value.is_finite() {
                is_read(&format!("{value:?}"));
                is_read(&format!("{value:e}"));
                is_read(&format!("{value:.40e}"));
            }
        }
    }
}

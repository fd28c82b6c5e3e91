//! Log readers on small made-up logs: both formats, and every kind of damage.

#![allow(clippy::unwrap_used, clippy::panic, clippy::print_stderr, reason = "tests")]

use flate2::Compression;
use flate2::write::GzEncoder;
use std::io::{Cursor, Write};
use ubbmap::logs::{LogError, LogPose, LogReader, LogScan, MAX_LINE_BYTES, PoseError};
use ubbmap::sensor::{Angles, ScanLimits};

const HEADER: &str =
    r#"{"beams": 3, "angle_min": -1.5, "angle_increment": 0.5, "range_max": 30.0, "pose": "corrected"}"#;

fn json_log(scans: usize) -> String {
    let scan = |i: usize| format!(r#"{{"t":{i}.5,"x":1.0,"y":2.0,"theta":0.1,"ranges":[1.25,{i},30.0]}}"#);
    std::iter::once(HEADER.to_owned()).chain((0..scans).map(scan)).map(|line| line + "\n").collect()
}

fn gzip(bytes: &[u8]) -> Vec<u8> {
    let mut encoder = GzEncoder::new(Vec::new(), Compression::fast());
    encoder.write_all(bytes).unwrap();
    encoder.finish().unwrap()
}

fn reader(bytes: impl Into<Vec<u8>>) -> LogReader {
    LogReader::new(Cursor::new(bytes.into()), ScanLimits { max_beams: 1000 })
}

/// The scans, and the damage that ended the log.
fn read(bytes: impl Into<Vec<u8>>) -> (Vec<LogScan>, Option<LogError>) {
    let mut scans = Vec::new();
    let mut reader = reader(bytes);
    while let Some(item) = reader.next() {
        match item {
            Ok(scan) => scans.push(scan),
            Err(error) => {
                assert!(reader.next().is_none(), "the iteration goes on after {error}");
                return (scans, Some(error));
            }
        }
    }
    (scans, None)
}

fn problem(bytes: impl Into<Vec<u8>>) -> (usize, u64, String) {
    let (scans, error) = read(bytes);
    let error = error.expect("damage is reported");
    (scans.len(), error.line(), error.to_string())
}

#[test]
fn json_lines_are_read_plain_and_compressed() {
    let log = json_log(4);
    let (plain, error) = read(log.as_bytes());
    assert!(error.is_none());
    assert_eq!(plain.len(), 4);
    assert_eq!(plain[2].line, 4);
    assert_eq!(plain[2].stamp, 2.5);
    assert_eq!(plain[2].ranges, [1.25, 2.0, 30.0]);
    assert_eq!(plain[2].angles, Angles::Uniform { min: -1.5, increment: 0.5 });
    assert_eq!(plain[2].pose, LogPose::Point { x: 1.0, y: 2.0, theta: 0.1 });
    assert_eq!(reader(log.as_bytes()).sensor().range_max, Some(30.0));
    let (compressed, error) = read(gzip(log.as_bytes()));
    assert!(error.is_none());
    assert_eq!(plain, compressed);
}

#[test]
fn several_gzip_members_are_one_log() {
    let log = json_log(6);
    let (head, tail) = log.split_at(log.len() / 2);
    let mut bytes = gzip(head.as_bytes());
    bytes.extend(gzip(tail.as_bytes()));
    assert_eq!(read(bytes).0, read(log).0);
}

#[test]
fn a_json_scan_may_say_all_by_itself() {
    let log =
        r#"{"stamp": 7, "pose": {"x": {"min": 1, "max": 2}, "y": {"min": 3, "max": 4}, "theta": {"min": -5, "max": 5}},
"ranges": [null, "NaN", "Infinity", 1e-3, -2], "angles": [0, 0.1, 0.3, 0.2, 0.5],
"footprint_radius": 0.3, "sweep_rotation": 0.25, "sweep_translation": 0.125}"#
            .replace('\n', " ");
    let (scans, error) = read(log);
    assert!(error.is_none(), "{error:?}");
    let scan = &scans[0];
    assert_eq!(scan.pose, LogPose::Box { x: (1.0, 2.0), y: (3.0, 4.0), theta: (-5.0, 5.0) });
    assert_eq!(scan.pose.bounds(&PoseError { position: 1.0, heading: 1.0 }).0, (1.0, 2.0), "the log's own box counts");
    assert!(scan.ranges[0].is_nan() && scan.ranges[1].is_nan() && scan.ranges[2] == f32::INFINITY);
    assert_eq!(scan.angles, Angles::Listed(vec![0.0, 0.1, 0.3, 0.2, 0.5]));
    assert_eq!(
        (scan.stamp, scan.footprint_radius, scan.sweep_rotation, scan.sweep_translation),
        (7.0, Some(0.3), 0.25, 0.125)
    );
}

#[test]
fn a_header_describes_the_sensor() {
    let log = r#"{"range_min":0.1,"range_max":8,"range_error":{"minus":0.02,"plus":0.03},"beam_opening":0.01,"beam_diameter":0.005,"no_return_free_to":7.5,"beam_angle_error":0.001,"footprint_radius":0.2,"angle_min":0,"angle_increment":1}
{"x":0,"y":0,"theta":0,"ranges":[1]}"#;
    let reader = reader(log);
    let sensor = *reader.sensor();
    assert_eq!((sensor.range_min, sensor.range_max, sensor.range_error), (Some(0.1), Some(8.0), Some((0.02, 0.03))));
    assert_eq!((sensor.beam_opening, sensor.beam_diameter), (Some(0.01), Some(0.005)));
    assert_eq!((sensor.no_return_free_to, sensor.beam_angle_error), (Some(7.5), Some(0.001)));
    assert_eq!(reader.map(Result::unwrap).next().unwrap().footprint_radius, Some(0.2));
}

fn flaser(ranges: usize) -> String {
    let ranges: Vec<String> = (0..ranges).map(|i| format!("{}.5", i % 7)).collect();
    format!("FLASER {} {} 1.5 -2.5 0.25 1 2 3 17.25 host 17.5\n", ranges.len(), ranges.join(" "))
}

#[test]
fn flaser_takes_the_lasers_pose_and_the_half_circle() {
    use std::f64::consts::{FRAC_PI_2, PI};
    for (beams, steps) in [(180, 180.0), (181, 180.0), (360, 360.0), (361, 360.0), (1, 1.0), (2, 2.0)] {
        let (scans, error) = read(format!("# a comment\nPARAM x y 1 h 1\n{}\nODOM 1 2 3\n", flaser(beams)));
        assert!(error.is_none(), "{error:?}");
        assert_eq!(scans.len(), 1);
        assert_eq!((scans[0].line, scans[0].stamp), (3, 17.25));
        assert_eq!(scans[0].pose, LogPose::Point { x: 1.5, y: -2.5, theta: 0.25 });
        assert_eq!(scans[0].angles, Angles::Uniform { min: -FRAC_PI_2, increment: PI / steps });
        assert_eq!(scans[0].ranges.len(), beams);
    }
}

#[test]
fn the_scans_of_a_pose_graph_are_read_and_its_vertices_and_edges_passed_over() {
    let graph = format!(
        "#SEQUENTIAL\nVERTEX_SE2 0 1.0 2.0 0.5\n{ROBOTLASER}EDGE_SE2 0 1 0.5 0 0 500 0 0 500 0 5000\nVERTEX_SE2 1 1.0 2.0 0.5\n{ROBOTLASER}"
    );
    let (scans, error) = read(graph.as_bytes());
    assert!(error.is_none(), "{error:?}");
    assert_eq!(scans.iter().map(|scan| scan.line).collect::<Vec<_>>(), [3, 6]);
    assert_eq!(scans[0].pose, LogPose::Point { x: 1.0, y: 2.0, theta: 0.5 });
}

const ROBOTLASER: &str = "ROBOTLASER1 0 -1.2 2.4 0.8 20.0 0.01 0 4 1.0 20.0 3.5 25 2 100 200 1 2 0.5 9 9 9 0.1 0.2 0.3 0.4 1000 12.5 host 0.1\n";

#[test]
fn robotlaser1_tells_its_angles_and_its_largest_range() {
    let mut log = ROBOTLASER.to_owned();
    log.push_str(&flaser(5));
    log.push_str(&ROBOTLASER.replace(" 2 100 200 ", " 0 "));
    let (scans, error) = read(log.as_bytes());
    assert!(error.is_none(), "{error:?}");
    assert_eq!(scans.len(), 2, "FLASER beside ROBOTLASER1 tells of the same scans");
    assert_eq!(scans[0].pose, LogPose::Point { x: 1.0, y: 2.0, theta: 0.5 });
    assert_eq!(scans[0].angles, Angles::Uniform { min: -1.2, increment: 0.8 });
    assert_eq!(scans[0].ranges, [1.0, f32::INFINITY, 3.5, f32::INFINITY]);
    assert_eq!(scans[0].stamp, 12.5);
    assert_eq!(scans[0].ranges, scans[1].ranges);
    assert_eq!(reader(log.as_bytes()).sensor().range_max, Some(20.0));
}

#[test]
fn damage_is_named_with_its_line() {
    let good = json_log(3);
    let cases: [(String, usize, u64, &str); 16] = [
        (format!("{good}{{\"t\":1,\"x\":0,"), 3, 5, "EOF"),
        (format!("{good}not json\n"), 3, 5, "at column 2"),
        (format!("{good}{{\"x\":1,\"y\":1,\"theta\":1,\"ranges\":[1,2]}}"), 3, 5, "has 2 ranges, the header says 3"),
        (format!("{good}{{\"x\":1,\"y\":1,\"theta\":1,\"ranges\":[]}}"), 3, 5, "ranges is empty"),
        (format!("{good}{{\"x\":1,\"y\":1,\"theta\":1}}"), 3, 5, "has no ranges"),
        (format!("{good}{{\"x\":1,\"y\":1,\"ranges\":[1,2,3]}}"), 3, 5, "has no pose"),
        (format!("{good}{{\"x\":1,\"y\":1,\"theta\":1,\"ranges\":[1,\"far\",3]}}"), 3, 5, "far"),
        (
            format!("{good}{{\"x\":1,\"y\":1,\"theta\":1,\"angles\":[1],\"ranges\":[1,2,3]}}"),
            3,
            5,
            "1 angles and 3 ranges",
        ),
        ("{}\n{\"x\":1,\"y\":1,\"theta\":1,\"ranges\":[1]}".to_owned(), 0, 2, "angle_min"),
        ("hello world\n".to_owned(), 0, 1, "no CARMEN message"),
        (flaser(180) + "FLASER 180 1.0 2.0\n", 1, 2, "has 4 fields, a FLASER of 180 ranges has 191"),
        (flaser(180) + "FLASER many 1.0 2.0\n", 1, 2, "\"many\""),
        (flaser(3).replace("1.5 -2.5", "nan -2.5"), 0, 1, "finite"),
        (flaser(3).replace(" 0.5 ", " 0.x5 "), 0, 1, "a range, is \"0.x5\""),
        (flaser(1001), 0, 1, "the limit is 1000"),
        (ROBOTLASER.replace(" 2 100 200 ", " 2 100 "), 0, 1, "has 29 fields"),
    ];
    for (log, scans, line, words) in cases {
        for bytes in [log.clone().into_bytes(), gzip(log.as_bytes())] {
            let found = problem(bytes);
            assert_eq!((found.0, found.1), (scans, line), "{}", found.2);
            assert!(found.2.contains(words), "{:?} does not say {words:?}", found.2);
        }
    }
}

#[test]
fn a_truncated_gzip_yields_what_was_whole() {
    let log = json_log(2000);
    let whole = gzip(log.as_bytes());
    let all = read(log).0;
    for cut in [whole.len() - 1, whole.len() - 9, whole.len() / 2, 40, 11, 3] {
        let (scans, error) = read(&whole[..cut]);
        let error = error.expect("a cut is damage");
        assert!(matches!(error, LogError::Truncated { .. }), "{cut}: {error}");
        assert_eq!(scans[..], all[..scans.len()], "{cut}");
        let lines = if error.line() == 0 { 0 } else { error.line() - 1 };
        assert_eq!(lines, scans.len() as u64, "{cut}: the error names the last whole line");
    }
}

#[test]
fn a_gzip_with_a_flipped_bit_is_damage() {
    let mut bytes = gzip(json_log(2000).as_bytes());
    let crc = bytes.len() - 6;
    bytes[crc] ^= 1;
    let (scans, error) = read(bytes);
    assert_eq!(scans.len(), 2000);
    assert!(matches!(error, Some(LogError::Read { line: 2001, .. })), "{error:?}");
}

#[test]
fn lines_are_limited_and_text() {
    let long = vec![b'{'; MAX_LINE_BYTES + 10];
    assert!(problem(long).2.contains("is longer than"));
    assert!(problem(b"FLASER \xff\xfe".to_vec()).2.contains("byte 8 is not UTF-8"));
    assert_eq!(read("").0.len(), 0);
    assert_eq!(read(gzip(b"\n\n")).0.len(), 0);
}

#[test]
fn pose_errors_are_parsed_strictly() {
    let good: [(&str, f64, f64); 5] = [
        ("0.02,0.5deg", 0.02, 0.5_f64.to_radians()),
        ("0, 0rad", 0.0, 0.0),
        ("1e-2,0.01rad", 0.01, 0.01),
        (" 0.1 , 3 deg", 0.1, 3.0_f64.to_radians()),
        ("2,180deg", 2.0, std::f64::consts::PI),
    ];
    for (text, position, heading) in good {
        assert_eq!(text.parse(), Ok(PoseError { position, heading }), "{text}");
    }
    for (text, words) in [
        ("0.02", "two values"),
        ("0.02,0.5", "no unit"),
        ("0.02,deg", "not a number"),
        ("a,0.5deg", "the position \"a\""),
        ("-0.1,0.5deg", "not negative"),
        ("0.1,infdeg", "finite"),
        ("nan,1deg", "finite"),
        ("1,2,3deg", "\"2,3\""),
        ("", "two values"),
    ] {
        let error = text.parse::<PoseError>().unwrap_err().to_string();
        assert!(error.contains(words) && error.contains("0.02,0.5deg"), "{text}: {error}");
    }
    let pose = LogPose::Point { x: 1.0, y: 2.0, theta: 3.0 };
    let (x, y, theta) = pose.bounds(&PoseError { position: 0.1, heading: 0.2 });
    assert!(x.0 < 0.9 && x.1 > 1.1 && y.0 < 1.9 && y.1 > 2.1 && theta.0 < 2.8 && theta.1 > 3.2, "rounded outward");
    assert!(x.1 - x.0 < 0.2 + 1e-12);
    assert_eq!(pose.bounds(&PoseError::default()), ((1.0, 1.0), (2.0, 2.0), (3.0, 3.0)));
}

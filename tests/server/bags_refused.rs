//! ROS 2 bags that leave a choice, lack something, or are damaged: a clear error, never a panic.

#![allow(clippy::unwrap_used, clippy::panic, reason = "tests")]

use super::bag_support::{Bag, Cdr, IMAGE, ODOMETRY, POSE, Packed, SCAN, Scan, TF, covariance, flat, pose, transforms};
use super::cli_support::run;
use proptest::prelude::*;
use std::path::{Path, PathBuf};
use ubbmap::logs::{BagOptions, LogReader};
use ubbmap::sensor::ScanLimits;

fn scan(stamp: f64, frame: &'static str) -> Vec<u8> {
    let ranges = vec![1.0, 2.0, f32::NAN, f32::INFINITY];
    let scan = Scan { stamp, frame, angle_min: 0.0, angle_increment: 0.1, time_increment: 0.0, range_max: 9.0, ranges };
    scan.message(true)
}

/// Ten scans, each with its transform.
fn plain() -> Bag {
    let mut bag = Bag::default();
    for step in 0..10 {
        let stamp = f64::from(step);
        bag.put("/tf", TF, transforms(stamp, &[("map", "base_link", flat(stamp, 0.0, 0.0))]));
        bag.put("/scan", SCAN, scan(stamp, "base_link"));
        bag.put("/camera", IMAGE, vec![1; 300]);
    }
    bag
}

fn write(folder: &Path, bag: &Bag) -> PathBuf {
    let path = folder.join("bag.mcap");
    std::fs::write(&path, bag.mcap(Packed::Zstd)).unwrap();
    path
}

/// The scans that can be read and what ends them; an error at the opening is one without scans.
fn read(path: &Path, options: &BagOptions) -> (usize, Option<String>) {
    match LogReader::open_with(path, ScanLimits::default(), options) {
        Err(error) => (0, Some(error.to_string())),
        Ok(mut reader) => {
            let mut scans = 0;
            loop {
                match reader.next() {
                    Some(Ok(_)) => scans += 1,
                    Some(Err(error)) => {
                        assert!(reader.next().is_none(), "the iteration goes on after {error}");
                        return (scans, Some(error.to_string()));
                    }
                    None => return (scans, None),
                }
            }
        }
    }
}

#[track_caller]
fn says(bag: &Bag, options: &BagOptions, words: &[&str]) {
    let folder = tempfile::tempdir().unwrap();
    let (scans, error) = read(&write(folder.path(), bag), options);
    let error = error.unwrap();
    assert_eq!(scans, 0, "{error}");
    for word in words {
        assert!(error.contains(word), "{word:?} is not in {error}");
    }
}

fn named(set: impl FnOnce(&mut BagOptions)) -> BagOptions {
    let mut options = BagOptions::default();
    set(&mut options);
    options
}

#[test]
fn what_leaves_a_choice_or_lacks_something_is_told_with_what_there_is() {
    let usual = BagOptions::default();
    let mut two = plain();
    two.put("/rear", SCAN, scan(1.0, "base_link"));
    says(&two, &usual, &["has 2 topics of scans", "--scan-topic", "/rear (sensor_msgs/msg/LaserScan), /scan"]);
    let folder = tempfile::tempdir().unwrap();
    assert_eq!(read(&write(folder.path(), &two), &named(|o| o.scan_topic = Some("/rear".to_owned()))), (1, None));
    says(
        &plain(),
        &named(|o| o.scan_topic = Some("/scn".to_owned())),
        &["has no topic /scn (--scan-topic)", "/camera (sensor_msgs/msg/Image)"],
    );
    says(
        &plain(),
        &named(|o| o.scan_topic = Some("/tf".to_owned())),
        &["/tf is of type tf2_msgs/msg/TFMessage, not sensor_msgs"],
    );
    let mut none = plain();
    none.messages.retain(|(topic, ..)| topic != "/scan");
    says(&none, &usual, &["has no topic of sensor_msgs/msg/LaserScan", "/tf (tf2_msgs/msg/TFMessage)"]);
    says(&Bag::default(), &usual, &["the bag has no topics"]);

    let fixed = |frame: &str| named(|o| o.fixed_frame = Some(frame.to_owned()));
    says(&plain(), &fixed("world"), &["has no frame \"world\" (--fixed-frame)", "base_link, map"]);
    let mut apart = plain();
    apart.put("/tf", TF, transforms(0.0, &[("odom", "wheel", flat(0.0, 0.0, 0.0))]));
    says(
        &apart,
        &fixed("odom"),
        &["no transforms lead from \"odom\" to \"base_link\"", "hangs on \"odom\", \"base_link\" on \"map\""],
    );
    let mut still = plain();
    still.messages.retain(|(topic, ..)| topic != "/tf");
    says(&still, &usual, &["has no transforms", "/scan (sensor_msgs/msg/LaserScan)"]);
    still.put("/tf_static", TF, transforms(0.0, &[("map", "base_link", flat(0.0, 0.0, 0.0))]));
    says(&still, &usual, &["nothing moves between \"map\" and \"base_link\""]);
    assert_eq!(
        read(&write(folder.path(), &still), &fixed("map")),
        (10, None),
        "a laser that stands, by its frame's name"
    );
}

#[test]
fn topics_of_poses_that_leave_a_choice_are_told() {
    let usual = BagOptions::default();
    let folder = tempfile::tempdir().unwrap();
    let mut still = plain();
    still.messages.retain(|(topic, ..)| topic != "/tf");
    still.put("/tf_static", TF, transforms(0.0, &[("map", "base_link", flat(0.0, 0.0, 0.0))]));
    let odometry = |child: &str| {
        let mut bag = still.clone();
        for step in 0..10 {
            let place = flat(f64::from(step), 0.0, 0.0);
            bag.put(
                "/odom",
                ODOMETRY,
                pose(f64::from(step), "odom", Some(child), &place, &covariance(1e-4, 1e-4, 1e-4)),
            );
        }
        bag
    };
    assert_eq!(read(&write(folder.path(), &odometry("base_link")), &usual), (10, None));
    says(
        &odometry("body"),
        &usual,
        &["from \"body\" to \"base_link\"", "Record /tf_static, or name the robot's frame by --base-frame"],
    );
    let based = named(|o| o.base_frame = Some("base_link".to_owned()));
    assert_eq!(read(&write(folder.path(), &odometry("body")), &based), (10, None));
    let other = named(|o| {
        o.pose_topic = Some("/odom".to_owned());
        o.fixed_frame = Some("world".to_owned());
    });
    says(
        &odometry("base_link"),
        &other,
        &["the poses of /odom stand in the frame \"odom\", not \"world\" (--fixed-frame)"],
    );
    let on = |topic: &str| named(|o| o.pose_topic = Some(topic.to_owned()));
    says(&odometry("base_link"), &on("/odm"), &["has no topic /odm (--pose-topic)", "/odom (nav_msgs/msg/Odometry)"]);
    says(&odometry("base_link"), &on("/camera"), &["/camera is of type sensor_msgs/msg/Image: poses are"]);
    let mut both = odometry("base_link");
    both.put(
        "/odom2",
        ODOMETRY,
        pose(0.0, "odom", Some("base_link"), &flat(0.0, 0.0, 0.0), &covariance(1e-4, 1e-4, 1e-4)),
    );
    says(&both, &usual, &["by --pose-topic: /odom (nav_msgs/msg/Odometry), /odom2"]);
    let mut nameless = Bag::default();
    nameless.put("/pose", POSE, pose(1.0, "map", None, &flat(0.0, 0.0, 0.0), &covariance(1e-4, 1e-4, 1e-4)));
    nameless.put("/scan", SCAN, scan(1.0, "laser"));
    says(&nameless, &usual, &["the poses do not name the robot's frame", "--base-frame (\"laser\""]);
    let own = named(|o| o.base_frame = Some("laser".to_owned()));
    assert_eq!(read(&write(folder.path(), &nameless), &own), (1, None));
}

#[test]
fn messages_that_are_not_what_they_say_are_told_by_topic_and_field() {
    let usual = BagOptions::default();
    let with = |at: usize, data: Vec<u8>| {
        let mut bag = plain();
        bag.messages[at].2 = data;
        bag
    };
    let place = flat(0.0, 0.0, 0.0);
    let long =
        |at: [f64; 3], turn: [f64; 4]| transforms(0.0, &[("map", "base_link", super::bag_support::Place { at, turn })]);
    says(&with(0, vec![0, 1, 0]), &usual, &["a message of /tf: has 3 bytes"]);
    says(&with(0, vec![0, 7, 0, 0, 1, 0, 0, 0]), &usual, &["/tf", "encoding is 00 07", "only plain CDR"]);
    says(&with(0, vec![0, 1, 0, 0, 255, 255, 255, 255]), &usual, &["transforms has 4294967295 elements, the limit is"]);
    says(&with(0, vec![0, 1, 0, 0, 9, 0, 0, 0]), &usual, &["transforms has 9 elements, 0 bytes are left"]);
    // One transform that is none is passed over, and told.
    let folder = tempfile::tempdir().unwrap();
    for (data, words) in [
        (long([f64::NAN, 0.0, 0.0], place.turn), "from \"map\" to \"base_link\" is not finite"),
        (long([1e10, 0.0, 0.0], place.turn), "beyond 1e9 m"),
        (long([0.0; 3], [0.0; 4]), "a quaternion of length 0.000, not 1"),
    ] {
        let path = write(folder.path(), &with(0, data));
        assert_eq!(read(&path, &usual), (9, None));
        let reader = LogReader::open_with(&path, ScanLimits::default(), &usual).unwrap();
        let chosen = reader.chosen().unwrap();
        assert!(chosen.contains("; 1 of the transforms are passed over: ") && chosen.contains(words), "{chosen}");
    }
    let own = with(0, transforms(0.0, &[("base_link", "base_link", place)]));
    assert_eq!(read(&write(folder.path(), &own), &usual), (9, None), "a frame in itself says nothing");
    says(&with(0, transforms(0.0, &[("odom", "base_link", place)])), &usual, &["two parents, \"odom\" and \"map\""]);
    // Of other frames it does not matter.
    let mut box_moved = plain();
    box_moved.put(
        "/tf",
        TF,
        transforms(0.0, &[("map", "box", place), ("base_link", "box", place), ("box", "box", place)]),
    );
    assert_eq!(read(&write(folder.path(), &box_moved), &usual), (10, None));
    let circle = transforms(0.0, &[("a", "map", place), ("b", "a", place), ("map", "b", place)]);
    let mut round = plain();
    round.put("/tf", TF, circle);
    says(&round, &named(|o| o.fixed_frame = Some("map".to_owned())), &["go in a circle"]);
    let bad = pose(0.0, "odom", Some("base_link"), &place, &covariance(f64::INFINITY, 1.0, 1.0));
    let mut odometry = plain();
    odometry.put("/odom", ODOMETRY, bad);
    assert_eq!(read(&write(folder.path(), &odometry), &usual), (10, None), "the transforms are enough");
    let by_topic = named(|o| o.pose_topic = Some("/odom".to_owned()));
    says(&odometry, &by_topic, &["a message of /odom: pose.covariance has inf for the variance of x"]);

    // A scan that cannot be read ends the log there.
    let cut = scan(3.0, "base_link");
    let mut text = Cdr::new(true);
    text.header(3.0, "base_link");
    for (data, words) in [
        (cut[..50].to_vec(), "scan 4: ends within"),
        (text.done(), "scan 4: ends within angle_min"),
        (scan(3.0, "other"), "scan 4: is of the frame \"other\", those before of \"base_link\""),
    ] {
        let (scans, error) = read(&write(folder.path(), &with(10, data)), &usual);
        assert!(scans == 3 && error.as_ref().unwrap().starts_with(words), "{scans}: {error:?}");
    }
    // Another encoding.
    std::fs::write(folder.path().join("ros1.mcap"), plain().mcap_encoded(Packed::No, "ros1")).unwrap();
    let (_, error) = read(&folder.path().join("ros1.mcap"), &usual);
    assert!(error.as_ref().unwrap().contains("encoded as \"ros1\", which is not read"), "{error:?}");
}

#[test]
fn a_recording_that_was_cut_off_is_read_up_to_there() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("cut.mcap");
    let mut bag = plain();
    for _ in 0..30 {
        bag.messages.extend(plain().messages);
    }
    for packed in [Packed::No, Packed::Zstd, Packed::Lz4] {
        let whole = bag.mcap(packed);
        std::fs::write(&path, &whole).unwrap();
        assert_eq!(read(&path, &BagOptions::default()), (310, None));
        for share in 1..20 {
            std::fs::write(&path, &whole[..whole.len() * share / 20]).unwrap();
            let (scans, error) = read(&path, &BagOptions::default());
            assert!(scans < 310 || share > 10, "{packed:?} {share}: {scans}");
            assert!(error.is_some(), "{packed:?} {share}: a cut is damage");
        }
    }
    // One that was cut off at once.
    let whole = bag.mcap(Packed::Zstd);
    std::fs::write(&path, &whole[..200]).unwrap();
    let (_, error) = read(&path, &BagOptions::default());
    assert!(error.as_ref().unwrap().contains("it was cut off; before that it has no topic"), "{error:?}");
    // The map holds what was whole, and the exit code tells.
    let whole = bag.mcap(Packed::No);
    std::fs::write(&path, &whole[..whole.len() / 2]).unwrap();
    let out = folder.path().join("m.ubbmap");
    let done = run(["build", path.to_str().unwrap(), "--out", out.to_str().unwrap(), "--json"]);
    let done = done.fails(1, "it was cut off");
    assert!(
        done.stderr.contains("is damaged; the map holds the ") && done.json()["scans"].as_u64().unwrap() > 50,
        "{done:?}"
    );
    // A flipped bit in a chunk.
    let mut flipped = bag.mcap(Packed::Zstd);
    flipped[400] ^= 4;
    std::fs::write(&path, &flipped).unwrap();
    let (_, error) = read(&path, &BagOptions::default());
    assert!(error.as_ref().unwrap().contains("the MCAP file is damaged"), "{error:?}");
}

#[test]
fn databases_and_folders_that_are_no_bags_are_told() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    let usual = BagOptions::default();
    let error = |name: &str| read(&path(name), &usual).1.unwrap();
    assert!(error("").contains("is a folder without a metadata.yaml"), "{}", error(""));
    assert!(error("none").contains("No such file"));
    rusqlite::Connection::open(path("other.db3")).unwrap().execute_batch("CREATE TABLE t(a)").unwrap();
    assert!(error("other.db3").contains("without a table \"topics\": no ROS 2 bag"), "{}", error("other.db3"));
    // A view would run whatever its author wants.
    let view = "CREATE TABLE topics(id, name, type, serialization_format);
        CREATE VIEW messages AS WITH RECURSIVE n(id) AS (SELECT 1 UNION ALL SELECT id + 1 FROM n) SELECT id, 1 AS topic_id, 'x' AS data FROM n";
    rusqlite::Connection::open(path("view.db3")).unwrap().execute_batch(view).unwrap();
    assert!(error("view.db3").contains("without a table \"messages\""), "{}", error("view.db3"));
    let wrong = "CREATE TABLE topics(id INTEGER PRIMARY KEY, name, type, serialization_format);
        CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id, data); INSERT INTO topics VALUES (1, 7, x'00', NULL)";
    rusqlite::Connection::open(path("wrong.db3")).unwrap().execute_batch(wrong).unwrap();
    assert!(error("wrong.db3").contains("the SQLite database cannot be read"), "{}", error("wrong.db3"));
    plain().sqlite(&path("plain.db3"));
    assert_eq!(read(&path("plain.db3"), &usual), (10, None));
    let bytes = std::fs::read(path("plain.db3")).unwrap();
    for at in (0..bytes.len()).step_by(97) {
        let mut hurt = bytes.clone();
        hurt[at] ^= 0x5a;
        std::fs::write(path("hurt.db3"), &hurt).unwrap();
        read(&path("hurt.db3"), &usual);
        std::fs::write(path("hurt.db3"), &bytes[..at]).unwrap();
        read(&path("hurt.db3"), &usual);
    }
    let packed = zstd::encode_all(bytes.as_slice(), 3).unwrap();
    std::fs::write(path("plain.db3.zstd"), packed).unwrap();
    assert!(error("plain.db3.zstd").contains("unpacked first: zstd -d"), "{}", error("plain.db3.zstd"));
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(if cfg!(debug_assertions) { 16 } else { 256 }))]

    #[test]
    fn no_bytes_of_a_message_bring_the_reader_down(
        at in 0_usize..30, place in 0_usize..600, bytes in prop::collection::vec(any::<u8>(), 0..40), whole in any::<bool>(),
    ) {
        let mut bag = plain();
        let data = &mut bag.messages[at].2;
        if whole {
            *data = [&[0, 1, 0, 0][..], &bytes].concat();
        } else {
            for (offset, byte) in bytes.iter().enumerate().take(8) {
                let here = (place + offset) % data.len();
                data[here] = *byte;
            }
        }
        let folder = tempfile::tempdir().unwrap();
        let path = write(folder.path(), &bag);
        let (scans, error) = read(&path, &BagOptions::default());
        prop_assert!(scans <= 10);
        if let Some(error) = error {
            prop_assert!(error.len() < 20_000);
        }
    }

    #[test]
    fn no_bytes_of_a_file_bring_the_reader_down(
        place in any::<prop::sample::Index>(), bytes in prop::collection::vec(any::<u8>(), 1..12), packed in 0_usize..3,
        cut in any::<bool>(),
    ) {
        let mut file = plain().mcap([Packed::No, Packed::Zstd, Packed::Lz4][packed]);
        let at = place.index(file.len());
        if cut {
            file.truncate(at);
            file.extend_from_slice(&bytes);
        } else {
            for (offset, byte) in bytes.iter().enumerate() {
                if let Some(there) = file.get_mut(at + offset) {
                    *there = *byte;
                }
            }
        }
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("hurt.mcap");
        std::fs::write(&path, &file).unwrap();
        prop_assert!(read(&path, &BagOptions::default()).0 <= 10);
    }
}

#[test]
fn the_first_scan_of_every_topic_was_held_with_its_ranges() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("topics.mcap");
    let mut bag = Bag::default();
    let scan = Scan {
        stamp: 1.0,
        frame: "laser",
        angle_min: 0.0,
        angle_increment: 1e-4,
        time_increment: 0.0,
        range_max: 30.0,
        ranges: vec![1.0; 20_000],
    };
    let data = zstd::encode_all(scan.message(true).as_slice(), 1).unwrap();
    for topic in 0..3000 {
        bag.put(&format!("/scan_{topic}"), SCAN, data.clone());
    }
    std::fs::write(&path, bag.mcap(Packed::No)).unwrap();
    // 240 MB of ranges, in a process that may have 150 MB.
    let limited = "ulimit -d 150000 && exec \"$0\" build \"$1\" --out \"$2\"";
    let out = folder.path().join("m.ubbmap");
    let done = std::process::Command::new("sh")
        .args(["-c", limited, env!("CARGO_BIN_EXE_ubbmap"), path.to_str().unwrap(), out.to_str().unwrap()])
        .output()
        .unwrap();
    let words = String::from_utf8_lossy(&done.stderr).chars().take(400).collect::<String>();
    assert_eq!(done.status.code(), Some(1), "{words}");
    assert!(words.contains("has 3000 topics of scans: name one by --scan-topic"), "{words}");
}

//! ROS 2 bags: their scans and poses against logs of text with the same numbers, and against the truth.

#![allow(clippy::unwrap_used, clippy::panic, reason = "tests")]

use super::bag_support::{
    Bag, IMAGE, ODOMETRY, POSE, Packed, Place, SCAN, Scan, TF, covariance, flat, heading, pose, transforms,
};
use super::cli_support::{Server, room_scans, run};
use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use ubbmap::logs::{BagOptions, LogPose, LogReader, LogScan, PoseError};
use ubbmap::sensor::{Angles, ScanLimits};

/// The half circle of the made-up scans, in the message's precision.
const ANGLE_MIN: f32 = -std::f32::consts::FRAC_PI_2;
const INCREMENT: f32 = std::f32::consts::PI / 180.0;
const RANGE_MAX: f32 = 30.0;

struct Folder(tempfile::TempDir);

impl Folder {
    fn new() -> Self {
        Self(tempfile::tempdir().unwrap())
    }

    fn path(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }

    fn text(&self, name: &str) -> String {
        self.path(name).to_str().unwrap().to_owned()
    }

    fn write(&self, name: &str, bytes: &[u8]) -> String {
        std::fs::write(self.path(name), bytes).unwrap();
        self.text(name)
    }

    /// The bytes of the map that a log gives.
    fn build(&self, log: &str, flags: &[&str]) -> Vec<u8> {
        run([&["build", log, "--out", &self.text("built.ubbmap")], flags].concat()).ok();
        std::fs::read(self.path("built.ubbmap")).unwrap()
    }
}

fn laser_scan(stamp: f64, ranges: &[f64]) -> Scan {
    let ranges = ranges.iter().map(|range| *range as f32).collect();
    Scan {
        stamp,
        frame: "laser",
        angle_min: ANGLE_MIN,
        angle_increment: INCREMENT,
        time_increment: 0.0,
        range_max: RANGE_MAX,
        ranges,
    }
}

/// A drive through the room: a transform at the time of every scan, and the same as JSON lines.
fn drive(count: usize) -> (Bag, String) {
    let mut bag = Bag::default();
    let mut log = format!(
        "{{\"angle_min\":{},\"angle_increment\":{},\"range_min\":{},\"range_max\":{}}}\n",
        f64::from(ANGLE_MIN),
        f64::from(INCREMENT),
        f64::from(0.05_f32),
        RANGE_MAX
    );
    for (i, (x, y, theta, ranges)) in room_scans(count).into_iter().enumerate() {
        let (stamp, place) = (100.0 + 0.1 * i as f64, flat(x, y, theta));
        // The transform comes after the scan now and then.
        let scan = laser_scan(stamp, &ranges);
        let there: Vec<f64> = scan.ranges.iter().map(|range| f64::from(*range)).collect();
        let theta = heading(&place);
        writeln!(log, "{{\"t\":{stamp},\"x\":{x},\"y\":{y},\"theta\":{theta},\"ranges\":{there:?}}}").unwrap();
        let transform = transforms(stamp, &[("map", "laser", place)]);
        if i % 3 == 0 {
            bag.put("/tf", TF, transform.clone());
        }
        bag.put("/scan", SCAN, scan.message(i % 2 == 0));
        bag.put("/camera", IMAGE, vec![7; 5000]);
        if i % 3 != 0 {
            bag.put("/tf", TF, transform);
        }
    }
    (bag, log)
}

fn open(path: &Path, options: &BagOptions) -> LogReader {
    LogReader::open_with(path, ScanLimits::default(), options).unwrap()
}

fn read(path: &Path, options: &BagOptions) -> Vec<LogScan> {
    open(path, options).map(Result::unwrap).collect()
}

fn refused(path: &Path, options: &BagOptions) -> String {
    LogReader::open_with(path, ScanLimits::default(), options).err().unwrap().to_string()
}

fn bounds(scan: &LogScan) -> [(f64, f64); 3] {
    let (x, y, theta) = scan.pose.bounds(&PoseError::default());
    [x, y, theta]
}

#[test]
fn a_bag_of_every_form_builds_the_map_of_the_same_log_of_text() {
    let folder = Folder::new();
    let (bag, log) = drive(60);
    let log = folder.write("room.jsonl", log.as_bytes());
    for flags in [&[][..], &["--pose-error", "0.03,0.5deg"]] {
        let expected = folder.build(&log, flags);
        for packed in [Packed::No, Packed::Zstd, Packed::Lz4] {
            let file = folder.write("room.mcap", &bag.mcap(packed));
            assert!(folder.build(&file, flags) == expected, "{packed:?}, {flags:?}");
        }
        let whole = zstd::encode_all(bag.mcap(Packed::No).as_slice(), 3).unwrap();
        let file = folder.write("room.mcap.zstd", &whole);
        assert!(folder.build(&file, flags) == expected, "compressed as a whole, {flags:?}");
        // Each message by itself.
        let mut small = bag.clone();
        for (_, _, data) in &mut small.messages {
            *data = zstd::encode_all(data.as_slice(), 3).unwrap();
        }
        let file = folder.write("small.mcap", &small.mcap(Packed::No));
        assert!(folder.build(&file, flags) == expected, "messages compressed, {flags:?}");
    }
    bag.sqlite(&folder.path("room.db3"));
    let expected = folder.build(&log, &[]);
    assert!(folder.build(&folder.text("room.db3"), &[]) == expected, "SQLite");

    // A folder of pieces: in the order of the list, and by their numbers where there is none.
    for (place, part) in bag.messages.chunks(15).enumerate() {
        let part = Bag { messages: part.to_vec() };
        std::fs::create_dir_all(folder.path("pieces")).unwrap();
        folder.write(&format!("pieces/drive_{place}.mcap"), &part.mcap(Packed::Zstd));
    }
    let pieces = bag.messages.len().div_ceil(15);
    assert!(pieces > 10, "drive_10 comes after drive_9");
    assert!(folder.build(&folder.text("pieces"), &[]) == expected, "a folder without a list");
    let names: String = (0..pieces).map(|place| format!("    - drive_{place}.mcap\n")).collect();
    let list = format!(
        "rosbag2_bagfile_information:\n  version: 5\n  relative_file_paths:\n{names}  duration:\n    nanoseconds: 1\n"
    );
    folder.write("pieces/metadata.yaml", list.as_bytes());
    assert!(folder.build(&folder.text("pieces"), &[]) == expected, "a folder with a list");
    folder.write("pieces/metadata.yaml", list.replace("drive_3.mcap", "drive_x.mcap").as_bytes());
    assert!(refused(&folder.path("pieces"), &BagOptions::default()).contains("\"drive_x.mcap\", which is not there"));
    folder.write("pieces/metadata.yaml", list.replace("drive_3.mcap", "../room.mcap").as_bytes());
    assert!(refused(&folder.path("pieces"), &BagOptions::default()).contains("which is not in the folder"));
}

#[test]
fn a_bag_is_replayed_and_told_of() {
    let folder = Folder::new();
    let (bag, _) = drive(40);
    let file = folder.write("drive.mcap", &bag.mcap(Packed::Lz4));
    let server = Server::start(&folder.path("data"), "127.0.0.1:0");
    let done = server.run(&["replay", &file, "--map", "room", "--json"]).ok();
    assert!(
        done.stderr.contains("scans of /scan (frame \"laser\"), poses of the transforms from \"map\" to \"laser\""),
        "{done:?}"
    );
    assert_eq!(
        (&done.json()["applied"], &server.show("room")["robots"][0]["robot"]),
        (&40.into(), &"drive-1of1".into())
    );
    let built = run(["build", &file, "--out", &folder.text("b.ubbmap"), "--json", "--max-gap", "0.2"]).ok().json();
    assert_eq!((&built["left_out"], &built["settings"]["bag"]["max_gap"]), (&0.into(), &0.2.into()));
    server.run(&["map", "import", "built", &folder.text("b.ubbmap")]).ok();
    assert_eq!(server.leaves("room"), server.leaves("built"));
    let text = folder.write("room.jsonl", drive(3).1.as_bytes());
    run(["build", &text, "--out", &folder.text("b.ubbmap"), "--sigma", "2"]).fails(2, "--sigma is for ROS 2 bags");
    assert_eq!(server.terminate(), 0);
}

/// A drive on a circle, of which the acceleration is known: the pose at a time.
fn circle(time: f64) -> (f64, f64, f64) {
    let turn = 0.8 * time + 0.3 * (1.5 * time).sin();
    (1.2 * turn.cos(), 1.2 * turn.sin(), turn + 1.5)
}

/// Above the acceleration on [`circle`]: the turn's rate is at most 0.8 + 0.45, its change 0.675.
const CIRCLE: PoseError = PoseError { position: 1.2 * (1.25 * 1.25 + 0.675), heading: 0.675 };

fn turned(angle: f64, near: f64) -> f64 {
    angle + ((near - angle) / std::f64::consts::TAU).round() * std::f64::consts::TAU
}

/// Where the laser is of a robot that has it at `(0.3, -0.1)`, turned by 0.4.
fn on_robot((x, y, theta): (f64, f64, f64)) -> (f64, f64, f64) {
    (x + 0.3 * theta.cos() + 0.1 * theta.sin(), y + 0.3 * theta.sin() - 0.1 * theta.cos(), theta + 0.4)
}

/// Transforms ten times a second, in two steps of which the first leaps; scans between them; the laser on the robot.
fn circle_bag() -> Bag {
    let mut bag = Bag::default();
    bag.put(
        "/tf_static",
        TF,
        transforms(0.0, &[("base_link", "plate", flat(0.3, -0.1, 0.0)), ("plate", "laser", flat(0.0, 0.0, 0.4))]),
    );
    let odom_from_map = flat(5.0, -3.0, 2.5);
    for step in 0..100 {
        let time = 0.1 * f64::from(step);
        let (x, y, theta) = circle(time);
        // odom stands in the map at a fixed place, told at other times than the robot's.
        bag.put("/tf", TF, transforms(time + 0.03, &[("map", "odom", odom_from_map)]));
        bag.put("/tf", TF, transforms(time, &[("odom", "base_link", flat(x, y, theta))]));
        for share in [0.013, 0.05, 0.081] {
            bag.put("/scan", SCAN, laser_scan(time + share, &[1.0, 2.0, 3.0]).message(true));
        }
    }
    bag
}

/// Where the laser of [`circle_bag`] is in the map.
fn truth(time: f64) -> [f64; 3] {
    let (x, y, theta) = on_robot(circle(time));
    let (sin, cos) = 2.5_f64.sin_cos();
    [5.0 + cos * x - sin * y, -3.0 + sin * x + cos * y, theta + 2.5]
}

/// Scans whose bounds leave the truth out, and the widest bounds.
fn outside(scans: &[LogScan]) -> (usize, f64) {
    let mut out = 0;
    let mut widest: f64 = 0.0;
    for scan in scans {
        let truth = truth(scan.stamp);
        let held = bounds(scan).iter().zip(truth).enumerate().all(|(axis, (bound, value))| {
            let value = if axis == 2 { turned(value, bound.0) } else { value };
            bound.0 - 1e-9 <= value && value <= bound.1 + 1e-9
        });
        out += usize::from(!held);
        widest = widest.max(bounds(scan).iter().map(|bound| bound.1 - bound.0).fold(0.0, f64::max));
    }
    (out, widest)
}

#[test]
fn between_two_poses_the_truth_is_within_the_bounds_of_the_acceleration() {
    let folder = Folder::new();
    folder.write("circle.mcap", &circle_bag().mcap(Packed::No));
    let options = BagOptions { max_acceleration: CIRCLE, ..BagOptions::default() };
    let scans = read(&folder.path("circle.mcap"), &options);
    // Of 300 scans one comes before the first place of odom, and some after the last of base_link.
    assert!((293..=297).contains(&scans.len()), "{}", scans.len());
    let (out, widest) = outside(&scans);
    assert_eq!(out, 0, "the truth is inside");
    // 0.1 s apart: the line is left by at most a / 800 either way, of the robot and of odom's place with 3 m of lever.
    assert!(widest <= 2.0 * (CIRCLE.position * 2.0 + CIRCLE.heading * 4.0) / 800.0, "{widest}");
    assert!(scans.iter().all(|scan| matches!(scan.pose, LogPose::Near { .. })), "their error is --pose-error's");
    // With bounds of the acceleration that the drive breaks, the truth is not inside.
    let low = PoseError { position: 0.2 * CIRCLE.position, heading: 0.2 * CIRCLE.heading };
    let options = BagOptions { max_acceleration: low, ..BagOptions::default() };
    assert!(outside(&read(&folder.path("circle.mcap"), &options)).0 > 10);
    // The laser's place on the robot counts: taken for the robot's own, everything is off.
    let options = BagOptions { max_acceleration: CIRCLE, ..BagOptions::default() };
    let mut bag = circle_bag();
    bag.messages[0].2 = transforms(0.0, &[("base_link", "laser", flat(0.0, 0.0, 0.0))]);
    folder.write("bare.mcap", &bag.mcap(Packed::No));
    assert!(outside(&read(&folder.path("bare.mcap"), &options)).0 > 250);
}

#[test]
fn scans_without_a_pose_near_are_left_out_and_counted() {
    let folder = Folder::new();
    let mut bag = circle_bag();
    // Nothing of the robot for a second.
    bag.messages.retain(|(topic, _, data)| {
        let time = f64::from(u32::from_le_bytes([data[8], data[9], data[10], data[11]]))
            + f64::from(u32::from_le_bytes([data[12], data[13], data[14], data[15]])) * 1e-9;
        topic != "/tf" || !(4.0..5.0).contains(&time)
    });
    folder.write("gap.mcap", &bag.mcap(Packed::No));
    let options = BagOptions { max_acceleration: CIRCLE, ..BagOptions::default() };
    let mut reader = open(&folder.path("gap.mcap"), &options);
    let scans: Vec<LogScan> = reader.by_ref().map(Result::unwrap).collect();
    assert_eq!(outside(&scans).0, 0);
    assert!(scans.iter().all(|scan| !(4.0..4.95).contains(&scan.stamp)));
    let (count, why) = reader.left_out();
    assert_eq!(count as usize + scans.len(), 300);
    let why = why.unwrap();
    assert!(why.contains("1 before the first pose") && why.contains("after the last pose"), "{why}");
    assert!(why.contains("between poses more than 0.5 s apart (--max-gap)"), "{why}");
    // With a longer gap the bound of the acceleration still holds, and is wide.
    let options = BagOptions { max_gap: 2.0, ..options };
    let wide = read(&folder.path("gap.mcap"), &options);
    assert!(wide.len() > scans.len() && outside(&wide).0 == 0);
    // A pose error on top.
    let error = PoseError { position: 0.5, heading: 0.1 };
    let (plain, wider) = (scans[9].pose.bounds(&PoseError::default()), scans[9].pose.bounds(&error));
    assert!(wider.0.0 < plain.0.0 - 0.49 && wider.2.1 > plain.2.1 + 0.09);
    let none = run(["build", &folder.text("gap.mcap"), "--out", &folder.text("m.ubbmap"), "--max-gap", "0.001"]);
    none.fails(1, "between poses more than 0.001 s apart (--max-gap)");
    assert!(!folder.path("m.ubbmap").exists());
}

#[test]
fn a_covariance_is_a_box_of_so_many_deviations() {
    let folder = Folder::new();
    let options = BagOptions { max_acceleration: CIRCLE, ..BagOptions::default() };
    for (type_name, child) in [(POSE, None), (ODOMETRY, Some("base_link"))] {
        let mut bag = Bag::default();
        bag.put("/tf_static", TF, transforms(0.0, &[("base_link", "laser", flat(0.3, -0.1, 0.4))]));
        for step in 0..50 {
            let time = 0.1 * f64::from(step);
            let (x, y, theta) = circle(time);
            let matrix = covariance(0.0004, 0.0001, 0.0025);
            bag.put("/pose", type_name, pose(time, "world", child, &flat(x, y, theta), &matrix));
            bag.put("/scan", SCAN, laser_scan(time, &[1.0, 2.0]).message(true));
            bag.put("/scan", SCAN, laser_scan(time + 0.04, &[1.0, 2.0]).message(true));
        }
        folder.write("pose.mcap", &bag.mcap(Packed::Zstd));
        for sigma in [3.0, 1.5] {
            let scans = read(&folder.path("pose.mcap"), &BagOptions { sigma, ..options.clone() });
            assert_eq!(scans.len(), 99, "{type_name}");
            for scan in &scans {
                // Robots at the corners of the box have their laser inside, and the box is not much larger.
                let (x, y, theta) = circle(scan.stamp);
                let mut hull = [(f64::INFINITY, f64::NEG_INFINITY); 3];
                for corner in 0..27 {
                    let side = |axis: u32| f64::from(corner / 3_i32.pow(axis) % 3 - 1);
                    let robot =
                        (x + sigma * 0.02 * side(0), y + sigma * 0.01 * side(1), theta + sigma * 0.05 * side(2));
                    let (x, y, theta) = on_robot(robot);
                    for (bound, value) in hull.iter_mut().zip([x, y, turned(theta, bounds(scan)[2].0)]) {
                        *bound = (bound.0.min(value), bound.1.max(value));
                    }
                }
                for (axis, (bound, hull)) in bounds(scan).iter().zip(hull).enumerate() {
                    assert!(bound.0 <= hull.0 + 1e-9 && hull.1 - 1e-9 <= bound.1, "axis {axis}: {bound:?}, {hull:?}");
                    assert!(hull.0 - bound.0 < 0.04 && bound.1 - hull.1 < 0.04, "axis {axis}: {bound:?}, {hull:?}");
                }
                assert!(matches!(scan.pose, LogPose::Box { .. }), "--pose-error is not added");
            }
        }
    }
    // Covariances that say that they know nothing.
    let unknown = [[0.0; 36], {
        let mut matrix = [0.0; 36];
        matrix[0] = -1.0;
        matrix
    }];
    for matrix in unknown {
        let mut bag = Bag::default();
        bag.put("/odom", ODOMETRY, pose(1.0, "odom", Some("laser"), &flat(1.0, 2.0, 0.5), &matrix));
        bag.put("/scan", SCAN, laser_scan(1.0, &[1.0]).message(true));
        folder.write("unknown.mcap", &bag.mcap(Packed::No));
        let mut reader = open(&folder.path("unknown.mcap"), &options);
        assert!(reader.chosen().unwrap().contains("which do not all tell their errors"), "{:?}", reader.chosen());
        assert!(matches!(reader.next().unwrap().unwrap().pose, LogPose::Near { x: (1.0, 1.0), y: (2.0, 2.0), .. }));
    }
    let mut wide = Bag::default();
    wide.put("/odom", ODOMETRY, pose(1.0, "odom", Some("laser"), &flat(1.0, 2.0, 0.5), &covariance(0.25, 0.25, 0.07)));
    wide.put("/scan", SCAN, laser_scan(1.0, &[1.0]).message(true));
    folder.write("wide.mcap", &wide.mcap(Packed::No));
    assert!(open(&folder.path("wide.mcap"), &options).nothing().contains("1 with a pose wider than 2 m or 60 deg"));
}

#[test]
fn a_laser_that_hangs_upside_down_measures_the_same_walls() {
    let folder = Folder::new();
    let (x, y, theta) = (1.0, -2.0, 0.7_f64);
    // Turned about the x-axis by half a turn, then by theta about the vertical.
    let hanging = Place { at: [x, y, 0.4], turn: [(0.5 * theta).cos(), (0.5 * theta).sin(), 0.0, 0.0] };
    let mut bag = Bag::default();
    bag.put("/tf", TF, transforms(1.0, &[("map", "laser", hanging)]));
    bag.put("/scan", SCAN, laser_scan(1.0, &[1.0, 2.0, 3.0]).message(true));
    folder.write("hanging.mcap", &bag.mcap(Packed::No));
    let scan = read(&folder.path("hanging.mcap"), &BagOptions::default()).remove(0);
    let Angles::Uniform { min, increment } = scan.angles else { panic!("listed") };
    let heading = bounds(&scan)[2].0;
    for beam in 0..3_i32 {
        // Where the beam points in space: its direction in the laser's frame, turned over, then by theta.
        let angle = f64::from(ANGLE_MIN) + f64::from(beam) * f64::from(INCREMENT);
        let (across, along) = (-angle.sin(), angle.cos());
        let expected = (theta.cos() * along - theta.sin() * across, theta.sin() * along + theta.cos() * across);
        let shown = heading + min + f64::from(beam) * increment;
        assert!((shown.cos() - expected.0).hypot(shown.sin() - expected.1) < 1e-6, "beam {beam}");
    }
    // One that looks into the floor is no planar scan.
    let tilted = Place { at: [x, y, 0.4], turn: [0.0, (0.5 * 0.2_f64).sin(), 0.0, (0.5 * 0.2_f64).cos()] };
    bag.messages[0].2 = transforms(1.0, &[("map", "laser", tilted)]);
    let file = folder.write("tilted.mcap", &bag.mcap(Packed::No));
    let done = run(["build", &file, "--out", &folder.text("m.ubbmap")]);
    done.fails(1, "all 1 have no place: 1 from a laser whose plane is tilted by more than 1 deg");
}

#[test]
fn the_motion_during_a_sweep_is_in_the_box_and_told() {
    let folder = Folder::new();
    let mut bag = circle_bag();
    for (topic, _, data) in &mut bag.messages {
        if topic == "/scan" {
            let seconds = u32::from_le_bytes([data[4], data[5], data[6], data[7]]);
            let rest = u32::from_le_bytes([data[8], data[9], data[10], data[11]]);
            let mut scan = laser_scan(f64::from(seconds) + f64::from(rest) * 1e-9, &[1.0; 101]);
            scan.time_increment = 0.001;
            *data = scan.message(true);
        }
    }
    folder.write("sweep.mcap", &bag.mcap(Packed::No));
    let options = BagOptions { max_acceleration: CIRCLE, ..BagOptions::default() };
    let scans = read(&folder.path("sweep.mcap"), &options);
    assert!(scans.len() > 280);
    for scan in &scans {
        let (mut turn, mut way) = (0.0, 0.0);
        for step in 0..=50 {
            let [x, y, theta] = truth(scan.stamp + 0.1 * f64::from(step) / 50.0);
            let [bx, by, bt] = bounds(scan);
            let theta = turned(theta, 0.5 * (bt.0 + bt.1));
            for (bound, value) in [bx, by, bt].iter().zip([x, y, theta]) {
                assert!(bound.0 - 1e-9 <= value && value <= bound.1 + 1e-9, "{bound:?} does not hold {value}");
            }
            if step > 0 {
                let before = truth(scan.stamp + 0.1 * f64::from(step - 1) / 50.0);
                way += (x - before[0]).hypot(y - before[1]);
                turn += (truth(scan.stamp + 0.1 * f64::from(step) / 50.0)[2] - before[2]).abs();
            }
        }
        assert!(
            scan.sweep_rotation >= turn - 1e-3 && scan.sweep_rotation < turn + 0.05,
            "{} {turn}",
            scan.sweep_rotation
        );
        assert!(
            scan.sweep_translation >= way - 1e-3 && scan.sweep_translation < way + 0.1,
            "{} {way}",
            scan.sweep_translation
        );
    }
    let still = read(&folder.path("sweep.mcap"), &BagOptions { sweep: false, ..options });
    assert!(still.iter().all(|scan| scan.sweep_rotation == 0.0 && scan.sweep_translation == 0.0));
}

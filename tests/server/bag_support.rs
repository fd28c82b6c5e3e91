//! ROS 2 bags for tests: messages in CDR, written as MCAP files and SQLite databases.

#![allow(clippy::unwrap_used, clippy::panic, reason = "tests")]

use std::collections::BTreeMap;
use std::path::Path;

/// A frame's place in another: `(x, y, z)` and a unit quaternion `(x, y, z, w)`.
#[derive(Debug, Clone, Copy)]
pub struct Place {
    pub at: [f64; 3],
    pub turn: [f64; 4],
}

/// In the plane.
pub fn flat(x: f64, y: f64, theta: f64) -> Place {
    Place { at: [x, y, 0.0], turn: [0.0, 0.0, (0.5 * theta).sin(), (0.5 * theta).cos()] }
}

/// What a reader makes of the heading of [`flat`]: the angle has been through a quaternion.
pub fn heading(place: &Place) -> f64 {
    let [x, y, z, w] = place.turn;
    (2.0 * (w * z + x * y)).atan2(1.0 - 2.0 * (y * y + z * z))
}

/// A message in CDR.
#[derive(Debug, Clone)]
pub struct Cdr {
    bytes: Vec<u8>,
    little: bool,
}

impl Cdr {
    pub fn new(little: bool) -> Self {
        Self { bytes: vec![0, u8::from(little), 0, 0], little }
    }

    fn put<const N: usize>(&mut self, mut value: [u8; N]) {
        while !(self.bytes.len() - 4).is_multiple_of(N) {
            self.bytes.push(0);
        }
        if !self.little {
            value.reverse();
        }
        self.bytes.extend_from_slice(&value);
    }

    pub fn u32(&mut self, value: u32) {
        self.put(value.to_le_bytes());
    }

    pub fn f32(&mut self, value: f32) {
        self.put(value.to_le_bytes());
    }

    pub fn f64(&mut self, value: f64) {
        self.put(value.to_le_bytes());
    }

    pub fn text(&mut self, text: &str) {
        self.u32(text.len() as u32 + 1);
        self.bytes.extend_from_slice(text.as_bytes());
        self.bytes.push(0);
    }

    pub fn header(&mut self, stamp: f64, frame: &str) {
        let nanoseconds = (stamp * 1e9).round() as i64;
        self.u32((nanoseconds / 1_000_000_000) as u32);
        self.u32((nanoseconds % 1_000_000_000) as u32);
        self.text(frame);
    }

    pub fn place(&mut self, place: &Place) {
        for value in place.at.iter().chain(&place.turn) {
            self.f64(*value);
        }
    }

    pub fn done(self) -> Vec<u8> {
        self.bytes
    }
}

/// `sensor_msgs/msg/LaserScan`
#[derive(Debug, Clone)]
pub struct Scan {
    pub stamp: f64,
    pub frame: &'static str,
    pub angle_min: f32,
    pub angle_increment: f32,
    pub time_increment: f32,
    pub range_max: f32,
    pub ranges: Vec<f32>,
}

impl Scan {
    pub fn message(&self, little: bool) -> Vec<u8> {
        let mut cdr = Cdr::new(little);
        cdr.header(self.stamp, self.frame);
        cdr.f32(self.angle_min);
        cdr.f32(self.angle_min + self.angle_increment * (self.ranges.len() as f32 - 1.0));
        cdr.f32(self.angle_increment);
        cdr.f32(self.time_increment);
        cdr.f32(0.1);
        cdr.f32(0.05);
        cdr.f32(self.range_max);
        cdr.u32(self.ranges.len() as u32);
        self.ranges.iter().for_each(|range| cdr.f32(*range));
        cdr.u32(0);
        cdr.done()
    }
}

/// `tf2_msgs/msg/TFMessage` with transforms `(parent, child, place)` of one time.
pub fn transforms(stamp: f64, all: &[(&str, &str, Place)]) -> Vec<u8> {
    let mut cdr = Cdr::new(true);
    cdr.u32(all.len() as u32);
    for (parent, child, place) in all {
        cdr.header(stamp, parent);
        cdr.text(child);
        cdr.place(place);
    }
    cdr.done()
}

/// `geometry_msgs/msg/PoseWithCovarianceStamped`, or `nav_msgs/msg/Odometry` where there is a child.
pub fn pose(stamp: f64, frame: &str, child: Option<&str>, place: &Place, covariance: &[f64; 36]) -> Vec<u8> {
    let mut cdr = Cdr::new(true);
    cdr.header(stamp, frame);
    if let Some(child) = child {
        cdr.text(child);
    }
    cdr.place(place);
    covariance.iter().for_each(|value| cdr.f64(*value));
    if child.is_some() {
        (0..6 + 36).for_each(|_| cdr.f64(0.0));
    }
    cdr.done()
}

/// A covariance with these variances of x, y and yaw, and something beside the diagonal.
pub fn covariance(x: f64, y: f64, yaw: f64) -> [f64; 36] {
    let mut matrix = [0.0; 36];
    (matrix[0], matrix[7], matrix[35]) = (x, y, yaw);
    let beside = 0.5 * (x * y).sqrt();
    (matrix[1], matrix[6]) = (beside, beside);
    matrix
}

/// Types by short names.
pub const SCAN: &str = "sensor_msgs/msg/LaserScan";
pub const TF: &str = "tf2_msgs/msg/TFMessage";
pub const ODOMETRY: &str = "nav_msgs/msg/Odometry";
pub const POSE: &str = "geometry_msgs/msg/PoseWithCovarianceStamped";
pub const IMAGE: &str = "sensor_msgs/msg/Image";

/// Messages in the order of a recording: topic, type, data.
#[derive(Debug, Clone, Default)]
pub struct Bag {
    pub messages: Vec<(String, &'static str, Vec<u8>)>,
}

/// How chunks are compressed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Packed {
    No,
    Zstd,
    Lz4,
}

impl Bag {
    pub fn put(&mut self, topic: &str, type_name: &'static str, data: Vec<u8>) {
        self.messages.push((topic.to_owned(), type_name, data));
    }

    pub fn mcap(&self, packed: Packed) -> Vec<u8> {
        self.mcap_encoded(packed, "cdr")
    }

    pub fn mcap_encoded(&self, packed: Packed, encoding: &str) -> Vec<u8> {
        let mut out = std::io::Cursor::new(Vec::new());
        let compression = match packed {
            Packed::No => None,
            Packed::Zstd => Some(mcap::Compression::Zstd),
            Packed::Lz4 => Some(mcap::Compression::Lz4),
        };
        let options = mcap::WriteOptions::new().profile("ros2").compression(compression).chunk_size(Some(40_000));
        let mut writer = options.create(&mut out).unwrap();
        let mut channels = BTreeMap::new();
        for (time, (topic, type_name, data)) in self.messages.iter().enumerate() {
            let channel_id = *channels.entry(topic.clone()).or_insert_with(|| {
                let schema = writer.add_schema(type_name, "ros2msg", b"# not read").unwrap();
                writer.add_channel(schema, topic, encoding, &BTreeMap::new()).unwrap()
            });
            let time = time as u64;
            let header = mcap::records::MessageHeader { channel_id, sequence: 0, log_time: time, publish_time: time };
            writer.write_to_known_channel(&header, data).unwrap();
        }
        writer.finish().unwrap();
        drop(writer);
        out.into_inner()
    }

    /// A database as `rosbag2_storage_sqlite3` makes it.
    pub fn sqlite(&self, path: &Path) {
        let database = rusqlite::Connection::open(path).unwrap();
        database
            .execute_batch(
                "CREATE TABLE schema(schema_version INTEGER PRIMARY KEY, ros_distro TEXT NOT NULL);
                 CREATE TABLE metadata(id INTEGER PRIMARY KEY, metadata_version INTEGER NOT NULL, metadata TEXT NOT NULL);
                 CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT NOT NULL, type TEXT NOT NULL, serialization_format TEXT
                     NOT NULL, offered_qos_profiles TEXT NOT NULL, type_description_hash TEXT NOT NULL);
                 CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER NOT NULL, timestamp INTEGER NOT NULL, data BLOB NOT
                     NULL);
                 CREATE INDEX timestamp_idx ON messages (timestamp ASC);",
            )
            .unwrap();
        let mut ids = BTreeMap::new();
        for (time, (topic, type_name, data)) in self.messages.iter().enumerate() {
            let next = ids.len() as i64 + 1;
            let id = *ids.entry(topic.clone()).or_insert(next);
            if id == next {
                let insert = "INSERT INTO topics VALUES (?1, ?2, ?3, 'cdr', '', '')";
                database.execute(insert, rusqlite::params![id, topic, type_name]).unwrap();
            }
            let insert = "INSERT INTO messages (topic_id, timestamp, data) VALUES (?1, ?2, ?3)";
            database.execute(insert, rusqlite::params![id, time as i64, data]).unwrap();
        }
    }
}

//! Many clients at once over all three transports: the recorded history of inserts, snapshots, restores and reads is one
//! that a map could have had which does one thing after the other, each between its call and its answer.
//!
//! Every answer names a revision, so the order need not be searched for. The history is replayed revision by revision
//! by the engine alone (no service, no store), and held to three things: each read is the map of its revision, leaf by
//! leaf; each scan that was answered is in the map of the answer's revision; and no answer is of an earlier revision than one
//! that had come before its call.

#![allow(clippy::unwrap_used, clippy::panic, reason = "tests")]

use crate::http_support::Site;
use crate::linearizable_judge::{Did, History, Op, Scanned, judge};
use crate::parity_support::{Call, Kind, TRANSPORTS, Transport};
use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use serde_json::{Value, json};
use std::f64::consts::TAU;
use std::sync::Mutex;
use std::time::Instant;
use ubbmap::service::{RawPose, ScanInput};

/// Clients of each transport.
const CLIENTS: usize = 2;

/// What each client does.
const STEPS: u64 = 60;

/// A robot's scan of a round wall, at a place of its own; walls of different numbers have different radii.
pub fn scan_of(client: usize, sequence: u64) -> ScanInput {
    let place = -9.0 + 3.5 * client as f64;
    ScanInput {
        robot: format!("amr-{client}"),
        sequence: Some(sequence),
        stamp: 0.0,
        sensor: String::new(),
        pose: Some(RawPose { x: (place, place), y: (0.0, 0.0), theta: (0.0, 0.0) }),
        angles: ubbmap::sensor::Angles::Uniform { min: 0.0, increment: TAU / 180.0 },
        ranges: vec![0.7 + 0.2 * (sequence % 5) as f32; 180],
        footprint_radius: 0.0,
        sweep_rotation: 0.0,
        sweep_translation: 0.0,
    }
}

fn insert(client: usize, sequences: &[u64]) -> Call {
    let scans: Vec<Value> = sequences
        .iter()
        .map(|sequence| {
            let scan = scan_of(client, *sequence);
            let pose = scan.pose.unwrap();
            let side = |(min, max): (f64, f64)| json!({"min": min, "max": max});
            json!({
                "robot": scan.robot, "sequence": sequence.to_string(),
                "pose": {"x": side(pose.x), "y": side(pose.y), "theta": side(pose.theta)},
                "angle_min": 0.0, "angle_increment": TAU / 180.0, "ranges": scan.ranges,
            })
        })
        .collect();
    Call::InsertScans(serde_json::from_value(json!({"map": "hall", "scans": scans})).unwrap())
}

fn of_hall<T: serde::de::DeserializeOwned>(mut fields: Value) -> T {
    fields["map"] = json!("hall");
    serde_json::from_value(fields).unwrap()
}

fn number(answer: &Value, field: &str) -> u64 {
    match &answer[field] {
        Value::String(text) => text.parse().unwrap(),
        other => other.as_u64().unwrap(),
    }
}

/// One client: its own random sequence of things to do.
struct Client<'a> {
    site: &'a Site,
    transport: Transport,
    kind: Kind,
    index: usize,
    dice: u64,
    next: u64,
    /// Names of the snapshots that any client took.
    snapshots: &'a Mutex<Vec<String>>,
}

impl Client<'_> {
    fn roll(&mut self, sides: u64) -> u64 {
        self.dice ^= self.dice << 13;
        self.dice ^= self.dice >> 7;
        self.dice ^= self.dice << 17;
        self.dice % sides
    }

    fn call(&self, call: &Call) -> Value {
        self.transport.call(self.site, call).unwrap_or_else(|refusal| panic!("{call:?}: {refusal:?}"))
    }

    fn step(&mut self, step: u64) -> Did {
        let kept = self.kind != Kind::Zenoh;
        match self.roll(20) {
            0 if kept => {
                let name = format!("s{}-{step}", self.index);
                let answer = self.call(&Call::CreateSnapshot(of_hall(json!({"name": name}))));
                self.snapshots.lock().unwrap().push(name.clone());
                Did::Snapshot { name, revision: number(&answer, "revision") }
            }
            1 if kept && !self.snapshots.lock().unwrap().is_empty() => {
                let name = {
                    let count = self.snapshots.lock().unwrap().len() as u64;
                    let chosen = self.roll(count) as usize;
                    self.snapshots.lock().unwrap()[chosen].clone()
                };
                let answer = self.call(&Call::RestoreSnapshot(of_hall(json!({"name": name}))));
                Did::Restore { name, revision: number(&answer, "revision") }
            }
            2..=4 if self.next > 0 => {
                // One that was sent before: applied already, or taken back by a restore.
                let sequence = self.next - self.roll(self.next.min(20));
                self.insert(&[sequence])
            }
            5..=10 => {
                let count = 1 + self.roll(2);
                let sequences: Vec<u64> = (1..=count).map(|more| self.next + more).collect();
                self.next += count;
                self.insert(&sequences)
            }
            _ => {
                let answer = self.call(&Call::GetGrid(of_hall(json!({}))));
                let classes = STANDARD.decode(answer["classes"].as_str().unwrap()).unwrap();
                Did::Read { revision: number(&answer, "revision"), classes }
            }
        }
    }

    fn insert(&self, sequences: &[u64]) -> Did {
        let answer = self.call(&insert(self.index, sequences));
        let rejected: Vec<(u64, String)> = answer["rejected"]
            .as_array()
            .unwrap()
            .iter()
            .map(|one| (number(one, "index"), one["code"].as_str().unwrap().to_owned()))
            .collect();
        // The one refusal that a good scan may meet; a robot sends it again.
        assert!(rejected.iter().all(|(_, code)| code == "MAP_RESTORED"), "{answer}");
        let taken = sequences.iter().zip(0..).filter(|(_, index)| rejected.iter().all(|(at, _)| at != index));
        Did::Insert {
            scans: taken.map(|(sequence, _)| Scanned { client: self.index, sequence: *sequence }).collect(),
            applied: number(&answer, "applied"),
            duplicates: number(&answer, "duplicates"),
            revision: number(&answer, "revision"),
        }
    }
}

fn record(seed: u64) -> History {
    let site = Site::on_zenoh(|_| {});
    let snapshots = Mutex::new(Vec::new());
    let history = Mutex::new(Vec::new());
    std::thread::scope(|scope| {
        for index in 0..CLIENTS * TRANSPORTS.len() {
            let (site, snapshots, history) = (&site, &snapshots, &history);
            scope.spawn(move || {
                let kind = TRANSPORTS[index % TRANSPORTS.len()];
                let transport = Transport::new(kind, site);
                let dice = (seed + 1).wrapping_mul(0x9e37_79b9_7f4a_7c15) ^ ((index as u64 + 1) << 32);
                let mut client = Client { site, transport, kind, index, dice, next: 0, snapshots };
                for step in 0..STEPS {
                    let begun = Instant::now();
                    let did = client.step(step);
                    let op = Op { client: index, begun, ended: Instant::now(), did };
                    history.lock().unwrap().push(op);
                }
            });
        }
    });
    history.into_inner().unwrap()
}

/// `UBBMAP_HISTORIES` records more of them.
#[test]
fn histories_of_many_clients_over_all_transports_are_linearizable() {
    let count = std::env::var("UBBMAP_HISTORIES").ok().map_or(3, |count| count.parse().unwrap());
    let mut summary = Vec::new();
    for seed in 0..count {
        let history = record(seed);
        summary.push(judge(&history).unwrap_or_else(|wrong| panic!("seed {seed}: {wrong}")));
    }
    let total = |of: fn(&crate::linearizable_judge::Summary) -> u64| summary.iter().map(of).sum::<u64>();
    eprintln!("{count} histories: {summary:?}");
    assert!(total(|s| s.reads) > 50 * count, "hardly anything was read");
    assert!(total(|s| s.applied) > 100 * count, "hardly anything was applied");
    assert!(total(|s| s.restores) > 0 && total(|s| s.duplicates) > 0 && total(|s| s.again) > 0, "{summary:?}");
}

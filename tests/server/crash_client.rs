//! The robots of the crash tests as clients of the real binary, and what it must serve.

use crate::crash_support::{After, Course};
use crate::http_support::agent;
use crate::service_support::leaves;
use prost::Message;
use serde_json::Value;
use ubbmap::sensor::Angles;
use ubbmap::service::ScanInput;
use ubbmap::wire::{to_wire_config, v1};
use ureq::Agent;

/// A client that takes a broken connection for an answer of its own: none.
#[derive(Clone)]
pub struct Client {
    agent: Agent,
    url: String,
}

impl Client {
    pub fn new(url: &str) -> Self {
        Self { agent: agent(), url: url.to_owned() }
    }

    pub fn create(&self, map: &str, course: &Course) -> Option<(u16, Value)> {
        let config = serde_json::to_vec(&to_wire_config(&course.config)).unwrap();
        self.send("PUT", &format!("/v1/maps/{map}"), "application/json", &config)
    }

    pub fn insert(&self, map: &str, request: &[ScanInput]) -> Option<(u16, Value)> {
        let scans = request.iter().map(message).collect();
        let body = v1::InsertScansRequest { map: map.to_owned(), scans }.encode_to_vec();
        self.send("POST", &format!("/v1/maps/{map}/scans"), "application/x-protobuf", &body)
    }

    pub fn get(&self, path: &str) -> Option<(u16, Value)> {
        let response = self.agent.get(format!("{}{path}", self.url)).call().ok()?;
        json(response)
    }

    fn send(&self, method: &str, path: &str, kind: &str, body: &[u8]) -> Option<(u16, Value)> {
        let request = ureq::http::Request::builder().method(method).uri(format!("{}{path}", self.url));
        let request = request.header("content-type", kind).header("accept", "application/json").body(body).unwrap();
        json(self.agent.run(request).ok()?)
    }

    /// The revision of a map; `None` where there is none.
    pub fn revision(&self, map: &str) -> Option<u64> {
        let (status, answer) = self.get(&format!("/v1/maps/{map}")).unwrap();
        assert!(status == 200 || status == 404, "{map}: {answer}");
        (status == 200).then(|| number(&answer["revision"]))
    }

    /// A map is, leaf for leaf and scan for scan, what its revision says; returns the revision.
    pub fn check(&self, map: &str, course: &Course) -> u64 {
        let (status, shown) = self.get(&format!("/v1/maps/{map}")).unwrap();
        assert_eq!(status, 200, "{map}: {shown}");
        let revision = number(&shown["revision"]);
        let After { sequence, tree } = &course.after[usize::try_from(revision).unwrap()];
        for robot in shown["robots"].as_array().unwrap() {
            assert_eq!(robot["robot"], course.robot.as_str());
            let (highest, applied) = (number(&robot["highest_sequence"]), number(&robot["applied"]));
            assert_eq!((highest, applied), (*sequence, *sequence), "{map} at revision {revision}");
        }
        let (_, region) = self.get(&format!("/v1/maps/{map}/region")).unwrap();
        assert_eq!(number(&region["revision"]), revision);
        let field = |leaf: &Value, name: &str| leaf[name].as_u64().unwrap();
        let found = region["leaves"].as_array().unwrap().iter();
        let found = found.map(|leaf| ["depth", "x", "y", "class"].map(|name| field(leaf, name)));
        let sought = leaves(tree)
            .into_iter()
            .map(|leaf| [u64::from(leaf.node.depth), leaf.node.x.into(), leaf.node.y.into(), leaf.class.into()]);
        assert!(found.eq(sought), "{map} at revision {revision}: other leaves");
        revision
    }
}

fn json(mut response: ureq::http::Response<ureq::Body>) -> Option<(u16, Value)> {
    let status = response.status().as_u16();
    let bytes = response.body_mut().with_config().limit(1 << 28).read_to_vec().ok()?;
    Some((status, serde_json::from_slice(&bytes).ok()?))
}

/// A number as the interface writes it: as text where it has 64 bits.
pub fn number(value: &Value) -> u64 {
    value.as_u64().or_else(|| value.as_str()?.parse().ok()).unwrap_or_else(|| panic!("{value} is no number"))
}

fn message(scan: &ScanInput) -> v1::Scan {
    let pose = scan.pose.unwrap();
    let interval = |(min, max): (f64, f64)| Some(v1::Interval { min: Some(min), max: Some(max) });
    let Angles::Uniform { min, increment } = scan.angles else { panic!("the robots' steps are even") };
    v1::Scan {
        robot: scan.robot.clone(),
        sequence: scan.sequence,
        stamp: scan.stamp,
        pose: Some(v1::PoseBox { x: interval(pose.x), y: interval(pose.y), theta: interval(pose.theta) }),
        angle_min: Some(min),
        angle_increment: Some(increment),
        ranges: scan.ranges.clone(),
        footprint_radius: scan.footprint_radius,
        sweep_rotation: scan.sweep_rotation,
        sweep_translation: scan.sweep_translation,
        ..v1::Scan::default()
    }
}

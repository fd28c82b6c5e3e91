//! Every limit on what a request may hold, over REST and gRPC: its own value passes, one more is refused by the setting's
//! name, and is counted.

#![allow(clippy::unwrap_used, reason = "a test may end where its ground is not as it should be")]

use crate::http_support::{Site, ring};
use crate::limits_support::{Asked, hits};
use serde_json::{Value, json};
use ubbmap::config::Config;
use ubbmap::service::LIMITS;

/// A limit: its setting, the value, and what is asked at the value and above. The number is that of the asking, for names.
type Case = (&'static str, fn(&mut Config), fn(usize) -> Asked, fn(usize) -> Asked);

fn scans(count: usize, with: impl Fn(&mut Value)) -> Asked {
    let scan = |_| {
        let mut scan = ring("", None);
        with(&mut scan);
        scan
    };
    Asked::Insert(json!({ "scans": (0..count).map(scan).collect::<Vec<_>>() }))
}

fn beams(count: usize) -> Asked {
    scans(1, |scan| {
        scan["ranges"] = json!(vec![3.0; count]);
        scan["angle_increment"] = json!(0.01);
    })
}

fn wide(field: &str, width: f64) -> Asked {
    scans(1, |scan| scan["pose"][field] = json!({ "min": 0.0, "max": width }))
}

fn points(count: usize) -> Asked {
    Asked::Classes(json!({ "points": vec![json!({ "x": 1, "y": 1 }); count] }))
}

fn regions(count: usize) -> Asked {
    let disc = json!({ "disc": { "center": { "x": 0, "y": 0 }, "radius": 0.1 } });
    Asked::Free(json!({ "regions": vec![disc; count] }))
}

fn corners(count: usize) -> Asked {
    let corner = |at: usize| {
        let angle = at as f64 / count as f64 * std::f64::consts::TAU;
        json!({ "x": angle.cos(), "y": angle.sin() })
    };
    Asked::Free(json!({ "regions": [{ "polygon": { "points": (0..count).map(corner).collect::<Vec<_>>() } }] }))
}

fn robot(name: &str) -> Asked {
    Asked::Insert(json!({ "scans": [ring(name, Some(1))] }))
}

fn cases() -> Vec<Case> {
    vec![
        ("limits.scans_per_request", |c| c.limits.scans_per_request = 3, |_| scans(3, |_| ()), |_| scans(4, |_| ())),
        ("limits.beams_per_scan", |c| c.limits.beams_per_scan = 20, |_| beams(20), |_| beams(21)),
        ("limits.pose_width", |c| c.limits.pose_width = 0.5, |_| wide("x", 0.5), |_| wide("y", 0.51)),
        (
            "limits.pose_heading_degrees",
            |c| c.limits.pose_heading_degrees = 20.0,
            |_| wide("theta", 20_f64.to_radians()),
            |_| wide("theta", 21_f64.to_radians()),
        ),
        ("limits.points_per_query", |c| c.limits.points_per_query = 5, |_| points(5), |_| points(6)),
        ("limits.regions_per_query", |c| c.limits.regions_per_query = 2, |_| regions(2), |_| regions(3)),
        ("limits.points_per_region", |c| c.limits.points_per_region = 6, |_| corners(6), |_| corners(7)),
        ("limits.cells_per_answer", |c| c.limits.cells_per_answer = 100, |_| Asked::Grid(1.0), |_| Asked::Grid(1.1)),
        (
            "limits.body_bytes",
            |c| {
                c.limits.body_bytes = 20_000;
                c.limits.insert_bytes = 1 << 29;
            },
            |_| points(600),
            |_| points(2000),
        ),
    ]
}

/// Of what is made and stays.
fn kept() -> Vec<Case> {
    vec![
        (
            "limits.depth",
            |c| c.limits.depth = 9,
            |turn| Asked::Create(format!("deep-{turn}"), json!({ "depth": 9 })),
            |turn| Asked::Create(format!("deeper-{turn}"), json!({ "depth": 10 })),
        ),
        (
            "limits.name_bytes",
            |c| c.limits.name_bytes = 8,
            |turn| Asked::Create(format!("seven-{turn:02}"), json!({ "depth": 4 })),
            |turn| Asked::Create(format!("seven-{turn:03}"), json!({ "depth": 4 })),
        ),
        (
            "limits.name_bytes",
            |c| c.limits.name_bytes = 8,
            |turn| Asked::Snapshot(format!("seven-{turn:02}")),
            |turn| Asked::Snapshot(format!("seven-{turn:03}")),
        ),
        (
            "limits.name_bytes",
            |c| c.limits.name_bytes = 8,
            |turn| robot(&format!("seven-{turn:02}")),
            |turn| robot(&format!("seven-{turn:03}")),
        ),
        (
            "limits.name_bytes",
            |c| c.limits.name_bytes = 8,
            |turn| Asked::Create(format!("m{turn}"), json!({ "depth": 4, "sensors": { "sensor-8": {} } })),
            |turn| Asked::Create(format!("n{turn}"), json!({ "depth": 4, "sensors": { "sensor-09": {} } })),
        ),
        (
            "limits.maps",
            |c| c.limits.maps = 3,
            |turn| Asked::Create(format!("m{turn}"), json!({ "depth": 4 })),
            |turn| Asked::Create(format!("n{turn}"), json!({ "depth": 4 })),
        ),
        (
            "limits.robots_per_map",
            |c| c.limits.robots_per_map = 2,
            |turn| robot(&format!("r{turn}")),
            |turn| robot(&format!("s{turn}")),
        ),
        (
            "limits.snapshots",
            |c| c.limits.snapshots = 2,
            |turn| Asked::Snapshot(format!("r{turn}")),
            |turn| Asked::Snapshot(format!("s{turn}")),
        ),
    ]
}

#[test]
fn a_limit_is_met_one_above_its_value_and_names_its_setting() {
    for (setting, change, within, above) in cases().into_iter().chain(kept()) {
        let site = Site::with(change);
        // One place among the maps is the hall's.
        site.make_hall();
        for (transport, answer) in [(0, within(0).rest(&site)), (1, within(1).rpc(&site))] {
            assert_eq!(answer, Ok(()), "{setting}, transport {transport}, at its value");
        }
        let before = hits(&site, setting);
        for (transport, answer) in [(0, above(2).rest(&site)), (1, above(3).rpc(&site))] {
            let Err(detail) = answer else { panic!("{setting}, transport {transport}: taken above its value") };
            assert!(detail.contains(&format!("setting {setting}")), "{setting}, transport {transport}: {detail}");
        }
        assert!(hits(&site, setting) >= before + 2, "{setting} is not counted");
    }
}

#[test]
fn the_leaves_of_an_answer_are_limited_by_its_setting() {
    let site = Site::new().with_hall();
    assert_eq!(Asked::Insert(json!({ "scans": [ring("", None)] })).rest(&site), Ok(()));
    let count = site.get("/v1/maps/hall/region").json()["leaves"].as_array().unwrap().len();
    for (limit, fits) in [(count, true), (count - 1, false)] {
        let site = Site::with(|config| config.limits.leaves_per_answer = limit).with_hall();
        assert_eq!(Asked::Insert(json!({ "scans": [ring("", None)] })).rest(&site), Ok(()));
        let before = hits(&site, "limits.leaves_per_answer");
        for fate in [Asked::Region.rest(&site), Asked::Region.rpc(&site)] {
            match fate {
                Ok(()) => assert!(fits, "{limit} of {count}"),
                Err(detail) => assert!(!fits && detail.contains("setting limits.leaves_per_answer"), "{detail}"),
            }
        }
        assert!(fits || hits(&site, "limits.leaves_per_answer") >= before + 2);
    }
}

#[test]
fn every_limit_is_shown_by_the_metrics_before_it_is_met() {
    let site = Site::new();
    for setting in LIMITS {
        let _ = hits(&site, setting);
    }
    let text = String::from_utf8(site.get("/metrics").body).unwrap();
    assert!(text.contains("# HELP ubbmap_limit_hits_total"));
}

#[test]
fn every_limit_is_a_setting() {
    let known = serde_json::to_value(Config::default()).unwrap();
    for setting in LIMITS {
        let (section, name) = setting.split_once('.').unwrap();
        assert!(known[section].get(name).is_some(), "{setting} is no setting");
    }
    // Those of the section that are not met by anybody, since whoever is too many waits.
    let waits = ["queries", "scans_per_stream", "requests_per_connection"];
    for name in known["limits"].as_object().unwrap().keys() {
        let counted = LIMITS.contains(&format!("limits.{name}").as_str());
        assert!(counted != waits.contains(&name.as_str()), "limits.{name}");
    }
}

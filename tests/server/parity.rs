//! One table of cases over REST, gRPC and Zenoh: the decoded answers are equal, and so are the errors.

#![allow(clippy::unwrap_used, clippy::panic, clippy::needless_pass_by_value, reason = "tests")]

use crate::http_support::Site;
use crate::parity_support::{Call, Kind, Outcome, TRANSPORTS, Transport};
use crate::service_support::{TestStore, Writes, applied, config, map_name, ring as scan_input};
use serde_json::{Value, json};
use std::collections::BTreeSet;
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::Duration;
use ubbmap::config::Config;
use ubbmap::service::ErrorKind;
use ubbmap::store::{LoadedMap, write_map_file};
use ubbmap::wire::v1;

/// Limits low enough to be passed.
fn low(config: &mut Config) {
    config.limits.scans_per_request = 3;
    config.limits.points_per_query = 4;
    config.limits.regions_per_query = 2;
    config.limits.leaves_per_answer = 50;
    config.limits.cells_per_answer = 3000;
    config.limits.maps = 2;
    config.limits.snapshots = 2;
    config.limits.import_bytes = 20_000;
    config.limits.body_bytes = 20_000;
    config.limits.config_bytes = 20_000;
}

fn from<T: serde::de::DeserializeOwned>(value: Value) -> T {
    serde_json::from_value(value).unwrap()
}

fn scan(sequence: u64) -> Value {
    crate::http_support::ring("amr-7", Some(sequence))
}

fn scans(list: Vec<Value>) -> Call {
    Call::InsertScans(from(json!({"map": "hall", "scans": list})))
}

fn create(map: &str, config: Value) -> Call {
    Call::CreateMap(from(json!({"map": map, "config": config})))
}

fn free(regions: Vec<Value>, tolerance: u32) -> Call {
    Call::CheckGuaranteedFree(from(json!({"map": "hall", "regions": regions, "tolerance": tolerance})))
}

fn disc(x: f64) -> Value {
    json!({"disc": {"center": {"x": x, "y": 0}, "radius": 0.4}})
}

const HALL: &str = r#"{"depth": 8, "min_obstacle_width": 0.1, "sensors": {"default": {"range_max": 10}}}"#;

/// Cases that are answered, in an order in which each finds what it needs.
fn answered() -> Vec<Call> {
    let hall: Value = serde_json::from_str(HALL).unwrap();
    let mut wide = scan(5);
    wide["pose"]["x"] = json!({"min": 0, "max": 3});
    let mut unnumbered = scan(0);
    unnumbered.as_object_mut().unwrap().remove("sequence");
    let path = json!({"path": {"points": [{"x": 0, "y": 0}, {"x": 5, "y": 0}], "radius": 0.35}});
    let polygon = json!({"polygon": {"points": [{"x": 0, "y": 0}, {"x": 1, "y": 0}, {"x": 0, "y": 1}]}});
    vec![
        create("hall", hall.clone()),
        create("hall", hall),
        create("plain", json!({})),
        scans(vec![scan(1), scan(2)]),
        scans(vec![scan(2), wide, unnumbered]),
        scans(vec![]),
        Call::GetMap(from(json!({"map": "hall"}))),
        Call::ListMaps,
        Call::GetClasses(from(
            json!({"map": "hall", "points": [{"x": 0, "y": 0}, {"x": 3, "y": 0}, {"x": 99, "y": 0}]}),
        )),
        Call::GetClasses(from(json!({"map": "hall", "points": [{"x": 1, "y": 1}], "depth": 3}))),
        Call::GetRegion(from(json!({"map": "hall", "depth": 2}))),
        Call::GetRegion(from(json!({"map": "hall", "min_x": 0, "max_x": 0.5, "min_y": -0.25, "max_y": 0}))),
        Call::GetGrid(from(json!({"map": "hall", "depth": 5}))),
        Call::GetGrid(from(json!({"map": "hall", "min_x": 1, "max_x": 4, "min_y": 1, "max_y": 4}))),
        Call::GetTile(from(json!({"map": "hall", "z": 1, "x": 1, "y": 0}))),
        free(vec![disc(0.0), disc(3.0)], 0),
        free(vec![path, polygon], 1),
        Call::GetChanges(from(json!({"map": "hall", "since": 0}))),
        Call::GetChanges(from(json!({"map": "hall", "since": 1, "contents": true, "depth": 4, "min_x": 0.5}))),
        Call::GetChanges(from(json!({"map": "hall", "since": 77}))),
        Call::GetRegion(from(json!({"map": "hall", "depth": 3, "blocks": true, "min_x": 0.5}))),
        Call::ListRobots(from(json!({"map": "hall"}))),
        Call::ListRobots(from(json!({"map": "plain"}))),
        Call::DeleteMap(from(json!({"map": "plain"}))),
        Call::ListMaps,
    ]
}

/// The same for snapshots and files, behind [`answered`].
fn answered_kept() -> Vec<Call> {
    let named = |name: &str| json!({"map": "hall", "name": name});
    vec![
        Call::ListSnapshots(from(json!({"map": "hall"}))),
        Call::CreateSnapshot(from(named("one"))),
        scans(vec![scan(7)]),
        Call::CreateSnapshot(from(named("Two.2"))),
        Call::ListSnapshots(from(json!({"map": "hall"}))),
        Call::ExportMap(from(json!({"map": "hall"}))),
        Call::ExportMap(from(json!({"map": "hall", "format": "EXPORT_FORMAT_UBBMAP", "snapshot": "one"}))),
        Call::ExportMap(from(json!({"map": "hall", "format": "EXPORT_FORMAT_NAV2"}))),
        Call::ExportMap(from(
            json!({"map": "hall", "format": "EXPORT_FORMAT_NAV2", "depth": 4, "mode": "EXPORT_MODE_SCALE"}),
        )),
        Call::GetClasses(from(
            json!({"map": "hall", "snapshot": "one", "points": [{"x": 0, "y": 0}, {"x": 3, "y": 0}]}),
        )),
        Call::GetRegion(from(json!({"map": "hall", "snapshot": "one", "depth": 3, "blocks": true}))),
        Call::GetGrid(from(json!({"map": "hall", "snapshot": "one", "depth": 5}))),
        Call::GetTile(from(json!({"map": "hall", "snapshot": "Two.2", "z": 1, "x": 1, "y": 0}))),
        Call::CheckGuaranteedFree(from(json!({"map": "hall", "snapshot": "one", "regions": [disc(0.0), disc(3.0)]}))),
        Call::RestoreSnapshot(from(named("one"))),
        Call::GetMap(from(json!({"map": "hall"}))),
        Call::GetChanges(from(json!({"map": "hall", "since": 2, "contents": true, "depth": 4}))),
        Call::DeleteSnapshot(from(named("one"))),
        Call::ListSnapshots(from(json!({"map": "hall"}))),
        Call::ImportMap("copy".to_owned(), map_file(40)),
        Call::GetMap(from(json!({"map": "copy"}))),
        Call::GetGrid(from(json!({"map": "copy", "depth": 6}))),
        Call::ExportMap(from(json!({"map": "copy"}))),
    ]
}

/// A map file of some scans.
fn map_file(scans: u64) -> Vec<u8> {
    let scans: Vec<_> = (0..scans).map(|i| scan_input("", None, i as f64 * 0.1)).collect();
    let (config, mut bytes) = (config(), Vec::new());
    let map = LoadedMap { revision: 40, tree: applied(&config, &scans), windows: Default::default() };
    write_map_file(&mut bytes, &config, &map).unwrap();
    bytes
}

/// Cases that are refused, each with its code; the map `hall` is there and the limits are [`low`].
fn refused() -> Vec<(ErrorKind, Call)> {
    use ErrorKind as Kind;
    let box_of = |min_x: Value| json!({"box": {"min_x": min_x, "min_y": 0, "max_x": 1, "max_y": 1}});
    vec![
        (Kind::MapNotFound, Call::GetMap(from(json!({"map": "nowhere"})))),
        (Kind::MapNotFound, Call::DeleteMap(from(json!({"map": "nowhere"})))),
        (Kind::MapNotFound, Call::GetTile(from(json!({"map": "nowhere"})))),
        (Kind::MapNotFound, Call::GetChanges(from(json!({"map": "nowhere", "since": 0})))),
        (Kind::MapNotFound, Call::ListRobots(from(json!({"map": "nowhere"})))),
        (Kind::InvalidName, Call::ListRobots(from(json!({"map": "Hall"})))),
        (Kind::MapExists, create("hall", json!({"depth": 9}))),
        (Kind::InvalidName, Call::GetMap(from(json!({"map": "Hall"})))),
        (Kind::InvalidName, create("-a", json!({}))),
        (Kind::InvalidConfig, create("other", json!({"classes": 3}))),
        (Kind::InvalidConfig, create("other", json!({"sensors": {"a": {"range_error": {"minus": 100}}}}))),
        (Kind::InvalidRequest, Call::Broken(vec![0x12, 0x7f, 0])),
        (Kind::InvalidRegion, Call::GetRegion(from(json!({"map": "hall", "min_x": 1, "max_x": 0})))),
        (Kind::InvalidRegion, free(vec![json!({})], 0)),
        (Kind::InvalidRegion, free(vec![box_of(json!(1e308))], 0)),
        (Kind::InvalidRegion, free(vec![json!({"disc": {"center": {"x": 0}, "radius": 1}})], 0)),
        (Kind::InvalidPoint, Call::GetClasses(from(json!({"map": "hall", "points": [{"x": 0, "y": 0}, {"x": 1}]})))),
        (Kind::DepthOutOfRange, Call::GetGrid(from(json!({"map": "hall", "depth": 9})))),
        (Kind::DepthOutOfRange, Call::GetClasses(from(json!({"map": "hall", "points": [], "depth": 300})))),
        (Kind::TileOutOfRange, Call::GetTile(from(json!({"map": "hall", "z": 2, "x": 4, "y": 0})))),
        (Kind::RegionTooLarge, Call::GetRegion(from(json!({"map": "hall"})))),
        (Kind::RegionTooLarge, Call::GetGrid(from(json!({"map": "hall"})))),
        (
            Kind::TooManyPoints,
            Call::GetClasses(from(json!({"map": "hall", "points": vec![json!({"x": 0, "y": 0}); 5]}))),
        ),
        (Kind::TooManyRegions, free(vec![disc(0.0); 3], 0)),
        (Kind::TooManyScans, scans(vec![scan(1); 4])),
        (
            Kind::BodyTooLarge,
            scans(vec![{
                let mut long = scan(1);
                long["ranges"] = json!(vec![1.5; 6000]);
                long
            }]),
        ),
        (Kind::ToleranceTooHigh, free(vec![disc(0.0)], 4)),
        (Kind::RouteNotFound, Call::Nothing),
    ]
}

/// The same of snapshots and files; there are the snapshots `one` and `two`, and no more may be.
fn refused_kept() -> Vec<(ErrorKind, Call)> {
    use ErrorKind as Kind;
    let named = |map: &str, name: &str| json!({"map": map, "name": name});
    let export = |more: Value| {
        let mut request = json!({"map": "hall"});
        request.as_object_mut().unwrap().extend(more.as_object().unwrap().clone());
        Call::ExportMap(from(request))
    };
    let file = map_file(3);
    let mut changed = file.clone();
    changed[60] ^= 1;
    let import = |map: &str, file: &[u8]| Call::ImportMap(map.to_owned(), file.to_vec());
    vec![
        (Kind::MapNotFound, Call::CreateSnapshot(from(named("nowhere", "a")))),
        (Kind::MapNotFound, Call::ListSnapshots(from(json!({"map": "nowhere"})))),
        (Kind::MapNotFound, Call::RestoreSnapshot(from(named("nowhere", "a")))),
        (Kind::MapNotFound, Call::DeleteSnapshot(from(named("nowhere", "a")))),
        (Kind::MapNotFound, Call::ExportMap(from(json!({"map": "nowhere"})))),
        (Kind::SnapshotNotFound, Call::RestoreSnapshot(from(named("hall", "three")))),
        (Kind::SnapshotNotFound, Call::DeleteSnapshot(from(named("hall", "three")))),
        (Kind::SnapshotNotFound, export(json!({"snapshot": "three"}))),
        (Kind::SnapshotNotFound, Call::GetClasses(from(json!({"map": "hall", "snapshot": "three", "points": []})))),
        (Kind::SnapshotNotFound, Call::GetRegion(from(json!({"map": "hall", "snapshot": "three"})))),
        (Kind::SnapshotNotFound, Call::GetGrid(from(json!({"map": "hall", "snapshot": "three"})))),
        (Kind::SnapshotNotFound, Call::GetTile(from(json!({"map": "hall", "snapshot": "three"})))),
        (Kind::SnapshotNotFound, Call::CheckGuaranteedFree(from(json!({"map": "hall", "snapshot": "three"})))),
        (Kind::InvalidName, Call::GetGrid(from(json!({"map": "hall", "snapshot": "-a"})))),
        (Kind::InvalidName, Call::GetTile(from(json!({"map": "hall", "snapshot": "-a"})))),
        (Kind::RegionTooLarge, Call::GetGrid(from(json!({"map": "hall", "snapshot": "one"})))),
        (Kind::SnapshotExists, Call::CreateSnapshot(from(named("hall", "one")))),
        (Kind::TooManySnapshots, Call::CreateSnapshot(from(named("hall", "three")))),
        (Kind::InvalidName, Call::CreateSnapshot(from(named("hall", "a b")))),
        (Kind::InvalidName, Call::CreateSnapshot(from(named("hall", "")))),
        (Kind::InvalidName, Call::RestoreSnapshot(from(named("hall", "-a")))),
        (Kind::InvalidName, Call::DeleteSnapshot(from(named("hall", "-a")))),
        (Kind::InvalidName, export(json!({"snapshot": "-a"}))),
        (Kind::InvalidName, import("Hall", &file)),
        (Kind::InvalidRequest, export(json!({"depth": 3}))),
        (Kind::InvalidRequest, export(json!({"mode": "EXPORT_MODE_SCALE"}))),
        (Kind::DepthOutOfRange, export(json!({"format": "EXPORT_FORMAT_NAV2", "depth": 9}))),
        (Kind::RegionTooLarge, export(json!({"format": "EXPORT_FORMAT_NAV2"}))),
        (Kind::MapExists, import("hall", &file)),
        (Kind::InvalidFile, import("copy", b"")),
        (Kind::InvalidFile, import("copy", &file[..file.len() - 3])),
        (Kind::InvalidFile, import("copy", &changed)),
        (Kind::BodyTooLarge, import("copy", &[0; 30_000])),
    ]
}

/// A server of each transport with the map `hall`.
fn sites(change: impl Fn(&mut Config)) -> Vec<(Transport, Site)> {
    let site = |kind| {
        let site = Site::on_zenoh(&change);
        (Transport::new(kind, &site), site)
    };
    TRANSPORTS.map(site).into()
}

/// Holds that all transports told the same, and gives it.
#[track_caller]
fn same(what: &str, told: Vec<Outcome>) -> Outcome {
    for (kind, outcome) in TRANSPORTS.iter().zip(&told) {
        assert_eq!(outcome, &told[0], "{what} over {kind:?}");
    }
    told.into_iter().next().unwrap()
}

/// The one outcome of a call on all transports. Where one does not have it, its site is called by REST, so that what
/// follows finds the same there.
#[track_caller]
fn told(sites: &[(Transport, Site)], call: &Call) -> Outcome {
    let ask = |(kind, (transport, site)): (&Kind, &(Transport, Site))| {
        if call.is_on(*kind) { transport.call(site, call) } else { Transport::Rest.call(site, call) }
    };
    same(&format!("{call:?}"), TRANSPORTS.iter().zip(sites).map(ask).collect())
}

#[test]
fn answers_are_equal_on_all_transports() {
    let sites = sites(|_| {});
    for (_, site) in &sites {
        // Made anew by the first case.
        assert_eq!(site.send("DELETE", "/v1/maps/hall", &[], b"").status, 204);
    }
    for call in answered().into_iter().chain(answered_kept()) {
        let outcome = told(&sites, &call);
        assert!(outcome.is_ok(), "{call:?}: {outcome:?}");
    }
}

#[test]
fn refusals_are_equal_on_all_transports() {
    let sites = sites(low);
    for (_, site) in &sites {
        assert_eq!(site.post("/v1/maps/hall/scans", &scan(1).to_string()).json()["applied"], 1);
        for name in ["one", "two"] {
            let request = json!({"name": name}).to_string();
            assert_eq!(site.post("/v1/maps/hall/snapshots", &request).status, 201);
        }
    }
    let before: Vec<_> = sites.iter().map(|(_, site)| site.get("/v1/maps/hall").json()["revision"].clone()).collect();
    for (kind, call) in refused().into_iter().chain(refused_kept()) {
        let refusal = told(&sites, &call).unwrap_err();
        assert_eq!(refusal.code, kind.code(), "{call:?}: {refusal:?}");
    }
    let filled = create("second", json!({}));
    let full = create("third", json!({}));
    for (transport, site) in &sites {
        transport.call(site, &filled).unwrap();
    }
    assert_eq!(told(&sites, &full).unwrap_err().code, "TOO_MANY_MAPS");
    assert_eq!(told(&sites, &Call::ImportMap("third".to_owned(), map_file(3))).unwrap_err().code, "TOO_MANY_MAPS");
    let after: Vec<_> = sites.iter().map(|(_, site)| site.get("/v1/maps/hall").json()["revision"].clone()).collect();
    assert_eq!(before, after, "a refusal changed a map");
}

/// A kind of error, the settings and the trouble that bring an insertion to it.
type Trouble = (ErrorKind, fn(&mut Config), fn(&Site));

/// What the server is brought to, and the error that an insertion then is.
fn troubles() -> Vec<Trouble> {
    vec![
        (
            ErrorKind::Busy,
            |config| config.writer.queue = 1,
            |site| {
                site.store.hold();
                let service = site.server.as_ref().unwrap().service().clone();
                // One in the commit that hangs, one in the queue.
                for robot in ["a", "b"] {
                    let service = service.clone();
                    site.runtime.spawn(async move {
                        service.insert_when_free(&map_name("hall"), vec![scan_input(robot, Some(1), 0.0)]).await
                    });
                    while site.store.waiting.load(Ordering::SeqCst) == 0 {
                        std::thread::sleep(Duration::from_millis(5));
                    }
                }
                std::thread::sleep(Duration::from_millis(200));
            },
        ),
        (ErrorKind::Timeout, |config| config.limits.request_seconds = 0.3, |site| site.store.hold()),
        (ErrorKind::ShuttingDown, |_| {}, |site| site.run(site.server.as_ref().unwrap().service().drain())),
        (ErrorKind::StoreFailed, |_| {}, |site| site.store.set_writes(Writes::FailStop)),
        (ErrorKind::Internal, |_| {}, |site| site.store.set_writes(Writes::PanicOnce)),
    ]
}

#[test]
fn troubles_of_the_server_are_equal_on_all_transports() {
    for (kind, settings, trouble) in troubles() {
        let sites = sites(settings);
        let call = scans(vec![scan(1)]);
        let mut told = Vec::new();
        for (transport, site) in &sites {
            // A map that is loaded: the store holds up loading too.
            assert_eq!(site.get("/v1/maps/hall").status, 200);
            trouble(site);
            told.push(transport.call(site, &call));
            site.store.release();
        }
        assert_eq!(same(kind.code(), told).unwrap_err().code, kind.code());
    }
}

#[test]
fn a_damaged_map_is_the_same_on_all_transports() {
    let mut told = Vec::new();
    for kind in TRANSPORTS {
        let store = TestStore::new();
        drop(Site::over(Arc::clone(&store), |_| {}).with_hall());
        store.damage(&map_name("hall"));
        let site = Site::over(store, crate::zenoh_support::router);
        let transport = Transport::new(kind, &site);
        told.push(transport.call(&site, &Call::GetMap(v1::GetMapRequest { map: "hall".to_owned() })));
    }
    assert_eq!(same("a damaged map", told).unwrap_err().code, "MAP_DAMAGED");
}

/// Kinds that not every transport knows, and where their tests are.
const ELSEWHERE: [ErrorKind; 7] = [
    ErrorKind::Unauthenticated,      // access_routes
    ErrorKind::PermissionDenied,     // access_routes
    ErrorKind::UnsupportedMediaType, // http_scans
    ErrorKind::NotAcceptable,        // http_queries
    ErrorKind::MethodNotAllowed,     // http_system
    ErrorKind::AnotherServer,        // zenoh_calls
    ErrorKind::TlsRequired,          // tls_calls
];

/// Every kind; one that is added does not compile until it has its place here.
fn every_kind() -> Vec<ErrorKind> {
    use ErrorKind as Kind;
    let next = |kind: Kind| match kind {
        Kind::MapNotFound => Some(Kind::MapExists),
        Kind::MapExists => Some(Kind::SnapshotNotFound),
        Kind::SnapshotNotFound => Some(Kind::SnapshotExists),
        Kind::SnapshotExists => Some(Kind::InvalidName),
        Kind::InvalidName => Some(Kind::InvalidConfig),
        Kind::InvalidConfig => Some(Kind::InvalidRequest),
        Kind::InvalidRequest => Some(Kind::InvalidRegion),
        Kind::InvalidRegion => Some(Kind::InvalidPoint),
        Kind::InvalidPoint => Some(Kind::DepthOutOfRange),
        Kind::DepthOutOfRange => Some(Kind::TileOutOfRange),
        Kind::TileOutOfRange => Some(Kind::RegionTooLarge),
        Kind::RegionTooLarge => Some(Kind::TooManyPoints),
        Kind::TooManyPoints => Some(Kind::TooManyRegions),
        Kind::TooManyRegions => Some(Kind::TooManyScans),
        Kind::TooManyScans => Some(Kind::TooManyMaps),
        Kind::TooManyMaps => Some(Kind::TooManySnapshots),
        Kind::TooManySnapshots => Some(Kind::InvalidFile),
        Kind::InvalidFile => Some(Kind::BodyTooLarge),
        Kind::BodyTooLarge => Some(Kind::ToleranceTooHigh),
        Kind::ToleranceTooHigh => Some(Kind::UnsupportedMediaType),
        Kind::UnsupportedMediaType => Some(Kind::NotAcceptable),
        Kind::NotAcceptable => Some(Kind::MethodNotAllowed),
        Kind::MethodNotAllowed => Some(Kind::RouteNotFound),
        Kind::RouteNotFound => Some(Kind::Unauthenticated),
        Kind::Unauthenticated => Some(Kind::PermissionDenied),
        Kind::PermissionDenied => Some(Kind::Busy),
        Kind::Busy => Some(Kind::ShuttingDown),
        Kind::ShuttingDown => Some(Kind::Timeout),
        Kind::Timeout => Some(Kind::AnotherServer),
        Kind::AnotherServer => Some(Kind::TlsRequired),
        Kind::TlsRequired => Some(Kind::MapDamaged),
        Kind::MapDamaged => Some(Kind::StoreFailed),
        Kind::StoreFailed => Some(Kind::Internal),
        Kind::Internal => None,
    };
    std::iter::successors(Some(Kind::MapNotFound), |kind| next(*kind)).collect()
}

#[test]
fn every_kind_of_error_is_in_the_table() {
    let mut covered: BTreeSet<&str> = refused().iter().chain(&refused_kept()).map(|(kind, _)| kind.code()).collect();
    covered.extend(troubles().iter().map(|(kind, ..)| kind.code()));
    covered.extend([ErrorKind::TooManyMaps, ErrorKind::MapDamaged].map(ErrorKind::code));
    covered.extend(ELSEWHERE.map(ErrorKind::code));
    let every: BTreeSet<&str> = every_kind().into_iter().map(ErrorKind::code).collect();
    assert_eq!(covered, every);
}

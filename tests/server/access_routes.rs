//! Every route of REST and every method of gRPC asks who is there, what they may do, and with which map.

#![allow(clippy::unwrap_used, reason = "a test may end where its ground is not as it should be")]

use crate::access_support::Gate;
use crate::http_support::{Answer, Site, ring};
use prost::Message;
use std::collections::BTreeSet;
use ubbmap::transport::access::{Operation, Reach, Role};
use ubbmap::wire::v1;

/// Routes as the router writes them, with a request for the map `hall` that succeeds, and its operation.
const ROUTES: [(&str, &str, &str, Operation); 20] = [
    ("GET", "/v1/maps/{map}", "/v1/maps/hall", Operation::GetMap),
    ("PUT", "/v1/maps/{map}", "/v1/maps/hall", Operation::CreateMap),
    ("POST", "/v1/maps/{map}/scans", "/v1/maps/hall/scans", Operation::InsertScans),
    ("POST", "/v1/maps/{map}/classes", "/v1/maps/hall/classes", Operation::GetClasses),
    ("POST", "/v1/maps/{map}/guaranteed-free", "/v1/maps/hall/guaranteed-free", Operation::CheckGuaranteedFree),
    ("GET", "/v1/maps/{map}/region", "/v1/maps/hall/region", Operation::GetRegion),
    ("GET", "/v1/maps/{map}/grid", "/v1/maps/hall/grid", Operation::GetGrid),
    ("GET", "/v1/maps/{map}/changes", "/v1/maps/hall/changes?since=0", Operation::GetChanges),
    ("GET", "/v1/maps/{map}/events", "/v1/maps/hall/events", Operation::WatchMap),
    ("GET", "/v1/maps/{map}/tiles/{z}/{x}/{y}", "/v1/maps/hall/tiles/0/0/0.png", Operation::GetTile),
    ("GET", "/v1/maps/{map}/robots", "/v1/maps/hall/robots", Operation::ListRobots),
    ("GET", "/v1/maps/{map}/snapshots", "/v1/maps/hall/snapshots", Operation::ListSnapshots),
    ("POST", "/v1/maps/{map}/snapshots", "/v1/maps/hall/snapshots", Operation::CreateSnapshot),
    (
        "POST",
        "/v1/maps/{map}/snapshots/{name}/restore",
        "/v1/maps/hall/snapshots/a/restore",
        Operation::RestoreSnapshot,
    ),
    ("DELETE", "/v1/maps/{map}/snapshots/{name}", "/v1/maps/hall/snapshots/a", Operation::DeleteSnapshot),
    ("GET", "/v1/maps/{map}/export", "/v1/maps/hall/export", Operation::ExportMap),
    ("PUT", "/v1/maps/{map}/import", "/v1/maps/hall/import", Operation::ImportMap),
    ("DELETE", "/v1/maps/{map}", "/v1/maps/hall", Operation::DeleteMap),
    ("GET", "/v1/maps", "/v1/maps", Operation::ListMaps),
    ("GET", "/metrics", "/metrics", Operation::ReadMetrics),
];

/// Routes that are for everybody.
const OPEN: [&str; 5] = ["/", "/docs", "/openapi.json", "/healthz", "/readyz"];

fn body(operation: Operation) -> String {
    match operation {
        Operation::CreateMap => {
            r#"{"depth": 8, "min_obstacle_width": 0.1, "sensors": {"default": {"range_max": 10}}}"#.to_owned()
        }
        Operation::InsertScans => ring("r", Some(1)).to_string(),
        Operation::GetClasses => r#"{"points": [{"x": 0, "y": 0}]}"#.to_owned(),
        Operation::CheckGuaranteedFree => {
            r#"{"regions": [{"disc": {"center": {"x": 0, "y": 0}, "radius": 1}}]}"#.to_owned()
        }
        Operation::CreateSnapshot => r#"{"name": "a"}"#.to_owned(),
        _ => String::new(),
    }
}

fn ask(gate: &Gate, name: &str, (method, _, path, operation): (&str, &str, &str, Operation)) -> Answer {
    // A form that no answer has: a stream would never end. It is looked at behind the question who asks.
    let headers: &[_] = if operation == Operation::WatchMap { &[("accept", "image/png")] } else { &[] };
    gate.send_to(&gate.site.url(), name, method, path, headers, body(operation).as_bytes())
}

/// The holder of the role below, if there is one.
fn below(role: Role) -> Option<&'static str> {
    match role {
        Role::Read => None,
        Role::Write => Some("reader"),
        Role::Admin => Some("writer"),
    }
}

fn least(role: Role) -> &'static str {
    match role {
        Role::Read => "reader",
        Role::Write => "writer",
        Role::Admin => "admin",
    }
}

#[test]
fn every_route_asks_for_a_token_a_role_and_a_map() {
    let gate = Gate::new();
    for route in ROUTES {
        let (role, reach) = route.3.needs();
        let (_, detail) = ask(&gate, "", route).problem(401, "UNAUTHENTICATED");
        assert!(detail.contains("Authorization: Bearer"), "{route:?}: {detail}");
        assert_eq!(ask(&gate, "", route).header("www-authenticate"), Some("Bearer realm=\"ubbmap\""), "{route:?}");
        let (field, detail) = ask(&gate, "late", route).problem(401, "UNAUTHENTICATED");
        assert!(field == "authorization" && detail.contains("expired at 2020-01-01"), "{route:?}: {detail}");
        if let Some(lower) = below(role) {
            let (_, detail) = ask(&gate, lower, route).problem(403, "PERMISSION_DENIED");
            assert!(detail.contains(lower) && detail.contains(&format!("takes {role}")), "{route:?}: {detail}");
        }
        if reach != Reach::Visible {
            let (_, detail) = ask(&gate, "elsewhere", route).problem(403, "PERMISSION_DENIED");
            assert!(detail.contains("its maps are attic, cellar-*"), "{route:?}: {detail}");
        }
        let answer = ask(&gate, least(role), route);
        let told = (route.3 != Operation::ReadMetrics).then(|| role.word());
        assert_eq!(answer.header("ubbmap-role"), told, "{route:?}");
        // An import is not made of nothing, and a watch has no such form; both come after the question who asks.
        let expected = match route.3 {
            Operation::ImportMap => 400..410,
            Operation::WatchMap => 406..407,
            _ => 200..300,
        };
        assert!(expected.contains(&answer.status), "{route:?}: {answer:?}");
    }
    for path in OPEN {
        assert_eq!(gate.send("", "GET", path, b"").status, 200, "{path}");
        assert_eq!(gate.send("late", "GET", path, b"").status, 200, "{path}");
    }
}

#[test]
fn the_walk_over_the_routes_leaves_none_out() {
    // The router is made of the table that this description is written from; another test holds them together.
    let description: serde_json::Value = serde_json::from_str(include_str!("../../docs/openapi.json")).unwrap();
    let mut found = BTreeSet::new();
    for (path, operations) in description["paths"].as_object().unwrap() {
        for method in ["get", "put", "post", "delete"].into_iter().filter(|method| operations.get(method).is_some()) {
            found.insert((method.to_uppercase(), path.replace(".{ending}", "")));
        }
    }
    assert!(found.len() > 20, "{found:?}");
    let known: BTreeSet<_> = ROUTES
        .iter()
        .map(|(method, path, ..)| ((*method).to_owned(), (*path).to_owned()))
        .chain(OPEN.map(|path| ("GET".to_owned(), path.to_owned())))
        .collect();
    assert_eq!(found, known);
    // And every operation has one.
    let operations: BTreeSet<_> = ROUTES.iter().map(|route| route.3.method()).collect();
    for operation in Operation::METHODS {
        assert!(operation == Operation::StreamScans || operations.contains(operation.method()), "{operation:?}");
    }
}

/// A call by gRPC-Web with one message: its code.
fn call(gate: &Gate, name: &str, method: &str, message: &[u8]) -> u32 {
    let path = format!("/ubbmap.v1.MapService/{method}");
    let body = [&[0], &u32::try_from(message.len()).unwrap().to_be_bytes()[..], message].concat();
    let headers = [("content-type", "application/grpc-web+proto")];
    let answer = gate.send_to(&gate.site.url(), name, "POST", &path, &headers, &body);
    assert_eq!(answer.status, 200, "{answer:?}");
    let trailers = String::from_utf8_lossy(&answer.body).into_owned();
    let code = |text: &str| text.split("grpc-status:").nth(1).map(|rest| rest.trim_start().to_owned());
    let text = answer.header("grpc-status").map(str::to_owned).or_else(|| code(&trailers)).unwrap();
    text.chars().take_while(char::is_ascii_digit).collect::<String>().parse().unwrap()
}

fn message(operation: Operation) -> Vec<u8> {
    let map = "hall".to_owned();
    let scan = crate::grpc_support::ring("r", None);
    match operation {
        Operation::CreateMap => {
            let config = serde_json::from_str(&body(operation)).unwrap();
            v1::CreateMapRequest { map, config: Some(config) }.encode_to_vec()
        }
        Operation::InsertScans => v1::InsertScansRequest { map, scans: vec![scan] }.encode_to_vec(),
        Operation::StreamScans => v1::StreamScansRequest { map, scan: Some(scan) }.encode_to_vec(),
        Operation::CreateSnapshot | Operation::RestoreSnapshot | Operation::DeleteSnapshot => {
            v1::CreateSnapshotRequest { map, name: "a".to_owned() }.encode_to_vec()
        }
        Operation::ListMaps => Vec::new(),
        // A watch of a box that is none ends at once, behind the question who asks.
        Operation::WatchMap => {
            v1::WatchMapRequest { map, min_x: Some(1.0), max_x: Some(0.0), ..Default::default() }.encode_to_vec()
        }
        // The map is the first field of all the others.
        _ => v1::GetMapRequest { map }.encode_to_vec(),
    }
}

#[test]
fn every_method_of_grpc_asks_for_a_token_a_role_and_a_map() {
    let (unauthenticated, denied) = (16, 7);
    let gate = Gate::new();
    let mut methods = Operation::METHODS.to_vec();
    // The map is needed by the others.
    methods.sort_by_key(|operation| *operation == Operation::DeleteMap);
    for operation in methods {
        let (role, reach) = operation.needs();
        let code = |name: &str| call(&gate, name, operation.method(), &message(operation));
        assert_eq!(code(""), unauthenticated, "{operation:?}");
        assert_eq!(code("late"), unauthenticated, "{operation:?}");
        if let Some(lower) = below(role) {
            assert_eq!(code(lower), denied, "{operation:?}");
        }
        if reach != Reach::Visible {
            assert_eq!(code("elsewhere"), denied, "{operation:?}");
        }
        let allowed = code(least(role));
        let expected: &[u32] = match operation {
            // Made of nothing; of a box that is none.
            Operation::ImportMap | Operation::WatchMap => &[3, 6],
            _ => &[0],
        };
        assert!(expected.contains(&allowed), "{operation:?}: {allowed}");
    }
    // The methods of the interface's own description are those of the table.
    let proto = include_str!("../../proto/ubbmap/v1/service.proto");
    let described: BTreeSet<_> =
        proto.lines().filter_map(|line| line.trim().strip_prefix("rpc ")?.split('(').next()).collect();
    assert_eq!(described, Operation::METHODS.iter().map(|operation| operation.method()).collect());
}

#[test]
fn a_server_on_loopback_without_tokens_asks_nothing() {
    let site = Site::hall();
    let headers = [("authorization", "Bearer of-another-server")];
    assert_eq!(site.send("GET", "/v1/maps/hall", &headers, b"").status, 200);
    assert_eq!(site.get("/metrics").status, 200);
    assert_eq!(site.get("/readyz").json(), serde_json::json!({"status": "ready"}));
}

//! Whole requests of REST against a server with one map in memory: path, parameters, headers and body. No panic, no answer
//! that blames the server, and every refusal is a problem with a code.
#![no_main]

use arbitrary::Arbitrary;
use axum::body::Body;
use axum::http::{Request, StatusCode, header};
use http_body_util::BodyExt;
use libfuzzer_sys::fuzz_target;
use std::sync::{Arc, OnceLock};
use std::time::Duration;
use tower::ServiceExt;
use ubbmap::service::{MapService, ServiceSettings};
use ubbmap::store::MemoryStore;
use ubbmap::transport::access::{Access, Guarded};
use ubbmap::transport::door::{Door, DoorSettings};
use ubbmap::transport::http::{self, HttpSettings, OutsideView};

#[derive(Debug, Arbitrary)]
struct Input<'a> {
    method: u8,
    route: u8,
    /// What stands in the path where a route has a part of the client's.
    part: &'a str,
    query: &'a str,
    accept: u8,
    kind: u8,
    gzip: bool,
    body: &'a [u8],
}

const METHODS: [&str; 6] = ["GET", "POST", "PUT", "DELETE", "HEAD", "PATCH"];
const ROUTES: [&str; 16] = [
    "/v1/maps",
    "/v1/maps/{}",
    "/v1/maps/m/scans",
    "/v1/maps/m/classes",
    "/v1/maps/m/guaranteed-free",
    "/v1/maps/m/region",
    "/v1/maps/m/grid",
    "/v1/maps/m/changes",
    "/v1/maps/m/tiles/{}",
    "/v1/maps/m/tiles/8/128/{}",
    "/v1/maps/m/snapshots",
    "/v1/maps/m/snapshots/{}",
    "/v1/maps/m/snapshots/{}/restore",
    "/v1/maps/m/export",
    "/v1/maps/{}/import",
    "/{}",
];
const KINDS: [&str; 6] = [
    "application/json",
    "application/x-ndjson",
    "application/x-protobuf",
    "application/octet-stream",
    "text/plain",
    "",
];
const ACCEPTS: [&str; 6] =
    ["*/*", "application/json", "image/png", "application/x-npy", "application/x-protobuf", "a/b;q=x"];

struct Site {
    runtime: tokio::runtime::Runtime,
    router: axum::Router,
}

fn router() -> axum::Router {
    let settings = ServiceSettings {
        max_maps: 64,
        max_snapshots: 16,
        max_robots: 64,
        max_import_bytes: 1 << 16,
        max_cells: 1 << 16,
        max_leaves: 1 << 14,
        ..ServiceSettings::default()
    };
    let service = MapService::open(Arc::new(MemoryStore::new()), settings).expect("a service over an empty store");
    let patience = Duration::from_secs(20);
    let door = Door::new(DoorSettings {
        requests: 16,
        insertions: 12,
        streams: 4096,
        streams_per_client: 4096,
        connections_per_client: 16,
        header_bytes: 1 << 14,
        incoming_bytes: 1 << 20,
        answer_bytes: 1 << 24,
        transfers: 4,
        request_timeout: patience,
        transfer_timeout: patience,
        idle_timeout: patience,
    });
    let limits =
        HttpSettings { body_bytes: 1 << 16, config_bytes: 1 << 14, import_bytes: 1 << 16, scans_per_stream: 4 };
    let outside = OutsideView { metrics: Box::new(String::new), reachable: Box::new(|| true) };
    http::router(Guarded::new(service, Access::open(false)), limits, door, outside)
}

fn site() -> &'static Site {
    static SITE: OnceLock<Site> = OnceLock::new();
    SITE.get_or_init(|| {
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().expect("a runtime");
        let router = runtime.block_on(async { router() });
        let request = Request::put("/v1/maps/m").body(Body::empty()).expect("a request");
        let created = runtime.block_on(router.clone().oneshot(request)).expect("an answer");
        assert_eq!(created.status(), StatusCode::CREATED);
        Site { runtime, router }
    })
}

fuzz_target!(|input: Input<'_>| {
    let method = METHODS[usize::from(input.method) % METHODS.len()];
    let path = ROUTES[usize::from(input.route) % ROUTES.len()].replace("{}", input.part);
    // The one map stays.
    if method == "DELETE" && path == "/v1/maps/m" {
        return;
    }
    let uri = if input.query.is_empty() { path } else { format!("{path}?{}", input.query) };
    let mut request = Request::builder()
        .method(method)
        .uri(&uri)
        .header(header::ACCEPT, ACCEPTS[usize::from(input.accept) % ACCEPTS.len()]);
    let kind = KINDS[usize::from(input.kind) % KINDS.len()];
    if !kind.is_empty() {
        request = request.header(header::CONTENT_TYPE, kind);
    }
    if input.gzip {
        request = request.header(header::CONTENT_ENCODING, "gzip");
    }
    let Ok(request) = request.body(Body::from(input.body.to_vec())) else { return };
    let site = site();
    site.runtime.block_on(async {
        let answer = site.router.clone().oneshot(request).await.expect("an answer");
        let status = answer.status();
        assert!(status.as_u16() < 500, "{method} {uri}: {status}");
        let kind = answer.headers().get(header::CONTENT_TYPE).cloned();
        if status.is_success() && kind.as_ref().is_some_and(|kind| kind == "text/event-stream") {
            return;
        }
        let body = answer.into_body().collect().await.expect("a body").to_bytes();
        if status.as_u16() >= 400 && method != "HEAD" {
            assert!(kind.is_some_and(|kind| kind == "application/problem+json"), "{method} {uri}: {status}");
            let problem: serde_json::Value = serde_json::from_slice(&body).expect("a problem is JSON");
            assert!(problem["code"].as_str().is_some_and(|code| !code.is_empty()), "{problem}");
        }
    });
});

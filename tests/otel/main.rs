//! Traces of the real binary, received by a collector: `cargo test --release --features otel --test otel`.
#![cfg(feature = "otel")]
#![allow(clippy::unwrap_used, clippy::panic, reason = "tests")]

use opentelemetry_proto::tonic::collector::trace::v1::trace_service_server::{TraceService, TraceServiceServer};
use opentelemetry_proto::tonic::collector::trace::v1::{ExportTraceServiceRequest, ExportTraceServiceResponse};
use opentelemetry_proto::tonic::common::v1::KeyValue;
use opentelemetry_proto::tonic::common::v1::any_value::Value;
use opentelemetry_proto::tonic::trace::v1::span::SpanKind;
use opentelemetry_proto::tonic::trace::v1::{Span, status::StatusCode};
use std::collections::BTreeMap;
use std::io::{BufRead, BufReader};
use std::process::{Child, Command, Stdio};
use std::sync::{Arc, Mutex};
use tonic::{Request, Response, Status};
use ubbmap::transport::grpc::generated::map_service_client::MapServiceClient;
use ubbmap::wire::v1;

/// A collector that keeps what it is sent.
#[derive(Debug, Clone, Default)]
struct Collector(Arc<Mutex<Vec<ExportTraceServiceRequest>>>);

#[tonic::async_trait]
impl TraceService for Collector {
    async fn export(
        &self,
        request: Request<ExportTraceServiceRequest>,
    ) -> Result<Response<ExportTraceServiceResponse>, Status> {
        self.0.lock().unwrap().push(request.into_inner());
        Ok(Response::new(ExportTraceServiceResponse::default()))
    }
}

fn attributes(all: &[KeyValue]) -> BTreeMap<String, String> {
    let text = |value: &Value| match value {
        Value::StringValue(text) => text.clone(),
        Value::IntValue(number) => number.to_string(),
        other => format!("{other:?}"),
    };
    let value =
        |pair: &KeyValue| pair.value.as_ref().and_then(|value| value.value.as_ref()).map(text).unwrap_or_default();
    all.iter().map(|pair| (pair.key.clone(), value(pair))).collect()
}

/// What the collector was sent: the services' names, and the spans by their names.
fn received(collector: &Collector) -> (Vec<String>, BTreeMap<String, Span>) {
    let requests = collector.0.lock().unwrap();
    let mut services = Vec::new();
    let mut spans = BTreeMap::new();
    for resource in requests.iter().flat_map(|request| &request.resource_spans) {
        services.push(attributes(&resource.resource.as_ref().unwrap().attributes)["service.name"].clone());
        let all = resource.scope_spans.iter().flat_map(|scope| &scope.spans);
        spans.extend(all.map(|span| (span.name.clone(), span.clone())));
    }
    (services, spans)
}

struct Server {
    child: Child,
    url: String,
}

impl Server {
    fn start(collector: &str, sampling: &str) -> Self {
        let mut command = Command::new(env!("CARGO_BIN_EXE_ubbmap"));
        command.env("UBBMAP_TELEMETRY__OTLP_ENDPOINT", collector).env("UBBMAP_TELEMETRY__SERVICE_NAME", "hall-server");
        command.env("UBBMAP_TELEMETRY__SAMPLING", sampling).env_remove("RUST_LOG");
        command.args(["serve", "--listen", "127.0.0.1:0", "--store", "memory", "--log", "warn"]);
        let mut child = command.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
        let mut line = String::new();
        BufReader::new(child.stdout.take().unwrap()).read_line(&mut line).unwrap();
        let url = line.trim().rsplit(' ').next().unwrap_or_default().to_owned();
        assert!(url.starts_with("http://127.0.0.1:"), "{line:?}");
        Self { child, url }
    }

    /// Ends it, and gives what it wrote to stderr.
    fn end(self) -> String {
        let pid = self.child.id().to_string();
        assert!(Command::new("kill").args(["-TERM", &pid]).status().unwrap().success());
        let output = self.child.wait_with_output().unwrap();
        assert!(output.status.success(), "{output:?}");
        String::from_utf8(output.stderr).unwrap()
    }
}

fn collect() -> (tokio::runtime::Runtime, Collector, String) {
    let runtime = tokio::runtime::Builder::new_multi_thread().enable_all().build().unwrap();
    let collector = Collector::default();
    let listener = runtime.block_on(tokio::net::TcpListener::bind("127.0.0.1:0")).unwrap();
    let url = format!("http://{}", listener.local_addr().unwrap());
    let router = tonic::service::Routes::new(TraceServiceServer::new(collector.clone())).into_axum_router();
    runtime.spawn(async move { axum::serve(listener, router).await });
    (runtime, collector, url)
}

fn get(url: &str, traceparent: Option<&str>) -> u16 {
    let agent: ureq::Agent = ureq::Agent::config_builder().http_status_as_error(false).build().into();
    let mut request = agent.get(url);
    if let Some(parent) = traceparent {
        request = request.header("traceparent", parent);
    }
    request.call().unwrap().status().as_u16()
}

const TRACE: &str = "0af7651916cd43dd8448eb211c80319c";

#[test]
fn requests_become_spans_of_the_callers_trace() {
    let (runtime, collector, endpoint) = collect();
    let server = Server::start(&endpoint, "1.0");
    assert_eq!(get(&format!("{}/v1/maps/none", server.url), Some(&format!("00-{TRACE}-b7ad6b7169203331-01"))), 404);
    assert_eq!(get(&format!("{}/v1/maps", server.url), None), 200);
    assert_eq!(
        get(&format!("{}/readyz", server.url), Some(&format!("00-{TRACE}-b7ad6b7169203331-00"))),
        200,
        "not sampled"
    );
    assert_eq!(get(&format!("{}/healthz", server.url), Some("nonsense")), 200);
    runtime.block_on(async {
        let mut client = MapServiceClient::connect(server.url.clone()).await.unwrap();
        client.list_maps(v1::ListMapsRequest::default()).await.unwrap();
        client.get_map(v1::GetMapRequest { map: "none".to_owned() }).await.unwrap_err();
    });
    let stderr = server.end();
    assert!(stderr.is_empty(), "the log has no spans: {stderr}");

    let (services, spans) = received(&collector);
    assert!(!services.is_empty() && services.iter().all(|name| name == "hall-server"), "{services:?}");
    let names: Vec<&str> = spans.keys().map(String::as_str).collect();
    let expected = [
        "GET /healthz",
        "GET /v1/maps",
        "GET /v1/maps/{map}",
        "ubbmap.v1.MapService/GetMap",
        "ubbmap.v1.MapService/ListMaps",
    ];
    assert_eq!(names, expected);
    let child = &spans["GET /v1/maps/{map}"];
    let hex = |bytes: &[u8]| bytes.iter().map(|byte| format!("{byte:02x}")).collect::<String>();
    assert_eq!((hex(&child.trace_id).as_str(), hex(&child.parent_span_id).as_str()), (TRACE, "b7ad6b7169203331"));
    assert_eq!(child.kind(), SpanKind::Server);
    let told = attributes(&child.attributes);
    for (name, value) in [
        ("http.request.method", "GET"),
        ("http.route", "/v1/maps/{map}"),
        ("http.response.status_code", "404"),
        ("url.path", "/v1/maps/none"),
        ("url.scheme", "http"),
        ("network.protocol.version", "1.1"),
    ] {
        assert_eq!(told.get(name).map(String::as_str), Some(value), "{name}: {told:?}");
    }
    // A client's mistake is no failure of the server.
    assert_eq!(child.status.clone().unwrap_or_default().code(), StatusCode::Unset);
    let root = &spans["GET /v1/maps"];
    assert!(root.parent_span_id.is_empty() && hex(&root.trace_id) != TRACE);
    assert!(spans["GET /healthz"].parent_span_id.is_empty(), "what is no traceparent is no parent");
    let call = attributes(&spans["ubbmap.v1.MapService/GetMap"].attributes);
    for (name, value) in [
        ("rpc.system", "grpc"),
        ("rpc.service", "ubbmap.v1.MapService"),
        ("rpc.method", "GetMap"),
        ("rpc.grpc.status_code", "5"),
        ("network.protocol.version", "2"),
    ] {
        assert_eq!(call.get(name).map(String::as_str), Some(value), "{name}: {call:?}");
    }
    assert_eq!(attributes(&spans["ubbmap.v1.MapService/ListMaps"].attributes)["rpc.grpc.status_code"], "0");
}

#[test]
fn what_is_not_sampled_is_not_sent_and_a_collector_that_is_away_harms_nobody() {
    let (_runtime, collector, endpoint) = collect();
    let server = Server::start(&endpoint, "0");
    assert_eq!(get(&format!("{}/v1/maps", server.url), None), 200);
    assert_eq!(get(&format!("{}/v1/maps", server.url), Some(&format!("00-{TRACE}-b7ad6b7169203331-01"))), 200);
    server.end();
    let (_, spans) = received(&collector);
    assert_eq!(spans.len(), 1, "the caller's alone: {spans:?}");

    let away = Server::start("http://127.0.0.1:9", "1.0");
    for _ in 0..3 {
        assert_eq!(get(&format!("{}/v1/maps", away.url), None), 200);
    }
    away.end();
}

//! Traces of requests by OpenTelemetry, sent over OTLP/gRPC.
//!
//! One span a request, with the standard attributes of HTTP and RPC; its parent is that of the request's `traceparent`
//! (W3C). It ends with the head of the answer: a stream's span does not last as long as the stream.

use crate::config::Telemetry;
use axum::Router;
use axum::extract::{MatchedPath, Request};
use axum::http::{HeaderMap, Version, header};
use axum::middleware::Next;
use axum::response::Response;
use opentelemetry::propagation::{Extractor, TextMapPropagator};
use opentelemetry::trace::TracerProvider;
use opentelemetry_otlp::{SpanExporter, WithExportConfig};
use opentelemetry_sdk::Resource;
use opentelemetry_sdk::propagation::TraceContextPropagator;
use opentelemetry_sdk::trace::{Sampler, SdkTracerProvider};
use tracing::field::Empty;
use tracing::{Instrument, Span};
use tracing_opentelemetry::OpenTelemetrySpanExt;
use tracing_subscriber::filter::{LevelFilter, filter_fn};
use tracing_subscriber::{Layer, Registry};

/// The target of the spans: nothing else is sent, and they are no part of the log.
pub(super) const TARGET: &str = "ubbmap::otel";

/// Longest text of a client's that becomes an attribute, characters.
const LONGEST_TEXT: usize = 256;

/// Traces on their way to a collector.
#[derive(Debug)]
pub struct Traces {
    provider: SdkTracerProvider,
}

impl Traces {
    /// Starts to send traces, where the settings name a collector. Call it within a runtime of tokio. A collector that cannot
    /// be reached is no error: what it does not take is lost, with a line in the log.
    ///
    /// # Errors
    /// What is wrong with the endpoint.
    pub fn start(settings: &Telemetry) -> Result<Option<Self>, String> {
        if settings.otlp_endpoint.is_empty() {
            return Ok(None);
        }
        let exporter = SpanExporter::builder()
            .with_tonic()
            .with_endpoint(&settings.otlp_endpoint)
            .build()
            .map_err(|error| format!("cannot send traces to {}: {error}", settings.otlp_endpoint))?;
        let sampler = Sampler::ParentBased(Box::new(Sampler::TraceIdRatioBased(settings.sampling)));
        let resource = Resource::builder().with_service_name(settings.service_name.clone()).build();
        let provider = SdkTracerProvider::builder()
            .with_batch_exporter(exporter)
            .with_sampler(sampler)
            .with_resource(resource)
            .build();
        Ok(Some(Self { provider }))
    }

    /// The layer that turns the spans of requests into traces.
    #[must_use]
    pub fn layer(&self) -> Box<dyn Layer<Registry> + Send + Sync> {
        let tracer = self.provider.tracer("ubbmap");
        let layer = tracing_opentelemetry::layer().with_tracer(tracer).with_location(false).with_threads(false);
        // The level's bound keeps the many finer lines of the libraries from being looked at.
        let filter = filter_fn(|metadata| metadata.target() == TARGET).with_max_level_hint(LevelFilter::INFO);
        layer.with_filter(filter).boxed()
    }

    /// Sends what is left.
    pub fn end(self) {
        if let Err(error) = self.provider.shutdown() {
            tracing::warn!(%error, "the last traces were not sent");
        }
    }
}

/// Traces every request of the routes.
pub fn trace_requests(router: Router) -> Router {
    router.layer(axum::middleware::from_fn(trace))
}

async fn trace(request: Request, next: Next) -> Response {
    let span = span_of(&request);
    if span.is_disabled() {
        return next.run(request).await;
    }
    let parent = TraceContextPropagator::new().extract(&Headers(request.headers()));
    // Without one it is a root.
    let _ = span.set_parent(parent);
    let call = is_call(&request);
    let response = next.run(request).instrument(span.clone()).await;
    let status = response.status();
    span.record("http.response.status_code", status.as_u16());
    if call {
        let code = tonic::Status::from_header_map(response.headers()).map_or(tonic::Code::Ok, |status| status.code());
        span.record("rpc.grpc.status_code", code as i32);
        // The codes that the conventions count as the server's failures.
        let failed = matches!(
            code,
            tonic::Code::Unknown
                | tonic::Code::DeadlineExceeded
                | tonic::Code::Unimplemented
                | tonic::Code::Internal
                | tonic::Code::Unavailable
                | tonic::Code::DataLoss
        );
        if failed {
            span.record("error.type", format!("{code:?}"));
            span.record("otel.status_code", "ERROR");
        }
    } else if status.is_server_error() {
        span.record("error.type", status.as_str());
        span.record("otel.status_code", "ERROR");
    }
    response
}

fn is_call(request: &Request) -> bool {
    let kind = request.headers().get(header::CONTENT_TYPE).and_then(|value| value.to_str().ok()).unwrap_or_default();
    kind.starts_with("application/grpc")
}

/// The span of a request, with all that is known before it is answered.
fn span_of(request: &Request) -> Span {
    let known = ["GET", "HEAD", "PUT", "POST", "DELETE", "OPTIONS", "PATCH"];
    let method = known.into_iter().find(|known| *known == request.method().as_str()).unwrap_or("_OTHER");
    let path = cut(request.uri().path());
    let route = request.extensions().get::<MatchedPath>().map(MatchedPath::as_str);
    let call = is_call(request).then(|| path.trim_start_matches('/').split_once('/')).flatten();
    let name = match (call, route) {
        (Some((service, method)), _) => format!("{service}/{method}"),
        (None, Some(route)) => format!("{method} {route}"),
        (None, None) => method.to_owned(),
    };
    let version = match request.version() {
        Version::HTTP_10 => "1.0",
        Version::HTTP_2 => "2",
        _ => "1.1",
    };
    let span = tracing::info_span!(
        target: TARGET,
        "request",
        otel.name = name,
        otel.kind = "server",
        otel.status_code = Empty,
        error.type = Empty,
        http.request.method = method,
        http.route = route,
        http.response.status_code = Empty,
        url.path = path,
        url.scheme = request.uri().scheme_str().unwrap_or("http"),
        network.protocol.name = "http",
        network.protocol.version = version,
        server.address = Empty,
        user_agent.original = Empty,
        rpc.system = Empty,
        rpc.service = Empty,
        rpc.method = Empty,
        rpc.grpc.status_code = Empty,
    );
    let text = |name| request.headers().get(name).and_then(|value| value.to_str().ok()).map(cut);
    if let Some(host) = text(header::HOST).or_else(|| request.uri().host().map(cut)) {
        span.record("server.address", host);
    }
    if let Some(agent) = text(header::USER_AGENT) {
        span.record("user_agent.original", agent);
    }
    if let Some((service, method)) = call {
        span.record("rpc.system", "grpc");
        span.record("rpc.service", service);
        span.record("rpc.method", method);
    }
    span
}

fn cut(text: &str) -> &str {
    text.char_indices().nth(LONGEST_TEXT).map_or(text, |(end, _)| &text[..end])
}

/// A request's headers, as the propagator reads them.
struct Headers<'a>(&'a HeaderMap);

impl Extractor for Headers<'_> {
    fn get(&self, key: &str) -> Option<&str> {
        self.0.get(key)?.to_str().ok()
    }

    fn keys(&self) -> Vec<&str> {
        self.0.keys().map(header::HeaderName::as_str).collect()
    }
}

//! The listener: connections are accepted, limited, timed, and let go at the end.

use super::lingering::{Lingering, linger};
use super::problem::{HttpError, PROBLEM_JSON, Problem};
use super::steady::Steady;
use crate::service::{ErrorKind, limit_hit, setting};
use crate::transport::access::{Listener, Peer};
use crate::transport::client::{self, Client, PerClient};
use crate::transport::tls::{self, Opened, Outcome, Secure, Tls};
use axum::http::Request;
use axum::{Extension, Router};
use hyper::body::Incoming;
use hyper_util::rt::{TokioExecutor, TokioIo, TokioTimer};
use hyper_util::server::conn::auto::Builder;
use hyper_util::server::graceful::GracefulShutdown;
use hyper_util::service::TowerToHyperService;
use metrics::{describe_gauge, gauge};
use std::future::Future;
use std::net::SocketAddr;
use std::sync::Arc;
use std::time::Duration;
use tokio::io::AsyncWriteExt;
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::Semaphore;
use tokio_util::sync::CancellationToken;
use tokio_util::task::TaskTracker;
use tower::ServiceExt;

const CONNECTIONS: &str = "ubbmap_connections_open";

/// How long to wait after a failed accept: out of file descriptors, the next one fails as well.
const ACCEPT_PAUSE: Duration = Duration::from_millis(50);

/// How often a connection of HTTP/2 is asked whether its client is still there, and how long it may take to say so.
const KEEP_ALIVE: Duration = Duration::from_secs(20);

/// Heads of requests are read up to so many bytes, so that those above the limit are told what it is.
const HEAD_BYTES: u32 = 64 << 10;

/// Most lines of a head.
const HEAD_LINES: usize = 200;

/// Streams of one connection of HTTP/2 that a client may begin and reset before they are looked at; more end the connection.
const RESETS: usize = 20;

/// How long the end waits for connections that are cut off.
const LAST: Duration = Duration::from_secs(1);

/// Limits on connections.
#[derive(Debug, Clone)]
pub struct ServeLimits {
    /// Most open at once; more wait to be accepted.
    pub connections: usize,
    /// Longest time for a request's head to arrive, and for a handshake.
    pub header_timeout: Duration,
    /// Longest time for a connection without a request, and for a write to move.
    pub idle_timeout: Duration,
    /// Most requests and streams of one connection of HTTP/2 at once.
    pub requests_per_connection: u32,
    /// The connections of each client.
    pub clients: Arc<PerClient>,
    /// How long requests under way may take to end once `stop` is done.
    pub grace: Duration,
}

/// A connection as the metrics see it.
struct Counted;

impl Counted {
    fn new() -> Self {
        gauge!(CONNECTIONS).increment(1.0);
        Self
    }
}

impl Drop for Counted {
    fn drop(&mut self) {
        gauge!(CONNECTIONS).decrement(1.0);
    }
}

/// Tells the recorder what the metric means, and shows it before there is a connection.
pub(super) fn describe_connections() {
    describe_gauge!(CONNECTIONS, "Connections of REST and gRPC that are open");
    gauge!(CONNECTIONS).increment(0.0);
}

/// Serves until `stop` is done, and tells the routes from whom and by which listener a request came; then accepts no more,
/// ends idle connections, and waits for requests under way for the time of grace. With `tls` it speaks nothing else.
pub async fn serve(
    listener: TcpListener,
    kind: Listener,
    router: Router,
    limits: &ServeLimits,
    tls: Option<Tls>,
    stop: impl Future<Output = ()>,
) {
    let builder = builder(limits);
    let patience = limits.header_timeout;
    let connections = Arc::new(Semaphore::new(limits.connections));
    let (graceful, tasks, over) = (GracefulShutdown::new(), TaskTracker::new(), CancellationToken::new());
    tokio::pin!(stop);
    loop {
        let accepted = async {
            if connections.available_permits() == 0 {
                limit_hit(setting::CONNECTIONS);
            }
            // The semaphore is never closed.
            let permit = Arc::clone(&connections).acquire_owned().await.ok();
            (listener.accept().await, permit)
        };
        let ((stream, address), permit) = tokio::select! {
            () = &mut stop => break,
            (accepted, permit) = accepted => match accepted {
                Ok(accepted) => (accepted, permit),
                Err(error) => {
                    tracing::warn!(%error, "cannot accept a connection");
                    tokio::time::sleep(ACCEPT_PAUSE).await;
                    continue;
                }
            },
        };
        let Some((client, share)) = client::connected(&limits.clients, address.ip()) else {
            tracing::debug!(%address, "closed: the client has too many connections");
            continue;
        };
        // One that is only told that it is too many is not kept.
        let idle = if client.is_refused() { limits.header_timeout } else { limits.idle_timeout };
        let (router, tls) = (router.clone(), tls.clone());
        let (builder, watcher, over) = (builder.clone(), graceful.watcher(), over.clone());
        let moving = limits.idle_timeout;
        tasks.spawn(async move {
            let (_share, _counted) = (share, Counted::new());
            let Some(Opened { stream, certificate }) = open(stream, address, tls, patience).await else { return };
            let peer = Peer { address: Some(address), certificate, listener: kind };
            let router = tower::Layer::layer(&Extension(peer), router).map_request(named(client.clone()));
            let stream = TokioIo::new(Steady::new(stream, moving));
            let connection = builder.serve_connection(stream, TowerToHyperService::new(router));
            tokio::select! {
                ended = watcher.watch(connection) => ended.unwrap_or_else(|error| ended_early(error.as_ref())),
                () = client.stuck(moving) => tracing::debug!(%address, "closed: an answer was not taken for too long"),
                () = over.cancelled() => tracing::debug!(%address, "closed: the server ends"),
                () = client.idle(idle) => tracing::debug!(%address, "closed: nothing came for too long"),
            }
            drop(permit);
        });
    }
    drop(listener);
    end(graceful, &tasks, &over, limits.grace).await;
}

/// Waits for requests under way for the time of grace, and cuts off what is left: it holds the server's parts, and would do
/// so for as long as its clients like.
async fn end(graceful: GracefulShutdown, tasks: &TaskTracker, over: &CancellationToken, grace: Duration) {
    if tokio::time::timeout(grace, graceful.shutdown()).await.is_err() {
        tracing::warn!("requests were still under way at the end of the time of grace");
    }
    over.cancel();
    tasks.close();
    if tokio::time::timeout(LAST, tasks.wait()).await.is_err() {
        tracing::warn!("connections did not end with the server");
    }
}

fn ended_early(error: &(dyn std::error::Error + Send + Sync + 'static)) {
    if error.downcast_ref::<hyper::Error>().is_some_and(hyper::Error::is_timeout) {
        limit_hit(setting::HEADER_SECONDS);
    }
    // A client that went away or sent no HTTP: its affair.
    tracing::debug!(%error, "a connection ended early");
}

fn builder(limits: &ServeLimits) -> Builder<TokioExecutor> {
    let mut builder = Builder::new(TokioExecutor::new());
    builder
        .http1()
        .timer(TokioTimer::new())
        .header_read_timeout(limits.header_timeout)
        .max_buf_size(HEAD_BYTES as usize)
        .max_headers(HEAD_LINES);
    builder
        .http2()
        .timer(TokioTimer::new())
        .keep_alive_interval(KEEP_ALIVE)
        .keep_alive_timeout(KEEP_ALIVE)
        .max_concurrent_streams(limits.requests_per_connection)
        .max_pending_accept_reset_streams(RESETS)
        .max_header_list_size(HEAD_BYTES);
    builder
}

/// Says in each request whose it is, and has what nobody reads of it read all the same.
fn named(client: Client) -> impl Fn(Request<Incoming>) -> Request<Lingering<Incoming>> + Clone {
    move |mut request| {
        request.extensions_mut().insert(client.clone());
        linger(request)
    }
}

/// Brings a connection to where requests can come; `None` where it does not get there in time.
async fn open(stream: TcpStream, peer: SocketAddr, tls: Option<Tls>, patience: Duration) -> Option<Opened> {
    // Small answers should not wait for the next packet; a socket that refuses works all the same.
    let _ = stream.set_nodelay(true);
    let secure = tls.is_some();
    let opened = async move {
        // The version of HTTP is told by the first bytes, for which nothing below would wait in vain.
        // Looked at rather than waited for: a stream is told to be readable now and then when it is not.
        if stream.peek(&mut [0]).await.ok()? == 0 {
            return None;
        }
        let Some(tls) = tls else { return Some(Opened { stream: Secure::Left(stream), certificate: None }) };
        match tls.open(stream, peer).await {
            Outcome::Opened(opened) => Some(*opened),
            Outcome::Plain(stream) => {
                turn_away(stream).await;
                None
            }
            Outcome::Failed => None,
        }
    };
    match tokio::time::timeout(patience, opened).await {
        Ok(opened) => opened,
        Err(_) => {
            limit_hit(setting::HEADER_SECONDS);
            if secure {
                Tls::late(peer);
            }
            None
        }
    }
}

/// Tells a client of plain HTTP/1.1 what to do. Others do not understand it, and see a connection that is closed.
async fn turn_away(mut stream: TcpStream) {
    let HttpError(error) =
        HttpError::new(ErrorKind::TlsRequired, "this port speaks TLS: its address begins with https://");
    let problem = Problem::from(&error);
    let body = serde_json::to_string(&problem).unwrap_or_default();
    let answer = format!(
        "HTTP/1.1 {} Bad Request\r\ncontent-type: {PROBLEM_JSON}\r\nconnection: close\r\ncontent-length: {}\r\n\r\n{body}",
        problem.status,
        body.len()
    );
    if stream.write_all(answer.as_bytes()).await.is_ok() {
        tls::linger(stream).await;
    }
}

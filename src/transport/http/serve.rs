//! The listener: connections are accepted, limited, timed, and let go at the end.

use super::steady::Steady;
use crate::service::{limit_hit, setting};
use crate::transport::client::{self, Client, PerClient};
use axum::Router;
use axum::http::Request;
use hyper::body::Incoming;
use hyper_util::rt::{TokioExecutor, TokioIo, TokioTimer};
use hyper_util::server::conn::auto::Builder;
use hyper_util::server::graceful::GracefulShutdown;
use hyper_util::service::TowerToHyperService;
use std::future::Future;
use std::sync::Arc;
use std::time::Duration;
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::Semaphore;
use tower::ServiceExt;

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

/// Limits on connections.
#[derive(Debug, Clone)]
pub struct ServeLimits {
    /// Most open at once; more wait to be accepted.
    pub connections: usize,
    /// Longest time for a request's head to arrive.
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

/// Serves until `stop` is done; then accepts no more, ends idle connections, and waits for requests under way for the
/// time of grace.
pub async fn serve(listener: TcpListener, router: Router, limits: &ServeLimits, stop: impl Future<Output = ()>) {
    let builder = builder(limits);
    let first_byte = limits.header_timeout;
    let connections = Arc::new(Semaphore::new(limits.connections));
    let graceful = GracefulShutdown::new();
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
        let ((stream, peer), permit) = tokio::select! {
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
        let Some((client, share)) = client::connected(&limits.clients, peer.ip()) else {
            tracing::debug!(%peer, "closed: the client has too many connections");
            continue;
        };
        // One that is only told that it is too many is not kept.
        let idle = if client.is_refused() { limits.header_timeout } else { limits.idle_timeout };
        let service = TowerToHyperService::new(router.clone().map_request(named(client.clone())));
        let (builder, watcher) = (builder.clone(), graceful.watcher());
        let patience = limits.idle_timeout;
        tokio::spawn(async move {
            let _share = share;
            // The version of HTTP is told by the first bytes, for which nothing below would wait in vain.
            match tokio::time::timeout(first_byte, stream.peek(&mut [0])).await {
                Ok(Ok(1)) => {}
                // It has gone again.
                Ok(_) => return,
                Err(_) => return limit_hit(setting::HEADER_SECONDS),
            }
            let connection = builder.serve_connection(io(stream, patience), service);
            tokio::select! {
                ended = watcher.watch(connection) => if let Err(error) = ended {
                    if error.downcast_ref::<hyper::Error>().is_some_and(hyper::Error::is_timeout) {
                        limit_hit(setting::HEADER_SECONDS);
                    }
                    // A client that went away or sent no HTTP: its affair.
                    tracing::debug!(%error, "a connection ended early");
                },
                () = client.idle(idle) => tracing::debug!(%peer, "closed: nothing came for too long"),
            }
            drop(permit);
        });
    }
    drop(listener);
    if tokio::time::timeout(limits.grace, graceful.shutdown()).await.is_err() {
        tracing::warn!("requests were still under way at the end of the time of grace");
    }
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

/// Says in each request whose it is.
fn named(client: Client) -> impl Fn(Request<Incoming>) -> Request<Incoming> + Clone {
    move |mut request| {
        request.extensions_mut().insert(client.clone());
        request
    }
}

fn io(stream: TcpStream, patience: Duration) -> TokioIo<Steady<TcpStream>> {
    // Small answers should not wait for the next packet; a socket that refuses works all the same.
    let _ = stream.set_nodelay(true);
    TokioIo::new(Steady::new(stream, patience))
}

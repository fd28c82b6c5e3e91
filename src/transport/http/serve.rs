//! The listener: connections are accepted, limited, timed, and let go at the end.

use crate::transport::access::{Listener, Peer};
use axum::Extension;
use axum::Router;
use hyper_util::rt::{TokioExecutor, TokioIo, TokioTimer};
use hyper_util::server::conn::auto::Builder;
use hyper_util::server::graceful::GracefulShutdown;
use hyper_util::service::TowerToHyperService;
use std::future::Future;
use std::sync::Arc;
use std::time::Duration;
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::Semaphore;

/// How long to wait after a failed accept: out of file descriptors, the next one fails as well.
const ACCEPT_PAUSE: Duration = Duration::from_millis(50);

/// How often a connection of HTTP/2 is asked whether its client is still there, and how long it may take to say so.
const KEEP_ALIVE: Duration = Duration::from_secs(20);

/// Most requests and streams of one connection of HTTP/2 at once.
const STREAMS_PER_CONNECTION: u32 = 256;

/// Largest head of a request of HTTP/2, bytes.
const HEAD_BYTES: u32 = 16 << 10;

/// Limits on connections.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ServeLimits {
    /// Most open at once; more wait to be accepted.
    pub connections: usize,
    /// Longest time for a request's head to arrive.
    pub header_timeout: Duration,
    /// How long requests under way may take to end once `stop` is done.
    pub grace: Duration,
}

/// Serves until `stop` is done, and tells the routes from whom and by which listener a request came; then accepts no more, ends idle connections, and waits for requests under way for the
/// time of grace.
pub async fn serve(
    listener: TcpListener,
    kind: Listener,
    router: Router,
    limits: &ServeLimits,
    stop: impl Future<Output = ()>,
) {
    let mut builder = Builder::new(TokioExecutor::new());
    builder.http1().timer(TokioTimer::new()).header_read_timeout(limits.header_timeout);
    builder
        .http2()
        .timer(TokioTimer::new())
        .keep_alive_interval(KEEP_ALIVE)
        .keep_alive_timeout(KEEP_ALIVE)
        .max_concurrent_streams(STREAMS_PER_CONNECTION)
        .max_header_list_size(HEAD_BYTES);
    let first_byte = limits.header_timeout;
    let connections = Arc::new(Semaphore::new(limits.connections));
    let graceful = GracefulShutdown::new();
    tokio::pin!(stop);
    loop {
        let accepted = async {
            // The semaphore is never closed.
            let permit = Arc::clone(&connections).acquire_owned().await.ok();
            (listener.accept().await, permit)
        };
        let (stream, address, permit) = tokio::select! {
            () = &mut stop => break,
            (accepted, permit) = accepted => match accepted {
                Ok((stream, address)) => (stream, address, permit),
                Err(error) => {
                    tracing::warn!(%error, "cannot accept a connection");
                    tokio::time::sleep(ACCEPT_PAUSE).await;
                    continue;
                }
            },
        };
        let peer = Peer { address: Some(address), certificate: None, listener: kind };
        let service = TowerToHyperService::new(tower::Layer::layer(&Extension(peer), router.clone()));
        let (builder, watcher) = (builder.clone(), graceful.watcher());
        tokio::spawn(async move {
            // The version of HTTP is told by the first bytes, for which nothing below would wait in vain.
            if !matches!(tokio::time::timeout(first_byte, stream.readable()).await, Ok(Ok(()))) {
                return;
            }
            let connection = builder.serve_connection(io(stream), service);
            if let Err(error) = watcher.watch(connection).await {
                // A client that went away or sent no HTTP: its affair.
                tracing::debug!(%error, "a connection ended early");
            }
            drop(permit);
        });
    }
    drop(listener);
    if tokio::time::timeout(limits.grace, graceful.shutdown()).await.is_err() {
        tracing::warn!("requests were still under way at the end of the time of grace");
    }
}

fn io(stream: TcpStream) -> TokioIo<TcpStream> {
    // Small answers should not wait for the next packet; a socket that refuses works all the same.
    let _ = stream.set_nodelay(true);
    TokioIo::new(stream)
}

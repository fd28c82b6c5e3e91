//! The listener: connections are accepted, limited, timed, and let go at the end.

use super::problem::{HttpError, PROBLEM_JSON, Problem};
use crate::service::ErrorKind;
use crate::transport::access::{Listener, Peer};
use crate::transport::tls::{Opened, Outcome, Secure, Tls, linger};
use axum::{Extension, Router};
use hyper_util::rt::{TokioExecutor, TokioIo, TokioTimer};
use hyper_util::server::conn::auto::Builder;
use hyper_util::server::graceful::GracefulShutdown;
use hyper_util::service::TowerToHyperService;
use std::future::Future;
use std::net::SocketAddr;
use std::sync::Arc;
use std::time::Duration;
use tokio::io::AsyncWriteExt;
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
    /// Longest time for a request's head to arrive, and for a handshake.
    pub header_timeout: Duration,
    /// How long requests under way may take to end once `stop` is done.
    pub grace: Duration,
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
    let graceful = GracefulShutdown::new();
    tokio::pin!(stop);
    loop {
        let accepted = async {
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
        let (router, tls) = (router.clone(), tls.clone());
        let (builder, watcher) = (builder.clone(), graceful.watcher());
        tokio::spawn(async move {
            let Some(Opened { stream, certificate }) = open(stream, address, tls, patience).await else { return };
            let peer = Peer { address: Some(address), certificate, listener: kind };
            let service = TowerToHyperService::new(tower::Layer::layer(&Extension(peer), router));
            let connection = builder.serve_connection(TokioIo::new(stream), service);
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

fn builder(limits: &ServeLimits) -> Builder<TokioExecutor> {
    let mut builder = Builder::new(TokioExecutor::new());
    builder.http1().timer(TokioTimer::new()).header_read_timeout(limits.header_timeout);
    builder
        .http2()
        .timer(TokioTimer::new())
        .keep_alive_interval(KEEP_ALIVE)
        .keep_alive_timeout(KEEP_ALIVE)
        .max_concurrent_streams(STREAMS_PER_CONNECTION)
        .max_header_list_size(HEAD_BYTES);
    builder
}

/// Brings a connection to where requests can come; `None` where it does not get there in time.
async fn open(stream: TcpStream, peer: SocketAddr, tls: Option<Tls>, patience: Duration) -> Option<Opened> {
    // Small answers should not wait for the next packet; a socket that refuses works all the same.
    let _ = stream.set_nodelay(true);
    let secure = tls.is_some();
    let opened = async move {
        // The version of HTTP is told by the first bytes, for which nothing below would wait in vain.
        stream.readable().await.ok()?;
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
        linger(stream).await;
    }
}

//! The beginning of a connection.

use super::{Named, Tls, count, named};
use std::net::SocketAddr;
use std::time::Duration;
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::TcpStream;
use tokio_rustls::TlsAcceptor;
use tokio_rustls::server::TlsStream;
use tokio_util::either::Either;

/// A connection, with or without TLS.
pub type Secure = Either<TcpStream, TlsStream<TcpStream>>;

/// The first byte of a handshake.
const HANDSHAKE: u8 = 22;

/// Most bytes that are read of a connection that is only still open to be closed.
const LINGER_BYTES: usize = 16 << 10;

/// How long that may take.
const LINGER: Duration = Duration::from_secs(2);

/// A connection that is open for requests.
#[derive(Debug)]
pub struct Opened {
    /// Where its bytes go.
    pub stream: Secure,
    /// Whom the client's certificate names; `None` without a certificate, or one that names nobody.
    pub certificate: Option<Named>,
}

/// What became of a handshake.
#[derive(Debug)]
pub enum Outcome {
    /// It was done.
    Opened(Box<Opened>),
    /// The client speaks no TLS; the connection as it came.
    Plain(TcpStream),
    /// It failed, and the client was told so by TLS's own means.
    Failed,
}

impl Tls {
    /// Does the handshake, and counts what became of it. It takes as long as the client likes: the caller
    /// has the clock, and calls [`Tls::late`] when it is over.
    pub async fn open(&self, stream: TcpStream, peer: SocketAddr) -> Outcome {
        let mut first = [0];
        match stream.peek(&mut first).await {
            Ok(1) if first[0] == HANDSHAKE => {}
            // Closed or broken before it said anything.
            Ok(0) | Err(_) => return Outcome::Failed,
            Ok(_) => {
                count("plain");
                tracing::debug!(%peer, "a client spoke without TLS");
                return Outcome::Plain(stream);
            }
        }
        match TlsAcceptor::from(self.config()).accept(stream).into_fallible().await {
            Ok(stream) => {
                count("done");
                let certificate = stream.get_ref().1.peer_certificates().and_then(|chain| named(chain.first()?));
                Outcome::Opened(Box::new(Opened { stream: Either::Right(stream), certificate }))
            }
            Err((error, stream)) => {
                count("failed");
                tracing::debug!(%peer, %error, "a handshake failed");
                linger(stream).await;
                Outcome::Failed
            }
        }
    }

    /// Takes note of a handshake that was not done in time.
    pub fn late(peer: SocketAddr) {
        count("late");
        tracing::debug!(%peer, "a handshake was not done in time");
    }
}

/// Closes a connection once its client has: one that is closed with unread bytes is reset, and the client may lose the last
/// thing that it was told. A client that sends its request with the end of its handshake always has such bytes on the way.
pub async fn linger(mut stream: TcpStream) {
    if stream.shutdown().await.is_err() {
        return;
    }
    let unread = async {
        let (mut read, mut waste) = (0, [0; 1024]);
        while read < LINGER_BYTES {
            match stream.read(&mut waste).await {
                Ok(some) if some > 0 => read += some,
                _ => return,
            }
        }
    };
    // In either case it is closed now.
    let _ = tokio::time::timeout(LINGER, unread).await;
}

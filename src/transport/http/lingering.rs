//! Refusals that arrive. A client of HTTP/1.1 sends its whole body before it reads. When it is refused early and the connection
//! is then closed with bytes unread, the kernel resets it, and the client sees a broken connection instead of its answer. So what
//! nobody reads any more is read and thrown away, for a while.

use axum::http::{Request, Version, header};
use hyper::body::{Body, Bytes, Frame, SizeHint};
use std::future::poll_fn;
use std::pin::Pin;
use std::task::{Context, Poll};
use std::time::Duration;

/// Most bytes of a body that are thrown away: four times the largest body by default. A client that sends more is cut off.
const MOST_BYTES: usize = 64 << 20;

/// How long that may take. The connection is one of its client's all the while.
const PATIENCE: Duration = Duration::from_secs(5);

/// A request's body. When it is dropped before its end, the rest of it is still read.
pub struct Lingering<B: Body<Data = Bytes> + Send + Unpin + 'static> {
    /// There until it is dropped.
    body: Option<B>,
    /// Is there somebody who sends whether or not it is read? HTTP/2 has a frame that ends a stream alone, and a client that asks
    /// first (`Expect: 100-continue`) sends nothing before it is told to.
    pushed: bool,
}

/// The request with a body whose rest is read when nobody reads it any more.
pub fn linger<B: Body<Data = Bytes> + Send + Unpin + 'static>(request: Request<B>) -> Request<Lingering<B>> {
    let pushed = request.version() <= Version::HTTP_11 && !request.headers().contains_key(header::EXPECT);
    request.map(|body| Lingering { body: Some(body), pushed })
}

impl<B: Body<Data = Bytes> + Send + Unpin + 'static> Body for Lingering<B> {
    type Data = Bytes;
    type Error = B::Error;

    fn poll_frame(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<Option<Result<Frame<Bytes>, B::Error>>> {
        let Some(body) = &mut self.body else { return Poll::Ready(None) };
        let frame = Pin::new(body).poll_frame(context);
        if matches!(frame, Poll::Ready(None | Some(Err(_)))) {
            self.body = None;
        }
        frame
    }

    fn is_end_stream(&self) -> bool {
        self.body.as_ref().is_none_or(Body::is_end_stream)
    }

    fn size_hint(&self) -> SizeHint {
        self.body.as_ref().map_or_else(|| SizeHint::with_exact(0), Body::size_hint)
    }
}

impl<B: Body<Data = Bytes> + Send + Unpin + 'static> Drop for Lingering<B> {
    fn drop(&mut self) {
        let Some(body) = self.body.take().filter(|body| self.pushed && !body.is_end_stream()) else { return };
        // At the end of the process there may be nobody left to read it.
        if let Ok(runtime) = tokio::runtime::Handle::try_current() {
            // In either case it is closed now.
            runtime.spawn(async move { drop(tokio::time::timeout(PATIENCE, throw_away(body)).await) });
        }
    }
}

/// Reads to the end of a body, or as much as is read of any.
async fn throw_away(mut body: impl Body<Data = Bytes> + Unpin) {
    let mut read = 0;
    while read < MOST_BYTES
        && let Some(Ok(frame)) = poll_fn(|context| Pin::new(&mut body).poll_frame(context)).await
    {
        read += frame.data_ref().map_or(0, Bytes::len);
    }
}

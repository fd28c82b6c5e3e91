//! Answers on their way out: in pieces, with what they hold until their client has taken them.

use super::client::UnderWay;
use axum::Error;
use axum::body::{Body, Bytes, HttpBody};
use axum::response::Response;
use hyper::body::{Frame, SizeHint};
use std::pin::Pin;
use std::sync::Arc;
use std::task::{Context, Poll};

/// Pieces of answers below this many bytes are not worth an owner of their own.
const COPIED: usize = 4096;

/// Largest piece that a connection is given at a time: of an answer that a client takes slowly each tells that it moves.
const PIECE: usize = 64 << 10;

/// A body that holds something until it has gone out, or its client has.
struct Outgoing<T> {
    body: Body,
    /// What of the last frame was not given out yet.
    rest: Bytes,
    kept: Arc<Kept<T>>,
}

struct Kept<T> {
    under_way: Option<UnderWay>,
    _more: T,
}

/// A piece of such a body: the connection takes it over as it is, and may have it for long.
struct Piece<T> {
    bytes: Bytes,
    _kept: Arc<Kept<T>>,
}

impl<T> AsRef<[u8]> for Piece<T> {
    fn as_ref(&self) -> &[u8] {
        &self.bytes
    }
}

/// Keeps something until the answer has gone out, and tells its connection whenever it is the client's turn to take some.
pub fn keep<T: Send + Sync + 'static>(response: Response, under_way: Option<UnderWay>, more: T) -> Response {
    if let Some(under_way) = &under_way {
        under_way.offered();
    }
    let kept = Arc::new(Kept { under_way, _more: more });
    response.map(|body| Body::new(Outgoing { body, rest: Bytes::new(), kept }))
}

impl<T: Send + Sync + 'static> Outgoing<T> {
    /// The next piece of what there is.
    fn piece(&mut self) -> Bytes {
        let bytes = self.rest.split_to(self.rest.len().min(PIECE));
        // Small ones are copied into what goes out.
        if bytes.len() < COPIED {
            return bytes;
        }
        Bytes::from_owner(Piece { bytes, _kept: Arc::clone(&self.kept) })
    }
}

impl<T: Send + Sync + 'static> HttpBody for Outgoing<T> {
    type Data = Bytes;
    type Error = Error;

    fn poll_frame(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<Option<Result<Frame<Bytes>, Error>>> {
        if self.rest.is_empty() {
            let Poll::Ready(frame) = Pin::new(&mut self.body).poll_frame(context) else {
                // The client has all that there is.
                self.kept.under_way.iter().for_each(UnderWay::taken);
                return Poll::Pending;
            };
            self.kept.under_way.iter().for_each(UnderWay::offered);
            match frame.map(|frame| frame.map(Frame::into_data)) {
                Some(Ok(Ok(data))) => self.rest = data,
                Some(Ok(Err(other))) => return Poll::Ready(Some(Ok(other))),
                Some(Err(error)) => return Poll::Ready(Some(Err(error))),
                None => return Poll::Ready(None),
            }
        } else {
            self.kept.under_way.iter().for_each(UnderWay::offered);
        }
        let piece = self.piece();
        Poll::Ready(Some(Ok(Frame::data(piece))))
    }

    fn is_end_stream(&self) -> bool {
        self.rest.is_empty() && self.body.is_end_stream()
    }

    fn size_hint(&self) -> SizeHint {
        let (mut hint, rest) = (self.body.size_hint(), self.rest.len() as u64);
        let (lower, upper) = (hint.lower() + rest, hint.upper().map(|upper| upper + rest));
        if let Some(upper) = upper {
            hint.set_upper(upper);
        }
        hint.set_lower(lower);
        hint
    }
}

//! Memory of bodies: held while they are, given back when they are not.

#![allow(clippy::unwrap_used, reason = "tests")]

use super::{Memory, Shape, counted, refusal};
use crate::service::{ErrorKind, ServiceError};
use crate::transport::outgoing::keep;
use axum::Error;
use axum::body::{Body, Bytes};
use axum::response::IntoResponse;
use futures_util::stream;
use http_body_util::BodyExt;
use std::convert::Infallible;
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::Duration;

const LONG: Duration = Duration::from_secs(60);

fn memory(limit: usize) -> Arc<Memory> {
    Memory::of_requests(limit)
}

fn used(memory: &Memory) -> usize {
    memory.used.load(Ordering::Relaxed)
}

fn wrap(error: ServiceError) -> Error {
    Error::new(error)
}

/// A body of these pieces, and what is held after each.
async fn pass(memory: &Arc<Memory>, shape: Shape, pieces: &[&[u8]]) -> Vec<usize> {
    let pieces: Vec<_> = pieces.iter().map(|piece| Ok::<_, Infallible>(Bytes::copy_from_slice(piece))).collect();
    let mut body = counted(Body::from_stream(stream::iter(pieces)), memory.hold(), shape, wrap, LONG);
    let mut held = Vec::new();
    while let Some(frame) = body.frame().await {
        frame.unwrap();
        held.push(used(memory));
    }
    held
}

#[tokio::test]
async fn a_body_is_held_whole_and_lines_and_messages_until_they_end() {
    let memory = memory(100);
    assert_eq!(pass(&memory, Shape::Whole, &[b"12345", b"678"]).await, [5, 8]);
    assert_eq!(pass(&memory, Shape::Lines, &[b"123", b"45\n6", b"\n", b"789"]).await, [3, 1, 0, 3]);
    let message = |length: usize| [&[0, 0, 0, 0, length as u8][..], &vec![7; length]].concat();
    let (four, none) = (message(4), message(0));
    assert_eq!(
        pass(&memory, Shape::Messages, &[&four, &none, &[four.clone(), none.clone()].concat()]).await,
        [0, 0, 0]
    );
    // Cut anywhere, what has come of a message is held.
    let two = [message(6), message(3)].concat();
    let pieces: Vec<&[u8]> = two.chunks(1).collect();
    let expected: Vec<usize> = (1..11).chain([0]).chain(1..8).chain([0]).collect();
    assert_eq!(pass(&memory, Shape::Messages, &pieces).await, expected);
    assert_eq!(used(&memory), 0);
}

#[tokio::test]
async fn a_body_that_finds_no_room_is_refused_by_the_setting_and_others_go_on() {
    let memory = memory(10);
    let other = memory.hold();
    other.set(6).unwrap();
    let mut body = counted(Body::from("12345"), memory.hold(), Shape::Whole, wrap, LONG);
    let error = refusal(body.frame().await.unwrap().unwrap_err()).unwrap();
    assert_eq!(error.kind, ErrorKind::Busy);
    assert!(error.detail.contains("limits.incoming_bytes"), "{error}");
    assert_eq!(other.grow(5).unwrap_err().kind, ErrorKind::BodyTooLarge);
    drop(other);
    assert_eq!(pass(&memory, Shape::Whole, &[b"1234567890"]).await, [10]);
    assert_eq!(used(&memory), 0);
}

#[tokio::test]
async fn an_answer_is_held_until_it_has_gone_out() {
    let memory = memory(1 << 20);
    assert!(memory.answer(1000).unwrap().is_none());
    let held = memory.answer(1 << 17).unwrap();
    let response = keep(vec![7; 1 << 17].into_response(), None, held);
    assert_eq!(used(&memory), 1 << 17);
    // The connection has the bytes when the body is over, in pieces, and has not sent them yet.
    let mut body = response.into_body();
    let mut pieces = Vec::new();
    while let Some(piece) = body.frame().await {
        pieces.push(piece.unwrap().into_data().unwrap());
    }
    drop(body);
    assert_eq!(pieces.iter().map(Bytes::len).collect::<Vec<_>>(), [1 << 16, 1 << 16]);
    drop(pieces.pop());
    assert_eq!(used(&memory), 1 << 17);
    drop(pieces);
    assert_eq!(used(&memory), 0);
    drop(keep("another".into_response(), None, memory.answer(1 << 18).unwrap()));
    assert_eq!(used(&memory), 0);
}

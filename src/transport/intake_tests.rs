//! Memory of bodies: held while they are, given back when they are not.

#![allow(clippy::unwrap_used, reason = "tests")]

use super::{Memory, Shape, counted, keep, refusal};
use crate::service::{ErrorKind, ServiceError};
use axum::Error;
use axum::body::{Body, Bytes};
use axum::response::IntoResponse;
use futures_util::stream::{self, StreamExt};
use http_body_util::BodyExt;
use std::convert::Infallible;
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::Duration;

/// As long as something is waited for that does not come.
const SHORT: Duration = Duration::from_millis(50);

/// Longer than any of these tests.
const LONG: Duration = Duration::from_secs(600);

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
    let mut body = counted(Body::from_stream(stream::iter(pieces)), memory.hold(), shape, LONG, wrap);
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
    let mut body = counted(Body::from("12345"), memory.hold(), Shape::Whole, LONG, wrap);
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
    let response = keep(vec![7; 1 << 17].into_response(), held);
    assert_eq!(used(&memory), 1 << 17);
    // The connection has the bytes when the body is over, and has not sent them yet.
    let mut body = response.into_body();
    let bytes = body.frame().await.unwrap().unwrap().into_data().unwrap();
    assert!(body.frame().await.is_none());
    drop(body);
    assert_eq!(used(&memory), 1 << 17);
    assert_eq!(bytes.len(), 1 << 17);
    drop(bytes);
    assert_eq!(used(&memory), 0);
    drop(keep("another".into_response(), memory.answer(1 << 18).unwrap()));
    assert_eq!(used(&memory), 0);
}

/// A body of which nothing comes any more after these bytes.
fn stopped(shape: Shape, bytes: &'static [u8]) -> (Arc<Memory>, Body) {
    let memory = memory(100);
    let pieces = stream::iter([Ok::<_, std::io::Error>(bytes)]).chain(stream::pending());
    let body = counted(Body::from_stream(pieces), memory.hold(), shape, SHORT, wrap);
    (memory, body)
}

#[tokio::test]
async fn a_message_that_stopped_half_way_held_memory_for_ever() {
    for (shape, bytes) in
        [(Shape::Messages, &b"\0\0\0\0\x09123"[..]), (Shape::Lines, b"one\ntwo"), (Shape::Whole, b"1")]
    {
        let (memory, mut body) = stopped(shape, bytes);
        assert!(body.frame().await.unwrap().is_ok());
        assert!(used(&memory) > 0);
        let error = refusal(body.frame().await.unwrap().unwrap_err()).unwrap();
        assert_eq!(error.kind, ErrorKind::Timeout);
        assert!(error.detail.contains("did not end within 0.05 s (setting limits.request_seconds)"), "{error:?}");
        drop(body);
        assert_eq!(used(&memory), 0);
    }
}

#[tokio::test]
async fn a_stream_may_be_silent_between_its_messages() {
    for (shape, bytes) in [(Shape::Messages, &b"\0\0\0\0\x03123"[..]), (Shape::Lines, b"one\n")] {
        let (_, mut body) = stopped(shape, bytes);
        assert!(body.frame().await.unwrap().is_ok());
        let silent = tokio::time::timeout(4 * SHORT, body.frame()).await;
        assert!(silent.is_err(), "{silent:?}");
    }
}

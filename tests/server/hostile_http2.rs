//! Clients of HTTP/2 that mean no good: floods of frames, heads without an end, streams that are opened and left.

use crate::hostile_support::{PREFACE, Target, flood, frame, rest};
use std::io::{Read, Write};
use std::time::Duration;

const DATA: u8 = 0;
const HEADERS: u8 = 1;
const SETTINGS: u8 = 4;
const PING: u8 = 6;
const CONTINUATION: u8 = 9;
const END_HEADERS: u8 = 4;

/// A head of `:method POST, :scheme http, :path .., :authority x, content-type application/grpc, te trailers`, without Huffman.
fn head(path: &str) -> Vec<u8> {
    let line = |name: &str, value: &str| {
        let text = |text: &str| [&[u8::try_from(text.len()).unwrap()][..], text.as_bytes()].concat();
        [vec![0], text(name), text(value)].concat()
    };
    let path = [&[0x04, u8::try_from(path.len()).unwrap()][..], path.as_bytes()].concat();
    [vec![0x83, 0x86], path, vec![0x41, 1, b'x'], line("content-type", "application/grpc"), line("te", "trailers")]
        .concat()
}

#[test]
fn floods_of_pings_and_settings_end_or_wait_and_hold_no_memory() {
    let target = Target::with(&[]);
    assert!(target.is_served());
    let before = target.memory();
    for bytes in [frame(PING, 0, 0, &[0; 8]), frame(SETTINGS, 0, 0, &[]), frame(DATA, 0, 0, &[])] {
        let mut flooding = target.send(PREFACE);
        // Answers are not read: where they may pile up, they do.
        let many = bytes.repeat(5000);
        flood(&mut flooding, &many, 64 << 20, Duration::from_secs(2));
        assert!(target.is_served());
        let grown = target.memory() - before;
        assert!(grown < 32e6, "{grown} bytes more after frames of type {}", bytes[3]);
    }
    target.is_none_the_worse();
}

#[test]
fn a_head_that_goes_on_for_ever_ends_its_connection() {
    let target = Target::with(&[]);
    let mut endless = target.send(PREFACE);
    endless.write_all(&frame(HEADERS, 0, 1, &head("/ubbmap.v1.MapService/ListMaps"))).unwrap();
    // A line that is not kept in the table, over and over (CVE-2024-27316).
    let line = [&[0x10, 1, b'x', 100][..], &[b'a'; 100]].concat();
    let taken = flood(&mut endless, &frame(CONTINUATION, 0, 1, &line.repeat(100)), 64 << 20, Duration::from_secs(10));
    assert!(taken < 16 << 20, "{taken} bytes of a head were read");
    target.is_none_the_worse();
}

#[test]
fn streams_that_are_opened_and_left_are_as_many_as_they_may_be_and_go_with_their_connection() {
    let target = Target::with(&[("LIMITS__STREAMS_PER_CLIENT", "8")]);
    let mut silent = target.send(PREFACE);
    for stream in 0..20_u32 {
        let open = frame(HEADERS, END_HEADERS, 2 * stream + 1, &head("/ubbmap.v1.MapService/StreamScans"));
        silent.write_all(&open).unwrap();
    }
    crate::limits_support::at_last(|| target.hits("limits.streams_per_client") >= 12.0);
    assert_eq!(target.metric("ubbmap_streams_open"), 8.0);
    assert!(target.is_served());
    Target::reset(silent);
    target.is_none_the_worse();
}

#[test]
fn a_message_of_grpc_that_stopped_half_way_held_memory_for_ever() {
    let target = Target::with(&[("LIMITS__REQUEST_SECONDS", "0.5")]);
    let mut waiting = target.send(PREFACE);
    waiting.write_all(&frame(HEADERS, END_HEADERS, 1, &head("/ubbmap.v1.MapService/InsertScans"))).unwrap();
    // A message of 1 MiB begins.
    let before = target.hits("limits.request_seconds");
    waiting.write_all(&frame(DATA, 0, 1, &[0, 0, 16, 0, 0, 1, 2, 3])).unwrap();
    crate::limits_support::at_last(|| target.hits("limits.request_seconds") > before);
    crate::limits_support::at_last(|| target.metric("ubbmap_incoming_bytes") == 0.0);
    // Another call of the same connection goes on.
    waiting.write_all(&frame(HEADERS, END_HEADERS, 3, &head("/ubbmap.v1.MapService/ListMaps"))).unwrap();
    waiting.write_all(&frame(DATA, 1, 3, &[0; 5])).unwrap();
    let (mut said, mut piece) = (Vec::new(), [0; 4096]);
    // The name of the map is in the answer.
    while !said.windows(4).any(|word| word == b"hall") {
        let length = waiting.read(&mut piece).unwrap();
        assert!(length > 0, "it is closed: {:?}", String::from_utf8_lossy(&said));
        said.extend_from_slice(&piece[..length]);
    }
    drop(waiting);
    target.is_none_the_worse();
}

#[test]
fn bytes_after_the_preface_that_are_no_frames_end_the_connection() {
    let target = Target::with(&[]);
    let mut odd = target.send(PREFACE);
    // Larger than any frame may be.
    odd.write_all(&[0xff; 64]).unwrap();
    assert!(!rest(odd).is_empty());
    target.is_none_the_worse();
}

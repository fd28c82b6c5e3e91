//! Databases that are damaged so that a reader which trusts them never comes to an end.

#![allow(clippy::unwrap_used, clippy::panic, reason = "tests")]

use super::bag_support::{IMAGE, SCAN};
use std::path::Path;
use ubbmap::logs::LogReader;
use ubbmap::sensor::ScanLimits;

/// Small pages, so that few messages make many of them.
const PAGE: usize = 512;

/// A bag with scans of topic 1 and pictures of topic 2: `count` messages of `topic`, each of `bytes` bytes. Gives the number of the
/// table's first page, from 0.
fn database(path: &Path, topic: i64, count: i64, bytes: i64) -> usize {
    let database = rusqlite::Connection::open(path).unwrap();
    let tables = format!(
        "PRAGMA page_size = {PAGE};
         CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT, type TEXT, serialization_format TEXT);
         CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER, timestamp INTEGER, data BLOB);
         INSERT INTO topics VALUES (1, '/scan', '{SCAN}', 'cdr'), (2, '/camera', '{IMAGE}', 'cdr');"
    );
    database.execute_batch(&tables).unwrap();
    for at in 0..count {
        let insert = "INSERT INTO messages (topic_id, timestamp, data) VALUES (?1, ?2, zeroblob(?3))";
        database.execute(insert, [topic, 100 + at, bytes]).unwrap();
    }
    let root = "SELECT rootpage FROM sqlite_master WHERE name = 'messages'";
    database.query_row(root, [], |row| row.get::<_, i64>(0)).unwrap() as usize - 1
}

#[track_caller]
fn says(path: &Path, words: &str) {
    let error = match LogReader::open(path, ScanLimits::default()) {
        Err(error) => error.to_string(),
        Ok(reader) => reader.last().unwrap().unwrap_err().to_string(),
    };
    assert!(error.contains(words), "{words:?} is not in {error}");
}

#[test]
fn messages_out_of_order_are_not_read_for_ever() {
    // Found by fuzzing: what comes after message 7 is message 7.
    let found = std::fs::read("fuzz/regressions/bag/messages-out-of-order").unwrap();
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("order.db3");
    // The first byte is the fuzz target's own.
    std::fs::write(&path, &found[1..]).unwrap();
    says(&path, "is damaged: message 7 stands behind message 7");
}

#[test]
fn pages_that_name_one_page_many_times_are_not_all_followed() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("pages.db3");
    let root = database(&path, 2, 60, 400);
    let mut bytes = std::fs::read(&path).unwrap();
    let pages = bytes.len() / PAGE;
    let levels: Vec<usize> = std::iter::once(root).chain(pages - 8..pages).collect();
    let leaf = (root + 1..pages - 8).find(|page| bytes[page * PAGE] == 0x0d).unwrap();
    // Nine pages, each with seventy times the next as its child, and the last with a leaf of pictures: 70 to the 9th leaves.
    for (at, page) in levels.iter().enumerate() {
        let child = levels.get(at + 1).copied().unwrap_or(leaf) as u32 + 1;
        let mut inner = [0; PAGE];
        inner[0] = 0x05;
        inner[3..5].copy_from_slice(&70_u16.to_be_bytes());
        inner[5..7].copy_from_slice(&((PAGE - 70 * 5) as u16).to_be_bytes());
        inner[8..12].copy_from_slice(&child.to_be_bytes());
        for cell in 0..70 {
            let place = PAGE - (cell + 1) * 5;
            inner[12 + 2 * cell..][..2].copy_from_slice(&(place as u16).to_be_bytes());
            inner[place..][..4].copy_from_slice(&child.to_be_bytes());
            inner[place + 4] = cell as u8 + 1;
        }
        bytes[page * PAGE..][..PAGE].copy_from_slice(&inner);
    }
    std::fs::write(&path, bytes).unwrap();
    says(&path, "is damaged: reading it takes more steps than a file of its size can need");
}

#[test]
fn messages_that_share_their_bytes_are_not_all_copied() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("shared.db3");
    // Five messages stand in one page, with their first bytes and the number of the page that has the rest.
    let root = database(&path, 1, 5, 4100);
    let mut bytes = std::fs::read(&path).unwrap();
    let cells: Vec<usize> = (0..5)
        .map(|cell| {
            let place = root * PAGE + 8 + 2 * cell;
            root * PAGE + usize::from(u16::from_be_bytes([bytes[place], bytes[place + 1]]))
        })
        .collect();
    assert_eq!(bytes[root * PAGE], 0x0d);
    // All cells are of one length; the last four bytes are that number.
    let length = cells[0] - cells[1];
    let rest: [u8; 4] = bytes[cells[0] + length - 4..][..4].try_into().unwrap();
    for cell in &cells {
        bytes[cell + length - 4..][..4].copy_from_slice(&rest);
    }
    // Nothing needs the pages of the others.
    let pages = u32::from_be_bytes(rest) as usize + 8;
    bytes.truncate(pages * PAGE);
    bytes[28..32].copy_from_slice(&(pages as u32).to_be_bytes());
    std::fs::write(&path, bytes).unwrap();
    says(&path, "is damaged: it holds more messages than it has bytes");
}

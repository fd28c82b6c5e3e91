//! `ubbmap experiment`: the report of a small log, with the real binary.

#![allow(clippy::unwrap_used, clippy::panic, reason = "tests")]

use super::cli_support::{Done, room_json, run};
use serde_json::Value;
use std::path::Path;
use tempfile::TempDir;

const SCANS: usize = 60;

fn experiment(folder: &Path, more: &[&str]) -> Done {
    let log = folder.join("room.jsonl");
    std::fs::write(&log, room_json(SCANS)).unwrap();
    let out = folder.join("report");
    let base = ["experiment", log.to_str().unwrap(), "--out", out.to_str().unwrap()];
    run(base.iter().chain(["--sample", "10", "--simulated", "40"].iter()).chain(more))
}

/// The rows of a table in which a column has a word.
fn rows<'a>(tables: &'a Value, table: &str, column: &str, word: &str) -> Vec<&'a Value> {
    let rows = tables[table].as_array().unwrap_or_else(|| panic!("no table {table}"));
    rows.iter().filter(|row| row[column] == word).collect()
}

#[track_caller]
fn number(row: &Value, column: &str) -> f64 {
    row[column].as_f64().unwrap_or_else(|| panic!("no number {column:?} in {row}"))
}

#[test]
fn the_report_agrees_with_the_maps_that_build_makes_of_the_same_log() {
    let folder = TempDir::new().unwrap();
    let tables = experiment(folder.path(), &["--json"]).ok().json();
    for rule in ["outer", "inner", "guaranteed"] {
        let map = folder.path().join("map.ubbmap");
        let args = ["build", "--evidence", rule, "--min-obstacle-width", "0.05", "--json", "--out"];
        let log = folder.path().join("room.jsonl");
        let built = run(args.iter().copied().chain([map.to_str().unwrap(), log.to_str().unwrap()])).ok().json();
        let size = rows(&tables, "size", "map", rule)[0];
        assert_eq!(number(size, "leaves or cells"), built["leaves"].as_f64().unwrap(), "{rule}");
        assert_eq!(number(size, "nodes"), built["nodes"].as_f64().unwrap(), "{rule}");
        for (column, key) in [("free m2", "leaf_area_free"), ("occupied m2", "leaf_area_occupied")] {
            assert!((number(size, column) - built[key].as_f64().unwrap()).abs() < 1e-6, "{rule}, {column}");
        }
        // A box of the paving is bisected where a square is quartered: at most 3 inner nodes for one, and at least 1.
        let (quad, paving) = (number(size, "nodes"), number(size, "k-OPM nodes"));
        assert!(paving > quad / 2.0 && paving < 1.5 * quad + 1.0, "{rule}: {quad} and {paving} nodes");
    }
    let grid = rows(&tables, "size", "map", "Gaussian grid")[0];
    // The room is 8 m x 6 m, with some four cells more on each side.
    assert!((5_900.0..6_500.0).contains(&number(grid, "leaves or cells")), "{grid}");
}

#[test]
fn no_seen_point_is_guaranteed_free_while_bounds_hold() {
    let folder = TempDir::new().unwrap();
    let tables = experiment(folder.path(), &["--json", "--seed", "7"]).ok().json();
    let guaranteed = rows(&tables, "seen-building", "map", "guaranteed");
    assert_eq!(guaranteed.len(), 3, "exact and two kinds of uncertain poses");
    for row in &guaranteed {
        assert_eq!(number(row, "called free"), 0.0, "{row}");
        assert!(number(row, "seen points") > 1_000.0 && number(row, "free m2") > 5.0, "{row}");
    }
    let lost: f64 =
        rows(&tables, "seen-building", "map", "Gaussian grid").iter().map(|row| number(row, "called free")).sum();
    assert!(lost > 0.0, "the grid loses some, so the points can be lost");
    let held = tables["broken-bounds"].as_array().unwrap().iter().filter(|row| number(row, "broken scans %") == 0.0);
    assert_eq!(held.map(|row| number(row, "called free")).sum::<f64>(), 0.0);
    // A larger tolerance never frees more.
    for pair in tables["broken-bounds"].as_array().unwrap().windows(2) {
        if number(&pair[1], "tolerance q") > number(&pair[0], "tolerance q") {
            assert!(number(&pair[1], "guaranteed free m2") <= number(&pair[0], "guaranteed free m2"), "{pair:?}");
        }
    }
}

#[test]
fn the_report_is_whole_and_its_page_needs_no_other_file() {
    let folder = TempDir::new().unwrap();
    let done = experiment(folder.path(), &[]).ok();
    assert!(done.stdout.contains("run time") && done.stdout.contains("report.md"), "{}", done.stdout);
    let out = folder.path().join("report");
    let read = |name: &str| std::fs::read_to_string(out.join(name)).unwrap();
    let (markdown, html) = (read("report.md"), read("report.html"));
    let mut named = 0;
    for link in markdown.split("](").skip(1).map(|rest| rest.split(')').next().unwrap()) {
        let bytes = std::fs::read(out.join(link)).unwrap_or_else(|error| panic!("{link}: {error}"));
        match link.rsplit('.').next().unwrap() {
            "png" => {
                let mut picture = png::Decoder::new(std::io::Cursor::new(bytes)).read_info().unwrap();
                let mut pixels = vec![0; picture.output_buffer_size().unwrap()];
                picture.next_frame(&mut pixels).unwrap();
                assert!(pixels.iter().any(|p| *p != pixels[0]), "{link} is blank");
            }
            "csv" => {
                let text = String::from_utf8(bytes).unwrap();
                let columns =
                    |line: &str| line.split('"').step_by(2).map(|part| part.matches(',').count()).sum::<usize>();
                let widths: Vec<usize> = text.lines().map(columns).collect();
                assert!(widths.len() > 1 && widths.iter().all(|width| *width == widths[0]), "{link}: {widths:?}");
            }
            other => panic!("a link to {other}"),
        }
        named += 1;
    }
    assert!(named >= 14, "{named} links");
    assert!(
        !html.contains("http") && !html.contains("src=\"") || html.matches("src=\"data:image/png;base64,").count() >= 8
    );
    assert_eq!(html.matches("src=\"").count(), html.matches("src=\"data:").count());
    assert!(
        markdown.contains("room.jsonl: 60 scans") && markdown.contains(env!("CARGO_PKG_VERSION")),
        "names log and version"
    );
    assert_eq!(std::fs::read_dir(&out).unwrap().count(), named + 2, "figures, tables, two reports and nothing else");
}

#[test]
fn what_cannot_be_run_is_refused_before_anything_is_written() {
    let folder = TempDir::new().unwrap();
    experiment(folder.path(), &["--classes", "3"]).fails(2, "classes must be between 4 and 255");
    experiment(folder.path(), &["--octomap", "/no/such/driver"]).fails(2, "/no/such/driver");
    experiment(folder.path(), &["--resolution", "-1"]).fails(2, "resolution");
    assert!(!folder.path().join("report").exists());
    let empty = folder.path().join("empty.jsonl");
    std::fs::write(&empty, "").unwrap();
    let out = folder.path().join("nothing");
    run(["experiment", empty.to_str().unwrap(), "--out", out.to_str().unwrap()]).fails(1, "no scans");
    assert!(!out.exists());
}

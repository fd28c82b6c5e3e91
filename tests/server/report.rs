//! Reports, drawings, charts, and the driver of OctoMap as the library uses it.

#![allow(clippy::unwrap_used, clippy::panic, reason = "tests")]

use std::path::{Path, PathBuf};
use ubbmap::experiment::octomap::{Insertion, OctoMap};
use ubbmap::experiment::report::{Block, Cell, Report, Table};
use ubbmap::picture::{Axis, Chart, Drawing, INK, LINES, PAPER, Series};
use ubbmap::sensor::{Angles, Mount, PoseBox, PoseLimits, Scan, ScanLimits, ScanSpec, SensorModel, SensorSpec};

fn report() -> Report {
    let mut table = Table::new("sizes", "A <caption> & more", &["map, and more", "m2"]);
    table.rows.push(vec!["say \"free\"".into(), Cell::Number(0.125_4, 2)]);
    table.rows.push(vec!["a, b".into(), Cell::Missing]);
    let mut drawing = Drawing::new(7, 5, PAPER);
    drawing.line((1.0, 1.0), (5.0, 3.0), 1, [200, 0, 0]);
    let figure = Block::Figure { name: "dot", caption: "a dot".to_owned(), png: drawing.png().unwrap() };
    let blocks = vec![Block::Head("Head".to_owned()), Block::Text("x < y".to_owned()), Block::Table(table), figure];
    Report { title: "A & B".to_owned(), blocks }
}

#[test]
fn a_table_is_quoted_as_rfc_4180_has_it_and_keeps_all_digits() {
    let Block::Table(table) = &report().blocks[2] else { panic!("a table") };
    assert_eq!(table.csv(), "\"map, and more\",m2\r\n\"say \"\"free\"\"\",0.1254\r\n\"a, b\",\r\n");
}

#[test]
fn markdown_and_html_say_the_same_and_html_is_escaped() {
    let (markdown, html) = (report().markdown(), report().html());
    assert!(markdown.contains("| say \"free\" | 0.13 |\n| a, b | - |"), "{markdown}");
    assert!(markdown.contains("![a dot](dot.png)") && markdown.contains("([CSV](sizes.csv))"));
    for part in
        ["<h1>A &amp; B</h1>", "<p>x &lt; y</p>", "A &lt;caption&gt; &amp; more", "say &quot;free&quot;", "0.13"]
    {
        assert!(html.contains(part), "{part} is not in {html}");
    }
}

fn decoded(drawing: &Drawing) -> (png::ColorType, Vec<u8>) {
    let mut reader = png::Decoder::new(std::io::Cursor::new(drawing.png().unwrap())).read_info().unwrap();
    let mut pixels = vec![0; reader.output_buffer_size().unwrap()];
    let frame = reader.next_frame(&mut pixels).unwrap();
    assert_eq!((frame.width, frame.height), (drawing.width(), drawing.height()));
    (frame.color_type, pixels)
}

#[test]
fn what_is_drawn_is_what_the_file_holds_and_nothing_is_drawn_outside() {
    let mut drawing = Drawing::new(6, 4, PAPER);
    drawing.fill((-2, -2), (4, 4), INK);
    drawing.outline((3, 1), (9, 9), [128; 3]);
    drawing.line((f64::NAN, 0.0), (2.0, 2.0), 3, INK);
    drawing.line((-1e9, 0.0), (1e9, 0.0), 1, INK);
    let (colour, pixels) = decoded(&drawing);
    assert_eq!(colour, png::ColorType::Grayscale, "no colour, a byte a pixel");
    let rows = [[0, 0, 255, 255, 255, 255], [0, 0, 255, 128, 128, 128], [255, 255, 255, 128, 255, 255]];
    assert_eq!(pixels[..18], rows.concat());
    drawing.set(5, 3, [1, 2, 3]);
    let (colour, pixels) = decoded(&drawing);
    assert_eq!((colour, &pixels[69..]), (png::ColorType::Rgb, &[1, 2, 3][..]));
    assert_eq!((drawing.pixel(5, 3), drawing.pixel(6, 0)), (Some([1, 2, 3]), None));
}

#[test]
fn drawings_stand_beside_each_other_in_rows() {
    let part = |width, grey| Drawing::new(width, 10, [grey; 3]);
    let whole = Drawing::beside(&[part(20, 10), part(30, 20), part(5, 30)], 2);
    assert_eq!((whole.width(), whole.height()), (8 + 20 + 8 + 30 + 8, 8 + 10 + 8 + 10 + 8));
    let at = |x, y| whole.pixel(x, y).unwrap()[0];
    assert_eq!((at(8, 8), at(36, 8), at(8, 26), at(36, 26), at(0, 0)), (10, 20, 30, 255, 255));
    assert_eq!(Drawing::beside(&[], 3).height(), 8);
}

#[test]
fn a_chart_draws_every_point_in_the_colour_of_its_line_whatever_the_values() {
    let lines = [vec![(0.0, 0.0), (1.0, 5.0)], vec![(0.5, 2.0)], vec![], vec![(0.2, f64::NAN), (0.3, 1.0)]];
    for (axes, off) in [((Axis::Linear, Axis::Linear), 0.0), ((Axis::Logarithmic, Axis::Logarithmic), 0.1)] {
        let moved = |points: &Vec<(f64, f64)>| points.iter().map(|(x, y)| (x + off, y + off)).collect();
        let series = lines.iter().map(|points| Series { name: "one".to_owned(), points: moved(points) });
        let chart = Chart { title: "a title".to_owned(), axes, series: series.collect() };
        let drawing = chart.draw(320, 200);
        let count = |colour| {
            let all = (0..200).flat_map(|y| (0..320).map(move |x| (x, y)));
            all.filter(|(x, y)| drawing.pixel(*x, *y) == Some(colour)).count()
        };
        // The legend's mark alone has 48 dots, a point 25 more.
        assert!(count(LINES[0]) > 48 + 50, "{axes:?}");
        assert!(count(LINES[1]) >= 48 + 25 - 20, "{axes:?}");
    }
    let zeros = vec![Series { name: "zero has no logarithm".to_owned(), points: lines[0].clone() }];
    let chart = Chart { title: String::new(), axes: (Axis::Logarithmic, Axis::Logarithmic), series: zeros };
    assert_eq!(chart.draw(300, 200).height(), 200);
    let empty = Chart { title: String::new(), axes: (Axis::Logarithmic, Axis::Linear), series: Vec::new() };
    assert_eq!(empty.draw(10, 5).width(), 10, "and nothing, on too little room");
}

fn scan() -> Scan {
    let mount = Mount { x: 0.5, y: 0.0, theta: 0.0 };
    let around = |v: f64| (v - 0.25, v + 0.25);
    let spec = ScanSpec {
        pose: PoseBox::new(around(1.0), around(2.0), (0.0, 0.0), &PoseLimits::default()).unwrap(),
        angles: Angles::Listed(vec![0.0, 1.0, 2.0]),
        ranges: vec![2.0, f32::NAN, f32::INFINITY],
        footprint_radius: 0.0,
        sweep_rotation: 0.0,
        sweep_translation: 0.0,
    };
    let sensor = SensorModel::new(SensorSpec { mount, ..SensorSpec::default() }).unwrap();
    Scan::new(spec, sensor, &ScanLimits::default()).unwrap()
}

/// A driver that is a shell script.
#[cfg(unix)]
fn driver(folder: &Path, script: &str) -> PathBuf {
    use std::os::unix::fs::PermissionsExt;
    let path = folder.join("driver");
    std::fs::write(&path, format!("#!/bin/sh\n{script}\n")).unwrap();
    std::fs::set_permissions(&path, std::fs::Permissions::from_mode(0o755)).unwrap();
    path
}

#[cfg(unix)]
#[test]
fn octomaps_driver_is_given_returns_in_the_map_frame_and_its_answers_are_taken() {
    let folder = tempfile::tempdir().unwrap();
    let figures =
        r#"{"version":"1","scans":1,"seconds":2,"scans_per_second":0.5,"leaves":3,"memory_bytes":4,"bt_bytes":5}"#;
    let script = format!(
        "cp \"$1\" {0}/seen.txt\nshift\nfor word; do [ \"$last\" = --answers ] && printf '0.25\\n-1\\n' > \"$word\"; last=$word; done\necho '{figures}'",
        folder.path().display()
    );
    let driver = driver(folder.path(), &script);
    let work = tempfile::tempdir().unwrap();
    let peer = OctoMap::new(&driver, work.path(), &[scan()]).unwrap();
    let measured = peer.insert(0.1, 3, Insertion::Discrete).unwrap();
    assert_eq!((measured.leaves, measured.bt_bytes, measured.seconds), (3, 5, 2.0));
    assert_eq!(std::fs::read_to_string(folder.path().join("seen.txt")).unwrap(), "1.5 2 1 3.5 2\n");
    assert_eq!(peer.occupancy(0.1, &[(0.0, 0.0), (1.0, 1.0)]).unwrap(), [Some(0.25), None]);
    let error = peer.occupancy(0.1, &[(0.0, 0.0)]).unwrap_err().to_string();
    assert!(error.contains("answered 2 of 1 points"), "{error}");
    drop(peer);
    assert_eq!(std::fs::read_dir(work.path()).unwrap().count(), 0, "its files are gone");
}

#[cfg(unix)]
#[test]
fn a_driver_that_fails_is_quoted_and_one_that_is_not_there_is_named() {
    let folder = tempfile::tempdir().unwrap();
    let broken = driver(folder.path(), "echo out of luck >&2; exit 3");
    let peer = OctoMap::new(&broken, folder.path(), &[scan()]).unwrap();
    let error = peer.insert(0.1, 1, Insertion::Whole).unwrap_err().to_string();
    assert!(error.contains("out of luck"), "{error}");
    let error = OctoMap::new(Path::new("/no/driver"), folder.path(), &[scan()]).unwrap_err().to_string();
    assert!(error.contains("/no/driver"), "{error}");
}

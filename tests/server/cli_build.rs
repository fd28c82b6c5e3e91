//! `ubbmap build`: counts, files, pictures, damage and bad flags, with the real binary.

#![allow(clippy::unwrap_used, clippy::panic, clippy::print_stderr, reason = "tests")]

use super::cli_support::{BEAMS, Done, Folder, gzip, room_carmen, room_json, run};
use super::logs_real::data;
use std::path::{Path, PathBuf};
use ubbmap::mapping::{EvidenceRule, MapConfig};
use ubbmap::quadtree::{NodeAddress, OccupancyTree};
use ubbmap::store::{LoadedMap, read_map_file};

impl Folder {
    fn log(&self, name: &str, bytes: impl AsRef<[u8]>) -> PathBuf {
        std::fs::write(self.path(name), bytes).unwrap();
        self.path(name)
    }

    /// `build LOG --out map.ubbmap --json ..`
    fn build(&self, log: &Path, more: &[&str]) -> Done {
        let out = self.path("map.ubbmap");
        let base = ["build", log.to_str().unwrap(), "--out", out.to_str().unwrap(), "--json"];
        run(base.iter().chain(more))
    }

    fn map(&self) -> (MapConfig, LoadedMap) {
        read_map_file(&mut std::fs::File::open(self.path("map.ubbmap")).unwrap()).unwrap()
    }

    fn bytes(&self) -> Vec<u8> {
        std::fs::read(self.path("map.ubbmap")).unwrap()
    }
}

fn class_at(config: &MapConfig, tree: &OccupancyTree, x: f64, y: f64) -> u8 {
    tree.max_class(config.grid().leaf_at(x, y).unwrap())
}

#[test]
fn a_room_is_mapped_counted_written_and_drawn() {
    let bench = Folder::new();
    let log = bench.log("room.jsonl", room_json(170));
    let png = bench.path("room.png");
    let counts = bench.build(&log, &["--png", png.to_str().unwrap(), "--min-obstacle-width", "0.05"]).ok().json();
    let (config, map) = bench.map();
    assert_eq!(config.rule(), EvidenceRule::Guaranteed);
    assert_eq!(config.min_obstacle_width(), 0.05);
    assert_eq!(config.sensors()["default"].spec().range_max, 30.0, "the log's own");
    // The middle of the room's free part, the wall, the pillar, and what is behind the wall.
    assert_eq!(class_at(&config, &map.tree, 1.5, 1.5), 1);
    assert_eq!(class_at(&config, &map.tree, 4.0, 0.05), 10);
    assert!(class_at(&config, &map.tree, 0.29, 0.05) > 5);
    assert_eq!(class_at(&config, &map.tree, 4.5, 0.0), 5);

    let statistics = map.tree.statistics();
    assert_eq!(counts["scans"], 170);
    assert_eq!(counts["beams"], 170 * BEAMS);
    assert_eq!(counts["revision"], 170);
    assert_eq!(map.revision, 170);
    assert_eq!(counts["leaves"], statistics.leaves);
    assert_eq!(counts["nodes"], statistics.nodes);
    assert_eq!(counts["file_bytes"], std::fs::metadata(bench.path("map.ubbmap")).unwrap().len());
    assert!(counts["memory_bytes"].as_u64().unwrap() > 0);
    let number = |key: &str| counts[key].as_f64().unwrap();
    assert!((number("leaf_area_free") - 0.01 * statistics.free_cells as f64).abs() < 1e-6);
    assert!((number("leaf_area_occupied") - 0.01 * statistics.occupied_cells as f64).abs() < 1e-6);
    let root = 6553.6 * 6553.6;
    let areas = number("leaf_area_free") + number("leaf_area_unknown") + number("leaf_area_occupied");
    assert!((areas - root).abs() < 1e-3, "the areas are those of the whole map: {areas}");
    let bounds = &counts["bounds"];
    let side =
        |axis: &str| bounds[format!("max_{axis}")].as_f64().unwrap() - bounds[format!("min_{axis}")].as_f64().unwrap();
    assert!((8.0..8.6).contains(&side("x")) && (6.0..6.6).contains(&side("y")), "{bounds}");
    let inside =
        number("leaf_area_free") + number("leaf_area_occupied") + bounds["leaf_area_unknown"].as_f64().unwrap();
    assert!((inside - side("x") * side("y")).abs() < 1e-6);
    assert!((40.0..48.0).contains(&number("leaf_area_free")), "{counts}");
    let rate = number("scans") / number("seconds");
    assert!((rate - number("scans_per_second")).abs() < 1e-6 * rate);
    assert_eq!(counts["settings"]["evidence"], "guaranteed");
    assert_eq!(counts["settings"]["sensor"]["range_max"], 30.0);

    let (width, height, pixels) = read_png(&png);
    let share = |grey: u8| pixels.iter().filter(|pixel| **pixel == grey).count() as f64 / (width * height) as f64;
    assert!(share(255) > 0.3 && share(0) > 0.02, "free is white, occupied black");
}

fn read_png(path: &Path) -> (usize, usize, Vec<u8>) {
    let file = std::io::BufReader::new(std::fs::File::open(path).unwrap());
    let mut reader = png::Decoder::new(file).read_info().unwrap();
    let mut pixels = vec![0; reader.output_buffer_size().unwrap()];
    let info = reader.next_frame(&mut pixels).unwrap();
    assert_eq!((info.color_type, info.bit_depth), (png::ColorType::Grayscale, png::BitDepth::Eight));
    (info.width as usize, info.height as usize, pixels)
}

#[test]
fn format_compression_and_threads_do_not_change_the_map() {
    let bench = Folder::new();
    let json = bench.log("a.jsonl", room_json(120));
    bench.build(&json, &["--pose-error", "0.03,0.5deg", "--threads", "1"]).ok();
    let expected = bench.bytes();
    // The name does not say what a log is.
    for (name, bytes) in [("b.gz", room_json(120).into_bytes()), ("c.txt", gzip(room_json(120).as_bytes()))] {
        let log = bench.log(name, bytes);
        bench.build(&log, &["--pose-error", "0.03,0.5deg", "--threads", "3"]).ok();
        assert!(bench.bytes() == expected, "{name}");
    }
    let carmen = bench.log("d.log.gz", gzip(room_carmen(120).as_bytes()));
    bench.build(&carmen, &["--pose-error", "0.03,0.5deg", "--range-max", "30"]).ok();
    assert!(bench.bytes() == expected, "CARMEN");
}

#[test]
fn every_and_limit_choose_scans() {
    let bench = Folder::new();
    let log = bench.log("a.jsonl", room_json(50));
    assert_eq!(bench.build(&log, &["--every", "7"]).ok().json()["scans"], 8);
    assert_eq!(bench.build(&log, &["--every", "7", "--limit", "3"]).ok().json()["scans"], 3);
    let by_flag = bench.bytes();
    let lines: Vec<String> = room_json(50).lines().map(str::to_owned).collect();
    let chosen = [0, 1, 8, 15].map(|i| lines[i].clone()).join("\n");
    let log = bench.log("b.jsonl", chosen);
    bench.build(&log, &[]).ok();
    assert!(by_flag == bench.bytes(), "every 7th, the first first");
}

#[test]
fn settings_reach_the_map() {
    let bench = Folder::new();
    let log = bench.log("a.jsonl", room_json(3));
    let flags = "--evidence outer --resolution 0.05 --depth 12 --classes 20 --origin -50,-60 --range-error 0.02,0.04 \
                 --beam-opening 0.5deg --beam-diameter 0.02 --range-min 0.1 --range-max 25 --no-return-free-to 20 \
                 --beam-angle-error 0.001rad --footprint-radius 0.2";
    let flags: Vec<&str> = flags.split_whitespace().collect();
    bench.build(&log, &flags).ok();
    let (config, map) = bench.map();
    assert_eq!((config.rule(), config.scale().count()), (EvidenceRule::Outer, 20));
    assert_eq!((config.grid().resolution(), config.grid().depth(), config.grid().origin()), (0.05, 12, (-50.0, -60.0)));
    let spec = config.sensors()["default"].spec();
    assert_eq!((spec.range_error_minus, spec.range_error_plus, spec.beam_diameter), (0.02, 0.04, 0.02));
    assert_eq!((spec.beam_opening, spec.beam_angle_error), (0.5_f64.to_radians(), 0.001));
    assert_eq!((spec.range_min, spec.range_max, spec.no_return_free_to), (0.1, 25.0, Some(20.0)));
    assert!(map.tree.max_class(NodeAddress { depth: 0, x: 0, y: 0 }) > 10);
    let words = bench.build(&log, &["--pose-error", "0.01,0.1deg"]).ok().stderr;
    assert!(words.is_empty(), "{words}");
}

#[test]
fn a_damaged_log_is_mapped_up_to_the_damage() {
    let bench = Folder::new();
    let whole = room_json(40);
    let lines: Vec<&str> = whole.lines().collect();
    let head = lines[..21].join("\n");
    let log = bench.log("head.jsonl", &head);
    bench.build(&log, &[]).ok();
    let expected = bench.bytes();
    let cut = gzip(whole.as_bytes());
    let cases: [(&str, Vec<u8>, Option<u64>, &str); 4] = [
        ("line.jsonl", format!("{head}\n{}\n{}", &lines[21][..60], lines[22]).into_bytes(), Some(20), "line 22"),
        (
            "count.jsonl",
            format!("{head}\n{}", lines[21].replacen("[", "[1.0,", 1)).into_bytes(),
            Some(20),
            "line 22: has 181 ranges, the header says 180",
        ),
        (
            "angle.jsonl",
            format!("{head}\n{}", lines[21].replacen("{", "{\"angle_increment\":9,", 1)).into_bytes(),
            Some(20),
            "line 22",
        ),
        ("cut.gz", cut[..cut.len() - 20].to_vec(), None, "unexpected end of the compressed data after line"),
    ];
    for (name, bytes, scans, words) in cases {
        let log = bench.log(name, bytes);
        let done = bench.build(&log, &[]).fails(1, words);
        assert!(done.stderr.contains(name), "the log is named: {done:?}");
        let counted = done.json()["scans"].as_u64().unwrap();
        assert!(done.stderr.contains(&format!("the {counted} scans before")), "{done:?}");
        if let Some(scans) = scans {
            assert_eq!(counted, scans, "{done:?}");
            assert!(bench.bytes() == expected, "{name}: the map of what is whole");
        } else {
            assert!(counted > 0 && counted < 40, "{done:?}");
        }
    }
}

#[test]
fn what_is_no_log_is_refused() {
    let bench = Folder::new();
    let missing = bench.path("missing.gz");
    bench.build(&missing, &[]).fails(1, "missing.gz");
    bench.build(&bench.path(""), &[]).fails(1, "is a folder without a metadata.yaml");
    for (name, bytes, words) in [
        ("empty", &b""[..], "no scans"),
        ("text", b"hello there", "no CARMEN message"),
        ("binary", b"\x7fELF\xff\xfe\x00\x01", "line 1"),
        ("odometry", b"ODOM 1 2 3 4 5 6 7 host 8\n", "no scans"),
        ("header", b"{\"beams\": 3}\n", "no scans"),
        ("gzip", b"\x1f\x8b\x08\x00", "compressed data"),
    ] {
        let log = bench.log(name, bytes);
        let done = bench.build(&log, &[]).fails(1, words);
        assert!(done.stdout.is_empty() && !bench.path("map.ubbmap").exists(), "{done:?}");
    }
}

#[test]
fn bad_flags_are_bad_usage_and_name_the_value() {
    let bench = Folder::new();
    let log = bench.log("a.jsonl", room_json(1));
    for (flags, words) in [
        ("--classes 3", "classes must be between 4 and 255, got 3"),
        ("--resolution 0", "resolution must be"),
        ("--resolution NaN", "resolution must be"),
        ("--resolution much", "--resolution"),
        ("--depth 25", "depth must be between 1 and 24"),
        ("--evidence hopeful", "guaranteed, outer, inner"),
        ("--pose-error 0.02", "0.02,0.5deg"),
        ("--pose-error 0.02,0.5", "no unit"),
        ("--beam-opening 0.25", "no unit"),
        ("--beam-opening 190deg", "beam_opening"),
        ("--range-error 1,2,3", "one number, or two"),
        ("--range-error 100", "range_error"),
        ("--range-max -1", "range_max"),
        ("--range-min 40", "range_m"),
        ("--no-return-free-to 30", "no_return_free_to"),
        ("--min-obstacle-width 11", "min_obstacle_width"),
        ("--every 0", "--every"),
        ("--threads 0", "--threads"),
        ("--origin 1", "X,Y"),
        ("--colour red", "--colour"),
    ] {
        let flags: Vec<&str> = flags.split(' ').collect();
        let done = bench.build(&log, &flags).fails(2, words);
        assert!(done.stdout.is_empty() && !bench.path("map.ubbmap").exists(), "{done:?}");
    }
    run(["build", log.to_str().unwrap()]).fails(2, "--out");
    run(["build", log.to_str().unwrap(), "--out", "/nonexistent/dir/m.ubbmap"]).fails(1, "/nonexistent/dir/m.ubbmap");
    bench.build(&log, &["--pose-error", "3,1deg"]).fails(1, "line 2: pose.x is 6");
}

#[test]
fn a_build_that_names_its_log_as_a_target_destroyed_it() {
    let bench = Folder::new();
    let log = bench.log("a.jsonl", room_json(3));
    let before = std::fs::read(&log).unwrap();
    let link = bench.path("link.jsonl");
    std::os::unix::fs::symlink(&log, &link).unwrap();
    let hard = bench.path("hard.jsonl");
    std::fs::hard_link(&log, &hard).unwrap();
    let (map, text) = (bench.path("map.ubbmap"), log.to_str().unwrap());
    for target in [&log, &link, &hard] {
        let target = target.to_str().unwrap();
        run(["build", text, "--out", target]).fails(2, "--out would overwrite the log");
        run(["build", text, "--out", map.to_str().unwrap(), "--png", target]).fails(2, "--png would overwrite the log");
    }
    run(["build", text, "--out", map.to_str().unwrap(), "--png", map.to_str().unwrap()]).fails(2, "the same file");
    assert_eq!(std::fs::read(&log).unwrap(), before);
}

#[test]
fn every_command_has_help_with_an_example() {
    for command in
        ["", "serve", "demo", "build", "replay", "map", "map create", "map list", "map show", "map delete", "check"]
    {
        let done = run(command.split_whitespace().chain(["--help"])).ok();
        assert!(done.stdout.contains("Example:\n  ubbmap "), "{command}: {}", done.stdout);
    }
    assert_eq!(run(["--version"]).ok().stdout.trim(), concat!("ubbmap ", env!("CARGO_PKG_VERSION")));
    run(["biuld"]).fails(2, "build");
    run([""; 0]).fails(2, "Usage");
}

#[test]
fn the_real_logs_are_mapped_by_every_rule() {
    let Some(data) = data() else { return };
    let bench = Folder::new();
    for (name, carmen, scans, flags) in [
        ("fr079", "freiburg-079-corrected.log.gz", 4791, ["--pose-error", "0,0deg"]),
        ("intel", "intel-corrected.log.gz", 910, ["--pose-error", "0.05,0.5deg"]),
    ] {
        let log = data.join(name).join(carmen);
        let [guaranteed, outer, inner] = ["guaranteed", "outer", "inner"].map(|rule| {
            let counts = bench
                .build(&log, &[&["--evidence", rule, "--min-obstacle-width", "0.05"][..], &flags].concat())
                .ok()
                .json();
            assert_eq!(counts["scans"], scans, "{name} {rule}");
            let area = |key: &str| counts[key].as_f64().unwrap();
            eprintln!(
                "{name} {rule}: {:.0} scans/s, free {:.1} m2, occupied {:.1} m2",
                area("scans_per_second"),
                area("leaf_area_free"),
                area("leaf_area_occupied")
            );
            (area("leaf_area_free"), area("leaf_area_occupied"))
        });
        assert!(guaranteed.0 < outer.0 && inner.0 < outer.0, "{name}: outer claims most");
        assert!(guaranteed.1 > outer.1, "{name}: outer wipes obstacles away");
        assert!(guaranteed.0 > 250.0, "{name}: {guaranteed:?}");
    }
}

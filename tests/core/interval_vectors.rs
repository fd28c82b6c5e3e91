//! Point intervals against real values computed with 2,400 bits and more (`fixtures/make_trig_vectors.py`).

#![allow(clippy::unwrap_used, clippy::panic, clippy::print_stdout, reason = "a test fails by panicking")]

use ubbmap::interval::Interval;

const VECTORS: &str = include_str!("fixtures/trig_vectors.txt");

fn double(field: &str) -> f64 {
    f64::from_bits(u64::from_str_radix(field, 16).unwrap())
}

/// The fields of every line of one function.
fn vectors(function: &str) -> Vec<Vec<&'static str>> {
    let lines: Vec<Vec<&str>> = VECTORS
        .lines()
        .map(|line| line.split(' ').collect::<Vec<_>>())
        .filter(|fields| fields[0] == function)
        .collect();
    assert!(lines.len() > 50, "the file has vectors of {function}");
    lines
}

/// Truth is inside `[down, up]`, so it is inside what encloses that; and two doubles more are all that is given away.
fn check(what: &str, got: Interval, down: f64, up: f64) {
    assert!(got.lo() <= down && up <= got.hi(), "{what}: {got:?} leaves out part of [{down:e}, {up:e}]");
    assert!(got.lo() >= down.next_down() && got.hi() <= up.next_up(), "{what}: {got:?} is wide for [{down:e}, {up:e}]");
}

#[test]
fn sines_and_cosines_of_points_enclose_the_truth_within_an_ulp() {
    for (name, function) in [("sin", Interval::sin as fn(Interval) -> Interval), ("cos", Interval::cos)] {
        for line in vectors(name) {
            let x = double(line[1]);
            let got = function(Interval::point(x));
            // Values outside [-1, 1] are given away by nobody.
            check(&format!("{name} {x:e}"), got, double(line[2]).max(-1.0), double(line[3]).min(1.0));
            assert!(got.lo() >= -1.0 && got.hi() <= 1.0);
        }
    }
}

#[test]
fn directions_and_lengths_of_points_enclose_the_truth_within_an_ulp() {
    for line in vectors("atan2") {
        let (y, x) = (double(line[1]), double(line[2]));
        let got = Interval::point(y).atan2(Interval::point(x));
        let (down, up) = (double(line[3]), double(line[4]));
        check(&format!("atan2 {y:e} {x:e}"), got, down, up);
    }
    for line in vectors("hypot") {
        let (y, x) = (double(line[1]), double(line[2]));
        check(
            &format!("hypot {y:e} {x:e}"),
            Interval::point(y).hypot(Interval::point(x)),
            double(line[3]),
            double(line[4]),
        );
    }
}

#[test]
fn extrema_are_found_at_every_quarter_turn() {
    for line in vectors("quarter") {
        let k: i64 = line[1].parse().unwrap();
        let c = double(line[2]);
        // k pi / 2 lies between the neighbours of the double nearest to it.
        let around = Interval::new(c.next_down(), c.next_up()).unwrap();
        let (sin, cos) = (around.sin(), around.cos());
        let (extreme, other, top) = if k % 2 == 0 { (cos, sin, k % 4 == 0) } else { (sin, cos, (k - 1) % 4 == 0) };
        assert_eq!(if top { extreme.hi() } else { -extreme.lo() }, 1.0, "k = {k}: {extreme:?}");
        assert!(extreme.width() < 1e-9_f64.max(c.abs() * 1e-15), "k = {k}: {extreme:?}");
        assert!(other.contains(0.0), "k = {k}: {other:?}");
        // A step of 0.01 to either side there is none.
        if c.abs() < 1e6 {
            for side in [-1.0, 1.0] {
                let beside = Interval::spanning(c + 0.01 * side, c + 1.5 * side);
                let beside = if k % 2 == 0 { beside.cos() } else { beside.sin() };
                assert!(if top { beside.hi() < 0.99996 } else { beside.lo() > -0.99996 }, "k = {k}: {beside:?}");
            }
        }
    }
}

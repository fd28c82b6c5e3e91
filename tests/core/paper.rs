//! SIVIA, BUILDSP and UBBMAP node by node: against brute force, and as the oracle of the fast engine.
#![allow(
    clippy::unwrap_used,
    clippy::print_stdout,
    reason = "a test that cannot be set up has failed; counts are told"
)]

use crate::regions_exact::Dice;
use crate::rules_support::{config, survey};
use std::collections::BTreeSet;
use ubbmap::interval::{Box2, Interval, Verdict};
use ubbmap::mapping::EvidenceRule;
use ubbmap::mapping::reference::{Enclosure, Reference, Subpaving, buildsp, sivia, ubbmap};
use ubbmap::quadtree::{ClassScale, Grid, NodeAddress, ReferenceTree};
use ubbmap::sensor::{Angles, PoseBox, PoseLimits, Scan, ScanLimits, ScanSpec, SensorModel, SensorSpec};

type Cells = BTreeSet<(u32, u32)>;

fn cells(set: &Subpaving, depth: u8) -> Cells {
    let leaves: Vec<_> = set.leaves(depth).map(|leaf| (leaf.x, leaf.y)).collect();
    let distinct: Cells = leaves.iter().copied().collect();
    assert_eq!(distinct.len(), leaves.len(), "a leaf is held twice");
    distinct
}

fn all_leaves(grid: &Grid) -> impl Iterator<Item = NodeAddress> {
    let (side, depth) = (grid.side(), grid.depth());
    (0..side).flat_map(move |y| (0..side).map(move |x| NodeAddress { depth, x, y }))
}

#[test]
fn sivia_encloses_a_disc_from_both_sides() {
    // Leaves are whole units, the disc about (21.5, 30.5) has the radius 13: decided in integers of half units.
    let grid = Grid::new(1.0, 6, Some((0.0, 0.0))).unwrap();
    let mut asked = 0;
    let Enclosure { inside, boundary } = sivia(&grid, &mut |square: &Box2| {
        asked += 1;
        let square_of = |i: Interval, c: f64| (i - Interval::point(c)).square();
        let distance = square_of(square.x, 21.5) + square_of(square.y, 30.5);
        match (distance.hi() <= 169.0, distance.lo() > 169.0) {
            (true, _) => Verdict::Yes,
            (_, true) => Verdict::No,
            _ => Verdict::Unknown,
        }
    });
    let (inside, boundary) = (cells(&inside, 6), cells(&boundary, 6));
    for leaf in all_leaves(&grid) {
        let (x, y) = (2 * i64::from(leaf.x), 2 * i64::from(leaf.y));
        let far = |lo: i64, c: i64| (lo - c).abs().max((lo + 2 - c).abs());
        let near = |lo: i64, c: i64| (lo - c).max(c - lo - 2).max(0);
        let farthest = far(x, 43).pow(2) + far(y, 61).pow(2);
        let nearest = near(x, 43).pow(2) + near(y, 61).pow(2);
        let key = (leaf.x, leaf.y);
        assert_eq!(inside.contains(&key), farthest <= 676, "{leaf:?}");
        assert_eq!(boundary.contains(&key), farthest > 676 && nearest <= 676, "{leaf:?}");
    }
    assert!(asked < 64 * 64 / 2, "nodes are decided whole: {asked} tests");
}

#[test]
fn buildsp_covers_boxes_by_the_fewest_nodes() {
    let grid = Grid::new(0.25, 6, Some((-8.0, -8.0))).unwrap();
    let mut dice = Dice(77);
    for _ in 0..50 {
        let mut one = || {
            let mut side = || {
                let lo = dice.real(-9.0, 8.0);
                Interval::spanning(lo, lo + dice.pick(&[0.0, 0.1, 1.0, 6.0]))
            };
            Box2::new(side(), side())
        };
        let boxes: Vec<Box2> = (0..5).map(|_| one()).collect();
        let cover = buildsp(&grid, &boxes);
        let held = cells(&cover, 6);
        for leaf in all_leaves(&grid) {
            let meets = boxes.iter().any(|other| other.meets(grid.node_box(leaf)));
            assert_eq!(held.contains(&(leaf.x, leaf.y)), meets, "{leaf:?} of {boxes:?}");
            assert_eq!(cover.holds(leaf), meets);
        }
        // The fewest: no four siblings are left apart.
        for node in cover.nodes() {
            let parent = (node.depth, node.x >> 1, node.y >> 1);
            let siblings = cover.nodes().iter().filter(|n| (n.depth, n.x >> 1, n.y >> 1) == parent).count();
            assert!(node.depth == 0 || siblings < 4, "{node:?}");
        }
    }
}

/// A scan of a room of random walls from an exact or uncertain pose.
fn scan(dice: &mut Dice, uncertain: bool) -> Scan {
    let spec = SensorSpec {
        range_max: 5.0,
        beam_opening: dice.pick(&[0.004_363, 0.2, 0.0]),
        beam_diameter: dice.pick(&[0.012, 0.3, 0.0]),
        ..SensorSpec::default()
    };
    let beams = dice.pick(&[24_usize, 45]);
    let mut around = |v: f64, most: f64| {
        let half = if uncertain { dice.real(0.0, most) } else { 0.0 };
        (v - half, v + half)
    };
    let pose = (around(0.31, 0.05), around(-0.17, 0.05), around(1.1, 0.02));
    let ranges = (0..beams).map(|_| dice.real(0.4, 5.2) as f32).collect();
    let scan = ScanSpec {
        pose: PoseBox::new(pose.0, pose.1, pose.2, &PoseLimits::default()).unwrap(),
        angles: Angles::Uniform { min: -2.0, increment: 4.0 / beams as f64 },
        ranges,
        footprint_radius: 0.0,
        sweep_rotation: 0.0,
        sweep_translation: 0.0,
    };
    Scan::new(scan, SensorModel::new(spec).unwrap(), &ScanLimits::default()).unwrap()
}

#[test]
fn the_engine_lies_between_what_sivia_shows_and_what_it_allows() {
    let grid = Grid::new(0.1, 7, None).unwrap();
    let mut dice = Dice(4242);
    let mut counts = [0_usize; 6];
    // Leaves inside one beam's empty part that `inner` does not have.
    let mut missed = 0;
    for round in 0..10 {
        let scan = scan(&mut dice, round % 2 == 1);
        let reference = Reference::new(&scan, 0.05);
        let occupied = cells(&reference.occupied_set(&grid), 7);
        let Enclosure { inside, boundary } = reference.empty_set(&grid);
        let (inside, boundary) = (cells(&inside, 7), cells(&boundary, 7));
        let sets = |rule| {
            let (occupied, empty) = survey(grid, rule, 0.05, &scan).sets();
            let key = |leaves: Vec<NodeAddress>| leaves.into_iter().map(|l| (l.x, l.y)).collect::<Cells>();
            (key(occupied), key(empty))
        };
        let (engine_occupied, outer) = sets(EvidenceRule::Outer);
        let (_, inner) = sets(EvidenceRule::Inner);
        assert!(engine_occupied.is_subset(&occupied), "round {round}: X_OCC beyond BUILDSP's");
        for cell in &outer {
            assert!(inside.contains(cell) || boundary.contains(cell), "round {round}: {cell:?} is excluded by SIVIA");
        }
        for cell in &inside {
            assert!(outer.contains(cell) || engine_occupied.contains(cell), "round {round}: {cell:?} is not in outer");
        }
        missed += inside.iter().filter(|cell| !inner.contains(cell) && !engine_occupied.contains(cell)).count();
        let row = [occupied.len(), engine_occupied.len(), inside.len(), boundary.len(), outer.len(), inner.len()];
        counts.iter_mut().zip(row).for_each(|(sum, one)| *sum += one);
    }
    println!(
        "BUILDSP, engine X_OCC, SIVIA inside, boundary, engine outer, inner: {counts:?}, {missed} missed by inner"
    );
    let [buildsp, occupied, inside, boundary, outer, _] = counts;
    assert!(inside > 50 && occupied * 3 > buildsp, "the reference is not vacuous: {counts:?}");
    assert!(missed * 50 < inside, "{missed} leaves that one beam covers are not in inner: {counts:?}");
    assert!(outer * 10 > 7 * (inside + boundary), "the engine finds what there is: {counts:?}");
}

#[test]
fn ubbmap_steps_every_leaf_by_the_sets_of_each_scan() {
    let grid = Grid::new(0.2, 6, None).unwrap();
    let mut dice = Dice(99);
    for rule in [EvidenceRule::Outer, EvidenceRule::Inner, EvidenceRule::Guaranteed] {
        let scale = ClassScale::new(10).unwrap();
        let mut tree = ReferenceTree::new(6, scale);
        let scans: Vec<Scan> = (0..3).map(|_| scan(&mut dice, false)).collect();
        for scan in &scans {
            ubbmap(&mut tree, &config(grid, rule, 0.05, scan.sensor()), scan);
        }
        let mut stepped = 0;
        for leaf in all_leaves(&grid) {
            let square = grid.node_box(leaf);
            let class = scans.iter().fold(scale.unknown(), |class, scan| {
                let reference = Reference::new(scan, 0.05);
                let any = |test: &dyn Fn(usize) -> bool| (0..scan.beams()).any(test);
                let occupied = any(&|beam| reference.meets_measurement_box(beam, &square));
                let touched = any(&|beam| reference.may_be_empty(beam, &square));
                let empty = match rule {
                    EvidenceRule::Outer => touched,
                    EvidenceRule::Inner => any(&|beam| reference.may_be_inner(beam, &square, 0.0)),
                    EvidenceRule::Guaranteed => touched && reference.proves(&square),
                };
                scale.step(class, occupied, empty)
            });
            assert_eq!(tree.max_class(leaf), class, "{rule:?}, {leaf:?}");
            stepped += usize::from(class != scale.unknown());
        }
        assert!(stepped > 50, "{rule:?}: {stepped} leaves stepped");
    }
}

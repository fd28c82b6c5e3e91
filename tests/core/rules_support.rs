//! Scans, leaf sets and the comparison of the engine's evidence with the slow reference.
#![allow(clippy::unwrap_used, reason = "a test that cannot be set up has failed")]
#![cfg_attr(not(feature = "server"), allow(dead_code, reason = "what is said of real logs needs their readers"))]

use crate::regions_exact::Dice;
use std::collections::BTreeMap;
use ubbmap::interval::{Box2, Interval};
use ubbmap::mapping::reference::{Pose, Reference};
use ubbmap::mapping::{EvidenceRule, MapConfig, Surveyor};
use ubbmap::quadtree::{BlockMasks, ClassScale, Grid, LeafMasks, LeafRange, NodeAddress, RowMask};
use ubbmap::sensor::{Scan, SensorModel};
use ubbmap::vector::Path;

/// The share of a leaf by which the engine's sets may reach beyond the exact ones.
const SLACK: f64 = 1.0 / 1024.0;

/// Sets of leaves that can be asked leaf by leaf.
pub struct Leaves {
    depth: u8,
    blocks: BTreeMap<(u32, u32), (RowMask, RowMask)>,
}

impl Leaves {
    pub fn new(masks: &LeafMasks, depth: u8) -> Self {
        let mut blocks = BTreeMap::new();
        for (address, masks) in &masks.blocks {
            let pair = match masks {
                BlockMasks::AllEmpty => ([0; 64], [u64::MAX; 64]),
                BlockMasks::Some { occupied, empty } => (**occupied, **empty),
            };
            for (occupied, empty) in pair.0.iter().zip(&pair.1) {
                assert_eq!(occupied & empty, 0, "a leaf is in X_OCC and in X_EMP");
            }
            assert!(blocks.insert((address.x, address.y), pair).is_none(), "a block comes twice");
        }
        Self { depth, blocks }
    }

    fn bit(&self, leaf: NodeAddress) -> (bool, bool) {
        let Some((occupied, empty)) = self.blocks.get(&(leaf.x / 64, leaf.y / 64)) else { return (false, false) };
        let bit = |mask: &RowMask| mask[(leaf.y % 64) as usize] >> (leaf.x % 64) & 1 == 1;
        (bit(occupied), bit(empty))
    }

    pub fn occupied(&self, leaf: NodeAddress) -> bool {
        self.bit(leaf).0
    }

    pub fn empty(&self, leaf: NodeAddress) -> bool {
        self.bit(leaf).1
    }

    /// All leaves of X_OCC and of X_EMP.
    pub fn sets(&self) -> (Vec<NodeAddress>, Vec<NodeAddress>) {
        let list = |pick: fn(&(RowMask, RowMask)) -> &RowMask| {
            let mut leaves = Vec::new();
            for ((bx, by), masks) in &self.blocks {
                for (y, word) in (0_u32..).zip(pick(masks)) {
                    for x in (0..64).filter(|x| word >> x & 1 == 1) {
                        let (x, y) = (bx * 64 + x, by * 64 + y);
                        assert!(x < 1 << self.depth && y < 1 << self.depth, "a leaf outside the root");
                        leaves.push(NodeAddress { depth: self.depth, x, y });
                    }
                }
            }
            leaves
        };
        (list(|m| &m.0), list(|m| &m.1))
    }
}

pub fn config(grid: Grid, rule: EvidenceRule, width: f64, sensor: &SensorModel) -> MapConfig {
    let sensors = BTreeMap::from([("default".to_owned(), *sensor)]);
    MapConfig::new(grid, ClassScale::new(10).unwrap(), rule, width, sensors).unwrap()
}

/// The sets of a scan, the same on every path.
pub fn survey(grid: Grid, rule: EvidenceRule, width: f64, scan: &Scan) -> Leaves {
    let config = config(grid, rule, width, scan.sensor());
    let masks = Surveyor::new().survey(&config, scan);
    for path in Path::all() {
        assert_eq!(Surveyor::on(path).survey(&config, scan), masks, "{path} differs: {scan:?}");
    }
    Leaves::new(&masks, grid.depth())
}

/// The sets of a scan as one that reaches too far for a dense window has them.
pub fn survey_wide(grid: Grid, rule: EvidenceRule, width: f64, scan: &Scan) -> Leaves {
    let config = config(grid, rule, width, scan.sensor());
    Leaves::new(&Surveyor::without_dense_windows().survey(&config, scan), grid.depth())
}

fn grown(leaf: Box2, margin: f64) -> Box2 {
    let grow = |i: Interval| Interval::spanning(i.lo() - margin, i.hi() + margin);
    Box2::new(grow(leaf.x), grow(leaf.y))
}

/// What one comparison counted.
#[derive(Debug, Default, Clone, Copy)]
pub struct Tally {
    pub scans: usize,
    /// Leaves of X_OCC and X_EMP.
    pub occupied: usize,
    pub empty: usize,
    /// Leaves of the lower bound that must be (or should be) there, and how many of them are.
    pub expected: usize,
    pub found: usize,
    /// Points drawn.
    pub points: usize,
}

impl Tally {
    pub fn add(&mut self, other: Self) {
        self.scans += 1;
        self.occupied += other.occupied;
        self.empty += other.empty;
        self.expected += other.expected;
        self.found += other.found;
        self.points += other.points;
    }
}

/// Leaves proven by different provers.
#[derive(Debug, Default, Clone, Copy)]
pub struct Proven {
    pub engine: usize,
    /// The rule for whole boxes with one range, and with a range for each bracket.
    pub one_range: usize,
    pub whole_boxes: usize,
    pub by_points: usize,
}

/// One scan on one grid, with its reference.
pub struct Case<'a> {
    pub grid: Grid,
    pub scan: &'a Scan,
    pub width: f64,
    pub reference: Reference<'a>,
    /// Named in every failure.
    pub name: String,
}

impl<'a> Case<'a> {
    pub fn new(grid: Grid, scan: &'a Scan, width: f64, name: String) -> Self {
        Self { grid, scan, width, reference: Reference::new(scan, width), name }
    }

    fn middle(&self) -> (f64, f64) {
        let o = self.scan.origins();
        (o.x.mid(), o.y.mid())
    }

    /// Beams in the order of how near their axes pass a leaf: the one that covers it comes first, mostly.
    fn beams_towards(&self, leaf: NodeAddress) -> Vec<usize> {
        let square = self.grid.node_box(leaf);
        let (x, y) = self.middle();
        let direction = (square.y.mid() - y).atan2(square.x.mid() - x) - self.scan.headings().mid();
        let off = |beam: usize| {
            let turn = (self.scan.angle(beam) - direction).rem_euclid(std::f64::consts::TAU);
            (turn.min(std::f64::consts::TAU - turn), beam)
        };
        let mut beams: Vec<(f64, usize)> = (0..self.scan.beams()).map(off).collect();
        beams.sort_unstable_by(|a, b| a.0.total_cmp(&b.0));
        beams.into_iter().map(|(_, beam)| beam).collect()
    }

    /// X_OCC holds the leaf of every drawn point of the measurement sets; the number of points.
    pub fn check_drawn(&self, leaves: &Leaves, draws: usize, dice: &mut Dice) -> usize {
        let mut points = 0;
        for beam in 0..self.scan.beams() {
            for _ in 0..draws {
                let Some(point) = self.reference.draw_occupied(beam, &mut || dice.real(0.0, 1.0)) else { break };
                let Some(leaf) = self.grid.leaf_at(point.0, point.1) else { continue };
                points += 1;
                assert!(leaves.occupied(leaf), "{}: {point:?} of beam {beam} is not in X_OCC", self.name);
            }
        }
        points
    }

    /// X_OCC holds the leaf of every drawn point of the measurement sets, and no leaf that meets no measurement box.
    pub fn check_occupied(&self, leaves: &Leaves, draws: usize, dice: &mut Dice) -> Tally {
        let mut tally = Tally { points: self.check_drawn(leaves, draws, dice), ..Tally::default() };
        let margin = SLACK * self.grid.resolution();
        for leaf in leaves.sets().0 {
            let square = grown(self.grid.node_box(leaf), margin);
            let met = self.beams_towards(leaf).into_iter().any(|b| self.reference.meets_measurement_box(b, &square));
            assert!(met, "{}: {leaf:?} of X_OCC meets no measurement box", self.name);
            tally.occupied += 1;
        }
        tally
    }

    /// X_EMP `outer` holds the leaf of every drawn point of the empty parts, and no leaf that (8), (9) leave out.
    pub fn check_outer(&self, leaves: &Leaves, draws: usize, dice: &mut Dice) -> Tally {
        let mut tally = Tally::default();
        for beam in 0..self.scan.beams() {
            for _ in 0..draws {
                let Some(point) = self.reference.draw_empty(beam, &mut || dice.real(0.0, 1.0)) else { break };
                let Some(leaf) = self.grid.leaf_at(point.0, point.1) else { continue };
                tally.points += 1;
                let there = leaves.empty(leaf) || leaves.occupied(leaf);
                assert!(there, "{}: {point:?} of beam {beam} is not in X_EMP outer", self.name);
            }
        }
        let margin = SLACK * self.grid.resolution();
        for leaf in leaves.sets().1 {
            let square = grown(self.grid.node_box(leaf), margin);
            let met = self.reference.is_in_footprint(&square)
                || self.beams_towards(leaf).into_iter().any(|b| self.reference.may_be_empty(b, &square));
            assert!(met, "{}: {leaf:?} of X_EMP outer fails (8), (9) for every beam", self.name);
            tally.empty += 1;
        }
        tally
    }

    /// X_EMP `inner` holds no leaf that (10), (11) leave out; counted is how many it has of the leaves that one beam covers
    /// at the middle pose.
    pub fn check_inner(&self, leaves: &Leaves) -> Tally {
        let mut tally = Tally::default();
        let margin = SLACK * self.grid.resolution();
        for leaf in leaves.sets().1 {
            let square = self.grid.node_box(leaf);
            let met = self.reference.is_in_footprint(&square)
                || self.beams_towards(leaf).into_iter().any(|b| {
                    self.reference.may_be_empty(b, &grown(square, margin))
                        && self.reference.may_be_inner(b, &square, margin)
                });
            assert!(met, "{}: {leaf:?} of X_EMP inner fails (10), (11) for every beam", self.name);
            tally.empty += 1;
        }
        let pose = self.reference.middle_pose();
        for leaf in self.leaves_about().into_iter().step_by(3) {
            let square = self.grid.node_box(leaf);
            let corners = [square.x.lo(), square.x.hi()].map(|x| [square.y.lo(), square.y.hi()].map(|y| (x, y)));
            let covered = self
                .beams_towards(leaf)
                .into_iter()
                .take(16)
                .any(|b| corners.iter().flatten().all(|c| self.reference.is_empty_at(b, pose, *c, margin)));
            if covered && !leaves.occupied(leaf) {
                tally.expected += 1;
                tally.found += usize::from(leaves.empty(leaf));
            }
        }
        tally
    }

    /// X_EMP `guaranteed`: every leaf of it is confirmed point by point; counted is how many it has of the leaves that the
    /// rule for whole boxes proves. With `all`, the rule is asked of every leaf about the sensor, not only of those whose
    /// middle is free at the middle pose (which it implies).
    pub fn check_guaranteed(&self, leaves: &Leaves, draws: usize, all: bool, dice: &mut Dice) -> Tally {
        let mut tally = Tally::default();
        for leaf in leaves.sets().1 {
            let square = self.grid.node_box(leaf);
            tally.empty += 1;
            tally.points += draws;
            self.confirm(leaf, square, draws, dice);
        }
        let pose = self.reference.middle_pose();
        for leaf in self.leaves_about() {
            let square = self.grid.node_box(leaf);
            let free = self.is_free(pose, (square.x.mid(), square.y.mid()), square);
            if (free || all) && !leaves.occupied(leaf) && self.reference.proves(&square) {
                assert!(free, "{}: {leaf:?} is proven as a whole but its middle is not free", self.name);
                tally.expected += 1;
                tally.found += usize::from(leaves.empty(leaf));
            }
        }
        tally
    }

    /// How much is proven beside what could be: the leaves of X_EMP `guaranteed`, those that the rule for whole boxes proves (in
    /// its simpler form and as it is), and those that a prover by points would, of which `draws` points at drawn poses are all free. Leaves of X_OCC count for
    /// none.
    pub fn proven(&self, leaves: &Leaves, draws: usize, dice: &mut Dice) -> Proven {
        let mut proven = Proven::default();
        let simpler = Reference::new(self.scan, self.width).with_one_range();
        for leaf in self.leaves_about() {
            if leaves.occupied(leaf) {
                continue;
            }
            let square = self.grid.node_box(leaf);
            let free = self.is_free(self.reference.middle_pose(), (square.x.mid(), square.y.mid()), square);
            proven.engine += usize::from(leaves.empty(leaf));
            proven.one_range += usize::from(free && simpler.proves(&square));
            proven.whole_boxes += usize::from(free && self.reference.proves(&square));
            proven.by_points += usize::from(leaves.empty(leaf) || (free && self.seems_free(square, draws, dice)));
        }
        proven
    }

    fn seems_free(&self, square: Box2, draws: usize, dice: &mut Dice) -> bool {
        (0..draws).all(|_| {
            let pose = self.reference.draw_pose(&mut || dice.real(0.0, 1.0));
            let mut along = |i: Interval| dice.pick(&[i.lo(), i.hi(), dice.clone().real(i.lo(), i.hi())]);
            let point = (along(square.x), along(square.y));
            self.reference.is_point_free(pose, point)
        })
    }

    fn is_free(&self, pose: Pose, point: (f64, f64), square: Box2) -> bool {
        self.reference.is_in_footprint(&square) || self.reference.is_point_free(pose, point)
    }

    fn confirm(&self, leaf: NodeAddress, square: Box2, draws: usize, dice: &mut Dice) {
        if self.reference.is_in_footprint(&square) {
            return;
        }
        for _ in 0..draws {
            let pose = self.reference.draw_pose(&mut || dice.real(0.0, 1.0));
            let mut along = |i: Interval| match dice.whole(0, 3) {
                0 => i.lo(),
                1 => i.hi(),
                _ => dice.real(i.lo(), i.hi()),
            };
            let point = (along(square.x), along(square.y));
            let free = self.reference.is_point_free(pose, point);
            assert!(free, "{}: {leaf:?} is called empty, but {point:?} is not proven at {pose:?}", self.name);
        }
    }

    /// The leaves within the scan's reach of the sensor.
    fn leaves_about(&self) -> Vec<NodeAddress> {
        let o = self.scan.origins();
        let reach = self.reference.reach().max(self.scan.spec().footprint_radius + 1.0);
        let (LeafRange { min_x, min_y, max_x, max_y }, _) = self.grid.leaves_meeting(&grown(o, reach));
        let depth = self.grid.depth();
        let within = |leaf: &NodeAddress| {
            let square = self.grid.node_box(*leaf);
            let (dx, dy) = (square.x.mid() - o.x.mid(), square.y.mid() - o.y.mid());
            dx.hypot(dy) <= reach + o.x.radius() + o.y.radius() + self.grid.resolution()
        };
        let all = (min_y..max_y).flat_map(|y| (min_x..max_x).map(move |x| NodeAddress { depth, x, y }));
        all.filter(within).collect()
    }
}

//! Guaranteed-free against brute force over all leaves of small maps, in exact geometry.
#![allow(clippy::unwrap_used, clippy::panic, reason = "a test that cannot be set up has failed")]

use crate::regions::{metres, region_of};
use crate::regions_exact::{Dice, Shape, Square, random_shape};
use ubbmap::mapping::{FreeAnswer, Reason, Region, RegionLimits, Witness, guaranteed_free};
use ubbmap::quadtree::{Block, BlockAddress, BlockView, Class, ClassScale, Grid, NodeAddress, OccupancyTree};

/// Units of one leaf's side.
const LEAF: i128 = 16;

struct Map {
    tree: OccupancyTree,
    grid: Grid,
    /// Root's min corner in units.
    origin: (i128, i128),
}

fn z_order(node: NodeAddress) -> u64 {
    BlockAddress { x: node.x, y: node.y }.morton()
}

impl Map {
    /// A map with patches of random classes.
    fn random(dice: &mut Dice, depth: u32, calm: bool) -> Self {
        let scale = ClassScale::new(10).unwrap();
        let side = 1_i128 << depth;
        let corner = dice.whole(-side, 0) * LEAF;
        let origin = (corner, if dice.chance(0.3) { corner + LEAF } else { corner });
        let grid = Grid::new(metres(LEAF), depth, Some((metres(origin.0), metres(origin.1)))).unwrap();
        let mut tree = OccupancyTree::new(depth as u8, scale);
        for y in 0..(side as u32).div_ceil(64) {
            for x in 0..(side as u32).div_ceil(64) {
                let view = if calm && dice.chance(0.7) {
                    BlockView::Uniform(dice.pick(&[1, 1, 2]))
                } else {
                    let mut leaves = Box::new([dice.pick(&[1, 1, 1, 3, 5]); 64 * 64]);
                    for _ in 0..dice.whole(0, 12) {
                        let class = if calm { dice.pick(&[1, 2, 3]) } else { dice.whole(1, 10) as Class };
                        let (px, py, size) = (dice.whole(0, 63), dice.whole(0, 63), dice.whole(1, 20));
                        for i in py..(py + size).min(64) {
                            leaves[(i * 64 + px) as usize..(i * 64 + (px + size).min(64)) as usize].fill(class);
                        }
                    }
                    if side < 64 {
                        // Only the rows and columns below the side exist; the rest stays unknown.
                        for i in 0..64 * 64_i128 {
                            if i % 64 >= side || i / 64 >= side {
                                leaves[i as usize] = 5;
                            }
                        }
                    }
                    BlockView::Mixed(std::sync::Arc::new(Block::from_leaves(leaves)))
                };
                tree.set_block(BlockAddress { x, y }, view);
            }
        }
        Self { tree, grid, origin }
    }

    fn square(&self, leaf: NodeAddress) -> Square {
        let min = (self.origin.0 + i128::from(leaf.x) * LEAF, self.origin.1 + i128::from(leaf.y) * LEAF);
        (min, (min.0 + LEAF, min.1 + LEAF))
    }

    fn leaves(&self) -> impl Iterator<Item = NodeAddress> + '_ {
        let side = self.grid.side();
        let mut all: Vec<_> =
            (0..side * side).map(|i| NodeAddress { depth: self.grid.depth(), x: i % side, y: i / side }).collect();
        all.sort_by_key(|leaf| z_order(*leaf));
        all.into_iter()
    }

    fn reaches_outside(&self, shape: &Shape) -> bool {
        let (min, max) = shape.bounds();
        let side = i128::from(self.grid.side()) * LEAF;
        min.0 < self.origin.0 || min.1 < self.origin.1 || max.0 > self.origin.0 + side || max.1 > self.origin.1 + side
    }
}

/// How far along a polyline a moving disc first touches a square, by search on the convex distance to it.
fn first_touch(points: &[(i128, i128)], radius: i128, square: Square) -> Option<f64> {
    let (radius, slack) = (metres(radius), 1e-12);
    let gap = |(x, y): (f64, f64)| {
        let dx = (metres(square.0.0) - x).max(x - metres(square.1.0)).max(0.0);
        let dy = (metres(square.0.1) - y).max(y - metres(square.1.1)).max(0.0);
        dx.hypot(dy)
    };
    let mut walked = 0.0;
    let pairs: Vec<_> = if points.len() == 1 {
        vec![(points[0], points[0])]
    } else {
        points.windows(2).map(|p| (p[0], p[1])).collect()
    };
    for (a, b) in pairs {
        let (a, b) = ((metres(a.0), metres(a.1)), (metres(b.0), metres(b.1)));
        let at = |t: f64| gap((a.0 + t * (b.0 - a.0), a.1 + t * (b.1 - a.1)));
        let (mut lo, mut hi) = (0.0, 1.0);
        for _ in 0..200 {
            let (p, q) = (lo + (hi - lo) / 3.0, hi - (hi - lo) / 3.0);
            if at(p) <= at(q) { hi = q } else { lo = p }
        }
        let length = (b.0 - a.0).hypot(b.1 - a.1);
        if at(0.0) <= radius + slack {
            return Some(walked);
        }
        let nearest = if at(1.0) < at(lo) { 1.0 } else { lo };
        if at(nearest) <= radius + slack {
            let (mut out, mut touching) = (0.0, nearest);
            for _ in 0..100 {
                let mid = 0.5 * (out + touching);
                if at(mid) <= radius + slack { touching = mid } else { out = mid }
            }
            return Some(walked + touching * length);
        }
        walked += length;
    }
    None
}

/// How far along a polyline a moving disc first reaches beyond the root: passes one of its edges, not merely touches it.
fn first_outside(points: &[(i128, i128)], radius: i128, map: &Map) -> Option<f64> {
    let side = i128::from(map.grid.side()) * LEAF;
    // How far beyond each edge the disc about a point reaches, in units.
    let beyond = |(x, y): (i128, i128)| {
        let (x, y) = (x - map.origin.0, y - map.origin.1);
        [radius - x, radius - y, x + radius - side, y + radius - side]
    };
    if beyond(points[0]).iter().any(|v| *v > 0) {
        return Some(0.0);
    }
    let mut walked = 0.0;
    for pair in points.windows(2) {
        let (dx, dy) = (metres(pair[1].0 - pair[0].0), metres(pair[1].1 - pair[0].1));
        let crossings = beyond(pair[0]).into_iter().zip(beyond(pair[1])).filter(|(_, to)| *to > 0);
        // Linear in between: it passes the edge where it is 0.
        let shares = crossings.map(|(from, to)| -from as f64 / (to - from) as f64);
        if let Some(share) = shares.min_by(f64::total_cmp) {
            return Some(walked + share * dx.hypot(dy));
        }
        walked += dx.hypot(dy);
    }
    None
}

fn check(map: &Map, shape: &Shape, tolerance: u8) -> FreeAnswer {
    let answer = guaranteed_free(&map.tree, &map.grid, &region_of(shape), tolerance);
    let context = format!("{shape:?}, tolerance {tolerance}, origin {:?}: {answer:?}", map.origin);
    let met: Vec<_> = map.leaves().filter(|leaf| shape.meets(map.square(*leaf))).collect();
    let inside = met.iter().map(|leaf| map.tree.max_class(*leaf)).max().unwrap_or(0);
    let outside = map.reaches_outside(shape);
    let worst = if outside { inside.max(5) } else { inside };
    let limit = 4 - tolerance;
    assert_eq!(answer.max_class, worst, "{context}");
    assert_eq!(answer.free, worst <= limit, "{context}");
    let Some((reason, witness)) = answer.refusal else {
        assert!(answer.free, "{context}");
        return answer;
    };
    assert!(!answer.free, "{context}");
    let expected = match witness.class {
        0..=4 => Reason::Tolerance,
        5 => Reason::Unknown,
        _ => Reason::Occupied,
    };
    assert_eq!(reason, expected, "{context}");
    assert_eq!(witness.size, metres(LEAF), "{context}");
    match witness.node {
        Some(leaf) => {
            assert!(met.contains(&leaf), "{context}");
            assert_eq!(map.tree.max_class(leaf), witness.class, "{context}");
            let min = map.square(leaf).0;
            assert_eq!(witness.min, (metres(min.0), metres(min.1)), "{context}");
        }
        None => {
            assert_eq!(witness.class, 5, "{context}");
            let in_units = |v: f64| (v / metres(1)).round() as i128;
            let min = (in_units(witness.min.0), in_units(witness.min.1));
            assert!(shape.meets((min, (min.0 + LEAF, min.1 + LEAF))), "{context}");
            let side = i128::from(map.grid.side()) * LEAF;
            let (x, y) = (min.0 - map.origin.0, min.1 - map.origin.1);
            assert!(x % LEAF == 0 && y % LEAF == 0, "{context}");
            assert!(x < 0 || y < 0 || x >= side || y >= side, "{context}");
        }
    }
    if let Shape::Path(points, radius) = shape {
        let blocking = met.iter().filter(|leaf| map.tree.max_class(**leaf) > limit);
        let touches = blocking.map(|leaf| first_touch(points, *radius, map.square(*leaf)).unwrap());
        let first = touches.chain(outside.then(|| first_outside(points, *radius, map)).flatten());
        let first = first.min_by(f64::total_cmp).unwrap();
        // Where a disc grazes a corner the moment of touch is known to the root of the rounding.
        let distance = witness.distance.unwrap();
        assert!((distance - first).abs() < 1e-6, "first at {first}, {context}");
        let own = match witness.node {
            Some(leaf) => first_touch(points, *radius, map.square(leaf)),
            None => first_outside(points, *radius, map),
        };
        assert!((own.unwrap() - first).abs() < 1e-6, "witness at {own:?}, first at {first}, {context}");
    } else {
        assert!(witness.distance.is_none(), "{context}");
        assert_eq!(witness.class, worst, "{context}");
        let first = met.iter().find(|leaf| map.tree.max_class(**leaf) == worst);
        assert_eq!(witness.node, first.copied(), "{context}");
    }
    answer
}

#[test]
fn answers_and_witnesses_are_those_of_brute_force() {
    let mut dice = Dice(11);
    let (mut free, mut outer, mut refused) = (0, 0, 0);
    for round in 0..60 {
        let depth = dice.pick(&[1, 3, 4, 5, 6, 7]);
        let map = Map::random(&mut dice, depth, round % 2 == 0);
        let side = LEAF << depth;
        let (lo, hi) = (map.origin.0.min(map.origin.1), map.origin.0.max(map.origin.1) + side);
        let margin = dice.pick(&[-5 * LEAF, 0, 2 * LEAF, side]);
        for _ in 0..60 {
            let shape = random_shape(&mut dice, lo - margin.max(-side / 3), hi + margin.max(-side / 3), LEAF);
            let answer = check(&map, &shape, dice.pick(&[0, 0, 1, 2, 3]));
            match answer.refusal {
                None => free += 1,
                Some((_, Witness { node: None, .. })) => outer += 1,
                Some(_) => refused += 1,
            }
        }
    }
    assert!(free > 500 && outer > 500 && refused > 700, "{free} free, {outer} outside, {refused} refused");
}

#[test]
fn a_region_that_fills_the_root_and_touches_its_edge_does_not_reach_outside() {
    let scale = ClassScale::new(10).unwrap();
    let grid = Grid::new(0.1, 16, None).unwrap();
    let mut tree = OccupancyTree::new(16, scale);
    for y in 0..1024 {
        for x in 0..1024 {
            tree.set_block(BlockAddress { x, y }, BlockView::Uniform(1));
        }
    }
    let half = 3276.8;
    let whole = Region::rectangle((-half, -half), (half, half)).unwrap();
    assert!(guaranteed_free(&tree, &grid, &whole, 3).free);
    let disc = Region::disc((0.0, 0.0), half).unwrap();
    assert!(guaranteed_free(&tree, &grid, &disc, 3).free);
    let beyond = Region::rectangle((-half, -half), (half.next_up(), half)).unwrap();
    let (reason, witness) = guaranteed_free(&tree, &grid, &beyond, 0).refusal.unwrap();
    assert_eq!((reason, witness.node), (Reason::Unknown, None));
    assert_eq!(witness.min.0, half);
}

#[test]
fn a_polygon_of_thousands_of_corners_is_answered_quickly() {
    // A comb of long teeth and a wheel: many edges at every height, and many edges in every leaf.
    let scale = ClassScale::new(10).unwrap();
    let grid = Grid::new(0.1, 16, None).unwrap();
    let mut tree = OccupancyTree::new(16, scale);
    for y in 500..524 {
        for x in 500..524 {
            let mut leaves = Box::new([1; 64 * 64]);
            leaves[usize::try_from((x * 7 + y * 13) % 4096).unwrap()] = 2;
            let view = BlockView::Mixed(std::sync::Arc::new(Block::from_leaves(leaves)));
            tree.set_block(BlockAddress { x, y }, view);
        }
    }
    let limits = RegionLimits::default();
    let comb: Vec<_> = (0..4096).map(|i| (f64::from(i) * 0.01 - 20.0, if i % 2 == 0 { -20.0 } else { 20.0 })).collect();
    let wheel: Vec<_> = (0..4096)
        .map(|i| {
            let angle = f64::from(i) * std::f64::consts::TAU / 4096.0;
            (30.0 * angle.cos(), 30.0 * angle.sin())
        })
        .collect();
    for points in [comb, wheel] {
        let region = Region::polygon(points, &limits).unwrap();
        let start = std::time::Instant::now();
        let answer = guaranteed_free(&tree, &grid, &region, 0);
        assert!(answer.free && answer.max_class == 2, "{answer:?}");
        // 4,096 edges times the 130,000 leaves of the region would take seconds.
        assert!(start.elapsed().as_secs_f64() < 0.5, "{:?}", start.elapsed());
    }
}

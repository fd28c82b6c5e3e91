//! Guaranteed-free of regions with numbers from the edge of floating point, against every leaf of a small map.
#![no_main]

use arbitrary::{Arbitrary, Result, Unstructured};
use libfuzzer_sys::fuzz_target;
use ubbmap::interval::{Box2, Interval};
use ubbmap::mapping::{Region, RegionLimits, guaranteed_free};
use ubbmap::quadtree::{Block, BlockAddress, BlockView, ClassScale, Grid, NodeAddress, OccupancyTree};

const EDGES: [f64; 11] =
    [0.0, -0.0, 5e-324, 1e-200, 1e-162, 1e-9, 1.0, 9_007_199_254_740_993.0, 1e154, 1e300, f64::MAX];

fn metres(from: &mut Unstructured<'_>, grid: &Grid) -> Result<f64> {
    let steps = f64::from(i16::arbitrary(from)? % 140);
    let on_lattice = grid.origin().0 + grid.resolution() * steps;
    Ok(match from.int_in_range(0..=9)? {
        0 => EDGES[from.int_in_range(0..=EDGES.len() - 1)?],
        1 => -EDGES[from.int_in_range(0..=EDGES.len() - 1)?],
        2 => f64::arbitrary(from)?,
        3 => on_lattice.next_up(),
        4 => on_lattice.next_down(),
        5 => on_lattice,
        _ => on_lattice + grid.resolution() * f64::from(i16::arbitrary(from)?) / 32768.0,
    })
}

fn point(from: &mut Unstructured<'_>, grid: &Grid) -> Result<(f64, f64)> {
    Ok((metres(from, grid)?, metres(from, grid)?))
}

fn region(from: &mut Unstructured<'_>, grid: &Grid) -> Result<Option<Region>> {
    let limits = RegionLimits { max_points: 16 };
    let radius = metres(from, grid)?.abs();
    Ok(match from.int_in_range(0..=3)? {
        0 => Region::rectangle(point(from, grid)?, point(from, grid)?).ok(),
        1 => Region::disc(point(from, grid)?, radius).ok(),
        kind => {
            let count = from.int_in_range(1..=6)?;
            let points = (0..count).map(|_| point(from, grid)).collect::<Result<Vec<_>>>()?;
            if kind == 2 { Region::polygon(points, &limits).ok() } else { Region::path(points, radius, &limits).ok() }
        }
    })
}

/// A leaf without a billionth of its side all round.
fn shrunk(leaf: &Box2) -> Box2 {
    let side = |side: Interval| {
        let slack = 1e-9 * (side.hi() - side.lo());
        Interval::spanning(side.lo() + slack, side.hi() - slack)
    };
    Box2::new(side(leaf.x), side(leaf.y))
}

fn check(from: &mut Unstructured<'_>) -> Result<()> {
    let resolution = from.choose(&[0.1, 0.05, 1.0, 1e-3, 1e3])?;
    let depth = from.int_in_range(1..=7_u32)?;
    let Ok(grid) = Grid::new(*resolution, depth, None) else { return Ok(()) };
    let Ok(scale) = ClassScale::new(10) else { return Ok(()) };
    let mut tree = OccupancyTree::new(depth as u8, scale);
    let side = grid.side();
    for y in 0..side.div_ceil(64) {
        for x in 0..side.div_ceil(64) {
            let mut leaves = Box::new([from.int_in_range(1..=4_u8)?; 64 * 64]);
            for _ in 0..from.int_in_range(0..=6)? {
                let (at, class) = (from.int_in_range(0..=4095_usize)?, from.int_in_range(1..=10_u8)?);
                leaves[at] = class;
            }
            for (at, leaf) in leaves.iter_mut().enumerate() {
                if at % 64 >= side as usize || at / 64 >= side as usize {
                    *leaf = 5;
                }
            }
            tree.set_block(BlockAddress { x, y }, BlockView::Mixed(std::sync::Arc::new(Block::from_leaves(leaves))));
        }
    }
    let Some(region) = region(from, &grid)? else { return Ok(()) };
    let tolerance = from.int_in_range(0..=3_u8)?;
    let answer = guaranteed_free(&tree, &grid, &region, tolerance);
    // A region's own test takes a leaf for met that it misses by rounding, which the query may know better: what is held
    // is a leaf that is met by more than that, and one that is not met even so.
    let (mut worst, mut most) = (0, 0);
    for y in 0..side {
        for x in 0..side {
            let node = NodeAddress { depth: depth as u8, x, y };
            let leaf = grid.node_box(node);
            if region.meets(&leaf) {
                most = most.max(tree.max_class(node));
                if region.meets(&shrunk(&leaf)) {
                    worst = worst.max(tree.max_class(node));
                }
            }
        }
    }
    let allowed = 4 - tolerance;
    assert!(answer.max_class >= worst, "{region:?} meets a leaf of class {worst}: {answer:?}");
    assert!(!answer.free || worst <= allowed, "{region:?} is called free: {answer:?}");
    assert_eq!(answer.free, answer.max_class <= allowed, "{region:?}: {answer:?}");
    assert_eq!(answer.free, answer.refusal.is_none(), "{region:?}: {answer:?}");
    // What is larger than all leaves say comes from outside of the root, which is unknown.
    assert!(answer.max_class <= most || answer.max_class == 5, "{region:?} {worst}: {answer:?}");
    Ok(())
}

fuzz_target!(|bytes: &[u8]| {
    // Bytes that are too few say nothing.
    let _ = check(&mut Unstructured::new(bytes));
});

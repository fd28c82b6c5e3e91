//! Grids: leaf edges are exact, and no touched leaf is missed.
#![allow(clippy::unwrap_used, clippy::panic, reason = "a test fails by panicking")]

use proptest::prelude::*;
use ubbmap::interval::{Box2, Interval};
use ubbmap::quadtree::{BlockAddress, Grid, GridError, LeafRange, NodeAddress};

/// Metres in units of 2^-80, exact: 10^9 m take 110 bits.
fn exact(v: f64) -> i128 {
    let bits = v.to_bits();
    let exponent = (bits >> 52 & 0x7ff) as i32 - 1075;
    let mantissa = i128::from(bits & ((1 << 52) - 1) | 1 << 52);
    if v == 0.0 {
        return 0;
    }
    let shift = exponent + 80;
    assert!((0..70).contains(&shift), "{v} is not a multiple of 2^-80 within the range");
    if v < 0.0 { -(mantissa << shift) } else { mantissa << shift }
}

/// Zero for numbers that are no multiple of 2^-80.
fn representable(v: f64) -> f64 {
    if v.abs() < 2.0_f64.powi(-27) { 0.0 } else { v }
}

/// Edge `i` of an axis, exact.
fn edge(grid: &Grid, origin: f64, i: i64) -> i128 {
    exact(origin) + i128::from(i) * exact(grid.resolution())
}

fn nudged(mut v: f64, ulps: i32) -> f64 {
    for _ in 0..ulps.abs() {
        v = if ulps < 0 { v.next_down() } else { v.next_up() };
    }
    representable(v)
}

fn grids() -> impl Strategy<Value = Grid> {
    let decimal = prop_oneof![Just(0.1), Just(0.05), Just(0.025), Just(0.3), Just(0.25), Just(1.0)];
    let any_size = (-4.0..4.0).prop_map(|e: f64| 10.0_f64.powf(e).clamp(1e-4, 1e4));
    let origin = prop_oneof![
        Just(None),
        (-1e9..1e9, -1e9..1e9).prop_map(|(x, y)| Some((representable(x), representable(y)))),
        (-500.0..500.0, -500.0..500.0).prop_map(|(x, y)| Some((representable(x), representable(y)))),
        (-5000..5000, -5000..5000).prop_map(|(x, y)| Some((f64::from(x) / 10.0, f64::from(y) / 10.0))),
    ];
    (prop_oneof![decimal, any_size], 1..=24_u32, origin)
        .prop_filter_map("not a grid", |(resolution, depth, origin)| Grid::new(resolution, depth, origin).ok())
}

/// A coordinate on, beside or far from an edge of the x axis.
fn coordinate(grid: &Grid, place: f64, kind: u8, ulps: i32) -> f64 {
    let side = f64::from(grid.side());
    let (origin, resolution) = (grid.origin().0, grid.resolution());
    representable(match kind {
        0 => nudged(origin + (place * side).round() * resolution, ulps),
        1 => origin + place * side * resolution,
        2 => nudged(origin + side * resolution, ulps),
        3 => nudged(origin, ulps),
        _ => (origin - side * resolution + 3.0 * place * side * resolution).clamp(-1e9, 1e9),
    })
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(4000))]

    #[test]
    fn a_point_is_in_the_half_open_leaf_that_is_named(
        grid in grids(), place in 0.0..=1.0, kind in 0..5_u8, ulps in -3..=3,
    ) {
        let v = coordinate(&grid, place, kind, ulps);
        let origin = grid.origin();
        let inside = edge(&grid, origin.0, 0) <= exact(v) && exact(v) < edge(&grid, origin.0, i64::from(grid.side()));
        let found = grid.leaf_at(v, origin.1);
        prop_assert_eq!(found.is_some(), inside);
        if let Some(leaf) = found {
            prop_assert_eq!((leaf.depth, leaf.y), (grid.depth(), 0));
            let x = i64::from(leaf.x);
            prop_assert!(edge(&grid, origin.0, x) <= exact(v) && exact(v) < edge(&grid, origin.0, x + 1));
            let area = grid.node_box(leaf);
            prop_assert!(area.contains(v, origin.1));
        }
    }

    #[test]
    fn a_node_box_encloses_its_square_and_little_more(grid in grids(), place in 0.0..1.0, level in 0.0..=1.0) {
        let depth = (level * f64::from(grid.depth())) as u8;
        let index = (place * f64::from(1_u32 << depth)) as u32;
        let node = NodeAddress { depth, x: index, y: 0 };
        let leaves = i64::from(grid.side() >> depth);
        let (low, high) = (i64::from(index) * leaves, (i64::from(index) + 1) * leaves);
        let (low, high) = (edge(&grid, grid.origin().0, low), edge(&grid, grid.origin().0, high));
        let area = grid.node_box(node).x;
        let (lo, hi) = (representable(area.lo()), representable(area.hi()));
        // An outer bound below 2^-27 m is compared as 0, which is as good within one unit of 2^-27.
        let tiny = 1_i128 << 53;
        let unsure = |compared: f64, bound: f64| if compared == bound { 0 } else { tiny };
        prop_assert!(exact(lo) <= low + unsure(lo, area.lo()));
        prop_assert!(exact(hi) >= high - unsure(hi, area.hi()));
        let reach = grid.origin().0.abs().max((grid.origin().0 + grid.node_size(0)).abs());
        let few_units = exact(representable(4.0 * f64::EPSILON * reach)).max(tiny);
        prop_assert!(low - exact(lo) <= few_units && exact(hi) - high <= few_units);
        let shown = grid.node_min(node).0;
        prop_assert!((exact(representable(shown)) - low).abs() <= few_units + exact(representable(1e-15 * reach)));
    }

    #[test]
    fn no_touched_leaf_is_missed_and_none_is_added(
        grid in grids(), place in (0.0..=1.0, 0.0..=1.0), kind in (0..5_u8, 0..5_u8), ulps in (-2..=2, -2..=2),
    ) {
        let (a, b) = (coordinate(&grid, place.0, kind.0, ulps.0), coordinate(&grid, place.1, kind.1, ulps.1));
        let (lo, hi) = (a.min(b), a.max(b));
        let origin = grid.origin();
        let area = Box2::new(Interval::new(lo, hi).unwrap(), Interval::point(origin.1));
        let (range, beyond) = grid.leaves_meeting(&area);
        let side = i64::from(grid.side());
        let outside = exact(lo) < edge(&grid, origin.0, 0) || exact(hi) > edge(&grid, origin.0, side);
        prop_assert_eq!(beyond, outside);
        prop_assert_eq!((range.min_y, range.max_y), (0, 1));
        let (first, behind) = (i64::from(range.min_x), i64::from(range.max_x));
        prop_assert!(behind <= side);
        let touches = |i: i64| edge(&grid, origin.0, i) <= exact(hi) && edge(&grid, origin.0, i + 1) >= exact(lo);
        for i in [0, first - 2, first - 1, first, first + 1, behind - 1, behind, behind + 1, side - 1] {
            if (0..side).contains(&i) {
                prop_assert_eq!(touches(i), (first..behind).contains(&i), "leaf {}", i);
            }
        }
    }

    #[test]
    fn leaves_within_a_half_open_box_share_its_inside(
        grid in grids(), place in (0.0..=1.0, 0.0..=1.0), kind in (0..5_u8, 0..5_u8), ulps in (-3..=3, -3..=3),
    ) {
        let (a, b) = (coordinate(&grid, place.0, kind.0, ulps.0), coordinate(&grid, place.1, kind.1, ulps.1));
        let (lo, hi) = (a.min(b), a.max(b));
        let (origin, resolution) = (grid.origin(), grid.resolution());
        let range = grid.leaves_within(lo, origin.1, hi, origin.1 + resolution);
        let (first, behind) = (i64::from(range.min_x), i64::from(range.max_x));
        let side = i64::from(grid.side());
        let units = (f64::from(grid.side()) + 2.0 * origin.0.abs() / resolution) * f64::EPSILON * 8.0;
        let slack = exact(representable(resolution * units.max(2e-9))).max(1 << 53);
        let common = |i: i64| exact(hi).min(edge(&grid, origin.0, i + 1)) - exact(lo).max(edge(&grid, origin.0, i));
        for i in [0, first - 2, first - 1, first, first + 1, behind - 1, behind, behind + 1, side - 1] {
            if (0..side).contains(&i) && (first..behind).contains(&i) {
                prop_assert!(common(i) > 0, "leaf {} has nothing in common", i);
            } else if (0..side).contains(&i) {
                prop_assert!(common(i) <= slack, "leaf {} is missed", i);
            }
        }
    }

    #[test]
    fn the_slack_bounds_the_error_of_positions(
        grid in grids(), place in -0.5..=1.5_f64, wrong in -1.0..=1.0_f64,
    ) {
        let (origin, resolution, side) = (grid.origin().0, grid.resolution(), f64::from(grid.side()));
        let v = representable(origin + place * side * resolution);
        prop_assume!(v.abs() <= 1e9);
        let reach = origin.abs().max((origin + side * resolution).abs());
        // 30 of the 32 rounding units; the sum itself rounds once more.
        let computed = v + wrong * 15.0 * f64::EPSILON * reach;
        let position = (computed - origin) / resolution;
        let whole = position.floor();
        let rest = exact(v) - edge(&grid, origin, whole as i64);
        let error = rest as f64 * 2.0_f64.powi(-80) / resolution - (position - whole);
        prop_assert!(error.abs() < grid.cell_slack(), "{} leaves", error);
        prop_assert!(grid.cell_slack() <= 1.0 / 64.0);
    }

    #[test]
    fn codes_interleave_the_bits_of_columns_and_rows(x in any::<u32>(), y in any::<u32>()) {
        let address = BlockAddress { x, y };
        let slow = (0..32).fold(0_u64, |code, bit| {
            code | u64::from(x >> bit & 1) << (2 * bit) | u64::from(y >> bit & 1) << (2 * bit + 1)
        });
        prop_assert_eq!(address.morton(), slow);
        prop_assert_eq!(BlockAddress::from_morton(slow), address);
    }

    #[test]
    fn no_input_panics(
        resolution in any::<f64>(), depth in any::<u32>(), x in any::<f64>(), y in any::<f64>(),
        grid in grids(), v in any::<[f64; 4]>(), at in any::<(u8, u32, u32)>(),
    ) {
        let _ = Grid::new(resolution, depth, Some((x, y)));
        let _ = Grid::new(resolution, depth % 30, None);
        let _ = Grid::new(0.1, 16, Some((x, y)));
        let _ = grid.leaf_at(v[0], v[1]);
        let within = grid.leaves_within(v[0], v[1], v[2], v[3]);
        let (meeting, _) = grid.leaves_meeting(&Box2::new(Interval::spanning(v[0], v[1]), Interval::spanning(v[2], v[3])));
        for range in [within, meeting] {
            prop_assert!(range.max_x <= grid.side() && range.max_y <= grid.side());
        }
        let node = NodeAddress { depth: at.0, x: at.1, y: at.2 };
        let _ = (grid.node_box(node), grid.node_min(node), grid.node_size(node.depth));
    }
}

#[test]
fn default_origin_and_display_are_those_of_the_interface() {
    let grid = Grid::new(0.1, 16, None).unwrap();
    assert_eq!(grid.origin(), (-3276.8, -3276.8));
    let node = NodeAddress { depth: 16, x: 32770, y: 32771 };
    assert_eq!(grid.node_min(node), (0.2, 0.3));
    assert_eq!(grid.node_size(16), 0.1);
    assert_eq!(grid.node_size(0), 6553.6);
    assert_eq!(grid.leaf_at(0.25, 0.35), Some(node));
    let range = |min_x, min_y, max_x, max_y| LeafRange { min_x, min_y, max_x, max_y };
    assert_eq!(grid.leaves_within(0.3, 0.2, 0.5, 0.3), range(32771, 32770, 32773, 32771));
    assert_eq!(grid.leaves_within(0.25, 0.2, 0.31, 0.3), range(32770, 32770, 32772, 32771));
    let whole = range(0, 0, 65536, 65536);
    assert_eq!(grid.leaves_within(f64::NEG_INFINITY, -1e300, f64::INFINITY, 3276.8), whole);
    for i in 0..65536_u32 {
        let decimal = (f64::from(i) - 32768.0) / 10.0;
        assert_eq!(grid.node_min(NodeAddress { depth: 16, x: i, y: 0 }).0, decimal);
        assert_eq!(grid.leaves_within(decimal, 0.0, 4000.0, 1.0).min_x, i);
    }
}

#[test]
fn the_smallest_numbers_beside_an_edge_are_on_the_right_side_of_it() {
    let grid = Grid::new(0.25, 4, None).unwrap();
    let tiny = f64::from_bits(1);
    assert_eq!(grid.leaf_at(-tiny, tiny), Some(NodeAddress { depth: 4, x: 7, y: 8 }));
    assert_eq!(grid.leaf_at(-0.0, 2.0), None);
    let (range, beyond) = grid.leaves_meeting(&Box2::point(-tiny, 0.0));
    assert_eq!((range, beyond), (LeafRange { min_x: 7, min_y: 7, max_x: 8, max_y: 9 }, false));
    let (range, beyond) = grid.leaves_meeting(&Box2::point(2.0, 2.0_f64.next_up()));
    assert_eq!((range.min_x, range.max_x, range.is_empty(), beyond), (15, 16, true, true));
    let square = grid.node_box(NodeAddress { depth: 4, x: 8, y: 9 });
    assert_eq!((square.x.lo(), square.x.hi(), square.y.lo(), square.y.hi()), (0.0, 0.25, 0.25, 0.5));
    assert_eq!(grid.bounds(), Box2::new(Interval::new(-2.0, 2.0).unwrap(), Interval::new(-2.0, 2.0).unwrap()));
    assert_eq!(grid.leaf_at(f64::NAN, 0.0), None);
    assert_eq!(grid.leaf_at(0.0, f64::INFINITY), None);
}

#[test]
fn a_grid_out_of_range_is_refused_by_field() {
    for resolution in [0.0, -0.1, f64::NAN, f64::INFINITY, 9.9e-5, 1.1e4] {
        assert!(matches!(Grid::new(resolution, 8, None), Err(GridError::Resolution(_))), "{resolution}");
    }
    for depth in [0, 25, 256 + 8, u32::MAX] {
        assert_eq!(Grid::new(0.1, depth, None), Err(GridError::Depth(depth)));
    }
    for origin in [f64::NAN, f64::INFINITY, -1.1e9, 1e9] {
        assert!(matches!(Grid::new(0.1, 8, Some((origin, 0.0))), Err(GridError::Origin(_))), "{origin}");
        assert!(matches!(Grid::new(0.1, 8, Some((0.0, origin))), Err(GridError::Origin(_))), "{origin}");
    }
    assert!(matches!(Grid::new(1e4, 24, None), Err(GridError::Origin(_))));
    assert!(matches!(Grid::new(1e-4, 8, Some((9e8, 0.0))), Err(GridError::TooFine { .. })));
    assert!(Grid::new(1e-4, 8, Some((1e8, -1e8))).is_ok());
    assert!(Grid::new(1e4, 16, None).is_ok() && Grid::new(0.1, 24, None).is_ok());
}

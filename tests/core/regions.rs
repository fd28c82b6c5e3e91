//! Regions against exact integer geometry, and against sampled points where the numbers are not exact.
#![allow(clippy::unwrap_used, clippy::panic, reason = "a test that cannot be set up has failed")]

use crate::regions_exact::{Dice, Shape, random_shape};
use ubbmap::interval::{Box2, Interval};
use ubbmap::mapping::{Region, RegionError, RegionLimits};

/// Metres of one unit of the exact geometry: a power of two, so that every coordinate is a float.
pub const UNIT: f64 = 1.0 / 64.0;

pub fn metres(v: i128) -> f64 {
    v as f64 * UNIT
}

pub fn region_of(shape: &Shape) -> Region {
    let point = |p: &(i128, i128)| (metres(p.0), metres(p.1));
    let limits = RegionLimits::default();
    match shape {
        Shape::Rectangle(min, max) => Region::rectangle(point(min), point(max)),
        Shape::Disc(center, radius) => Region::disc(point(center), metres(*radius)),
        Shape::Polygon(points) => Region::polygon(points.iter().map(point).collect(), &limits),
        Shape::Path(points, radius) => Region::path(points.iter().map(point).collect(), metres(*radius), &limits),
    }
    .unwrap()
}

fn box_of(min: (f64, f64), max: (f64, f64)) -> Box2 {
    Box2::new(Interval::spanning(min.0, max.0), Interval::spanning(min.1, max.1))
}

#[test]
fn a_box_meets_a_region_exactly_when_integer_geometry_says_so() {
    let mut dice = Dice(1);
    let (mut met, mut apart) = (0, 0);
    for _ in 0..4_000 {
        let shape = random_shape(&mut dice, -200, 200, 16);
        let region = region_of(&shape);
        for _ in 0..40 {
            let side = dice.pick(&[0, 1, 7, 16, 64]);
            let grain = dice.pick(&[1, 16]);
            let min = (dice.whole(-260 / grain, 240 / grain) * grain, dice.whole(-260 / grain, 240 / grain) * grain);
            let max = (min.0 + side, min.1 + side);
            let square = box_of((metres(min.0), metres(min.1)), (metres(max.0), metres(max.1)));
            let truth = shape.meets((min, max));
            assert_eq!(region.meets(&square), truth, "{shape:?} and {min:?} {max:?}");
            if truth { met += 1 } else { apart += 1 }
        }
    }
    assert!(met > 10_000 && apart > 20_000, "{met} met, {apart} apart");
}

#[test]
fn the_bounds_are_the_smallest_box() {
    let mut dice = Dice(2);
    for _ in 0..2_000 {
        let shape = random_shape(&mut dice, -200, 200, 16);
        let bounds = region_of(&shape).bounds();
        let (min, max) = shape.bounds();
        for (axis, lo, hi) in [(bounds.x, min.0, max.0), (bounds.y, min.1, max.1)] {
            assert!(axis.lo() <= metres(lo) && axis.hi() >= metres(hi), "{shape:?}");
            assert!(axis.lo() >= metres(lo) - 1e-14 && axis.hi() <= metres(hi) + 1e-14, "{shape:?}");
        }
    }
}

/// Distance of a point from a segment, the plain way.
fn distance((px, py): (f64, f64), a: (f64, f64), b: (f64, f64)) -> f64 {
    let (dx, dy) = (b.0 - a.0, b.1 - a.1);
    let squared = dx * dx + dy * dy;
    let t = if squared == 0.0 { 0.0 } else { (((px - a.0) * dx + (py - a.1) * dy) / squared).clamp(0.0, 1.0) };
    (px - a.0 - t * dx).hypot(py - a.1 - t * dy)
}

#[test]
fn far_from_the_origin_a_box_that_touches_is_met_and_one_a_trillionth_away_is_not() {
    let mut dice = Dice(3);
    for _ in 0..20_000 {
        let scale = 10_f64.powf(dice.real(-3.0, 6.0));
        let shift = (dice.real(-1.0, 1.0) * 1e3 * scale, dice.real(-1.0, 1.0) * 1e3 * scale);
        let point = |dice: &mut Dice| (shift.0 + scale * dice.real(-1.0, 1.0), shift.1 + scale * dice.real(-1.0, 1.0));
        let (a, b) = (point(&mut dice), point(&mut dice));
        let corner = point(&mut dice);
        let gap = distance(corner, a, b);
        // The box has one corner nearest to the segment: it extends away from it along both axes.
        let t = {
            let (dx, dy) = (b.0 - a.0, b.1 - a.1);
            (((corner.0 - a.0) * dx + (corner.1 - a.1) * dy) / (dx * dx + dy * dy)).clamp(0.0, 1.0)
        };
        let away = (corner.0 - a.0 - t * (b.0 - a.0), corner.1 - a.1 - t * (b.1 - a.1));
        let side = scale * dice.real(0.001, 1.0);
        let far = (corner.0 + side.copysign(away.0), corner.1 + side.copysign(away.1));
        let square = box_of((corner.0.min(far.0), corner.1.min(far.1)), (corner.0.max(far.0), corner.1.max(far.1)));
        // The nearest point of the box is that corner only where the segment is on its far side altogether.
        let behind = |p: (f64, f64)| (p.0 - corner.0) * away.0 <= 0.0 && (p.1 - corner.1) * away.1 <= 0.0;
        if !behind(a) || !behind(b) {
            continue;
        }
        let limits = RegionLimits::default();
        let fuzz = 1e-12 * 1e3 * scale + 1e-12 * gap;
        let path = |radius: f64| Region::path(vec![a, b], radius, &limits).unwrap();
        assert!(path(gap + fuzz).meets(&square));
        assert!(!path((gap - fuzz).max(0.0)).meets(&square) || gap <= fuzz);
        let disc = |radius: f64| Region::disc(a, radius).unwrap();
        let gap = (corner.0 - a.0).hypot(corner.1 - a.1);
        assert!(disc(gap * (1.0 + 1e-14)).meets(&square));
        assert!(!disc(gap * (1.0 - 1e-12)).meets(&square));
    }
}

/// The squares of such numbers keep a bit or two, so that a sum of two may be rounded above the square of the radius.
#[test]
fn regions_of_next_to_nothing_missed_boxes_that_they_touch() {
    let mut dice = Dice(4);
    for _ in 0..20_000 {
        let gap = 10_f64.powf(dice.real(-163.0, -150.0));
        let (x, y) = (gap * dice.real(0.0, 1.0), gap);
        let radius = x.hypot(y) * (1.0 + 1e-15);
        let square = box_of((x, y), (x + 1.0, y + 1.0));
        assert!(Region::disc((0.0, 0.0), radius).unwrap().meets(&square), "a disc of {radius} and {square:?}");
        for end in [(0.0, 0.0), (-radius, -1.0), (radius * dice.real(-1.0, 0.0), 0.0)] {
            let path = Region::path(vec![(0.0, 0.0), end], radius, &RegionLimits::default()).unwrap();
            assert!(path.meets(&square), "a path to {end:?} of {radius} and {square:?}");
        }
    }
}

#[test]
fn bad_regions_name_the_field() {
    let limits = RegionLimits { max_points: 5 };
    let field = |result: Result<Region, RegionError>| match result.unwrap_err() {
        RegionError::NotFinite { field, .. }
        | RegionError::Inverted { field, .. }
        | RegionError::Negative { field, .. }
        | RegionError::Points { field, .. } => field,
    };
    assert_eq!(field(Region::rectangle((f64::NAN, 0.0), (1.0, 1.0))), "box.min_x");
    assert_eq!(field(Region::rectangle((0.0, 0.0), (1.0, f64::INFINITY))), "box.max_y");
    assert_eq!(field(Region::rectangle((0.0, 2.0), (1.0, 1.0))), "box.y");
    assert_eq!(field(Region::disc((0.0, 1e300), 1.0)), "disc.center.y");
    assert_eq!(field(Region::disc((0.0, 0.0), -1.0)), "disc.radius");
    assert_eq!(field(Region::disc((0.0, 0.0), f64::NAN)), "disc.radius");
    assert_eq!(field(Region::polygon(vec![(0.0, 0.0); 2], &limits)), "polygon.points");
    assert_eq!(field(Region::polygon(vec![(0.0, 0.0); 6], &limits)), "polygon.points");
    let mut points = vec![(0.0, 0.0); 5];
    points[3].1 = f64::NEG_INFINITY;
    assert_eq!(field(Region::polygon(points.clone(), &limits)), "polygon.points[3].y");
    assert_eq!(field(Region::path(points, 1.0, &limits)), "path.points[3].y");
    assert_eq!(field(Region::path(vec![], 1.0, &limits)), "path.points");
    assert_eq!(field(Region::path(vec![(0.0, 0.0)], -0.5, &limits)), "path.radius");
}

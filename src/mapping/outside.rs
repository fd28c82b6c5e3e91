//! Where a region reaches beyond the root of a map.

use super::Region;
use super::region::{Segment, Shape};
use crate::quadtree::Grid;

/// A cell outside the root that a region meets.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Overhang {
    /// Min corner of the cell, on the lattice of the map's leaves; metres.
    pub cell_min: (f64, f64),
}

/// A side of the root.
#[derive(Debug, Clone, Copy)]
struct Side {
    /// 0 for x, 1 for y.
    axis: usize,
    /// True for the max side.
    upper: bool,
}

const SIDES: [Side; 4] = [
    Side { axis: 0, upper: false },
    Side { axis: 0, upper: true },
    Side { axis: 1, upper: false },
    Side { axis: 1, upper: true },
];

/// `a + b` as a float and the rest that it rounds away, exactly (Knuth's two-sum).
fn two_sum(a: f64, b: f64) -> (f64, f64) {
    let sum = a + b;
    let bb = sum - a;
    (sum, (a - (sum - bb)) + (b - bb))
}

/// True when `a > b` for two sums as [`two_sum`] gives them. A rest is at most half an ulp of its float, so that the
/// floats decide where they differ (where both rests are half an ulp, equal sums may be called larger).
fn exceeds(a: (f64, f64), b: (f64, f64)) -> bool {
    a.0 > b.0 || (a.0 == b.0 && a.1 > b.1)
}

impl Side {
    fn pick(self, (x, y): (f64, f64)) -> f64 {
        if self.axis == 0 { x } else { y }
    }

    /// The root's edge on this side; the side of the root is a power of two times the resolution, which is exact.
    fn edge(self, grid: &Grid) -> (f64, f64) {
        let origin = self.pick(grid.origin());
        if self.upper { two_sum(origin, f64::from(grid.side()) * grid.resolution()) } else { (origin, 0.0) }
    }

    /// True when the disc of this radius about a point reaches beyond the root on this side.
    fn is_passed(self, point: (f64, f64), radius: f64, grid: &Grid) -> bool {
        let edge = self.edge(grid);
        if self.upper {
            exceeds(two_sum(self.pick(point), radius), edge)
        } else {
            exceeds(edge, two_sum(self.pick(point), -radius))
        }
    }

    /// The cell outside the root in which the disc about a point ends on this side.
    fn overhang(self, point: (f64, f64), radius: f64, grid: &Grid) -> Overhang {
        let reach = if self.upper { radius } else { -radius };
        let (x, y) = if self.axis == 0 { (point.0 + reach, point.1) } else { (point.0, point.1 + reach) };
        let (origin, resolution) = (grid.origin(), grid.resolution());
        let index = |v: f64, origin: f64| ((v - origin) / resolution).floor();
        let (mut column, mut row) = (index(x, origin.0), index(y, origin.1));
        // Rounding may put a point just beyond the edge on it.
        let across = if self.axis == 0 { &mut column } else { &mut row };
        *across = if self.upper { across.max(f64::from(grid.side())) } else { across.min(-1.0) };
        Overhang { cell_min: (origin.0 + column * resolution, origin.1 + row * resolution) }
    }

    fn of_points(self, points: impl Iterator<Item = (f64, f64)>, radius: f64, grid: &Grid) -> Option<Overhang> {
        let signed = |p: &(f64, f64)| if self.upper { self.pick(*p) } else { -self.pick(*p) };
        let outermost = points.max_by(|a, b| signed(a).total_cmp(&signed(b)))?;
        self.is_passed(outermost, radius, grid).then(|| self.overhang(outermost, radius, grid))
    }
}

/// A cell outside the root that a region meets, `None` when the region lies within the closed root.
pub(super) fn overhang(region: &Region, grid: &Grid) -> Option<Overhang> {
    let bounds = region.bounds();
    let (origin, side) = (grid.origin(), f64::from(grid.side()) * grid.resolution());
    // The bounds are rounded outward by a float at most, so that this settles nearly every query.
    let well_within = |lo: f64, hi: f64, origin: f64| lo > origin && hi < (origin + side).next_down();
    if well_within(bounds.x.lo(), bounds.x.hi(), origin.0) && well_within(bounds.y.lo(), bounds.y.hi(), origin.1) {
        return None;
    }
    SIDES.iter().find_map(|side| match region.shape() {
        Shape::Rectangle => {
            let corners = [(bounds.x.lo(), bounds.y.lo()), (bounds.x.hi(), bounds.y.hi())];
            side.of_points(corners.into_iter(), 0.0, grid)
        }
        Shape::Disc { center, radius } => side.of_points(std::iter::once(*center), *radius, grid),
        Shape::Polygon { edges } => side.of_points(edges.iter().map(|e| e.start), 0.0, grid),
        Shape::Path { pieces, radius } => side.of_points(pieces.iter().flat_map(|p| [p.start, p.end]), *radius, grid),
    })
}

/// How far along a straight piece a disc first reaches beyond the root, metres, and a cell that it meets there.
pub(super) fn overhang_along(piece: &Segment, radius: f64, grid: &Grid) -> Option<(f64, Overhang)> {
    let mut first: Option<(f64, Overhang)> = None;
    for side in SIDES {
        let along = if side.is_passed(piece.start, radius, grid) {
            0.0
        } else if side.is_passed(piece.end, radius, grid) {
            let (from, to) = (side.pick(piece.start), side.pick(piece.end));
            let edge = side.edge(grid).0;
            let limit = if side.upper { edge - radius } else { edge + radius };
            (piece.length() * ((limit - from) / (to - from))).clamp(0.0, piece.length())
        } else {
            continue;
        };
        if first.is_none_or(|(best, _)| along < best) {
            first = Some((along, side.overhang(piece.at(along), radius, grid)));
        }
    }
    first
}

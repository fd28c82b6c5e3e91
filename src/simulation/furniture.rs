//! What stands in rooms, as a scanner sees it at the height of table legs.

use super::{Point, Shape};
use std::f64::consts::{FRAC_PI_2, TAU};

/// A frame for furnishing: room coordinates to the map, without a turn but perhaps mirrored along `y`.
#[derive(Debug, Clone, Copy)]
pub(super) struct RoomFrame {
    /// The map point of the room's corner at `u = v = 0`.
    pub origin: (f64, f64),
    /// `1` when `v` runs upwards on the map, `-1` when downwards.
    pub up: f64,
}

impl RoomFrame {
    /// A point of the room on the map; `u` along the corridor, `v` away from it, metres.
    pub(super) fn point(&self, u: f64, v: f64) -> Point {
        Point::new(self.origin.0 + u, self.origin.1 + self.up * v)
    }

    /// An axis-parallel box between two corners.
    pub(super) fn block(&self, a: (f64, f64), b: (f64, f64)) -> Shape {
        let (a, b) = (self.point(a.0, a.1), self.point(b.0, b.1));
        Shape::rectangle_between((a.x, a.y), (b.x, b.y))
    }

    /// A round thing, such as a pillar or a plant.
    pub(super) fn round(&self, u: f64, v: f64, radius: f64) -> Shape {
        Shape::Disc { center: self.point(u, v), radius }
    }

    /// A board with round edges between two points.
    pub(super) fn board(&self, a: (f64, f64), b: (f64, f64), thickness: f64) -> Shape {
        Shape::Capsule { from: self.point(a.0, a.1), to: self.point(b.0, b.1), radius: 0.5 * thickness }
    }

    /// The legs of a table whose top is the box between two corners; `rows` pairs of legs along `v`.
    pub(super) fn table(&self, a: (f64, f64), b: (f64, f64), rows: usize, radius: f64, out: &mut Vec<Shape>) {
        let inset = 0.06;
        for row in 0..rows {
            let v = a.1 + inset + (b.1 - a.1 - 2.0 * inset) * row as f64 / (rows - 1).max(1) as f64;
            out.extend([a.0 + inset, b.0 - inset].map(|u| self.round(u, v, radius)));
        }
    }

    /// The four legs of a chair, turned by `heading` (radians).
    pub(super) fn chair(&self, u: f64, v: f64, heading: f64, out: &mut Vec<Shape>) {
        out.extend((0..4).map(|leg| {
            let angle = heading + FRAC_PI_2 * (f64::from(leg) + 0.5);
            self.round(u + 0.27 * angle.cos(), v + 0.27 * angle.sin(), 0.012)
        }));
    }

    /// An office chair: a column on five castors.
    pub(super) fn office_chair(&self, u: f64, v: f64, heading: f64, out: &mut Vec<Shape>) {
        out.push(self.round(u, v, 0.03));
        out.extend((0..5).map(|castor| {
            let angle = heading + TAU / 5.0 * f64::from(castor);
            self.round(u + 0.28 * angle.cos(), v + 0.28 * angle.sin(), 0.028)
        }));
    }
}

//! The free star as a polygon on the sheet.
//!
//! Each piece of the ring is a chord between its two borders at distance `rho`, inside the arc; neighbours are joined by
//! an edge along the border between them. The polygon is thus a subset of the star, closed, and winds once.

use super::dense::Units;
use super::directions::Directions;
use super::envelope::{Border, Piece};
use super::frame::Frame;
use super::raster::{Point, edge};
use super::sheet::Sheet;
use std::f64::consts::TAU;

/// A chord may lie this much inside its arc, leaves; wider pieces are split.
pub(super) const SAGITTA: f64 = 1.0 / 32.0;

/// Widest angle under one chord, radians.
pub(super) const WIDEST: f64 = 0.5;

/// Draws stars; keeps the borders' directions between scans.
#[derive(Debug, Default)]
pub(super) struct Vertices {
    units: Vec<Point>,
}

impl Vertices {
    /// Draws the boundary and the parity of the star of `pieces`. `half_width` is the window of the envelope.
    pub(super) fn draw(
        &mut self,
        sheet: &mut impl Sheet,
        frame: &Frame,
        directions: &Directions,
        pieces: &[Piece],
        half_width: f64,
    ) {
        let Some(first) = pieces.first() else { return };
        let heading = self.turn(frame, directions, pieces, half_width);
        let dilation = frame.dilation();
        let mut at = vertex(frame, self.units[0], pieces[0].rho);
        let start = at;
        for (i, piece) in pieces.iter().enumerate() {
            let next = if i + 1 == pieces.len() { 0 } else { i + 1 };
            let end = if next == 0 { first.angle + TAU } else { pieces[next].angle };
            let chords = chords(end - piece.angle, piece.rho * frame.scale);
            for step in 1..=chords {
                let unit = if step == chords {
                    self.units[next]
                } else {
                    let angle = piece.angle + (end - piece.angle) * f64::from(step) / f64::from(chords);
                    turned(heading, rotation(angle))
                };
                let to = vertex(frame, unit, piece.rho);
                join(sheet, at, to, dilation);
                at = to;
            }
            let to = if next == 0 { start } else { vertex(frame, self.units[next], pieces[next].rho) };
            join(sheet, at, to, dilation);
            at = to;
        }
    }

    /// The directions in which pieces begin, at the heading's middle; returns that heading's own direction.
    fn turn(&mut self, frame: &Frame, directions: &Directions, pieces: &[Piece], half_width: f64) -> Point {
        let heading = rotation(frame.heading.0);
        let window = rotation(half_width);
        let before = turned(heading, (window.0, -window.1));
        let behind = turned(heading, window);
        self.units.clear();
        self.units.extend(pieces.iter().map(|piece| match piece.border {
            Border::Before(beam) => turned(before, directions.unit(beam as usize)),
            Border::Behind(beam) => turned(behind, directions.unit(beam as usize)),
            Border::Free => turned(heading, rotation(piece.angle)),
        }));
        heading
    }

    /// The chords of the star in single precision: the direction in which each begins and its distance, leaves, and the
    /// first again behind the last.
    pub(super) fn chords(
        &mut self,
        frame: &Frame,
        directions: &Directions,
        pieces: &[Piece],
        half_width: f64,
        units: &mut Units,
        rho: &mut Vec<f32>,
    ) {
        units.x.clear();
        units.y.clear();
        rho.clear();
        let Some(first) = pieces.first() else { return };
        let heading = self.turn(frame, directions, pieces, half_width);
        let mut add = |unit: Point, radius: f64| {
            units.x.push(unit.0 as f32);
            units.y.push(unit.1 as f32);
            rho.push(radius as f32);
        };
        for (i, piece) in pieces.iter().enumerate() {
            let end = pieces.get(i + 1).map_or(first.angle + TAU, |next| next.angle);
            let radius = piece.rho * frame.scale;
            let chords = chords(end - piece.angle, radius);
            add(self.units[i], radius);
            for step in 1..chords {
                let angle = piece.angle + (end - piece.angle) * f64::from(step) / f64::from(chords);
                add(turned(heading, rotation(angle)), radius);
            }
        }
        add(self.units[0], first.rho * frame.scale);
    }
}

fn join(sheet: &mut impl Sheet, from: Point, to: Point, dilation: Point) {
    if from != to {
        edge(sheet, from, to, dilation);
    }
}

fn vertex(frame: &Frame, unit: Point, rho: f64) -> Point {
    let radius = rho * frame.scale;
    (frame.origin.0 + radius * unit.0, frame.origin.1 + radius * unit.1)
}

/// How many chords an arc of `angle` radians and `radius` leaves is split into: a chord lies `radius * angle^2 / 8` inside.
fn chords(angle: f64, radius: f64) -> u32 {
    if radius == 0.0 {
        return 1;
    }
    let widest = (8.0 * SAGITTA / radius).sqrt().min(WIDEST);
    (angle / widest).ceil().clamp(1.0, 4096.0) as u32
}

fn rotation(angle: f64) -> Point {
    (core_math::cos(angle), core_math::sin(angle))
}

fn turned(by: Point, unit: Point) -> Point {
    (by.0 * unit.0 - by.1 * unit.1, by.1 * unit.0 + by.0 * unit.1)
}

//! The evidence of a scan on a dense window, in vectors.

use super::cones::Cones;
use super::directions::{Directions, Even, Turn};
use super::edges::Target;
use super::envelope::Envelope;
use super::frame::Frame;
use super::outline::Outline;
use super::polygon::{SAGITTA, Vertices, WIDEST};
use super::returns::{Shape, mark_returns};
use super::sectors::{GapRule, Sectors};
use super::window::Window;
use crate::sensor::Scan;
use crate::vector::{Path, on_each_path};

/// Beams are computed by so many at once; slices are filled up to a multiple.
const LANES: usize = 16;

/// Window and scratch memory.
#[derive(Debug, Default)]
pub(super) struct Dense {
    pub(super) window: Window,
    pub(super) sectors: Sectors,
    outline: Outline,
    /// Directions at the heading's middle, less and plus the window of the pieces about the axes.
    middle: Units,
    before: Units,
    behind: Units,
    /// The directions in which all pieces begin, and their distances.
    ring: Units,
    rho: Vec<f32>,
    about: Vec<f32>,
    between: Vec<f32>,
    large: Vec<u64>,
    aside: Turn,
}

/// Unit vectors.
#[derive(Debug, Default)]
pub(super) struct Units {
    pub(super) x: Vec<f32>,
    pub(super) y: Vec<f32>,
}

impl Units {
    /// The directions turned by an angle of this sine and cosine, filled up to whole lanes.
    fn turn(&mut self, path: Path, directions: &Directions, (sin, cos): (f64, f64)) {
        let (sin, cos) = (sin as f32, cos as f32);
        let count = directions.cos.len();
        self.x.resize(count, 0.0);
        self.y.resize(count, 0.0);
        turn(path, &directions.cos, &directions.sin, cos, sin, &mut self.x, &mut self.y);
        self.x.resize(count.next_multiple_of(LANES), 0.0);
        self.y.resize(count.next_multiple_of(LANES), 0.0);
    }
}

/// The first `count` of two lists in turn, and the first again behind the last.
fn interleave(path: Path, even: &[f32], odd: &[f32], count: usize, out: &mut Vec<f32>) {
    out.resize(2 * count, 0.0);
    take_turns(path, &even[..count], &odd[..count], out);
    out.extend(even.first().copied());
}

on_each_path! {
    fn take_turns(even: &[f32], odd: &[f32], out: &mut [f32]) {
        for ((pair, even), odd) in out.as_chunks_mut::<2>().0.iter_mut().zip(even).zip(odd) {
            *pair = [*even, *odd];
        }
    }
}

on_each_path! {
    fn turn(cosines: &[f32], sines: &[f32], cos: f32, sin: f32, x: &mut [f32], y: &mut [f32]) {
        for (((x, y), c), s) in x.iter_mut().zip(y).zip(cosines).zip(sines) {
            *x = cos * c - sin * s;
            *y = sin * c + cos * s;
        }
    }
}

/// What the star of a scan at even steps is computed from.
#[derive(Debug, Clone, Copy)]
pub(super) struct StarSpec {
    pub(super) even: Even,
    /// `s` of assumption A4, metres.
    pub(super) min_obstacle_width: f64,
    /// Half width of the window of directions, radians.
    pub(super) half_width: f64,
}

impl Dense {
    /// Reads the scan's ranges in ascending angle and turns the directions to the heading's middle.
    pub(super) fn read(&mut self, path: Path, scan: &Scan, directions: &Directions, frame: &Frame) {
        directions.sort(&scan.spec().ranges, &mut self.sectors.ranges);
        self.sectors.read(path, scan.sensor(), frame.scale);
        self.middle.turn(path, directions, frame.turn);
    }

    /// Draws the star of a scan at even steps. False where it takes the general way: no beam returned, or chords so long
    /// that they would have to be split.
    pub(super) fn draw_even_star(
        &mut self,
        path: Path,
        scan: &Scan,
        directions: &Directions,
        frame: &Frame,
        spec: &StarSpec,
    ) -> bool {
        let sensor = scan.sensor().spec();
        let rule = GapRule {
            step: spec.even.step,
            wider: 2.0 * sensor.beam_angle_error + spec.even.seam_error,
            width: spec.min_obstacle_width,
            beam_diameter: sensor.beam_diameter,
            beam_opening: sensor.beam_opening,
            scale: frame.scale,
        };
        let Some(farthest) = self.sectors.build(path, spec.even, rule) else { return false };
        let step = spec.even.step;
        if step > WIDEST || f64::from(farthest) * step * step > 8.0 * SAGITTA {
            return false;
        }
        let place = frame.place();
        let (about, between) = (&mut self.about, &mut self.between);
        let aside = self.sectors.envelope(path, spec.even, spec.half_width, about, between);
        let [_, boundary, toggle, _] = &mut self.window.planes;
        let (boundary, toggle) = (boundary.bits(), toggle.bits());
        let target = Target { boundary, toggle, touched: &mut self.window.touched };
        if about.is_empty() {
            between.extend(between.first().copied());
            self.outline.draw(path, &self.middle.x, &self.middle.y, between, &place, target);
        } else {
            let ((sin, cos), (sin_aside, cos_aside)) = (frame.turn, self.aside.sin_cos(aside));
            let (same, cross) = ((sin * cos_aside, cos * cos_aside), (cos * sin_aside, sin * sin_aside));
            self.before.turn(path, directions, (same.0 - cross.0, same.1 + cross.1));
            self.behind.turn(path, directions, (same.0 + cross.0, same.1 - cross.1));
            let (ring, rho) = (&mut self.ring, &mut self.rho);
            interleave(path, &self.before.x, &self.behind.x, between.len(), &mut ring.x);
            interleave(path, &self.before.y, &self.behind.y, between.len(), &mut ring.y);
            interleave(path, about, between, between.len(), rho);
            self.outline.draw(path, &ring.x, &ring.y, rho, &place, target);
        }
        true
    }

    /// Draws the star of any scan from its ring of pieces.
    pub(super) fn draw_star(
        &mut self,
        path: Path,
        vertices: &mut Vertices,
        frame: &Frame,
        directions: &Directions,
        envelope: &Envelope,
        half_width: f64,
    ) {
        vertices.chords(frame, directions, &envelope.pieces, half_width, &mut self.before, &mut self.between);
        if self.between.is_empty() {
            return;
        }
        let [_, boundary, toggle, _] = &mut self.window.planes;
        let (boundary, toggle) = (boundary.bits(), toggle.bits());
        let target = Target { boundary, toggle, touched: &mut self.window.touched };
        self.outline.draw(path, &self.before.x, &self.before.y, &self.between, &frame.place(), target);
    }

    /// Draws X_OCC: the measurement sets of all returns. Those that are not for vectors are left to `alone`, by position.
    pub(super) fn draw_returns(
        &mut self,
        path: Path,
        cones: &Cones,
        frame: &Frame,
        alone: impl Fn(&mut Window, usize),
    ) {
        let count = self.sectors.far.len();
        let whole = count.next_multiple_of(LANES);
        let Some(shape) = Shape::of(cones, (0.5 * frame.rounding()) as f32) else {
            (0..count).for_each(|position| alone(&mut self.window, position));
            return;
        };
        self.sectors.near.resize(whole, -1.0);
        self.sectors.far.resize(whole, -1.0);
        self.large.resize(whole.div_ceil(64), 0);
        let [occupied, ..] = &mut self.window.planes;
        let (x, y) = (&self.middle.x[..whole], &self.middle.y[..whole]);
        let touched = &mut self.window.touched;
        let (near, far) = (&self.sectors.near, &self.sectors.far);
        mark_returns(path, x, y, near, far, &shape, &frame.place(), occupied.bits(), touched, &mut self.large);
        for word in 0..self.large.len() {
            let mut left = self.large[word];
            while left != 0 {
                alone(&mut self.window, 64 * word + left.trailing_zeros() as usize);
                left &= left - 1;
            }
        }
    }
}

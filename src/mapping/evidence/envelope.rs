//! The smallest `rho` within a window of directions: the free star for an uncertain heading.
//!
//! A bracket counts in every direction from which its wedge is no farther than its window: the half width of the heading,
//! the angle error of single beams and the sensor's motion between the two beams. The result is a ring of pieces, each
//! with one `rho`, found with a queue of ascending minima in one pass.
//!
//! The bracket with the largest motion may leave its motion out of its window. Let it be `X`. If the directions of a point
//! from all poses stay outside `X`, the axes fired on either side of `X` lie on either side of the point whenever they were
//! fired, so two successive beams of the others straddle it; if not, `X` counts anyway, at some pose of the sweep. When the
//! two beams of `X` fired the sensor was elsewhere, by at most the sweep's translation, so its `rho` is less by that. For a
//! full circle that a moving sensor sweeps, `X` is its seam.

use super::star::Bracket;
use std::collections::VecDeque;
use std::f64::consts::TAU;

/// Where a piece of the ring begins.
#[derive(Debug, Clone, Copy)]
pub(super) enum Border {
    /// At a beam's axis less the window.
    Before(u32),
    /// At a beam's axis plus the window.
    Behind(u32),
    /// At an angle of its own.
    Free,
}

/// Directions from `angle` to the next piece's, in which everything nearer than `rho` is free.
#[derive(Debug, Clone, Copy)]
pub(super) struct Piece {
    /// First direction, radians relative to the heading's middle.
    pub angle: f64,
    /// How that direction came about.
    pub border: Border,
    /// Metres.
    pub rho: f64,
}

/// The ring of pieces.
#[derive(Debug, Default)]
pub(super) struct Envelope {
    windows: Vec<Window>,
    minima: VecDeque<(usize, f64)>,
    /// Pieces in ascending angle over one full turn; the last ends where the first begins.
    pub(super) pieces: Vec<Piece>,
}

#[derive(Debug, Clone, Copy)]
struct Window {
    start: f64,
    end: f64,
    start_border: Border,
    end_border: Border,
    rho: f64,
}

impl Envelope {
    /// Computes the ring for windows of `half_width` radians (plus each bracket's own motion) and a sensor that moves by up
    /// to `translation` metres during the sweep.
    pub(super) fn build(&mut self, brackets: &[Bracket], half_width: f64, translation: f64) {
        self.pieces.clear();
        if brackets.is_empty() || !self.open_windows(brackets, half_width, translation) {
            return;
        }
        let count = self.windows.len();
        let turn_start = self.windows[0].start;
        let turn_end = turn_start + TAU;
        // Windows of the turn before that reach into this one come first, those of the turn behind last.
        let mut next = 0usize;
        let mut oldest = 0usize;
        self.minima.clear();
        let at = |windows: &[Window], i: usize| -> Window {
            let mut window = windows[i % count];
            let shift = (i / count) as f64 * TAU - TAU;
            window.start += shift;
            window.end += shift;
            window
        };
        let mut angle = f64::NEG_INFINITY;
        loop {
            let begin = at(&self.windows, next);
            let end = at(&self.windows, oldest);
            let (event, border) = if begin.start <= end.end || oldest == next {
                (begin.start, begin.start_border)
            } else {
                (end.end, end.end_border)
            };
            if event >= turn_end {
                break;
            }
            if angle < event && event >= turn_start {
                // Events at one angle become one border; the value is set once all of them are in.
                self.pieces.push(Piece { angle: event, border, rho: 0.0 });
            }
            angle = event;
            if begin.start <= event {
                while self.minima.back().is_some_and(|(_, rho)| *rho >= begin.rho) {
                    self.minima.pop_back();
                }
                self.minima.push_back((next, begin.rho));
                next += 1;
            } else {
                oldest += 1;
                while self.minima.front().is_some_and(|(i, _)| *i < oldest) {
                    self.minima.pop_front();
                }
            }
            if let Some(piece) = self.pieces.last_mut() {
                piece.rho = self.minima.front().map_or(0.0, |(_, rho)| *rho);
            }
        }
        self.close();
    }

    /// One window a bracket, widened so that starts and ends both ascend: a window too wide takes away, never adds.
    /// False when a window reaches half a turn: then nothing is shown.
    fn open_windows(&mut self, brackets: &[Bracket], half_width: f64, translation: f64) -> bool {
        let widest = brackets.iter().enumerate().max_by(|(_, a), (_, b)| a.motion.total_cmp(&b.motion)).map(|(i, _)| i);
        self.windows.clear();
        let mut moving = false;
        for (i, bracket) in brackets.iter().enumerate() {
            let (motion, rho) = if Some(i) == widest {
                (0.0, (bracket.rho - translation).max(0.0))
            } else {
                (bracket.motion, bracket.rho)
            };
            let reach = half_width + motion;
            if reach >= 0.5 * TAU {
                return false;
            }
            moving |= motion > 0.0;
            self.windows.push(Window {
                start: bracket.start - reach,
                end: bracket.end + reach,
                start_border: if motion > 0.0 { Border::Free } else { Border::Before(bracket.low) },
                end_border: if motion > 0.0 { Border::Free } else { Border::Behind(bracket.high) },
                rho,
            });
        }
        if moving {
            self.sort_borders();
        }
        true
    }

    /// Moves starts down and ends up until both ascend round the ring.
    fn sort_borders(&mut self) {
        let count = self.windows.len();
        // Twice round, since a wide window reaches over the seam.
        for i in (0..2 * count - 1).rev() {
            let (this, next) = (i % count, (i + 1) % count);
            let bound = self.windows[next].start + if next == 0 { TAU } else { 0.0 };
            if bound < self.windows[this].start {
                self.windows[this].start = bound;
                self.windows[this].start_border = Border::Free;
            }
        }
        for i in 1..2 * count {
            let (this, before) = (i % count, (i - 1) % count);
            let bound = self.windows[before].end - if this == 0 { TAU } else { 0.0 };
            if bound > self.windows[this].end {
                self.windows[this].end = bound;
                self.windows[this].end_border = Border::Free;
            }
        }
    }

    /// Joins neighbours in which nothing is shown.
    fn close(&mut self) {
        self.pieces.dedup_by(|later, earlier| later.rho == 0.0 && earlier.rho == 0.0);
    }
}

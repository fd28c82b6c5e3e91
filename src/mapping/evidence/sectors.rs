//! The free star of a scan at even steps, in single precision and vectors: `rho` by sector between neighbouring beams.
//!
//! It is the rule of [`super::star`] (there in double precision and for beams at any angle): a sector has the `rho` of the
//! bracket of usable beams that spans it. For an uncertain heading the smallest `rho` within its half width `W` counts in
//! every direction ([`super::envelope`]). At even steps `D`, with `W = q D + f` and `g = min(f, D - f)`, that ring has two kinds
//! of pieces: about each axis, `+-g`, the smallest of `2 q + 2` sectors, and between them the smallest of `2 q + 1` (where
//! `f < D / 2`) or `2 q + 3`.
//!
//! Distances are in leaves. Rounding moves a point by a few units of `2^-24` of the scan's reach: [`super::frame`] has the
//! slack.

use super::directions::Even;
use super::star::{LAMBDA, kappa};
use crate::sensor::SensorModel;
use crate::vector::{Path, on_each_path};

/// Says nothing.
const NOTHING: f32 = -1.0;

/// A bound that binds nothing, leaves.
const UNBOUNDED: f32 = 1e30;

/// What the readings of a scan are compared with and turned into.
#[derive(Debug, Clone, Copy)]
struct Reader {
    range_min: f32,
    range_max: f32,
    /// Leaves per metre, less and plus what half an ulp of a range is.
    scale_near: f32,
    scale_far: f32,
    /// Range errors, leaves.
    minus: f32,
    plus: f32,
    /// `d-` of a beam without a return, leaves.
    free_to: f32,
}

/// The rule of a bracket: `rho = min(m, m shrink + rim, wide)`, leaves.
#[derive(Debug, Clone, Copy)]
struct Gap {
    shrink: f32,
    wide: f32,
}

/// What all brackets of a scan have in common.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct GapRule {
    /// Radians between neighbouring beams.
    pub step: f64,
    /// Radians that every gap is wider by: angle errors of its two beams, the error of the seam.
    pub wider: f64,
    /// `s` of assumption A4, metres.
    pub width: f64,
    /// Metres.
    pub beam_diameter: f64,
    /// Radians.
    pub beam_opening: f64,
    /// Leaves per metre.
    pub scale: f64,
}

/// Readings and sectors of one scan, by position in ascending angle.
#[derive(Debug, Default)]
pub(super) struct Sectors {
    /// Ranges in ascending angle, metres.
    pub(super) ranges: Vec<f32>,
    /// `d-`, leaves; negative where a beam says nothing.
    pub(super) near: Vec<f32>,
    /// `d+` of returns, leaves; negative otherwise.
    pub(super) far: Vec<f32>,
    /// Which positions returned.
    pub(super) returned: Vec<u64>,
    /// `rho` of the sector behind each position, leaves; 0 over the seam of what is no ring.
    rho: Vec<f32>,
    /// Gaps by steps, for the rule they were computed with.
    gaps: Vec<Option<Gap>>,
    rule: Option<GapRule>,
    /// The sectors in a row, and the smallest of 2, 4, 8, .. of them.
    minima: Vec<f32>,
    spare: [Vec<f32>; 2],
}

impl Sectors {
    /// Reads the ranges that were put into [`Sectors::ranges`]; `scale` is leaves per metre.
    pub(super) fn read(&mut self, path: Path, sensor: &SensorModel, scale: f64) {
        let spec = sensor.spec();
        // Half an ulp of a 32-bit range is at most 2^-24 of it.
        let ulp = 0.5 * f64::from(f32::EPSILON);
        let reader = Reader {
            range_min: spec.range_min as f32,
            range_max: spec.range_max as f32,
            scale_near: (scale * (1.0 - ulp)) as f32,
            scale_far: (scale * (1.0 + ulp)) as f32,
            minus: (spec.range_error_minus * scale) as f32,
            plus: (spec.range_error_plus * scale) as f32,
            free_to: sensor.no_return_free_to().map_or(NOTHING, |free_to| (free_to * scale) as f32),
        };
        let count = self.ranges.len();
        self.near.resize(count, 0.0);
        self.far.resize(count, 0.0);
        self.returned.resize(count.div_ceil(64), 0);
        read(path, &self.ranges, &reader, &mut self.near, &mut self.far);
        bits_of_returns(path, &self.far, &mut self.returned);
    }

    /// Computes the sectors and returns the largest `rho`, leaves; `None` where no beam returned.
    pub(super) fn build(&mut self, path: Path, even: Even, rule: GapRule) -> Option<f32> {
        if self.rule != Some(rule) {
            self.gaps.clear();
            self.rule = Some(rule);
        }
        let count = self.ranges.len();
        let first = next_one(&self.returned, 0, count)?;
        let rim = (LAMBDA * rule.beam_diameter * rule.scale) as f32;
        let gap = self.gap(1);
        self.rho.clear();
        self.rho.resize(count, 0.0);
        let last = self.bracket(1, self.near[count - 1].min(self.near[0]));
        sector_radii(path, &self.near, gap.shrink, rim, gap.wide, &mut self.rho);
        if even.ring {
            self.rho[count - 1] = last;
        }
        self.patch(first, even.ring);
        Some(largest(path, &self.rho))
    }

    /// Corrects the sectors next to beams that did not return. From one return to the next, `d-` of the beams between
    /// that are free to a declared distance counts, or, where that shows more, they are skipped.
    fn patch(&mut self, first: usize, ring: bool) {
        let count = self.ranges.len();
        let mut at = first;
        // Without a ring, the beams before the first return and behind the last have a return on one side alone.
        if !ring {
            self.chain(0, first, false);
        }
        while let Some(gone) = next_zero(&self.returned, at, count) {
            let before = gone - 1;
            match next_one(&self.returned, gone, count) {
                Some(next) => {
                    self.chain(before, next, true);
                    at = next;
                }
                None if ring => {
                    self.chain(before, count + first, true);
                    return;
                }
                None => {
                    self.chain(before, count - 1, false);
                    return;
                }
            }
        }
        if ring && first > 0 {
            // The last beam returned: the run over the seam begins behind it.
            self.chain(count - 1, count + first, true);
        }
    }

    /// Sets the sectors from position `from` to position `to` (which may lie a turn further) from the usable beams between;
    /// with `skip`, both ends returned, and the bracket of these two alone counts where it shows more.
    fn chain(&mut self, from: usize, to: usize, skip: bool) {
        let count = self.ranges.len();
        let near = |sectors: &Self, at: usize| sectors.near[at % count];
        let mut before = None;
        let mut inner = false;
        for at in from..=to {
            if near(self, at) < 0.0 {
                continue;
            }
            let rho = match before {
                Some(before) => self.bracket(at - before, near(self, before).min(near(self, at))),
                None => 0.0,
            };
            for sector in before.unwrap_or(from)..at {
                self.rho[sector % count] = rho;
            }
            inner |= at > from && at < to;
            before = Some(at);
        }
        for sector in before.unwrap_or(from)..to {
            self.rho[sector % count] = 0.0;
        }
        if skip && inner {
            let rho = self.bracket(to - from, near(self, from).min(near(self, to)));
            for sector in from..to {
                let here = &mut self.rho[sector % count];
                *here = here.max(rho);
            }
        }
    }

    /// `rho` of a bracket of two beams `steps` apart, `m = min(d_j-, d_k-)`, leaves.
    fn bracket(&mut self, steps: usize, m: f32) -> f32 {
        let Some(rule) = self.rule else { return 0.0 };
        let gap = self.gap(steps);
        let rim = (LAMBDA * rule.beam_diameter * rule.scale) as f32;
        bounded(m, gap.shrink, rim, gap.wide)
    }

    fn gap(&mut self, steps: usize) -> Gap {
        if self.gaps.len() <= steps {
            self.gaps.resize(steps + 1, None);
        }
        let Some(rule) = self.rule else { return Gap { shrink: 0.0, wide: 0.0 } };
        *self.gaps[steps].get_or_insert_with(|| rule.gap(steps))
    }

    /// The ring for a heading within `+-half_width` radians. `about` (a piece about each axis) is left empty where the pieces
    /// between them are all; returns the half width of those about the axes, radians.
    pub(super) fn envelope(
        &mut self,
        path: Path,
        even: Even,
        half_width: f64,
        about: &mut Vec<f32>,
        between: &mut Vec<f32>,
    ) -> f64 {
        let count = self.rho.len();
        about.clear();
        between.clear();
        if half_width == 0.0 {
            between.extend_from_slice(&self.rho);
            return 0.0;
        }
        let wide = half_width + even.seam_error;
        if 2.0 * wide >= count as f64 * even.step {
            // Every window reaches over the ends of the view, or all the way round: nothing is shown. So no window has more
            // sectors than there are, however small the steps.
            between.resize(count, 0.0);
            return 0.0;
        }
        let mut whole = (wide / even.step).floor();
        let mut rest = (wide - whole * even.step).max(0.0);
        if even.step - rest < NEGLIGIBLE {
            whole += 1.0;
            rest = 0.0;
        }
        let q = whole as usize;
        let single = rest < NEGLIGIBLE;
        let narrow = single || 2.0 * rest < even.step;
        let widest = 2 * q + if narrow { 2 } else { 3 };
        let before = q + 2;
        self.unroll(before, before + widest, even.ring);
        // The sector of position i is at i + before.
        if single {
            smallest(path, &self.minima, &mut self.spare, 2 * q + 1, before - q, between, count);
            return 0.0;
        }
        smallest(path, &self.minima, &mut self.spare, 2 * q + 2, before - q - 1, about, count);
        let (size, first) = if narrow { (2 * q + 1, before - q) } else { (2 * q + 3, before - q - 1) };
        smallest(path, &self.minima, &mut self.spare, size, first, between, count);
        rest.min(even.step - rest)
    }

    /// Puts the sectors in a row, with more before the first and behind the last: round the ring, or showing nothing.
    fn unroll(&mut self, before: usize, behind: usize, ring: bool) {
        let count = self.rho.len();
        self.minima.clear();
        if !ring {
            self.minima.resize(before, 0.0);
            self.minima.extend_from_slice(&self.rho);
            self.minima.resize(before + count + behind, 0.0);
            return;
        }
        let mut at = (count - before % count) % count;
        let mut left = before + count + behind;
        while left > 0 {
            let taken = left.min(count - at);
            self.minima.extend_from_slice(&self.rho[at..][..taken]);
            left -= taken;
            at = 0;
        }
    }
}

/// A half width that is more than whole steps by less is taken for whole steps, radians: `4 u` with `u = 2^-24`, which counts in
/// the slack of single precision ([`super::frame`]). So the rounding of a bound that was meant to be whole steps does not
/// double the pieces.
const NEGLIGIBLE: f64 = 1.0 / (1 << 22) as f64;

impl GapRule {
    fn gap(&self, steps: usize) -> Gap {
        let kappa = kappa(steps as f64 * self.step + self.wider, core_math::tan(0.5 * self.beam_opening).next_down());
        if kappa == f64::INFINITY {
            return Gap { shrink: 0.0, wide: 0.0 };
        }
        let shrink = (1.0 - 2.0 * LAMBDA * kappa).max(0.0);
        let wide = if kappa > 0.0 {
            ((self.width * shrink + self.beam_diameter) / (2.0 * kappa) * self.scale) as f32
        } else {
            UNBOUNDED
        };
        Gap { shrink: shrink as f32, wide: wide.min(UNBOUNDED) }
    }
}

#[inline(always)]
fn smaller(a: f32, b: f32) -> f32 {
    if a < b { a } else { b }
}

#[inline(always)]
fn bounded(m: f32, shrink: f32, rim: f32, wide: f32) -> f32 {
    let rho = smaller(smaller(m, m * shrink + rim), wide);
    if rho > 0.0 { rho } else { 0.0 }
}

on_each_path! {
    fn read(ranges: &[f32], reader: &Reader, near: &mut [f32], far: &mut [f32]) {
        for ((range, near), far) in ranges.iter().zip(near).zip(far) {
            let r = *range;
            let returned = (r > 0.0) & (r >= reader.range_min) & (r < reader.range_max);
            let least = r * reader.scale_near - reader.minus;
            let least = if least > 0.0 { least } else { 0.0 };
            let other = if r >= reader.range_max { reader.free_to } else { NOTHING };
            *near = if returned { least } else { other };
            *far = if returned { r * reader.scale_far + reader.plus } else { NOTHING };
        }
    }
}

on_each_path! {
    fn bits_of_returns(far: &[f32], words: &mut [u64]) {
        for (word, far) in words.iter_mut().zip(far.chunks(64)) {
            *word = far.iter().enumerate().fold(0, |word, (i, far)| word | u64::from(*far >= 0.0) << i);
        }
    }
}

on_each_path! {
    /// `rho` of every sector as if the beams at its two sides were usable.
    fn sector_radii(near: &[f32], shrink: f32, rim: f32, wide: f32, rho: &mut [f32]) {
        for ((low, high), rho) in near.iter().zip(&near[1..]).zip(rho) {
            *rho = bounded(smaller(*low, *high), shrink, rim, wide);
        }
    }
}

on_each_path! {
    fn largest(values: &[f32]) -> f32 {
        // None is negative, and the bits of such floats are in their order.
        f32::from_bits(values.iter().fold(0, |most, value| most.max(value.to_bits())))
    }
}

on_each_path! {
    /// Every value or the one `step` further, whichever is smaller.
    fn pairwise(values: &[f32], step: usize, out: &mut [f32]) {
        for ((low, high), out) in values.iter().zip(&values[step..]).zip(out) {
            *out = smaller(*low, *high);
        }
    }
}

/// The smallest of each `size` values from `first + i` on, for `i` in `0..count`.
fn smallest(
    path: Path,
    values: &[f32],
    spare: &mut [Vec<f32>; 2],
    size: usize,
    first: usize,
    out: &mut Vec<f32>,
    count: usize,
) {
    // The smallest of 2^n values are those of twice 2^(n - 1); two overlapping runs of 2^n have any size up to twice that.
    let mut run = 1;
    let [now, next] = spare;
    now.clear();
    now.extend_from_slice(values);
    while 2 * run <= size {
        next.resize(now.len() - run, 0.0);
        pairwise(path, now, run, next);
        std::mem::swap(now, next);
        run *= 2;
    }
    out.resize(count, 0.0);
    pairwise(path, &now[first..][..count + size - run], size - run, out);
}

/// The first position from `from` on whose bit is 1.
fn next_one(words: &[u64], from: usize, count: usize) -> Option<usize> {
    let mut at = from / 64;
    let mut word = words.get(at)? & u64::MAX << (from % 64);
    while word == 0 {
        at += 1;
        word = *words.get(at)?;
    }
    Some(at * 64 + word.trailing_zeros() as usize).filter(|at| *at < count)
}

/// The first position from `from` on whose bit is 0.
fn next_zero(words: &[u64], from: usize, count: usize) -> Option<usize> {
    let mut at = from / 64;
    let mut word = !words.get(at)? & u64::MAX << (from % 64);
    while word == 0 {
        at += 1;
        word = !*words.get(at)?;
    }
    Some(at * 64 + word.trailing_zeros() as usize).filter(|at| *at < count)
}

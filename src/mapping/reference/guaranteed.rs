//! The rule `guaranteed` for a whole box, model section 4, "Rule", as it is written.

use super::paper::corners;
use super::{LAMBDA, Ray, Reference};
use crate::interval::{Box2, Interval};
use std::f64::consts::{FRAC_PI_2, PI, TAU};

impl Reference<'_> {
    /// Is a box guaranteed empty by the rule for whole boxes, or by the robot's footprint (A5)?
    ///
    /// Beams that failed are always skipped. A run of beams without a return is used with `d- = F`, beam by beam, or
    /// skipped as a whole. The largest distance `r` of condition 2 is that of the part of `D` within the bracket's window.
    #[must_use]
    pub fn proves(&self, leaf: &Box2) -> bool {
        self.is_in_footprint(leaf) || self.brackets_prove(leaf)
    }

    fn brackets_prove(&self, leaf: &Box2) -> bool {
        if self.rays.is_empty() {
            return false;
        }
        let origins = self.origins();
        let d = Box2::new(leaf.x - origins.x, leaf.y - origins.y);
        let error = self.scan.sensor().spec().beam_angle_error;
        let beta = d.y.atan2(d.x) - self.headings() + Interval::spanning(-error, error);
        if d.contains(0.0, 0.0) || beta.width() >= TAU {
            return self.holds_all_round(&d);
        }
        // Places count through the sorted beams four times round; beta is turned so that it begins in the second round.
        let first = self.rays[0].angle;
        let turn = ((beta.lo() - first) / TAU).floor() - 1.0;
        let (lo, hi) = (beta.lo() - turn * TAU, beta.hi() - turn * TAU);
        let places = 0..4 * self.rays.len();
        let Some(start) = places.rev().find(|place| self.angle(*place) <= lo) else { return false };
        // A run without returns in which beta begins may be skipped from the return before it.
        let before = (0..=start).rev().take(self.rays.len()).find(|place| self.ray(*place).is_return);
        self.leads_through(&[Some(start), before], |place| self.angle(place) >= hi, &d)
    }

    /// Brackets that hold all the way round.
    fn holds_all_round(&self, d: &Box2) -> bool {
        let start = self.rays.iter().position(|ray| ray.is_return).unwrap_or(0);
        self.leads_through(&[Some(start)], |place| place == start + self.rays.len(), d)
    }

    /// Is there a chain of brackets that hold, from one of the starts to a place that is the goal?
    fn leads_through(&self, starts: &[Option<usize>], is_goal: impl Fn(usize) -> bool, d: &Box2) -> bool {
        let Some(first) = starts.iter().flatten().min().copied() else { return false };
        let mut reached = vec![false; 4 * self.rays.len()];
        let mut last_return = None;
        for place in first..reached.len() {
            reached[place] = starts.contains(&Some(place))
                || (place > first && reached[place - 1] && self.bracket_holds(place - 1, place, d))
                || last_return.is_some_and(|from: usize| {
                    let skips = from + 1 < place && self.ray(place).is_return;
                    skips && reached[from] && self.bracket_holds(from, place, d)
                });
            if reached[place] && is_goal(place) {
                return true;
            }
            if self.ray(place).is_return {
                last_return = Some(place);
            }
            if !reached[place] && last_return == Some(place) && starts.iter().flatten().all(|start| *start < place) {
                // Nothing leads past a return that is not reached.
                return false;
            }
        }
        false
    }

    fn ray(&self, place: usize) -> &Ray {
        &self.rays[place % self.rays.len()]
    }

    fn angle(&self, place: usize) -> f64 {
        self.ray(place).angle + TAU * (place / self.rays.len()) as f64
    }

    /// Conditions 1 to 3 for the bracket of two places, the beams between them skipped.
    fn bracket_holds(&self, j: usize, k: usize, d: &Box2) -> bool {
        let spec = self.scan.sensor().spec();
        let nearest = d.x.mignitude().hypot(d.y.mignitude());
        let Some(motion) = self.motion(self.ray(j), self.ray(k), nearest) else { return false };
        let widened = spec.beam_angle_error + motion;
        let step = (self.angle(k) - self.angle(j)).max(0.0);
        let h = 0.5 * (step + 2.0 * spec.beam_angle_error + motion);
        if h > FRAC_PI_2 {
            return false;
        }
        let window = Interval::spanning(self.angle(j) - widened, self.angle(j) + step + widened) + self.headings();
        let Some(mut r) = farthest_in_window(d, window) else { return true };
        if self.one_range {
            r = d.x.magnitude().hypot(d.y.magnitude());
        }
        let kappa = h.sin() - h.cos() * (0.5 * spec.beam_opening).tan();
        let disc = if 2.0 * r * kappa <= spec.beam_diameter {
            0.0
        } else {
            let denominator = 1.0 - 2.0 * LAMBDA * kappa;
            if denominator <= 0.0 {
                return false;
            }
            (2.0 * r * kappa - spec.beam_diameter) / denominator
        };
        disc <= self.min_obstacle_width && self.ray(j).near.min(self.ray(k).near) > r + LAMBDA * disc
    }

    /// A1: how far directions to points at `nearest` metres or farther may turn between two beams, radians; `None` when
    /// nothing bounds it. The sensor moves between the beams by at most twice their even share of the sweep, which covers
    /// a constant acceleration from rest; the seam of a full circle lies between the first and the last beam fired.
    pub(super) fn motion(&self, j: &Ray, k: &Ray, nearest: f64) -> Option<f64> {
        let (spec, share) = (self.scan.spec(), self.share(j, k));
        let translation = share * spec.sweep_translation;
        if translation == 0.0 {
            return Some(share * spec.sweep_rotation);
        }
        let ratio = translation / (nearest - self.min_obstacle_width);
        (0.0..=1.0).contains(&ratio).then(|| share * spec.sweep_rotation + ratio.asin())
    }

    /// The largest part of the sweep's motion that can lie between two beams.
    pub(super) fn share(&self, j: &Ray, k: &Ray) -> f64 {
        let apart = j.index.abs_diff(k.index) as f64;
        let gaps = self.scan.beams().saturating_sub(1) as f64;
        if 2.0 * apart >= gaps { 1.0 } else { 2.0 * apart / gaps }
    }
}

/// The largest distance of the part of a box whose direction lies in a window; `None` when there is no such part.
fn farthest_in_window(d: &Box2, window: Interval) -> Option<f64> {
    let mut part = corners(d).to_vec();
    if window.width() < PI {
        // The wedge is convex: cut the box at both its sides, and at the line across its back for the thinnest ones.
        let (lo, hi, mid) = (window.lo().sin_cos(), window.hi().sin_cos(), window.mid().sin_cos());
        part = cut(&part, |(x, y)| lo.1 * y - lo.0 * x);
        part = cut(&part, |(x, y)| hi.0 * x - hi.1 * y);
        part = cut(&part, |(x, y)| mid.1 * x + mid.0 * y);
    }
    part.iter().map(|(x, y)| x.hypot(*y)).max_by(f64::total_cmp)
}

/// The part of a convex polygon where a linear function is not negative (up to a trillionth of its size).
fn cut(polygon: &[(f64, f64)], value: impl Fn((f64, f64)) -> f64) -> Vec<(f64, f64)> {
    let size = polygon.iter().map(|(x, y)| x.abs().max(y.abs())).fold(0.0, f64::max);
    let value = |p: (f64, f64)| value(p) + 1e-12 * size;
    let mut part = Vec::with_capacity(polygon.len() + 1);
    for (i, &p) in polygon.iter().enumerate() {
        let q = polygon[(i + 1) % polygon.len()];
        let (at_p, at_q) = (value(p), value(q));
        if at_p >= 0.0 {
            part.push(p);
        }
        if (at_p < 0.0) != (at_q < 0.0) {
            let t = at_p / (at_p - at_q);
            part.push((p.0 + t * (q.0 - p.0), p.1 + t * (q.1 - p.1)));
        }
    }
    part
}

//! The free star of one scan: how far from the sensor, direction by direction, no obstacle point can be.
//!
//! This is the rule of model section 4 in its pointwise form. For a bracket `(j, k)` of successive usable beams with
//! half angle `h`, every point in the wedge between their axes and nearer than
//!
//! ```text
//! kappa = sin h - cos h tan(phi_b / 2)        D = max(0, 1 - 2 lambda kappa)        m = min(d_j-, d_k-)
//! rho = min( m                      if 2 m kappa <= w_b, else m D + lambda w_b (with D = 0: w_b / (2 kappa)),
//!            (s D + w_b) / (2 kappa)   if kappa > 0 )
//! ```
//!
//! is free at that pose: condition 2 asks `s' = max(0, (2 r kappa - w_b) / D) <= s` and condition 3 `r + lambda s' < m`, and
//! both bounds are these solved for `r`. For an uncertain heading the smallest `rho` within its half width counts in
//! every direction ([`super::envelope`]).

use super::Fault;
use super::directions::Directions;
use crate::sensor::{Reading, Scan};
use std::f64::consts::{FRAC_1_SQRT_2, FRAC_PI_2, TAU};

/// lambda of assumption A4.
pub(super) const LAMBDA: f64 = FRAC_1_SQRT_2;

/// Slack on `kappa`, times `1 + tan(phi_b / 2)`, since it may change as fast as that with the angle; and, relative to the
/// distances, on `rho`. Angles are at most 1e3 rad, so an angle `min + i * increment`
/// is off by at most 2^-43, half a gap and its sine by at most 2^-42; the further operations are a few units of 2^-53.
const SLACK: f64 = 1.0 / (1u64 << 40) as f64;

/// A wedge between two successive usable beams, in ascending angle.
#[derive(Debug, Clone, Copy)]
pub(super) struct Bracket {
    /// Position of the lower beam in ascending order ([`Directions`]).
    pub low: u32,
    /// Position of the upper beam.
    pub high: u32,
    /// Angle of the lower axis, radians in the sensor frame.
    pub start: f64,
    /// Angle of the upper axis, `>= start`; beyond the lower one by up to 2 pi.
    pub end: f64,
    /// Within this distance of the sensor the wedge is free, metres.
    pub rho: f64,
    /// How far the wedge is widened on both sides by the sensor's motion between its two beams, radians.
    pub motion: f64,
}

/// Gaps that differ by no more are taken as one, radians: a quarter of the slack on `kappa`, which changes no faster.
const SAME_GAP: f64 = 0.25 * SLACK;

/// The usable beams of a scan in ascending angle and the brackets between them.
#[derive(Debug, Default)]
pub(super) struct Star {
    usable: Vec<Usable>,
    pub(super) brackets: Vec<Bracket>,
}

#[derive(Debug, Clone, Copy)]
struct Usable {
    position: u32,
    near: f64,
    returned: bool,
}

/// What the brackets of one scan have in common.
struct Rule {
    width: f64,
    beam_diameter: f64,
    tan_half_opening: f64,
    angle_error: f64,
    rotation: f64,
    translation: f64,
    /// Points nearer are not shown, so that the motion's angle has a bound; metres.
    nearest: f64,
    beams: usize,
    fault: Fault,
    /// The last gap and its kappa: most gaps of a scan are equal.
    last: (f64, f64),
}

impl Star {
    /// Finds the brackets; `readings` are by position. `min_obstacle_width` is `s`, metres. Only points at least `nearest` metres from the sensor
    /// are shown (0 unless the sensor moves during the sweep).
    pub(super) fn build(
        &mut self,
        scan: &Scan,
        readings: &[Reading],
        directions: &Directions,
        min_obstacle_width: f64,
        nearest: f64,
        fault: Fault,
    ) {
        self.collect(scan, readings, fault);
        self.brackets.clear();
        if self.usable.len() < 2 {
            return;
        }
        let sensor = scan.sensor().spec();
        let mut rule = Rule {
            width: min_obstacle_width,
            beam_diameter: sensor.beam_diameter,
            tan_half_opening: core_math::tan(0.5 * sensor.beam_opening).next_down(),
            angle_error: sensor.beam_angle_error,
            rotation: scan.spec().sweep_rotation,
            translation: super::sensor_translation(scan),
            nearest,
            beams: scan.beams(),
            fault,
            last: (f64::INFINITY, f64::INFINITY),
        };
        for i in 0..self.usable.len() {
            let next = if i + 1 == self.usable.len() { 0 } else { i + 1 };
            let bracket = rule.bracket(self.usable[i], self.usable[next], directions);
            self.brackets.push(bracket);
        }
        self.skip_no_returns(&mut rule, directions);
    }

    /// Usable beams in ascending angle: returns, and beams without one that are free to a declared distance.
    fn collect(&mut self, scan: &Scan, readings: &[Reading], fault: Fault) {
        self.usable.clear();
        let free_to = scan.sensor().no_return_free_to();
        for (position, reading) in readings.iter().enumerate() {
            let (near, returned) = match *reading {
                Reading::Return { near, .. } => (near, true),
                Reading::NoReturn => match free_to {
                    Some(free_to) => (free_to, false),
                    None => continue,
                },
                Reading::Failed => continue,
            };
            self.usable.push(Usable { position: position as u32, near, returned });
        }
        if fault == Fault::SkipShortReturns && self.usable.len() > 3 {
            // Taken out of the star while its neighbours still count as neighbours. (With the gap widened to what is
            // left, a skipped return costs nothing: under A4 what it saw shows in one of the two beams about it.)
            let all = self.usable.clone();
            for (i, beam) in self.usable.iter_mut().enumerate() {
                let (before, after) = (all[(i + all.len() - 1) % all.len()], all[(i + 1) % all.len()]);
                beam.near = beam.near.max(before.near.min(after.near));
            }
        }
    }

    /// A run of beams without a return may be used or be skipped; both show what they show, so the larger `rho` counts.
    /// Skipping a part of a run shows nothing more: such a bracket still ends at a beam of the run, at a wider angle.
    ///
    /// When the sensor moves along, a point's distance differs between the beams by up to the way. Let the run be skipped
    /// for a point that is nearer than the skipping bracket's `rho` from everywhere. For another point, every distance is at
    /// least that `rho` less the way, so a distance below the larger of the two is below the `rho` of the beams used.
    fn skip_no_returns(&mut self, rule: &mut Rule, directions: &Directions) {
        let count = self.usable.len();
        let Some(first) = self.usable.iter().position(|beam| beam.returned) else { return };
        let mut i = first;
        while i < first + count {
            let run = (1..=count).take_while(|step| !self.usable[(i + step) % count].returned).count();
            if run > 0 {
                let skipping = rule.bracket(self.usable[i % count], self.usable[(i + run + 1) % count], directions);
                for step in 0..=run {
                    let bracket = &mut self.brackets[(i + step) % count];
                    bracket.rho = bracket.rho.max(skipping.rho - rule.translation);
                }
            }
            i += run + 1;
        }
    }
}

impl Rule {
    fn bracket(&mut self, low: Usable, high: Usable, directions: &Directions) -> Bracket {
        let start = directions.angle(low.position as usize);
        let mut end = directions.angle(high.position as usize);
        if high.position <= low.position {
            end = (end + TAU).max(start);
        }
        let motion = self.motion(directions.beam(low.position as usize), directions.beam(high.position as usize));
        let rho = self.rho(end - start + motion + 2.0 * self.angle_error, low.near.min(high.near));
        Bracket { low: low.position, high: high.position, start, end, rho, motion }
    }

    /// `m` of assumption A1 between two beams given in firing order, radians. Their poses are at most twice their even
    /// share of the sweep apart, which covers a constant acceleration from rest; over the seam of a full circle, between
    /// the first and the last beam fired, it is the whole sweep.
    fn motion(&self, a: usize, b: usize) -> f64 {
        if self.rotation == 0.0 && self.translation == 0.0 {
            return 0.0;
        }
        let share = (2.0 * a.abs_diff(b) as f64 / (self.beams - 1).max(1) as f64).min(1.0);
        let mut motion = share * self.rotation;
        if self.translation > 0.0 {
            let ratio = share * self.translation / (self.nearest - self.width);
            // Past 1 there is no bound, and a gap of more than pi shows nothing.
            motion += if (0.0..1.0).contains(&ratio) { core_math::asin(ratio) } else { TAU };
        }
        motion + SLACK
    }

    /// The bound on the distance for a gap between two axes (radians) and `m = min(d_j-, d_k-)` (metres).
    fn rho(&mut self, gap: f64, m: f64) -> f64 {
        // Equal steps differ by rounding alone, which the slack on kappa covers.
        if (self.last.0 - gap).abs() > SAME_GAP {
            self.last = (gap, kappa(gap, self.tan_half_opening));
        }
        let kappa = self.last.1;
        if kappa == f64::INFINITY || m <= 0.0 {
            return 0.0;
        }
        let shrink = (1.0 - 2.0 * LAMBDA * kappa).max(0.0);
        let mut rho = m;
        if kappa > 0.0 {
            let wide = (self.width * shrink + self.beam_diameter) / (2.0 * kappa);
            rho = match self.fault {
                Fault::SlackInCondition2 => rho.min(wide * 1.02),
                _ => rho.min(wide),
            };
            if 2.0 * m * kappa > self.beam_diameter && self.fault != Fault::IgnoreLambda {
                rho = rho.min(m * shrink + LAMBDA * self.beam_diameter);
            }
        }
        (rho - SLACK * m).max(0.0)
    }
}

/// `kappa` of condition 2 for a gap between two axes (radians), rounded up; infinite beyond half a turn. `tan_half_opening`
/// is `tan(phi_b / 2)`, rounded down.
pub(super) fn kappa(gap: f64, tan_half_opening: f64) -> f64 {
    let half = 0.5 * gap;
    // Just past pi/2 by rounding is pi/2: sine and cosine change by less than the slack.
    if half > FRAC_PI_2 * (1.0 + 1e-15) {
        return f64::INFINITY;
    }
    let (sin, cos) = (core_math::sin(half), core_math::cos(half));
    sin - cos * tan_half_opening + SLACK * (1.0 + tan_half_opening)
}

//! The evidence of one scan: X_OCC and X_EMP as sets of leaves.
//!
//! A scan is drawn once, as a whole, on a canvas of one bit a leaf. The rule `guaranteed` draws the boundary of the free
//! star ([`star`], [`envelope`]) as a polygon whose edges are dilated by the box of the sensor's origins: a leaf is proven
//! when it is off that boundary and inside by parity, since a leaf dilated by the box is connected and does not cross
//! the polygon. The paper's rules draw the cones of single beams ([`cones`]).

mod canvas;
mod cones;
mod directions;
mod envelope;
mod frame;
mod polygon;
mod raster;
mod star;

use super::config::MAX_REACH_CELLS;
use super::{EvidenceRule, MapConfig};
use crate::interval::{Box2, Interval};
use crate::quadtree::LeafMasks;
use crate::sensor::{Reading, Scan};
use canvas::{BOUNDARY, Canvas};
use cones::{Cones, Footprint};
use directions::Directions;
use envelope::Envelope;
use frame::Frame;
use raster::{Disc, cover};
use star::Star;

/// Distances from the sensor, beyond the obstacle width, behind which points are shown when the sensor moves along
/// during the sweep (assumption A1: the nearer a point, the more the motion turns its direction); metres. Each is drawn by
/// itself and what any of them shows is shown.
const NEAREST: [f64; 4] = [0.25, 1.0, 4.0, 16.0];

/// A fault to plant in the rule, so that tests can show that they would find it.
#[doc(hidden)]
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Fault {
    /// The rule as it is.
    #[default]
    None,
    /// Condition 2 with 2 % slack.
    SlackInCondition2,
    /// `d-` compared with `r` alone.
    IgnoreLambda,
    /// The heading reduced to its midpoint.
    HeadingMidpoint,
    /// The position reduced to its midpoint.
    PositionMidpoint,
    /// Beams skipped although they were short, as if those about them were neighbours.
    SkipShortReturns,
}

/// Computes the evidence of scans; holds scratch memory and tables, so keep one a thread and use it again.
#[derive(Debug, Default)]
pub struct Surveyor {
    canvas: Canvas,
    directions: Directions,
    /// What the beams say, in ascending angle.
    readings: Vec<Reading>,
    star: Star,
    envelope: Envelope,
    vertices: polygon::Vertices,
    fault: Fault,
}

impl Surveyor {
    /// A surveyor with no scratch memory yet.
    #[must_use]
    pub fn new() -> Self {
        Self::default()
    }

    /// A surveyor with a planted fault, for tests only.
    #[doc(hidden)]
    #[must_use]
    pub fn with_fault(fault: Fault) -> Self {
        Self { fault, ..Self::default() }
    }

    /// The leaf sets X_OCC (7) and X_EMP of a scan by the map's evidence rule, held to the root, `X_EMP := X_EMP \ X_OCC`.
    /// Does not look at a map: the same configuration and scan give the same sets.
    pub fn survey(&mut self, config: &MapConfig, scan: &Scan) -> LeafMasks {
        self.directions.prepare(scan);
        self.readings.clear();
        self.readings.extend((0..scan.beams()).map(|position| scan.reading(self.directions.beam(position))));
        let reach = reach(config, scan, self.readings.iter().copied());
        if !meets_root(config, scan, reach) {
            return LeafMasks::default();
        }
        let frame = Frame::new(config.grid(), scan, reach);
        self.canvas.begin(frame.base, frame.size);
        if config.rule() == EvidenceRule::Guaranteed {
            self.draw_free(config, scan, &frame);
        }
        self.draw_beams(config.rule(), scan, &frame);
        self.canvas.masks(config.grid().depth())
    }

    /// True when the scan can say something about some leaf of the map: false when all that it can reach is outside
    /// the root.
    #[must_use]
    pub fn reaches(config: &MapConfig, scan: &Scan) -> bool {
        meets_root(config, scan, reach(config, scan, (0..scan.beams()).map(|beam| scan.reading(beam))))
    }

    /// Draws the free star (model section 4) and the robot's footprint.
    fn draw_free(&mut self, config: &MapConfig, scan: &Scan, frame: &Frame) {
        let spec = scan.spec();
        if sensor_translation(scan) > 0.0 {
            for behind in NEAREST {
                let nearest = config.min_obstacle_width() + behind;
                self.draw_star(config, scan, frame, nearest);
                let disc = Disc { center: frame.origin, radius: nearest * frame.scale };
                cover::<BOUNDARY>(&mut self.canvas, &disc, frame.dilation());
                self.canvas.keep_star();
            }
        } else {
            self.draw_star(config, scan, frame, 0.0);
        }
        if spec.footprint_radius > 0.0 {
            let (center, half) = frame.locate(scan.pose().x(), scan.pose().y());
            let radius = (spec.footprint_radius * frame.scale).min(MAX_REACH_CELLS);
            Footprint { center, half, radius }.draw(&mut self.canvas, 2.0 * frame.slack);
        }
    }

    fn draw_star(&mut self, config: &MapConfig, scan: &Scan, frame: &Frame, nearest: f64) {
        let mut frame = *frame;
        match self.fault {
            Fault::HeadingMidpoint => frame.heading.1 = 0.0,
            Fault::PositionMidpoint => frame.spread = (0.0, 0.0),
            _ => {}
        }
        self.star.build(scan, &self.readings, &self.directions, config.min_obstacle_width(), nearest, self.fault);
        let half_width = frame.heading.1 + scan.sensor().spec().beam_angle_error;
        self.envelope.build(&self.star.brackets, half_width, sensor_translation(scan));
        self.vertices.draw(&mut self.canvas, &frame, &self.directions, &self.envelope.pieces, half_width);
    }

    /// Draws what single beams say: X_OCC, and the cones of the paper's rules.
    fn draw_beams(&mut self, rule: EvidenceRule, scan: &Scan, frame: &Frame) {
        let cones = Cones::new(frame, scan.sensor());
        let (sin, cos) = (core_math::sin(frame.heading.0), core_math::cos(frame.heading.0));
        for position in 0..scan.beams() {
            let (x, y) = self.directions.unit(position);
            let unit = (cos * x - sin * y, sin * x + cos * y);
            let near = match self.readings[position] {
                Reading::Return { near, far } => {
                    cones.measurement(&mut self.canvas, unit, near, far);
                    near
                }
                Reading::NoReturn => match scan.sensor().no_return_free_to() {
                    Some(free_to) => free_to,
                    None => continue,
                },
                Reading::Failed => continue,
            };
            match rule {
                _ if near <= 0.0 => {}
                EvidenceRule::Guaranteed => {}
                EvidenceRule::Outer => cones.outer(&mut self.canvas, unit, near),
                EvidenceRule::Inner => cones.inner(&mut self.canvas, unit, near),
            }
        }
    }
}

/// True when some point within `reach` metres of the sensor may lie in the root.
fn meets_root(config: &MapConfig, scan: &Scan, reach: f64) -> bool {
    let origins = scan.origins();
    let around = Interval::around(0.0, reach + 2.0 * config.grid().resolution());
    config.grid().bounds().meets(Box2::new(origins.x + around, origins.y + around))
}

/// How far the sensor moves over a sweep, metres, rounded up: along with the robot, and, where it is not mounted at the
/// robot's origin, on an arc about that as the robot turns.
fn sensor_translation(scan: &Scan) -> f64 {
    let (spec, mount) = (scan.spec(), scan.sensor().spec().mount);
    (spec.sweep_translation + spec.sweep_rotation * mount.x.hypot(mount.y)) * (1.0 + 1e-12)
}

/// How far from the sensor's origin a scan can say something, metres: the farthest point of a measurement set, with its
/// width and the turn of the heading, or the footprint about the robot.
fn reach(config: &MapConfig, scan: &Scan, readings: impl Iterator<Item = Reading>) -> f64 {
    let sensor = scan.sensor().spec();
    let farthest = readings.map(|reading| match reading {
        Reading::Return { far, .. } => far,
        Reading::NoReturn => scan.sensor().no_return_free_to().unwrap_or(0.0),
        Reading::Failed => 0.0,
    });
    // Half width at most d sin(phi_b / 2) + w_b / 2, once more turned aside: below 2 d + w_b beyond d.
    let beams = farthest.fold(0.0, f64::max);
    let wide = 0.5 * sensor.beam_opening + scan.headings().radius() + sensor.beam_angle_error;
    let aside = 2.0 * beams * core_math::sin(wide.min(std::f64::consts::FRAC_PI_2)) + sensor.beam_diameter;
    let mount = sensor.mount.x.hypot(sensor.mount.y);
    let footprint = MAX_REACH_CELLS * config.grid().resolution();
    (beams + aside).max(scan.spec().footprint_radius.min(footprint) + 2.0 * mount)
}

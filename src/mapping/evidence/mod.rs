//! The evidence of one scan: X_OCC and X_EMP as sets of leaves.
//!
//! A scan is drawn once, as a whole, on a canvas of one bit a leaf. The rule `guaranteed` draws the boundary of the free
//! star ([`star`], [`envelope`]) as a polygon whose edges are dilated by the box of the sensor's origins: a leaf is proven
//! when it is off that boundary and inside by parity, since a leaf dilated by the box is connected and does not cross
//! the polygon. The paper's rules draw the cones of single beams ([`cones`]).

mod canvas;
mod cones;
mod dense;
mod directions;
mod edges;
mod envelope;
mod frame;
mod outline;
mod polygon;
mod raster;
mod returns;
mod sectors;
mod sheet;
mod star;
mod window;

use super::config::{MAX_REACH_CELLS, MAX_SPREAD_CELLS};
use super::{EvidenceRule, MapConfig};
use crate::interval::{Box2, Interval};
use crate::quadtree::LeafMasks;
use crate::sensor::{Reading, Scan, ScanError};
use crate::vector::Path;
use canvas::Canvas;
use cones::{ConeTrig, Cones, Footprint};
use dense::{Dense, StarSpec};
use directions::Directions;
use envelope::Envelope;
use frame::Frame;
use raster::{Disc, cover};
use sheet::{BOUNDARY, Sheet};
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
    path: Path,
    dense: Dense,
    canvas: Canvas,
    scratch: Scratch,
    /// What the beams say, in ascending angle.
    readings: Vec<Reading>,
    directions: Directions,
    fault: Fault,
    /// Never a dense window.
    wide: bool,
}

/// Stars of scans of any kind, in double precision.
#[derive(Debug, Default)]
struct Scratch {
    star: Star,
    envelope: Envelope,
    vertices: polygon::Vertices,
    trig: ConeTrig,
}

impl Surveyor {
    /// A surveyor with no scratch memory yet, on the machine's fastest path.
    #[must_use]
    pub fn new() -> Self {
        Self::default()
    }

    /// A surveyor on a path of this machine. All paths compute the same sets.
    #[must_use]
    pub fn on(path: Path) -> Self {
        Self { path, ..Self::default() }
    }

    /// A surveyor that draws every scan on a window of any size, as it does those that reach beyond a dense one: so that tests
    /// need no scans of thousands of leaves.
    #[doc(hidden)]
    #[must_use]
    pub fn without_dense_windows() -> Self {
        Self { wide: true, ..Self::default() }
    }

    /// Bytes of the dense window: none before the first drawing, since surveyors are made to stand in for lent ones.
    #[doc(hidden)]
    #[must_use]
    pub fn window_bytes(&self) -> usize {
        self.dense.window.bytes()
    }

    /// A surveyor with a planted fault, for tests only.
    #[doc(hidden)]
    #[must_use]
    pub fn with_fault(fault: Fault) -> Self {
        Self { fault, ..Self::default() }
    }

    /// The leaf sets X_OCC (7) and X_EMP of a scan by the map's evidence rule, held to the root, `X_EMP := X_EMP \ X_OCC`.
    /// Does not look at a map: the same configuration and scan give the same sets. A scan that [`Surveyor::fits`] refuses says
    /// nothing.
    pub fn survey(&mut self, config: &MapConfig, scan: &Scan) -> LeafMasks {
        let mut masks = LeafMasks::default();
        self.survey_into(config, scan, &mut masks);
        masks
    }

    /// As [`Surveyor::survey`], into masks that are no longer wanted, whose memory is used again.
    pub fn survey_into(&mut self, config: &MapConfig, scan: &Scan, masks: &mut LeafMasks) {
        self.dense.window.recycle(masks);
        self.directions.prepare(scan);
        let reach = reach(config, scan);
        if !meets_root(config, scan, reach) || bounded(config, scan, reach).is_err() {
            return;
        }
        let frame = Frame::new(config.grid(), scan, reach);
        let depth = config.grid().depth();
        let moving = sensor_translation(scan) > 0.0;
        if self.wide || !frame.dense {
            self.read(scan);
            self.canvas.begin(frame.base, frame.size);
            let Self { canvas, scratch, readings, directions, fault, .. } = self;
            let mut drawing = Drawing { sheet: canvas, scratch, readings, directions, fault: *fault };
            drawing.draw(config, scan, &frame);
            *masks = self.canvas.masks(depth);
            return;
        }
        self.dense.window.begin(frame.base, frame.around());
        if moving || config.rule() != EvidenceRule::Guaranteed {
            self.read(scan);
            let Self { dense, scratch, readings, directions, fault, .. } = self;
            let mut drawing = Drawing { sheet: &mut dense.window, scratch, readings, directions, fault: *fault };
            drawing.draw(config, scan, &frame);
        } else {
            self.draw_dense(config, scan, &frame);
        }
        self.dense.window.emit(self.path, depth, masks);
    }

    /// Checks that a scan spreads over no more leaves of the map than one scan may cost.
    ///
    /// # Errors
    /// [`ScanError::TooManyLeaves`]: the box of the sensor's positions is wider than [`MAX_SPREAD_CELLS`] leaves (field `pose`),
    /// or, of a sensor that is not one of the configuration's, the ranges reach too far (field `ranges`).
    pub fn fits(config: &MapConfig, scan: &Scan) -> Result<(), ScanError> {
        bounded(config, scan, reach(config, scan))
    }

    /// True when the scan can say something about some leaf of the map: false when all that it can reach is outside
    /// the root.
    #[must_use]
    pub fn reaches(config: &MapConfig, scan: &Scan) -> bool {
        meets_root(config, scan, reach(config, scan))
    }

    fn read(&mut self, scan: &Scan) {
        self.readings.clear();
        self.readings.extend((0..scan.beams()).map(|position| scan.reading(self.directions.beam(position))));
    }

    /// Draws the evidence of the rule `guaranteed` in vectors, for a sensor that turns about itself at most.
    fn draw_dense(&mut self, config: &MapConfig, scan: &Scan, frame: &Frame) {
        self.dense.read(self.path, scan, &self.directions, frame);
        let of_star = self.fault.of_frame(frame);
        let half_width = of_star.heading.1 + scan.sensor().spec().beam_angle_error;
        let even = self.directions.even().filter(|_| self.fault.is_in_frame() && scan.spec().sweep_rotation == 0.0);
        let drawn = even.is_some_and(|even| {
            let spec = StarSpec { even, min_obstacle_width: config.min_obstacle_width(), half_width };
            self.dense.draw_even_star(self.path, scan, &self.directions, &of_star, &spec)
        });
        if !drawn {
            self.read(scan);
            let Scratch { star, envelope, vertices, .. } = &mut self.scratch;
            star.build(scan, &self.readings, &self.directions, config.min_obstacle_width(), 0.0, self.fault);
            envelope.build(&star.brackets, half_width, 0.0);
            self.dense.draw_star(self.path, vertices, &of_star, &self.directions, envelope, half_width);
        }
        draw_footprint(&mut self.dense.window, scan, frame);
        let cones = Cones::new(frame, scan.sensor(), &mut self.scratch.trig);
        let (sin, cos) = frame.turn;
        let directions = &self.directions;
        let alone = |window: &mut window::Window, position: usize| {
            let (x, y) = directions.unit(position);
            if let Reading::Return { near, far } = scan.reading(directions.beam(position)) {
                cones.measurement(window, (cos * x - sin * y, sin * x + cos * y), near, far);
            }
        };
        self.dense.draw_returns(self.path, &cones, frame, alone);
    }
}

impl Fault {
    /// True when the fault, if there is one, lies in the frame alone.
    fn is_in_frame(self) -> bool {
        matches!(self, Self::None | Self::HeadingMidpoint | Self::PositionMidpoint)
    }

    /// The frame that the star is drawn in.
    fn of_frame(self, frame: &Frame) -> Frame {
        let mut frame = *frame;
        match self {
            Self::HeadingMidpoint => frame.heading.1 = 0.0,
            Self::PositionMidpoint => frame.spread = (0.0, 0.0),
            _ => {}
        }
        frame
    }
}

/// One scan drawn row by row in double precision, on any sheet.
struct Drawing<'a, S> {
    sheet: &'a mut S,
    scratch: &'a mut Scratch,
    readings: &'a [Reading],
    directions: &'a Directions,
    fault: Fault,
}

impl<S: Sheet> Drawing<'_, S> {
    fn draw(&mut self, config: &MapConfig, scan: &Scan, frame: &Frame) {
        if config.rule() == EvidenceRule::Guaranteed {
            self.draw_free(config, scan, frame);
        }
        self.draw_beams(config.rule(), scan, frame);
    }

    /// Draws the free star (model section 4) and the robot's footprint.
    fn draw_free(&mut self, config: &MapConfig, scan: &Scan, frame: &Frame) {
        if sensor_translation(scan) > 0.0 {
            for behind in NEAREST {
                let nearest = config.min_obstacle_width() + behind;
                // Then no point of the star is beyond, and nothing is drawn farther away than the window was told.
                if nearest * frame.scale > frame.reach {
                    break;
                }
                self.draw_star(config, scan, frame, nearest);
                let disc = Disc { center: frame.origin, radius: nearest * frame.scale };
                cover::<BOUNDARY>(self.sheet, &disc, frame.dilation());
                self.sheet.keep_star();
            }
        } else {
            self.draw_star(config, scan, frame, 0.0);
        }
        draw_footprint(self.sheet, scan, frame);
    }

    fn draw_star(&mut self, config: &MapConfig, scan: &Scan, frame: &Frame, nearest: f64) {
        let frame = self.fault.of_frame(frame);
        let Scratch { star, envelope, vertices, .. } = &mut *self.scratch;
        star.build(scan, self.readings, self.directions, config.min_obstacle_width(), nearest, self.fault);
        let half_width = frame.heading.1 + scan.sensor().spec().beam_angle_error;
        envelope.build(&star.brackets, half_width, sensor_translation(scan));
        vertices.draw(self.sheet, &frame, self.directions, &envelope.pieces, half_width);
    }

    /// Draws what single beams say: X_OCC, and the cones of the paper's rules.
    fn draw_beams(&mut self, rule: EvidenceRule, scan: &Scan, frame: &Frame) {
        let cones = Cones::new(frame, scan.sensor(), &mut self.scratch.trig);
        let (sin, cos) = frame.turn;
        for position in 0..scan.beams() {
            let (x, y) = self.directions.unit(position);
            let unit = (cos * x - sin * y, sin * x + cos * y);
            let near = match self.readings[position] {
                Reading::Return { near, far } => {
                    cones.measurement(self.sheet, unit, near, far);
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
                EvidenceRule::Outer => cones.outer(self.sheet, unit, near),
                EvidenceRule::Inner => cones.inner(self.sheet, unit, near),
            }
        }
    }
}

fn draw_footprint(sheet: &mut impl Sheet, scan: &Scan, frame: &Frame) {
    let spec = scan.spec();
    if spec.footprint_radius > 0.0 {
        let (center, half) = frame.locate(scan.pose().x(), scan.pose().y());
        let radius = (spec.footprint_radius * frame.scale).min(MAX_REACH_CELLS);
        Footprint { center, half, radius }.draw(sheet, 2.0 * frame.slack);
    }
}

/// True when some point within `reach` metres of the sensor may lie in the root.
fn meets_root(config: &MapConfig, scan: &Scan, reach: f64) -> bool {
    let origins = scan.origins();
    let around = Interval::around(0.0, reach + 2.0 * config.grid().resolution());
    config.grid().bounds().meets(Box2::new(origins.x + around, origins.y + around))
}

/// Window coordinates must stay small ([`frame`]), and so must the sets, which all grow by the box of positions.
fn bounded(config: &MapConfig, scan: &Scan, reach: f64) -> Result<(), ScanError> {
    let origins = scan.origins();
    let wide = origins.x.width().max(origins.y.width());
    // A sensor of the configuration reaches three times its limit at most, rounding aside: with all that lies aside.
    let limits = [("pose", wide, MAX_SPREAD_CELLS), ("ranges", reach, 4.0 * MAX_REACH_CELLS)];
    for (field, metres, limit) in limits {
        let cells = metres / config.grid().resolution();
        // One part in 10^12 above is rounding of the sender's.
        if cells > limit * (1.0 + 1e-12) {
            return Err(ScanError::TooManyLeaves { field, cells, limit });
        }
    }
    Ok(())
}

/// How far the sensor moves over a sweep, metres, rounded up: along with the robot, and, where it is not mounted at the
/// robot's origin, on an arc about that as the robot turns.
fn sensor_translation(scan: &Scan) -> f64 {
    let (spec, mount) = (scan.spec(), scan.sensor().spec().mount);
    (spec.sweep_translation + spec.sweep_rotation * mount.x.hypot(mount.y)) * (1.0 + 1e-12)
}

/// How far from the sensor's origin a scan can say something, metres: the farthest point of a measurement set, with its
/// width and the turn of the heading, or the footprint about the robot.
fn reach(config: &MapConfig, scan: &Scan) -> f64 {
    let sensor = scan.sensor().spec();
    // Half width at most d sin(phi_b / 2) + w_b / 2, once more turned aside: below 2 d + w_b beyond d.
    let beams = scan.farthest();
    let wide = 0.5 * sensor.beam_opening + scan.headings().radius() + sensor.beam_angle_error;
    let aside = 2.0 * beams * core_math::sin(wide.min(std::f64::consts::FRAC_PI_2)) + sensor.beam_diameter;
    let mount = sensor.mount.x.hypot(sensor.mount.y);
    let footprint = MAX_REACH_CELLS * config.grid().resolution();
    (beams + aside).max(scan.spec().footprint_radius.min(footprint) + 2.0 * mount)
}

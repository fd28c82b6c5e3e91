//! Figures 1 to 3: measurement boxes, and the cells of a single beam, computed by the code that maps are made with.

use super::maps::Setup;
use crate::interval::Box2;
use crate::mapping::{EvidenceRule, Surveyor};
use crate::picture::{Colour, Drawing, INK, LINE, PAPER};
use crate::quadtree::{BLOCK_SIDE, BlockMasks, LeafMasks};
use crate::sensor::{
    Angles, BeamCone, MeasurementSet, PoseBox, PoseLimits, Scan, ScanLimits, ScanSpec, SensorModel, SensorSpec,
    apex_offset, natural_measurement_box,
};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::collections::BTreeMap;

const SET: Colour = [0, 90, 181];
const NATURAL: Colour = [220, 50, 32];
const TIGHT: Colour = [0, 130, 90];
const AXIS: Colour = [170, 170, 170];
const OCCUPIED: Colour = [40, 40, 40];
const INNER: Colour = [90, 180, 120];
const OUTER: Colour = [205, 235, 212];
const LATTICE: Colour = [225, 225, 225];

/// The measured range of the drawn beams and the heading, metres and radians.
const RANGE: f64 = 5.0;
const HEADING: f64 = 0.5;

/// Points drawn from a set.
const POINTS: usize = 4000;

/// A part of the plane `side` metres wide on so many pixels.
struct View {
    middle: (f64, f64),
    side: f64,
    pixels: u32,
    /// Of the middle's row.
    row: f64,
}

impl View {
    fn at(&self, (x, y): (f64, f64)) -> (f64, f64) {
        let scale = f64::from(self.pixels) / self.side;
        let half = 0.5 * f64::from(self.pixels);
        (half + (x - self.middle.0) * scale, self.row - (y - self.middle.1) * scale)
    }

    fn boxed(&self, drawing: &mut Drawing, area: &Box2, colour: Colour) {
        let (x, y) = (area.x, area.y);
        let corners = [(x.lo(), y.lo()), (x.hi(), y.lo()), (x.hi(), y.hi()), (x.lo(), y.hi())].map(|p| self.at(p));
        drawing.polygon(&corners, 2, colour);
    }
}

fn pose(position: f64, heading: f64) -> anyhow::Result<PoseBox> {
    let around = |v: f64, e: f64| (v - e, v + e);
    let limits = PoseLimits::default();
    Ok(PoseBox::new(around(0.0, position), around(0.0, position), around(HEADING, heading), &limits)?)
}

/// Points of (6) for an angle of the axis, the pose anywhere in its box.
fn draw_set(sensor: &SensorModel, pose: &PoseBox, angle: f64, random: &mut ChaCha8Rng) -> Vec<(f64, f64)> {
    let spec = sensor.spec();
    let mut within = |lo: f64, hi: f64| lo + (hi - lo) * random.random::<f64>();
    let one = |_| {
        let d = within(RANGE - spec.range_error_minus, RANGE + spec.range_error_plus);
        let (along, across) = if spec.beam_opening == 0.0 {
            (d, within(-0.5 * spec.beam_diameter, 0.5 * spec.beam_diameter))
        } else {
            let offset = apex_offset(spec.beam_opening, spec.beam_diameter);
            let tau = within(-0.5 * spec.beam_opening, 0.5 * spec.beam_opening);
            ((d + offset) * tau.cos() - offset, (d + offset) * tau.sin())
        };
        let (x, y) = (within(pose.x().lo(), pose.x().hi()), within(pose.y().lo(), pose.y().hi()));
        let (sin, cos) = (within(pose.theta().lo(), pose.theta().hi()) + angle).sin_cos();
        (x + along * cos - across * sin, y + along * sin + across * cos)
    };
    (0..POINTS).map(one).collect()
}

/// The sets of three neighbouring beams with the paper's box and the tight one about each.
fn boxes(title: &str, spec: SensorSpec, pose: &PoseBox, side: f64) -> anyhow::Result<Drawing> {
    const PIXELS: u32 = 430;
    let sensor = SensorModel::new(spec)?;
    let top = LINE + 4;
    let mut drawing = Drawing::new(PIXELS, PIXELS + top, PAPER);
    let (sin, cos) = HEADING.sin_cos();
    let row = f64::from(top) + 0.5 * f64::from(PIXELS);
    let view = View { middle: (RANGE * cos, RANGE * sin), side, pixels: PIXELS, row };
    let mut random = ChaCha8Rng::seed_from_u64(1);
    for step in [-1.0, 0.0, 1.0] {
        let angle = step * 1.5_f64.to_radians();
        let (sin, cos) = (HEADING + angle).sin_cos();
        drawing.line(view.at((4.0 * cos, 4.0 * sin)), view.at((RANGE * cos, RANGE * sin)), 1, AXIS);
        for point in draw_set(&sensor, pose, angle, &mut random) {
            let (x, y) = view.at(point);
            drawing.set(x as i64, y as i64, SET);
        }
        let (near, far) = (RANGE - spec.range_error_minus, RANGE + spec.range_error_plus);
        view.boxed(&mut drawing, &natural_measurement_box(pose, &sensor, angle, near, far), NATURAL);
        view.boxed(&mut drawing, &MeasurementSet::new(pose, &sensor, angle, near, far).hull, TIGHT);
    }
    drawing.fill((0, 0), (PIXELS, top), PAPER);
    drawing.text((0, 2), title, 1, INK);
    drawing.outline((0, i64::from(top)), (PIXELS, PIXELS), INK);
    let bar = (0.1 * f64::from(PIXELS) / side).round() as u32;
    let bottom = i64::from(PIXELS + top);
    drawing.fill((10, bottom - 14), (bar, 4), INK);
    drawing.text((16 + i64::from(bar), bottom - 16), "10 cm", 1, INK);
    Ok(drawing)
}

/// Figures 1 and 2: measurement sets without and with beam width, for an exact and for an uncertain pose.
///
/// # Errors
/// When the sensor or the pose error is refused.
pub fn measurement_boxes(sensor: &SensorSpec, position: f64, heading: f64) -> anyhow::Result<Drawing> {
    let thin = SensorSpec { beam_opening: 0.0, beam_diameter: 0.0, ..*sensor };
    let (exact, uncertain) = (pose(0.0, 0.0)?, pose(position, heading)?);
    let wide = 0.55 + 2.2 * (2.0 * position + 2.0 * heading * (RANGE + 3.0));
    let words = format!("+-{position} m, +-{:.2} deg", heading.to_degrees());
    let parts = [
        boxes("fig. 1: without width, exact pose", thin, &exact, 0.55)?,
        boxes("fig. 2: with width, exact pose", *sensor, &exact, 0.55)?,
        boxes(&format!("without width, {words}"), thin, &uncertain, wide)?,
        boxes(&format!("with width, {words}"), *sensor, &uncertain, wide)?,
    ];
    let mut whole = Drawing::beside(&parts, 2);
    let legend = [("points of the set (6)", SET), ("natural extension", NATURAL), ("tight enclosure", TIGHT)];
    whole = below(&whole, &legend);
    Ok(whole)
}

/// A drawing with a legend below.
fn below(drawing: &Drawing, legend: &[(&str, Colour)]) -> Drawing {
    let mut whole = Drawing::new(drawing.width(), drawing.height() + LINE + 6, PAPER);
    whole.place(drawing, (0, 0));
    let (mut x, y) = (10, i64::from(drawing.height()));
    for (word, colour) in legend {
        whole.fill((x, y), (14, 8), *colour);
        whole.outline((x, y), (14, 8), INK);
        whole.text((x + 20, y), word, 1, INK);
        x += i64::from(Drawing::text_width(word, 1)) + 44;
    }
    whole
}

/// Occupied and empty leaves.
type Sets = (BTreeMap<(u32, u32), ()>, BTreeMap<(u32, u32), ()>);

fn sets(masks: &LeafMasks) -> Sets {
    let (mut occupied, mut empty) = Sets::default();
    for (address, masks) in &masks.blocks {
        for y in 0..BLOCK_SIDE {
            for x in 0..BLOCK_SIDE {
                let leaf = (address.x * BLOCK_SIDE + x, address.y * BLOCK_SIDE + y);
                let (is_occupied, is_empty) = match masks {
                    BlockMasks::AllEmpty => (false, true),
                    BlockMasks::Some { occupied, empty } => {
                        (occupied[y as usize] >> x & 1 == 1, empty[y as usize] >> x & 1 == 1)
                    }
                };
                if is_occupied {
                    occupied.insert(leaf, ());
                }
                if is_empty {
                    empty.insert(leaf, ());
                }
            }
        }
    }
    (occupied, empty)
}

/// Figure 3: the leaves of one wide beam: occupied, empty by `inner`, empty by `outer`; for an exact and an uncertain pose.
///
/// # Errors
/// When numbers are refused.
pub fn single_beam() -> anyhow::Result<Drawing> {
    let parts = [
        beam_cells("exact pose", &pose(0.0, 0.0)?)?,
        beam_cells("+-0.01 m, +-0.5 deg", &pose(0.01, 0.5_f64.to_radians())?)?,
    ];
    let legend = [("occupied", OCCUPIED), ("empty, inner", INNER), ("empty, outer alone", OUTER), ("beam", SET)];
    Ok(below(&Drawing::beside(&parts, 2), &legend))
}

/// What figure 3's beam is: a width that shows, and small leaves.
fn wide_beam() -> SensorSpec {
    SensorSpec { beam_opening: 3.0_f64.to_radians(), beam_diameter: 0.06, ..SensorSpec::default() }
}

fn beam_cells(title: &str, pose: &PoseBox) -> anyhow::Result<Drawing> {
    const CELL: u32 = 7;
    const SIDE: u32 = 84;
    const ROWS: u32 = 54;
    const REACH: f64 = 1.5;
    let setup = Setup {
        resolution: 0.02,
        depth: 8,
        classes: 10,
        min_obstacle_width: 0.0,
        octomap: None,
        folder: std::path::PathBuf::new(),
    };
    let sensor = SensorModel::new(wide_beam())?;
    let spec = ScanSpec {
        pose: *pose,
        angles: Angles::Uniform { min: 0.0, increment: 1.0 },
        ranges: vec![REACH as f32],
        footprint_radius: 0.0,
        sweep_rotation: 0.0,
        sweep_translation: 0.0,
    };
    let scan = Scan::new(spec, sensor, &ScanLimits::default())?;
    let survey =
        |rule| -> anyhow::Result<Sets> { Ok(sets(&Surveyor::new().survey(&setup.config(rule, sensor)?, &scan))) };
    let ((occupied, outer), (_, inner)) = (survey(EvidenceRule::Outer)?, survey(EvidenceRule::Inner)?);
    let (top, pixels) = (LINE + 4, SIDE * CELL);
    let mut drawing = Drawing::new(pixels, ROWS * CELL + top, PAPER);
    let corner = 1_u32 << (setup.depth - 1);
    // A little below and to the left of the sensor, which is at the root's middle.
    let first = (corner - 4, corner - 6);
    for y in 0..ROWS {
        for x in 0..SIDE {
            let leaf = (first.0 + x, first.1 + y);
            let colour = if occupied.contains_key(&leaf) {
                OCCUPIED
            } else if inner.contains_key(&leaf) {
                INNER
            } else if outer.contains_key(&leaf) {
                OUTER
            } else {
                PAPER
            };
            let at = (i64::from(x * CELL), i64::from(top + (ROWS - 1 - y) * CELL));
            drawing.fill(at, (CELL, CELL), LATTICE);
            drawing.fill(at, (CELL - 1, CELL - 1), colour);
        }
    }
    let side = f64::from(SIDE) * setup.resolution;
    let from_sensor = |cells: u32| (f64::from(cells) - f64::from(corner)) * setup.resolution;
    let middle = (from_sensor(first.0) + 0.5 * side, from_sensor(first.1));
    let view = View { middle, side, pixels, row: f64::from(top + ROWS * CELL) };
    draw_cone(&mut drawing, &view, &sensor, REACH);
    drawing.text((0, 2), title, 1, INK);
    drawing.outline((0, i64::from(top)), (pixels, ROWS * CELL), INK);
    Ok(drawing)
}

/// The outline of the beam of the middle pose up to `d+`, and where `d-` is.
fn draw_cone(drawing: &mut Drawing, view: &View, sensor: &SensorModel, range: f64) {
    let cone = BeamCone::new(sensor);
    let (sin, cos) = HEADING.sin_cos();
    let at = |(along, across): (f64, f64)| view.at((along * cos - across * sin, along * sin + across * cos));
    let side = |d: f64, sign: f64| (cone.side_axial(d).mid(), sign * cone.side_lateral(d).mid());
    let (near, far) = (range - sensor.spec().range_error_minus, range + sensor.spec().range_error_plus);
    drawing.polygon(&[side(0.0, -1.0), side(far, -1.0), side(far, 1.0), side(0.0, 1.0)].map(at), 2, SET);
    drawing.line(at(side(near, -1.0)), at(side(near, 1.0)), 2, SET);
}

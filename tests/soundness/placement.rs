//! Where the obstacles of a scene stand: in gaps, at the field of view's ends, behind leaf corners, at the limits.

use crate::scenario::{Family, pick};
use rand::{Rng, RngExt};
use std::f64::consts::{FRAC_1_SQRT_2, FRAC_PI_4, PI, TAU};
use ubbmap::sensor::{Angles, SensorSpec};
use ubbmap::simulation::{Cone, Motion, Point, Profile, Shape, World};

/// What placing needs to know of a scene.
pub struct Stage<'a> {
    /// By how much each beam is turned.
    pub errors: Vec<f64>,
    pub sensor: SensorSpec,
    pub motion: Motion,
    pub reach: f64,
    pub width: f64,
    pub resolution: f64,
    pub footprint: f64,
    pub angles: &'a Angles,
    pub beams: usize,
    pub family: Family,
}

/// Two neighbouring beams as they truly were: directions in the map frame, the sensor's origin and cone at the first.
struct Gap {
    origin: Point,
    from: f64,
    to: f64,
    cone: Cone,
}

impl Gap {
    fn width(&self) -> f64 {
        self.to - self.from
    }
}

/// A kind of shape, to be put at some distance along some direction.
#[derive(Clone, Copy)]
struct Kind {
    index: u32,
    width: f64,
    length: f64,
}

pub fn angle_of(angles: &Angles, beam: usize) -> f64 {
    match angles {
        Angles::Uniform { min, increment } => min + beam as f64 * increment,
        Angles::Listed(angles) => angles[beam],
    }
}

/// An obstacle point that a leaf's far corner is to be laid at.
#[derive(Debug, Clone, Copy)]
pub struct Nose {
    /// The point.
    pub at: Point,
    /// The vector to it from the sensor.
    pub away: Point,
}

impl Nose {
    /// Where leaf edges are to run: just behind the point as seen from the sensor.
    pub fn edges(&self) -> Point {
        self.at + self.away.map(|away| 1e-6_f64.copysign(away))
    }
}

/// The obstacles, and the point that the leaves are to be laid out by.
pub fn place(stage: &Stage<'_>, rng: &mut impl Rng) -> (Vec<Shape>, Option<Nose>) {
    let mut shapes = Vec::new();
    let mut corner = None;
    let mut add = |shape: Shape| {
        let fits = clear(stage, &shape);
        if fits {
            shapes.push(shape);
        }
        fits
    };
    let gaps = gaps(stage);
    let adversaries = match stage.family {
        Family::Any => 3..16,
        Family::Tight => 8..40,
        Family::Edges => 4..24,
        // Where a window of headings or positions must be clear, few obstacles: all that is seen hides its surroundings.
        _ => match rng.random_range(0..4) {
            0 => 4..24,
            1 => 1..5,
            _ => 1..3,
        },
    };
    for _ in 0..rng.random_range(adversaries) {
        let at_end = rng.random_bool(if stage.family == Family::Edges { 0.4 } else { 0.08 });
        let mut draw = || if at_end { at_an_end(stage, &gaps, rng) } else { in_a_gap(stage, &gaps, rng) };
        let mut best = draw();
        if let Some(corner) = corner {
            // Leaves begin where the first obstacle put an edge: of some tries the one whose nose is nearest to the far
            // corner of its leaf, so that the whole leaf is nearer to the sensor than the obstacle.
            for _ in 0..if matches!(stage.family, Family::Lever | Family::Turned) { 2 } else { 12 } {
                let other = draw();
                if behind(&other, corner, stage.resolution) < behind(&best, corner, stage.resolution) {
                    best = other;
                }
            }
        }
        let (shape, nose, origin) = best;
        if add(shape) && corner.is_none() {
            corner = Some(Nose { at: nose, away: nose - origin });
        }
    }
    let few =
        matches!(stage.family, Family::Heading | Family::Position | Family::Turned | Family::Sweep | Family::Lever);
    for _ in 0..rng.random_range(0..if few { 2 } else { 8 }) {
        let shape = clutter(stage, rng);
        add(shape);
    }
    if stage.footprint > 0.0 {
        let (heading, radius) = (rng.random_range(-PI..PI), 0.5 * stage.width.max(0.01));
        let out = Point::new(heading.cos(), heading.sin()) * (stage.footprint + radius + 1e-6);
        add(Shape::Disc { center: stage.motion.start.position() + out, radius });
    }
    if few || rng.random_bool(0.75) {
        for shape in walls(stage, rng) {
            add(shape);
        }
    }
    (shapes, corner)
}

/// How far behind an obstacle's nose the far corner of its leaf is, when a leaf's corner is at `corner`.
fn behind((_, nose, origin): &(Shape, Point, Point), corner: Nose, resolution: f64) -> f64 {
    let along = |nose: f64, origin: f64, edge: f64| {
        let into = (nose - edge).rem_euclid(resolution);
        if nose > origin { resolution - into } else { into }
    };
    let edges = corner.edges();
    along(nose.x, origin.x, edges.x).hypot(along(nose.y, origin.y, edges.y))
}

/// True when a shape leaves the robot's path free: the sensor outside of it, and nothing within the footprint (A5).
fn clear(stage: &Stage<'_>, shape: &Shape) -> bool {
    let steps = 16;
    let (mut spread, mut last) = (0.0_f64, None::<Point>);
    let mut free = f64::INFINITY;
    for i in 0..=steps {
        let pose = stage.motion.at(i, steps + 1);
        let (sensor, _) = pose.sensor(&stage.sensor);
        let margin = shape.distance(sensor) - 0.005;
        let body = shape.distance(pose.position()) - stage.footprint;
        free = free.min(margin).min(if stage.footprint > 0.0 { body } else { f64::INFINITY });
        // Between two samples neither origin is farther off than their distance.
        if let Some(last) = last {
            spread = spread.max((sensor - last).norm());
        }
        last = Some(sensor);
    }
    let moved = (stage.motion.start.position() - stage.motion.end.position()).norm() / steps as f64;
    free > 2.0 * (spread + moved)
}

/// All pairs of neighbouring beams, sorted by angle, the seam of a full circle among them.
fn gaps(stage: &Stage<'_>) -> Vec<Gap> {
    let mut beams: Vec<(f64, Point, f64)> = (0..stage.beams)
        .map(|i| {
            let angle = angle_of(stage.angles, i);
            let (origin, heading) = stage.motion.at(i, stage.beams).sensor(&stage.sensor);
            (angle.rem_euclid(TAU), origin, heading + angle + stage.errors[i])
        })
        .collect();
    beams.sort_by(|a, b| a.0.total_cmp(&b.0));
    // The angle between two beams as fired: the one between their mirror angles, and what they turned in between.
    let turned = |a: &(f64, Point, f64), b: &(f64, Point, f64)| {
        let mirror = (b.0 - a.0).rem_euclid(TAU);
        let more = (b.2 - a.2 - mirror + PI).rem_euclid(TAU) - PI;
        a.2 + (mirror + more).max(0.0)
    };
    let mut gaps: Vec<Gap> = (0..beams.len())
        .map(|i| {
            let (a, b) = (&beams[i], &beams[(i + 1) % beams.len()]);
            let cone = Cone::new(a.1, a.2, &stage.sensor);
            Gap { origin: a.1, from: a.2, to: turned(a, b), cone }
        })
        .collect();
    // The widest, most often the part that is out of view, comes last.
    let widest = (0..gaps.len()).max_by(|a, b| gaps[*a].width().total_cmp(&gaps[*b].width())).unwrap_or(0);
    gaps.rotate_left(widest + 1);
    gaps
}

/// `kappa` of the model for half the angle between two beams.
pub fn kappa(half: f64, sensor: &SensorSpec) -> f64 {
    half.sin() - half.cos() * (0.5 * sensor.beam_opening).tan()
}

/// An obstacle in the gap between two neighbouring beams: most often of the least width, its nose towards the sensor,
/// just where it slips between the two.
fn in_a_gap(stage: &Stage<'_>, gaps: &[Gap], rng: &mut impl Rng) -> (Shape, Point, Point) {
    // A robot that accelerates is fastest at the end of its sweep.
    let count = gaps.len();
    let last_fifth = count - 1 - rng.random_range(0..count.div_ceil(5));
    let i = match (stage.motion.profile, stage.angles) {
        _ if stage.family != Family::Lever || rng.random_bool(0.3) => rng.random_range(0..count),
        (Profile::Accelerating, Angles::Uniform { increment, .. }) if *increment > 0.0 => last_fifth,
        (Profile::Decelerating, Angles::Uniform { increment, .. }) if *increment < 0.0 => last_fifth,
        _ => count - 1 - last_fifth,
    };
    let skipped = pick(rng, &[0, 0, 0, 1, 2]);
    let (gap, last) = (&gaps[i], &gaps[(i + skipped) % gaps.len()]);
    let to = gap.to + (last.to - gap.to).rem_euclid(TAU);
    let half = (0.5 * (to - gap.from)).min(PI);
    let middle = gap.from + half;
    let direction = match rng.random_range(0..6) {
        0 => gap.from + 2.0 * half * rng.random::<f64>(),
        1 => pick(rng, &[gap.from, to]),
        _ => middle + half * rng.random_range(-0.1..0.1) * pick(rng, &[0.0, 1.0]),
    };
    let kind = kind_of(stage, rng);
    let out = Point::new(direction.cos(), direction.sin());
    if rng.random_bool(if matches!(stage.family, Family::Sweep | Family::Lever | Family::Turned) { 0.8 } else { 0.2 }) {
        // The beams about this gap, and the least distance at which they all miss the shape.
        let count = gaps.len();
        let cones: Vec<Cone> = (0..count.min(9)).map(|k| gaps[(i + k + count - count.min(4)) % count].cone).collect();
        let tries = (0..12).map(|_| middle + half * rng.random_range(-1.8..1.8)).chain([direction]);
        let hidden = tries.filter_map(|direction| {
            let out = Point::new(direction.cos(), direction.sin());
            least_hidden(&cones, gap.origin, out, stage.reach, kind).map(|distance| (distance, out))
        });
        if let Some((distance, out)) = hidden.min_by(|a, b| a.0.total_cmp(&b.0)) {
            return shape_at(gap.origin, out, distance * (1.0 + pick(rng, &[1e-7, 1e-7, 1e-3])), kind);
        }
    }
    let kappa = kappa(half, &stage.sensor);
    // Where a disc of this width in the middle of the gap touches neither cone any more.
    let slips = (kind.width / (0.5 * stage.sensor.beam_opening).cos() + stage.sensor.beam_diameter) / (2.0 * kappa);
    let distance = match rng.random_range(0..8) {
        0..5 if kappa > 0.0 && slips < 1.3 * stage.reach => slips * (1.0 + pick(rng, &[1e-7, 1e-4, 1e-3, 0.01, 0.1])),
        5 if kappa > 0.0 && slips < 1.3 * stage.reach => slips * rng.random_range(0.5..1.0),
        _ => stage.reach * rng.random_range(0.05..1.0),
    };
    shape_at(gap.origin, out, distance, kind)
}

/// The least distance, by bisection, at which none of the beams touches the shape; `None` when even the farthest does.
fn least_hidden(cones: &[Cone], origin: Point, out: Point, reach: f64, kind: Kind) -> Option<f64> {
    let seen = |distance: f64| {
        let world = World::new(vec![shape_at(origin, out, distance, kind).0]);
        cones.iter().any(|cone| world.nearest_in(cone).is_some())
    };
    let (mut near, mut far) = (0.02 * reach, reach);
    if seen(far) {
        return None;
    }
    for _ in 0..24 {
        let middle = 0.5 * (near + far);
        if seen(middle) {
            near = middle;
        } else {
            far = middle;
        }
    }
    Some(far)
}

/// An obstacle just beyond (or on) the end of the field of view, or in the largest gap.
fn at_an_end(stage: &Stage<'_>, gaps: &[Gap], rng: &mut impl Rng) -> (Shape, Point, Point) {
    let widest = gaps.last().unwrap();
    let distance = stage.reach * rng.random_range(0.05..1.0);
    let kind = kind_of(stage, rng);
    let aside = (0.5 * kind.width + 0.5 * stage.sensor.beam_diameter) / distance + 0.5 * stage.sensor.beam_opening;
    let aside = aside * rng.random_range(0.0..2.5);
    let direction = if rng.random_bool(0.5) { widest.from + aside } else { widest.to - aside };
    shape_at(widest.origin, Point::new(direction.cos(), direction.sin()), distance, kind)
}

/// Most often exactly the least width that the map's configuration claims (a trifle more, for rounding).
fn width_of(stage: &Stage<'_>, rng: &mut impl Rng) -> f64 {
    let least = stage.width * (1.0 + 1e-9);
    if rng.random_bool(0.7) { least } else { least.max(0.01) * rng.random_range(1.0..3.0) }
}

fn kind_of(stage: &Stage<'_>, rng: &mut impl Rng) -> Kind {
    Kind { index: rng.random_range(0..10), width: width_of(stage, rng), length: rng.random_range(1.0..10.0) }
}

/// A shape whose disc is `distance` away, its point nearest to the sensor, and where the sensor is.
fn shape_at(origin: Point, out: Point, distance: f64, kind: Kind) -> (Shape, Point, Point) {
    let center = origin + out * distance;
    let (radius, heading) = (0.5 * kind.width, out.y.atan2(out.x));
    let long = kind.width * kind.length;
    match kind.index {
        0..4 => {
            let nose = center - out * (radius / FRAC_1_SQRT_2);
            (Shape::Drop { center, radius, heading: heading + PI }, nose, origin)
        }
        4 | 5 => (Shape::Disc { center, radius }, center - out * radius, origin),
        6 | 7 => {
            // A square with a corner towards the sensor.
            let nose = center - out * (radius / FRAC_1_SQRT_2);
            (Shape::Rectangle { center, heading: heading + FRAC_PI_4, half: (radius, radius) }, nose, origin)
        }
        8 => (Shape::Capsule { from: center, to: center + out * long, radius }, center - out * radius, origin),
        _ => {
            let center = center + out * (0.5 * long - radius);
            let nose = center - out * (0.5 * long);
            (Shape::Rectangle { center, heading, half: (0.5 * long, radius) }, nose, origin)
        }
    }
}

fn clutter(stage: &Stage<'_>, rng: &mut impl Rng) -> Shape {
    let (origin, _) = stage.motion.start.sensor(&stage.sensor);
    let direction: f64 = rng.random_range(-PI..PI);
    let center =
        origin + Point::new(direction.cos(), direction.sin()) * (stage.reach * rng.random_range(0.02..1.0_f64));
    let radius = 0.5 * width_of(stage, rng);
    let heading: f64 = rng.random_range(-PI..PI);
    let long = stage.reach * rng.random_range(0.0..0.4);
    match rng.random_range(0..4) {
        0 => Shape::Disc { center, radius },
        1 => {
            let to = center + Point::new(heading.cos(), heading.sin()) * long;
            Shape::Capsule { from: center, to, radius }
        }
        2 => Shape::Rectangle { center, heading, half: (radius, radius.max(long)) },
        _ => Shape::Drop { center, radius, heading },
    }
}

/// Four walls about the sensor, at any angle, some of them missing.
fn walls(stage: &Stage<'_>, rng: &mut impl Rng) -> Vec<Shape> {
    let (origin, _) = stage.motion.start.sensor(&stage.sensor);
    let turn: f64 = rng.random_range(-PI..PI);
    let thick = 0.5 * stage.width.max(0.05);
    let keep = pick(rng, &[1.0, 1.0, 0.7]);
    let mut walls = Vec::new();
    for side in 0..4 {
        let heading = turn + f64::from(side) * std::f64::consts::FRAC_PI_2;
        let distance = stage.reach * rng.random_range(0.7..1.0);
        let center = origin + Point::new(heading.cos(), heading.sin()) * (distance + thick);
        if rng.random_bool(keep) {
            walls.push(Shape::Rectangle { center, heading, half: (thick, 1.1 * stage.reach) });
        }
    }
    walls
}

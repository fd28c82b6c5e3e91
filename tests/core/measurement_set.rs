//! Measurement sets against equation (6), sampled densely: the truth is inside, and little else is.

#![allow(clippy::unwrap_used, clippy::panic, clippy::print_stdout, reason = "a test fails by panicking")]

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use ubbmap::interval::{Box2, Interval};
use ubbmap::sensor::{
    MeasurementSet, Mount, PoseBox, PoseLimits, SensorModel, SensorSpec, apex_offset, natural_measurement_box,
};

/// A beam with its pose box, and the two kinds of enclosure.
struct Case {
    pose: PoseBox,
    spec: SensorSpec,
    angle: f64,
    near: f64,
    far: f64,
}

impl Case {
    fn sensor(&self) -> SensorModel {
        SensorModel::new(self.spec).unwrap()
    }

    fn hull(&self) -> Box2 {
        MeasurementSet::new(&self.pose, &self.sensor(), self.angle, self.near, self.far).hull
    }

    fn natural(&self) -> Box2 {
        natural_measurement_box(&self.pose, &self.sensor(), self.angle, self.near, self.far)
    }

    /// (6) at one choice of everything, straight from the paper; `side` in -1..=1 is the place across the beam.
    fn at(&self, x: f64, y: f64, theta: f64, d: f64, side: f64, error: f64) -> (f64, f64) {
        let SensorSpec { beam_opening, beam_diameter, mount, .. } = self.spec;
        let axis = theta + mount.theta + self.angle + error;
        let tau = side * 0.5 * beam_opening;
        let (px, py) = if beam_opening == 0.0 {
            let v = side * 0.5 * beam_diameter;
            (d * axis.cos() - v * axis.sin(), d * axis.sin() + v * axis.cos())
        } else {
            let offset = apex_offset(beam_opening, beam_diameter);
            let reach = d + offset;
            (reach * (axis + tau).cos() - offset * axis.cos(), reach * (axis + tau).sin() - offset * axis.sin())
        };
        (x + px + mount.x * theta.cos() - mount.y * theta.sin(), y + py + mount.x * theta.sin() + mount.y * theta.cos())
    }

    /// The hull of samples on a grid that holds all the ends. Inner ranges and inner positions are never extreme.
    fn sampled(&self, headings: u32, sides: u32, errors: u32) -> Box2 {
        let steps = |lo: f64, hi: f64, count: u32| {
            (0..=count).map(move |i| if i == count { hi } else { lo + (hi - lo) * f64::from(i) / f64::from(count) })
        };
        let eps = self.spec.beam_angle_error;
        let (mut x, mut y) = ((f64::INFINITY, f64::NEG_INFINITY), (f64::INFINITY, f64::NEG_INFINITY));
        for theta in steps(self.pose.theta().lo(), self.pose.theta().hi(), headings) {
            for side in steps(-1.0, 1.0, sides) {
                for error in steps(-eps, eps, if eps == 0.0 { 1 } else { errors }) {
                    for d in [self.near, self.far] {
                        let (px, py) = self.at(0.0, 0.0, theta, d, side, error);
                        x = (px.min(x.0), px.max(x.1));
                        y = (py.min(y.0), py.max(y.1));
                    }
                }
            }
        }
        let (px, py) = (self.pose.x(), self.pose.y());
        Box2::new(Interval::spanning(x.0 + px.lo(), x.1 + px.hi()), Interval::spanning(y.0 + py.lo(), y.1 + py.hi()))
    }

    /// What the sampler's own rounding may amount to: a few ulps of the largest number that it adds.
    fn sampler_rounding(&self) -> f64 {
        let offset = if self.spec.beam_opening == 0.0 {
            0.0
        } else {
            apex_offset(self.spec.beam_opening, self.spec.beam_diameter)
        };
        let size = self.far + offset + self.pose.x().magnitude() + self.pose.y().magnitude() + 200.0;
        (16.0 + 4.0 * self.pose.theta().magnitude()) * f64::EPSILON * size
    }
}

fn pose(x: (f64, f64), y: (f64, f64), theta: (f64, f64)) -> PoseBox {
    PoseBox::new(x, y, theta, &PoseLimits { max_position_width: 10.0, max_heading_width: 7.0 }).unwrap()
}

fn random_case(rng: &mut ChaCha8Rng) -> Case {
    let centre = (rng.random_range(-50.0..50.0), rng.random_range(-50.0..50.0));
    let theta = rng.random_range(-10.0..10.0);
    let (wide, turn) = match rng.random_range(0..4) {
        0 => (0.0, 0.0),
        1 => (0.05, 0.0087),
        2 => (0.0, rng.random_range(0.0..0.5)),
        _ => (rng.random_range(0.0..1.0), rng.random_range(0.0..3.3)),
    };
    let opening = match rng.random_range(0..5) {
        0 => 0.0,
        1 => 0.25_f64.to_radians(),
        2 => rng.random_range(0.0..0.01),
        3 => rng.random_range(0.0..1.0),
        _ => rng.random_range(0.0..3.1),
    };
    let near: f64 = if rng.random_range(0..5) == 0 { 0.0 } else { rng.random_range(0.0..20.0) };
    let mount = if rng.random() {
        Mount::default()
    } else {
        Mount { x: rng.random_range(-1.0..1.0), y: rng.random_range(-1.0..1.0), theta: rng.random_range(-4.0..4.0) }
    };
    Case {
        pose: pose(
            (centre.0 - wide, centre.0 + wide),
            (centre.1 - wide, centre.1 + wide),
            (theta - turn, theta + turn),
        ),
        spec: SensorSpec {
            beam_opening: opening,
            beam_diameter: [0.0, 0.012, 0.3][rng.random_range(0..3)],
            beam_angle_error: [0.0, 0.0, 0.002, 0.3][rng.random_range(0..4)],
            mount,
            ..SensorSpec::default()
        },
        angle: rng.random_range(-3.2..3.2),
        near,
        far: near + [0.0, 0.07, 1.0][rng.random_range(0..3)],
    }
}

#[test]
fn every_choice_within_the_bounds_lies_in_the_set_and_in_the_natural_extension() {
    let mut rng = ChaCha8Rng::seed_from_u64(11);
    for _ in 0..20_000 {
        let case = random_case(&mut rng);
        let (hull, natural) = (case.hull(), case.natural());
        let slack = case.sampler_rounding();
        let eps = case.spec.beam_angle_error;
        for _ in 0..60 {
            // The extremes are favoured: that is where an enclosure leaks.
            let mut pick = |lo: f64, hi: f64| match rng.random_range(0..4) {
                0 => lo,
                1 => hi,
                _ => lo + (hi - lo) * rng.random::<f64>(),
            };
            let (x, y, t) = (case.pose.x(), case.pose.y(), case.pose.theta());
            let (x, y, theta) = (pick(x.lo(), x.hi()), pick(y.lo(), y.hi()), pick(t.lo(), t.hi()));
            let (d, side, error) = (pick(case.near, case.far), pick(-1.0, 1.0), pick(-eps, eps));
            let (px, py) = case.at(x, y, theta, d, side, error);
            let sample = Box2::new(Interval::around(px, slack), Interval::around(py, slack));
            assert!(hull.meets(sample), "{px} {py} is outside {hull:?}: {:?} {:?}", case.spec, case.pose);
            assert!(natural.meets(sample), "{px} {py} is outside the natural {natural:?}: {:?}", case.spec);
        }
        assert!(natural.encloses(hull), "{hull:?} passes {natural:?}: {:?}", case.spec);
    }
}

#[test]
fn the_beam_frame_rectangle_encloses_the_cone() {
    let mut rng = ChaCha8Rng::seed_from_u64(12);
    for _ in 0..20_000 {
        let mut case = random_case(&mut rng);
        // In the frame of the beam: no pose, no mount, no angle.
        case.pose = pose((0.0, 0.0), (0.0, 0.0), (0.0, 0.0));
        case.spec.mount = Mount::default();
        case.spec.beam_angle_error = 0.0;
        case.angle = 0.0;
        let set = MeasurementSet::new(&case.pose, &case.sensor(), 0.0, case.near, case.far);
        let slack = case.sampler_rounding();
        let sampled = case.sampled(1, 64, 1);
        assert!(set.near <= sampled.x.lo() + slack && sampled.x.hi() <= set.far + slack);
        assert!(sampled.y.magnitude() <= set.half_width + slack);
        assert!(set.near >= sampled.x.lo() - slack && set.half_width <= sampled.y.hi() + slack, "no wider than it is");
        assert_eq!(set.far, case.far);
    }
}

/// How much wider the hull is than the sampled one, the worse axis.
fn excess(case: &Case, sampled: Box2) -> f64 {
    let hull = case.hull();
    (hull.x.width() / sampled.x.width()).max(hull.y.width() / sampled.y.width()) - 1.0
}

#[test]
fn at_ten_metres_and_half_a_degree_the_hull_is_at_most_5_percent_wide() {
    let turn = 0.5_f64.to_radians();
    let mounts = [Mount::default(), Mount { x: 0.3, y: -0.1, theta: 0.7 }, Mount { x: -0.8, y: 0.6, theta: 3.0 }];
    let mut worst = 0.0_f64;
    for mount in mounts {
        for opening in [0.0_f64, 0.25, 0.4, 1.0, 3.0, 15.0, 60.0, 150.0] {
            for diameter in [0.0, 0.012, 0.1] {
                for (error, extent) in [(0.035, 0.0), (0.035, 0.03), (0.005, 0.0), (0.0, 0.0)] {
                    for step in 0..48 {
                        let theta = 0.3;
                        let case = Case {
                            pose: pose((1.0 - extent, 1.0 + extent), (-extent, extent), (theta - turn, theta + turn)),
                            spec: SensorSpec {
                                beam_opening: opening.to_radians(),
                                beam_diameter: diameter,
                                mount,
                                ..SensorSpec::default()
                            },
                            // Every direction, the axes among them.
                            angle: f64::from(step) * std::f64::consts::TAU / 48.0 - theta - mount.theta,
                            near: 10.0 - error,
                            far: 10.0 + error,
                        };
                        let sides = if opening < 1.0 { 4 } else { 32 };
                        let sampled = case.sampled(48, sides, 1);
                        let here = excess(&case, sampled);
                        assert!(here <= 0.05, "{here} too wide: {:?} angle {} error {error}", case.spec, case.angle);
                        worst = worst.max(here);
                    }
                }
            }
        }
    }
    // The bound is not met by a sampler that samples nothing.
    assert!(worst > 0.0);
    println!("worst excess over the sampled hull: {:.3} %", 100.0 * worst);
}

#[test]
fn an_angle_error_of_single_beams_keeps_within_the_5_percent() {
    let turn = 0.5_f64.to_radians();
    for eps in [0.0005, 0.002, 0.01, 0.1, 0.5] {
        for opening in [0.0_f64, 0.25, 5.0] {
            for step in 0..24 {
                let case = Case {
                    pose: pose((0.0, 0.0), (0.0, 0.0), (-turn, turn)),
                    spec: SensorSpec {
                        beam_opening: opening.to_radians(),
                        beam_angle_error: eps,
                        mount: Mount { x: 0.4, y: 0.2, theta: 0.0 },
                        ..SensorSpec::default()
                    },
                    angle: f64::from(step) * std::f64::consts::TAU / 24.0,
                    near: 9.965,
                    far: 10.035,
                };
                let here = excess(&case, case.sampled(32, 8, 32));
                assert!(here <= 0.05, "{here} too wide: eps {eps} opening {opening} angle {}", case.angle);
            }
        }
    }
}

#[test]
fn the_natural_extension_is_far_wider_as_soon_as_the_heading_is_uncertain() {
    let turn = 0.5_f64.to_radians();
    let case = Case {
        pose: pose((0.0, 0.0), (0.0, 0.0), (-turn, turn)),
        spec: SensorSpec::default(),
        angle: 0.0,
        near: 9.965,
        far: 10.035,
    };
    assert!(case.natural().y.width() > 1.4 * case.hull().y.width());
    // With an exact heading the two agree up to rounding.
    let exact = Case { pose: pose((0.0, 0.0), (0.0, 0.0), (0.7, 0.7)), ..case };
    assert!(exact.natural().x.width() < exact.hull().x.width() + 1e-12);
}

#[test]
fn the_apex_lies_where_equation_4_puts_it() {
    assert!((apex_offset(0.25_f64.to_radians(), 0.012) - 2.750).abs() < 0.001);
    assert_eq!(apex_offset(0.0, 0.012), f64::INFINITY);
    assert_eq!(apex_offset(0.0, 0.0), 0.0);
    assert_eq!(apex_offset(1.0, 0.0), 0.0);
    // Openings that are all but zero give the strip, whatever becomes of the apex.
    for opening in [5e-324, 1e-300, 1e-30, 1e-12] {
        let strip = |beam_opening: f64| {
            let spec = SensorSpec { beam_opening, ..SensorSpec::default() };
            MeasurementSet::new(
                &pose((0.0, 0.1), (0.0, 0.0), (1.0, 1.01)),
                &SensorModel::new(spec).unwrap(),
                0.3,
                5.0,
                5.1,
            )
        };
        let (hull, limit) = (strip(opening).hull, strip(0.0).hull);
        assert!(
            hull.x.meets(limit.x) && (hull.x.width() - limit.x.width()).abs() < 1e-9,
            "{opening}: {hull:?} {limit:?}"
        );
        assert!(
            hull.y.meets(limit.y) && (hull.y.width() - limit.y.width()).abs() < 1e-9,
            "{opening}: {hull:?} {limit:?}"
        );
    }
}

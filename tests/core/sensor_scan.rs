//! What a scan may be, and what its beams say.

#![allow(clippy::unwrap_used, clippy::panic, clippy::print_stdout, reason = "a test fails by panicking")]

use proptest::prelude::*;
use ubbmap::interval::Box2;
use ubbmap::sensor::{
    Angles, Mount, PoseBox, PoseLimits, Reading, ReadingCounts, Scan, ScanError, ScanLimits, ScanSpec, SensorModel,
    SensorSpec,
};

fn pose_at(theta: (f64, f64)) -> PoseBox {
    PoseBox::new((1.0, 1.1), (-2.0, -1.9), theta, &PoseLimits::default()).unwrap()
}

fn spec(angles: Angles, ranges: Vec<f32>) -> ScanSpec {
    ScanSpec {
        pose: pose_at((0.0, 0.1)),
        angles,
        ranges,
        footprint_radius: 0.0,
        sweep_rotation: 0.0,
        sweep_translation: 0.0,
    }
}

fn sensor(spec: SensorSpec) -> SensorModel {
    SensorModel::new(spec).unwrap()
}

fn scan(spec: ScanSpec) -> Result<Scan, ScanError> {
    Scan::new(spec, sensor(SensorSpec::default()), &ScanLimits::default())
}

fn uniform(min: f64, increment: f64, beams: usize) -> Result<Scan, ScanError> {
    scan(spec(Angles::Uniform { min, increment }, vec![1.0; beams]))
}

/// Code and field of a refusal.
fn refusal(result: Result<Scan, ScanError>) -> (&'static str, String) {
    let error = result.unwrap_err();
    assert!(error.to_string().contains(error.field()), "{error} names {}", error.field());
    (error.code(), error.field().to_owned())
}

#[test]
fn refusals_have_a_code_and_name_the_field() {
    let tau = std::f64::consts::TAU;
    let is = |code: &'static str, field: &str| (code, field.to_owned());
    assert_eq!(refusal(uniform(0.0, 0.1, 0)), is("NO_BEAMS", "ranges"));
    assert_eq!(refusal(uniform(0.0, 1e-6, 20_001)), is("TOO_MANY_BEAMS", "ranges"));
    assert_eq!(refusal(scan(spec(Angles::Listed(vec![0.0; 2]), vec![1.0; 3]))), is("LENGTH_MISMATCH", "angles"));
    assert_eq!(refusal(scan(spec(Angles::Listed(vec![0.0, f64::NAN]), vec![1.0; 2]))), is("BAD_ANGLE", "angles"));
    assert_eq!(refusal(scan(spec(Angles::Listed(vec![1000.1]), vec![1.0]))), is("BAD_ANGLE", "angles"));
    assert_eq!(refusal(uniform(f64::INFINITY, 0.1, 3)), is("BAD_ANGLE", "angle_min"));
    assert_eq!(refusal(uniform(0.0, f64::NAN, 1)), is("BAD_ANGLE", "angle_increment"));
    assert_eq!(refusal(uniform(0.0, 0.0, 2)), is("BAD_ANGLE", "angle_increment"));
    assert_eq!(refusal(uniform(0.0, 0.1, 64)), is("SPAN_TOO_WIDE", "angle_increment"));
    assert_eq!(refusal(uniform(0.0, -0.1, 64)), is("SPAN_TOO_WIDE", "angle_increment"));
    assert_eq!(refusal(scan(spec(Angles::Listed(vec![-4.0, 4.0]), vec![1.0; 2]))), is("SPAN_TOO_WIDE", "angles"));
    type Change = fn(&mut ScanSpec, f64);
    let fields: [(&str, Change, f64); 3] = [
        ("footprint_radius", |s, v| s.footprint_radius = v, 100.0),
        ("sweep_rotation", |s, v| s.sweep_rotation = v, tau),
        ("sweep_translation", |s, v| s.sweep_translation = v, 100.0),
    ];
    for (field, change, limit) in fields {
        for value in [-0.001, limit * 1.001, f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
            let mut bad = spec(Angles::Uniform { min: 0.0, increment: 0.1 }, vec![1.0; 3]);
            change(&mut bad, value);
            assert_eq!(refusal(scan(bad)), is("OUT_OF_RANGE", field));
        }
        let mut good = spec(Angles::Uniform { min: 0.0, increment: 0.1 }, vec![1.0; 3]);
        change(&mut good, limit);
        assert!(scan(good).is_ok());
    }
}

#[test]
fn refusals_of_poses_have_a_code_and_name_the_field() {
    let new = |x, y, theta| PoseBox::new(x, y, theta, &PoseLimits::default()).unwrap_err();
    let ok = (0.0, 0.1);
    let cases = [
        (new((f64::NAN, 0.0), ok, ok), "POSE_NOT_FINITE", "pose.x"),
        (new(ok, (0.0, f64::INFINITY), ok), "POSE_NOT_FINITE", "pose.y"),
        (new(ok, ok, (f64::NEG_INFINITY, 0.0)), "POSE_NOT_FINITE", "pose.theta"),
        (new((1.0, 0.0), ok, ok), "POSE_INVERTED", "pose.x"),
        (new(ok, (1.1e9, 1.1e9), ok), "POSE_OUT_OF_RANGE", "pose.y"),
        (new(ok, ok, (-1.1e6, -1.1e6)), "POSE_OUT_OF_RANGE", "pose.theta"),
        (new((0.0, 2.1), ok, ok), "POSE_TOO_WIDE", "pose.x"),
        (new(ok, ok, (0.0, 1.1)), "POSE_TOO_WIDE", "pose.theta"),
    ];
    for (error, code, field) in cases {
        assert_eq!((error.code(), error.field()), (code, field), "{error}");
        assert!(error.to_string().contains(field));
    }
    // Theta may lie outside -pi..pi.
    assert!(PoseBox::new(ok, ok, (100.0, 100.1), &PoseLimits::default()).is_ok());
}

#[test]
fn fields_of_view_from_one_beam_to_a_closed_circle_are_accepted() {
    let tau = std::f64::consts::TAU;
    assert!(uniform(0.3, 0.0, 1).is_ok());
    for degrees in 1..=360 {
        let fov = f64::from(degrees).to_radians();
        assert!(uniform(-0.5 * fov, fov / 180.0, 181).is_ok(), "{degrees}");
        assert!(uniform(0.5 * fov, -fov / 180.0, 181).is_ok(), "{degrees}");
    }
    // A last beam that closes the circle, with a step of 32-bit precision.
    let step = f64::from((tau / 720.0) as f32);
    assert!(uniform(-std::f64::consts::PI, step, 721).is_ok());
    let closed = scan(spec(Angles::Listed((0..=8).map(|i| f64::from(i) * tau / 8.0).collect()), vec![1.0; 9]));
    assert_eq!(closed.unwrap().angle(8), tau);
    let beams = uniform(1.0, -0.25, 5).unwrap();
    assert_eq!((beams.angle(0), beams.angle(4), beams.beams()), (1.0, 0.0, 5));
}

#[test]
fn readings_compare_in_32_bits() {
    // 5.6 as a 32-bit float is below 5.6: a sensor that reports its range_max reports no return.
    let model = sensor(SensorSpec { range_min: 0.1, range_max: 5.6, ..SensorSpec::default() });
    let ranges = vec![
        5.6,
        5.6_f32.next_down(),
        f32::INFINITY,
        0.1,
        0.1_f32.next_down(),
        0.0,
        -0.0,
        -1.0,
        f32::NAN,
        f32::NEG_INFINITY,
        f32::from_bits(1),
        f32::MAX,
    ];
    let spec = spec(Angles::Uniform { min: 0.0, increment: 0.01 }, ranges);
    let scan = Scan::new(spec, model, &ScanLimits::default()).unwrap();
    let kinds: Vec<char> = (0..scan.beams())
        .map(|beam| match scan.reading(beam) {
            Reading::Return { .. } => 'r',
            Reading::NoReturn => 'n',
            Reading::Failed => 'f',
        })
        .collect();
    assert_eq!(kinds.iter().collect::<String>(), "nrnrfffffffn");
    assert_eq!(scan.reading_counts(), ReadingCounts { returns: 2, no_returns: 3, failed: 7 });
    let all: Vec<Reading> = scan.readings().collect();
    assert_eq!(all, (0..scan.beams()).map(|beam| scan.reading(beam)).collect::<Vec<_>>());
}

#[test]
fn without_a_least_range_the_smallest_positive_float_is_a_return() {
    let ranges = vec![f32::from_bits(1), 0.02, 0.0];
    let scan = scan(spec(Angles::Uniform { min: 0.0, increment: 0.01 }, ranges)).unwrap();
    for beam in [0, 1] {
        let Reading::Return { near, far } = scan.reading(beam) else { panic!("beam {beam} is a return") };
        assert!(near == 0.0 && far > 0.035 && far < 0.056);
    }
    assert_eq!(scan.reading(2), Reading::Failed);
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(20_000))]

    /// Every 64-bit range that travels as `r`, with any error in the bounds, is in `[d]`; which is not much wider.
    #[test]
    fn range_intervals_hold_what_the_32_bits_stand_for(r in 0.001..80.9_f32, minus in 0.0..0.5, plus in 0.0..0.5, at in 0.0..=1.0) {
        let model = sensor(SensorSpec { range_error_minus: minus, range_error_plus: plus, ..SensorSpec::default() });
        let scan = Scan::new(spec(Angles::Uniform { min: 0.0, increment: 0.1 }, vec![r]), model, &ScanLimits::default()).unwrap();
        let Reading::Return { near, far } = scan.reading(0) else { panic!("{r} is a return") };
        let (below, above) = (f64::from(r.next_down()), f64::from(r.next_up()));
        let (least, most) = (0.5 * (below + f64::from(r)), 0.5 * (f64::from(r) + above));
        let measured = least + at * (most - least);
        prop_assert!(near <= f64::max(measured - minus, 0.0) && measured + plus <= far);
        prop_assert!(near >= 0.0 && near >= least - minus - (above - f64::from(r)));
        prop_assert!(far <= most + plus + 1e-13);
    }

    #[test]
    fn any_bits_are_accepted_or_refused_by_the_name_of_a_field(
        bits in prop::array::uniform5(any::<u64>()), choice in any::<u8>(), ranges in prop::collection::vec(any::<u32>(), 0..20),
        listed in prop::option::of(prop::collection::vec(any::<u64>(), 0..20)),
    ) {
        let v = |i: usize| if choice & (1 << i) == 0 { 0.1 } else { f64::from_bits(bits[i]) };
        let angles = match listed {
            Some(list) if choice & 32 == 0 => Angles::Listed(list.into_iter().map(f64::from_bits).collect()),
            Some(_) => Angles::Listed(vec![v(0); ranges.len()]),
            None => Angles::Uniform { min: v(0), increment: v(1) },
        };
        let spec = ScanSpec {
            footprint_radius: v(2), sweep_rotation: v(3), sweep_translation: v(4),
            ..spec(angles, ranges.into_iter().map(f32::from_bits).collect())
        };
        match scan(spec) {
            Ok(scan) => {
                for beam in 0..scan.beams() {
                    prop_assert!(scan.angle(beam).is_finite() && scan.angle(beam).abs() < 1007.0);
                    if let Reading::Return { near, far } = scan.reading(beam) {
                        prop_assert!(0.0 <= near && near < far && far < 82.0);
                    }
                }
                let counts = scan.reading_counts();
                prop_assert_eq!(counts.returns + counts.no_returns + counts.failed, scan.beams());
            }
            Err(error) => {
                let known = ["ranges", "angles", "angle_min", "angle_increment", "footprint_radius", "sweep_rotation", "sweep_translation"];
                prop_assert!(known.contains(&error.field()), "{}", error);
                prop_assert!(error.code().bytes().all(|b| b.is_ascii_uppercase() || b == b'_'));
            }
        }
    }

    #[test]
    fn any_bits_of_a_pose_are_accepted_or_refused(bits in prop::array::uniform6(any::<u64>()), everyday in any::<u8>()) {
        let v = |i: usize| if everyday & (1 << i) == 0 { f64::from_bits(bits[i]) } else { 0.5 };
        match PoseBox::new((v(0), v(1)), (v(2), v(3)), (v(4), v(5)), &PoseLimits::default()) {
            Ok(pose) => prop_assert!(pose.x().is_bounded() && pose.y().is_bounded() && pose.theta().width() < 1.1),
            Err(error) => prop_assert!(error.field().starts_with("pose.") && error.code().starts_with("POSE_")),
        }
    }

    /// The origins enclose every pose's sensor, and are no wider than those at 400 headings.
    #[test]
    fn origins_are_the_hull_of_the_sensors_places(
        x in -5.0..5.0_f64, y in -5.0..5.0, theta in -20.0..20.0, turn in 0.0..1.0, mx in -2.0..2.0, my in -2.0..2.0, phi in -3.0..3.0,
    ) {
        let model = sensor(SensorSpec { mount: Mount { x: mx, y: my, theta: phi }, ..SensorSpec::default() });
        let pose = PoseBox::new((x, x + 0.1), (y, y + 0.2), (theta, theta + turn), &PoseLimits::default()).unwrap();
        let scan = Scan::new(ScanSpec { pose, ..spec(Angles::Uniform { min: 0.0, increment: 0.1 }, vec![1.0]) }, model,
            &ScanLimits::default()).unwrap();
        let origins = scan.origins();
        let mut hull: Option<Box2> = None;
        for i in 0..=400 {
            let t = f64::min(theta + turn * f64::from(i) / 400.0, theta + turn);
            for (px, py) in [(x, y), (x + 0.1, y + 0.2)] {
                let place = (px + mx * t.cos() - my * t.sin(), py + mx * t.sin() + my * t.cos());
                // The sampler rounds too.
                prop_assert!(origins.x.lo() <= place.0 + 1e-14 && place.0 <= origins.x.hi() + 1e-14);
                prop_assert!(origins.y.lo() <= place.1 + 1e-14 && place.1 <= origins.y.hi() + 1e-14);
                let point = Box2::point(place.0, place.1);
                hull = Some(hull.map_or(point, |h| h.hull(point)));
            }
        }
        let hull = hull.unwrap();
        // Between samples an arc of 3 m bulges by 3 (1 / 800)^2 / 2.
        prop_assert!(origins.x.width() <= hull.x.width() + 5e-6 && origins.y.width() <= hull.y.width() + 5e-6);
        let headings = scan.headings();
        prop_assert!(headings.contains(theta + phi) && headings.contains(theta + turn + phi) && headings.width() <= turn + 1e-13);
    }
}

//! What a sensor's parameters may be.

#![allow(clippy::unwrap_used, clippy::panic, clippy::print_stdout, reason = "a test fails by panicking")]

use proptest::prelude::*;
use ubbmap::sensor::{Mount, SensorModel, SensorSpec};

const FIELDS: [&str; 10] = [
    "range_error.minus",
    "range_error.plus",
    "beam_opening",
    "beam_diameter",
    "range_min",
    "range_max",
    "beam_angle_error",
    "mount.x",
    "mount.y",
    "mount.theta",
];

/// The default with one field set by its name in the interface.
fn with(field: &str, value: f64) -> SensorSpec {
    let mut spec = SensorSpec::default();
    match field {
        "range_error.minus" => spec.range_error_minus = value,
        "range_error.plus" => spec.range_error_plus = value,
        "beam_opening" => spec.beam_opening = value,
        "beam_diameter" => spec.beam_diameter = value,
        "range_min" => spec.range_min = value,
        "range_max" => spec.range_max = value,
        "no_return_free_to" => spec.no_return_free_to = Some(value),
        "beam_angle_error" => spec.beam_angle_error = value,
        "mount.x" => spec.mount.x = value,
        "mount.y" => spec.mount.y = value,
        "mount.theta" => spec.mount.theta = value,
        _ => panic!("no field {field}"),
    }
    spec
}

#[test]
fn a_field_out_of_its_range_is_refused_by_its_name_with_its_value() {
    let cases: &[(&str, &[f64])] = &[
        ("range_error.minus", &[-0.001, 81.0, 90.0, 1e300]),
        ("range_error.plus", &[-0.001, 1.1e6]),
        ("beam_opening", &[-1e-300, std::f64::consts::PI, 4.0]),
        ("beam_diameter", &[-0.1, 101.0]),
        ("range_min", &[-0.1, 81.0, 100.0]),
        ("range_max", &[-1.0, 0.0, 1e-300, 1e-45, 1.1e6]),
        ("no_return_free_to", &[-0.1, 80.966, 81.0, 1e300]),
        ("beam_angle_error", &[-0.1, 0.51]),
        ("mount.x", &[-100.1, 100.1]),
        ("mount.y", &[-100.1, 100.1]),
        ("mount.theta", &[-1000.1, 1000.1]),
    ];
    for (field, values) in cases {
        for value in values.iter().copied().chain([f64::NAN, f64::INFINITY, f64::NEG_INFINITY]) {
            let error = SensorModel::new(with(field, value)).unwrap_err();
            assert_eq!(error.field, *field, "{value}: {error}");
            assert!(error.value == value || value.is_nan() && error.value.is_nan(), "{error}");
            assert!(error.to_string().starts_with(field), "{error}");
        }
    }
}

#[test]
fn the_ends_of_the_ranges_are_accepted() {
    let cases: &[(&str, &[f64])] = &[
        ("range_error.minus", &[0.0, 80.9]),
        ("range_error.plus", &[0.0, 1e6]),
        ("beam_opening", &[0.0, 5e-324, std::f64::consts::PI.next_down()]),
        ("beam_diameter", &[0.0, 100.0]),
        ("range_min", &[0.0, 80.9]),
        ("range_max", &[0.1, 1e6]),
        ("no_return_free_to", &[0.0, 8.0, 81.0 - 0.035]),
        ("beam_angle_error", &[0.0, 0.5]),
        ("mount.x", &[-100.0, 100.0]),
        ("mount.theta", &[-1000.0, 1000.0]),
    ];
    for (field, values) in cases {
        for value in *values {
            let spec = with(field, *value);
            assert_eq!(SensorModel::new(spec).unwrap().spec(), &spec);
        }
    }
}

#[test]
fn a_no_return_is_free_no_farther_than_a_reading_just_below_the_limit_would_be() {
    // 5.6 as a 32-bit float is below 5.6: an obstacle measured at 5.5999998 travels as range_max.
    for range_max in [5.6, 8.0, 81.0, 81.83, 0.1] {
        let minus = 0.03;
        let free_to = range_max - minus;
        let spec = SensorSpec {
            range_max,
            range_error_minus: minus,
            no_return_free_to: Some(free_to),
            ..SensorSpec::default()
        };
        let used = SensorModel::new(spec).unwrap().no_return_free_to().unwrap();
        // The smallest 64-bit range whose 32-bit form is at range_max or beyond is half an ulp below that.
        let limit = range_max as f32;
        let least = 0.5 * (f64::from(limit) + f64::from(limit.next_down()));
        assert!(used <= least - minus, "{range_max}: {used}");
        assert!(used > free_to - 1e-5);
    }
    assert_eq!(SensorModel::new(SensorSpec::default()).unwrap().no_return_free_to(), None);
    let near = SensorModel::new(with("no_return_free_to", 8.0)).unwrap();
    assert_eq!(near.no_return_free_to(), Some(8.0));
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(20_000))]
    #[test]
    fn any_bits_are_accepted_or_refused_by_the_name_of_a_field(
        bits in prop::array::uniform11(any::<u64>()), everyday in prop::array::uniform11(0.0..2.0_f64),
        choice in any::<u16>(), free in any::<bool>(),
    ) {
        let v = |i: usize| if choice & (1 << i) == 0 { everyday[i] } else { f64::from_bits(bits[i]) };
        let spec = SensorSpec {
            range_error_minus: v(0), range_error_plus: v(1), beam_opening: v(2), beam_diameter: v(3), range_min: v(4),
            range_max: v(5), no_return_free_to: free.then(|| v(6)), beam_angle_error: v(7),
            mount: Mount { x: v(8), y: v(9), theta: v(10) },
        };
        match SensorModel::new(spec) {
            Ok(model) => {
                let s = model.spec();
                prop_assert!(s.range_max.is_finite() && s.range_min < s.range_max && s.range_error_minus < s.range_max);
                prop_assert!((0.0..std::f64::consts::PI).contains(&s.beam_opening));
                for length in [s.range_min, s.range_error_minus, s.range_error_plus, s.beam_diameter, s.beam_angle_error] {
                    prop_assert!(length >= 0.0 && length.is_finite());
                }
                prop_assert!(s.mount.x.is_finite() && s.mount.y.is_finite() && s.mount.theta.is_finite());
                prop_assert!(model.no_return_free_to().is_none_or(|f| (0.0..s.range_max).contains(&f)));
            }
            Err(error) => {
                prop_assert!(FIELDS.contains(&error.field) || error.field == "no_return_free_to", "{}", error);
                prop_assert!(!error.problem.is_empty());
            }
        }
    }
}

//! Any numbers at all: the service answers or refuses by name, it does not panic, and refusals change nothing.

#![allow(clippy::unwrap_used, reason = "tests")]

use super::service_support::{TestStore, config, config_of, map_name, open, ring};
use proptest::collection::vec;
use proptest::prelude::*;
use std::sync::LazyLock;
use tokio::runtime::Runtime;
use ubbmap::mapping::EvidenceRule;
use ubbmap::sensor::Angles;
use ubbmap::service::{BoxQuery, ErrorKind, MapService, RawPose, ScanInput, ServiceError, ServiceSettings};

static SERVICE: LazyLock<(Runtime, MapService)> = LazyLock::new(|| {
    let runtime = Runtime::new().unwrap();
    let settings = ServiceSettings { max_cells: 100_000, max_leaves: 2_000, ..ServiceSettings::default() };
    let service = open(&TestStore::new(), settings);
    runtime.block_on(async {
        for (name, config) in [
            ("hall", config()),
            ("deep", config_of(0.01, 24, 255, EvidenceRule::Outer)),
            ("flat", config_of(0.5, 1, 4, EvidenceRule::Inner)),
        ] {
            service.create_map(&map_name(name), config).await.unwrap();
            service.insert(&map_name(name), vec![ring("", None, 0.0)]).await.unwrap();
        }
    });
    (runtime, service)
});

fn map() -> impl Strategy<Value = &'static str> {
    prop::sample::select(vec!["hall", "deep", "flat"])
}

/// Numbers of every kind, most of them near what is sensible.
fn number() -> impl Strategy<Value = f64> {
    let edges = vec![0.0, -0.0, 12.8, -12.8, 1.0, f64::NAN, f64::INFINITY, f64::NEG_INFINITY, 5e-324, 1e9, -1e9, 1e308];
    prop_oneof![5 => -20.0..20.0, 2 => prop::sample::select(edges), 1 => any::<f64>()]
}

fn pair() -> impl Strategy<Value = (f64, f64)> {
    prop_oneof![4 => (-10.0..10.0, 0.0..0.3).prop_map(|(lo, w)| (lo, lo + w)), 1 => (number(), number())]
}

fn depth() -> impl Strategy<Value = Option<u32>> {
    prop::option::of(prop_oneof![4 => 0..26_u32, 1 => any::<u32>()])
}

fn scan() -> impl Strategy<Value = ScanInput> {
    let range = prop_oneof![4 => 0.0_f32..12.0, 1 => any::<f32>(), 1 => Just(f32::NAN)];
    let angles = prop_oneof![
        3 => (-4.0..4.0, -0.1..0.1).prop_map(|(min, increment)| Angles::Uniform { min, increment }),
        1 => (number(), number()).prop_map(|(min, increment)| Angles::Uniform { min, increment }),
        1 => vec(number(), 0..20).prop_map(Angles::Listed),
    ];
    let robot = prop::sample::select(vec!["", "amr-1", "a b", "ä", "x"]);
    let small = prop_oneof![3 => Just(0.0), 1 => 0.0..0.5, 1 => number()];
    let pose = prop::option::weighted(0.9, (pair(), pair(), pair()));
    (robot, prop::option::of(0..2000_u64), pose, angles, vec(range, 0..60), (small.clone(), small.clone(), small))
        .prop_map(|(robot, sequence, pose, angles, ranges, (footprint_radius, sweep_rotation, sweep_translation))| {
            ScanInput {
                robot: robot.to_owned(),
                sequence,
                stamp: f64::NAN,
                sensor: String::new(),
                pose: pose.map(|(x, y, theta)| RawPose { x, y, theta }),
                angles,
                ranges,
                footprint_radius,
                sweep_rotation,
                sweep_translation,
            }
        })
}

/// A refusal is one that names what is wrong, never a failure of the server.
fn held<T>(answer: Result<T, ServiceError>, kinds: &[ErrorKind]) -> Option<T> {
    answer.map_err(|error| assert!(kinds.contains(&error.kind), "{error:?}")).ok()
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(400))]

    #[test]
    fn boxes_tiles_and_points_of_any_numbers(
        map in map(),
        bounds in vec(prop::option::of(number()), 4),
        depth in depth(),
        tile in (0..26_u32, any::<u32>(), any::<u32>(), any::<bool>()),
        points in vec((number(), number()), 0..20),
    ) {
        let (runtime, service) = &*SERVICE;
        let name = map_name(map);
        let query = BoxQuery { min_x: bounds[0], min_y: bounds[1], max_x: bounds[2], max_y: bounds[3], depth };
        let boxes = [ErrorKind::InvalidRegion, ErrorKind::DepthOutOfRange, ErrorKind::RegionTooLarge];
        runtime.block_on(async {
            if let Some(grid) = held(service.grid(&name, &query).await, &boxes) {
                assert_eq!(grid.classes.len(), grid.width as usize * grid.height as usize);
                assert!(grid.classes.len() <= 100_000 && grid.min.0.is_finite() && grid.min.1.is_finite());
            }
            if let Some(region) = held(service.region(&name, &query).await, &boxes) {
                assert!(region.leaves.len() <= 2_000);
            }
            let (z, x, y, fold) = tile;
            let fold = |v: u32| if fold && z < 32 { v % (1 << z) } else { v };
            let tile = held(service.tile(&name, z, fold(x), fold(y)).await, &[ErrorKind::TileOutOfRange]);
            assert!(tile.is_none_or(|tile| tile.classes.len() == 65_536));
            let kinds = [ErrorKind::InvalidPoint, ErrorKind::DepthOutOfRange];
            let classes = held(service.classes(&name, &points, depth).await, &kinds);
            assert!(classes.is_none_or(|answer| answer.classes.len() == points.len()));
        });
    }

    #[test]
    fn scans_of_any_numbers(map in map(), scans in vec(scan(), 1..6)) {
        let (runtime, service) = &*SERVICE;
        let name = map_name(map);
        let count = scans.len();
        let answer = runtime.block_on(service.insert(&name, scans)).unwrap();
        prop_assert_eq!(answer.applied as usize + answer.duplicates as usize + answer.rejected.len(), count);
        for rejection in &answer.rejected {
            prop_assert!(rejection.code != "INTERNAL" && !rejection.detail.is_empty(), "{:?}", rejection);
        }
    }
}

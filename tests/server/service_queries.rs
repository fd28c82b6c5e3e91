//! Queries against the leaves that a plain walk of the tree gives, and their limits.

#![allow(clippy::unwrap_used, reason = "tests")]

use super::service_support::{TestStore, applied, config, config_of, hall, leaves, map_name, open, ring};
use ubbmap::mapping::{EvidenceRule, Reason, Region};
use ubbmap::quadtree::{Class, Leaf, OccupancyTree};
use ubbmap::service::{BoxQuery, ErrorKind, MapService, ScanInput, ServiceSettings};
use ubbmap::store::MapName;

/// Classes of all 256 x 256 leaves of the test map, row-major, drawn from the quadtree's leaves.
fn picture(tree: &OccupancyTree) -> Vec<Class> {
    let side = 1_usize << tree.depth();
    let mut classes = vec![0; side * side];
    for Leaf { node, class } in leaves(tree) {
        let size = 1 << (tree.depth() - node.depth);
        for row in 0..size {
            let start = (node.y as usize * size + row) * side + node.x as usize * size;
            classes[start..start + size].fill(class);
        }
    }
    classes
}

fn scans() -> Vec<ScanInput> {
    (0..12).map(|i| ring("", None, 0.31 * f64::from(i))).collect()
}

/// A service with the map `hall` of a few scans, and the picture of its leaves.
async fn drawn(settings: ServiceSettings) -> (MapService, MapName, Vec<Class>) {
    let store = TestStore::new();
    let (service, name) = hall(&store, settings).await;
    service.insert(&name, scans()).await.unwrap();
    let picture = picture(&applied(&config(), &scans()));
    assert!(picture.contains(&1) && picture.iter().any(|class| *class > 5), "something free, something occupied");
    (service, name, picture)
}

/// The maximum of a picture below the node `(depth, x, y)` of the test map of depth 8.
fn maximum(picture: &[Class], depth: u8, x: u32, y: u32) -> Class {
    let size = 1_usize << (8 - depth);
    let (left, bottom) = (x as usize * size, y as usize * size);
    (bottom..bottom + size).flat_map(|row| &picture[row * 256 + left..][..size]).copied().max().unwrap()
}

fn boxed(min_x: f64, min_y: f64, max_x: f64, max_y: f64, depth: Option<u32>) -> BoxQuery {
    BoxQuery { min_x: Some(min_x), min_y: Some(min_y), max_x: Some(max_x), max_y: Some(max_y), depth }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_grid_is_the_maximum_of_the_leaves_below_each_cell() {
    let (service, name, picture) = drawn(ServiceSettings::default()).await;
    for depth in 0..=8_u8 {
        let query = BoxQuery { depth: Some(depth.into()), ..BoxQuery::default() };
        let grid = service.grid(&name, &query).await.unwrap();
        let side = 1_u32 << depth;
        assert_eq!((grid.x, grid.y, grid.width, grid.height, grid.depth), (0, 0, side, side, depth));
        let expected: Vec<Class> = (0..side)
            .flat_map(|y| (0..side).map(move |x| (x, y)))
            .map(|(x, y)| maximum(&picture, depth, x, y))
            .collect();
        assert_eq!(grid.classes, expected, "depth {depth}");
        assert!((grid.cell_size * f64::from(side) - 25.6).abs() < 1e-9 && grid.min == config().grid().origin());
        assert_eq!((grid.class_count, grid.revision), (10, 1));
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_grid_of_a_box_has_the_cells_that_it_reaches_into() {
    let (service, name, picture) = drawn(ServiceSettings::default()).await;
    // 0.3 = leaf edge 131; half-open, so the leaf that begins at 1.0 is not in it.
    let grid = service.grid(&name, &boxed(0.3, -0.45, 1.0, 0.2, None)).await.unwrap();
    assert_eq!((grid.x, grid.y, grid.width, grid.height), (131, 123, 7, 7));
    assert!((grid.min.0 - 0.3).abs() < 1e-9 && (grid.min.1 + 0.5).abs() < 1e-9);
    for (i, class) in grid.classes.iter().enumerate() {
        assert_eq!(*class, picture[(123 + i / 7) * 256 + 131 + i % 7]);
    }
    let coarse = service.grid(&name, &boxed(0.3, -0.45, 1.0, 0.2, Some(6))).await.unwrap();
    assert_eq!((coarse.x, coarse.y, coarse.width, coarse.height), (32, 30, 3, 3));
    assert_eq!(coarse.classes[4], maximum(&picture, 6, 33, 31));
    // Held to the root; outside of it, or without area: empty.
    let corner = service.grid(&name, &boxed(-99.0, -99.0, -12.55, -12.65, None)).await.unwrap();
    assert_eq!((corner.x, corner.y, corner.width, corner.height), (0, 0, 3, 2));
    for empty in [boxed(20.0, 0.0, 30.0, 1.0, None), boxed(1.0, 1.0, 1.0, 2.0, Some(3))] {
        let grid = service.grid(&name, &empty).await.unwrap();
        assert!(grid.classes.is_empty() && u64::from(grid.width) * u64::from(grid.height) == 0);
    }
    let beyond = BoxQuery { min_x: Some(500.0), ..BoxQuery::default() };
    assert!(service.grid(&name, &beyond).await.unwrap().classes.is_empty(), "no more inverted than empty");
    assert!(service.region(&name, &beyond).await.unwrap().leaves.is_empty());
}

#[tokio::test(flavor = "multi_thread")]
async fn a_region_is_the_leaves_that_cover_the_box() {
    let (service, name, picture) = drawn(ServiceSettings::default()).await;
    for (query, x, y) in [
        (BoxQuery::default(), 0..256, 0..256),
        (boxed(-3.2, -1.0, 2.0, 3.05, None), 96..148, 118..159),
        (boxed(-3.2, -1.0, 2.0, 3.05, Some(5)), 96..148, 118..159),
    ] {
        let answer = service.region(&name, &query).await.unwrap();
        let mut covered = vec![0_u8; 256 * 256];
        for Leaf { node, class } in &answer.leaves {
            assert!(node.depth <= answer.depth);
            assert_eq!(*class, maximum(&picture, node.depth, node.x, node.y));
            let size = 256_u32 >> node.depth;
            for cell_y in node.y * size..(node.y + 1) * size {
                for cell_x in node.x * size..(node.x + 1) * size {
                    covered[(cell_y * 256 + cell_x) as usize] += 1;
                }
            }
            assert!(node.x * size < x.end && (node.x + 1) * size > x.start, "meets the box");
            assert!(node.y * size < y.end && (node.y + 1) * size > y.start, "meets the box");
        }
        let inside = y.flat_map(|y| x.clone().map(move |x| (y * 256 + x) as usize));
        assert!(inside.clone().all(|i| covered[i] == 1), "each leaf of the box once");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn classes_are_read_by_half_open_cells() {
    let (service, name, picture) = drawn(ServiceSettings::default()).await;
    let points: Vec<(f64, f64)> =
        (0..3000).map(|i| (f64::from(i) * 0.0083 - 12.40375, f64::from(i % 97) * 0.13 - 6.003)).collect();
    for depth in [None, Some(8), Some(5), Some(0)] {
        let answer = service.classes(&name, &points, depth).await.unwrap();
        let depth = depth.unwrap_or(8) as u8;
        assert_eq!((answer.depth, answer.classes.len()), (depth, points.len()));
        for ((x, y), class) in points.iter().zip(&answer.classes) {
            let cell = |v: f64| ((v + 12.8) / 0.1).floor() as u32 >> (8 - depth);
            assert_eq!(*class, maximum(&picture, depth, cell(*x), cell(*y)), "{x} {y}");
        }
    }
    let outside = service.classes(&name, &[(12.8, 0.0), (0.0, -12.81), (1e300, 0.0)], None).await.unwrap();
    assert_eq!(outside.classes, [5, 5, 5], "unknown");
    assert!(service.classes(&name, &[], None).await.unwrap().classes.is_empty());
}

#[tokio::test(flavor = "multi_thread")]
async fn tiles_repeat_the_leaves_where_they_are_finer() {
    let (service, name, picture) = drawn(ServiceSettings::default()).await;
    let whole = service.tile(&name, 0, 0, 0).await.unwrap();
    assert_eq!((whole.depth, whole.x, whole.y, whole.width, whole.height), (8, 0, 0, 256, 256));
    assert_eq!(whole.classes, picture);
    let quarter = service.tile(&name, 2, 2, 1).await.unwrap();
    assert_eq!((quarter.depth, quarter.x, quarter.y, quarter.width), (10, 512, 256, 256));
    assert!((quarter.cell_size - 0.025).abs() < 1e-12);
    assert!(quarter.min.0.abs() < 1e-9 && (quarter.min.1 + 6.4).abs() < 1e-9);
    for (i, class) in quarter.classes.iter().enumerate() {
        assert_eq!(*class, picture[(64 + i / 256 / 4) * 256 + 128 + i % 256 / 4]);
    }
    let leaf = service.tile(&name, 8, 130, 128).await.unwrap();
    assert!(leaf.classes.len() == 65_536 && leaf.classes.iter().all(|class| *class == picture[128 * 256 + 130]));
    for (z, x, y, field) in [(9, 0, 0, "z"), (300, 0, 0, "z"), (2, 4, 0, "x"), (2, 0, 4, "y"), (0, u32::MAX, 0, "x")] {
        let error = service.tile(&name, z, x, y).await.unwrap_err();
        assert_eq!((error.kind, error.field.as_deref()), (ErrorKind::TileOutOfRange, Some(field)));
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn tiles_of_the_deepest_and_the_flattest_map() {
    let service = open(&TestStore::new(), ServiceSettings::default());
    let (deep, flat) = (map_name("deep"), map_name("flat"));
    service.create_map(&deep, config_of(0.01, 24, 10, EvidenceRule::Guaranteed)).await.unwrap();
    service.create_map(&flat, config_of(0.5, 1, 10, EvidenceRule::Guaranteed)).await.unwrap();
    let last = (1 << 24) - 1;
    let tile = service.tile(&deep, 24, last, last).await.unwrap();
    assert_eq!((tile.depth, tile.x, tile.y), (32, last * 256, last * 256));
    assert!(tile.classes.iter().all(|class| *class == 5));
    assert_eq!(service.tile(&deep, 16, 65_535, 0).await.unwrap().depth, 24);
    assert_eq!(service.tile(&flat, 0, 0, 0).await.unwrap().classes, vec![5; 65_536]);
    assert_eq!(service.tile(&flat, 1, 1, 1).await.unwrap().classes.len(), 65_536);
}

#[tokio::test(flavor = "multi_thread")]
async fn guaranteed_free_is_answered_for_all_regions_in_order() {
    let (service, name, _) = drawn(ServiceSettings::default()).await;
    let regions = [
        Region::disc((1.5, 0.0), 0.4).unwrap(),
        Region::disc((-3.0, 0.0), 0.3).unwrap(),
        Region::rectangle((8.0, 8.0), (9.0, 9.0)).unwrap(),
    ];
    let answers = service.guaranteed_free(&name, &regions, 0).await.unwrap();
    assert!(answers.sound && answers.revision == 1 && answers.depth == 8);
    let reasons: Vec<_> = answers.results.iter().map(|answer| answer.refusal.map(|(reason, _)| reason)).collect();
    assert_eq!(reasons, [None, Some(Reason::Occupied), Some(Reason::Unknown)]);
    assert!(service.guaranteed_free(&name, &regions, 3).await.unwrap().results[0].free, "twelve scans saw it free");
    let error = service.guaranteed_free(&name, &regions, 4).await.unwrap_err();
    assert_eq!((error.kind, error.field.as_deref()), (ErrorKind::ToleranceTooHigh, Some("tolerance")));
    assert!(error.detail.contains('3'), "names the largest: {}", error.detail);
    assert_eq!(service.guaranteed_free(&name, &regions, 1 << 20).await.unwrap_err().kind, ErrorKind::ToleranceTooHigh);
    let outer = map_name("outer");
    service.create_map(&outer, config_of(0.1, 8, 10, EvidenceRule::Outer)).await.unwrap();
    assert!(!service.guaranteed_free(&outer, &regions, 0).await.unwrap().sound);
}

#[tokio::test(flavor = "multi_thread")]
async fn limits_name_themselves_and_the_depth_that_fits() {
    let settings = ServiceSettings {
        max_points: 3,
        max_regions: 1,
        max_leaves: 300,
        max_cells: 1000,
        ..ServiceSettings::default()
    };
    let (service, name, _) = drawn(settings).await;
    let error = service.grid(&name, &BoxQuery::default()).await.unwrap_err();
    assert_eq!(error.kind, ErrorKind::RegionTooLarge);
    assert!(error.detail.contains("1000") && error.detail.contains("depth 4 fits"), "{}", error.detail);
    assert_eq!(
        service.grid(&name, &BoxQuery { depth: Some(4), ..BoxQuery::default() }).await.unwrap().classes.len(),
        256
    );
    let error = service.region(&name, &BoxQuery::default()).await.unwrap_err();
    assert_eq!(error.kind, ErrorKind::RegionTooLarge);
    let count = |depth: u8| {
        let tree = applied(&config(), &scans());
        let mut count = 0;
        let all = ubbmap::quadtree::LeafRange { min_x: 0, min_y: 0, max_x: 256, max_y: 256 };
        tree.visit_leaves(&all, depth, &mut |_| {
            count += 1;
            true
        });
        count
    };
    let fits = (0..8).rev().find(|depth| count(*depth) <= 300).unwrap();
    assert!(error.detail.contains("300") && error.detail.contains(&format!("depth {fits} fits")), "{}", error.detail);
    let query = BoxQuery { depth: Some(fits.into()), ..BoxQuery::default() };
    assert_eq!(service.region(&name, &query).await.unwrap().leaves.len(), count(fits));
    let points = [(0.0, 0.0); 4];
    assert_eq!(service.classes(&name, &points, None).await.unwrap_err().kind, ErrorKind::TooManyPoints);
    let region = Region::disc((0.0, 0.0), 1.0).unwrap();
    let regions = [region.clone(), region];
    assert_eq!(service.guaranteed_free(&name, &regions, 0).await.unwrap_err().kind, ErrorKind::TooManyRegions);
}

#[tokio::test(flavor = "multi_thread")]
async fn bad_boxes_points_and_depths_name_their_field() {
    let (service, name, _) = drawn(ServiceSettings::default()).await;
    for (query, field) in [
        (BoxQuery { min_x: Some(f64::NAN), ..BoxQuery::default() }, "min_x"),
        (BoxQuery { max_y: Some(f64::INFINITY), ..BoxQuery::default() }, "max_y"),
        (boxed(1.0, 0.0, 0.0, 1.0, None), "min_x"),
        (boxed(0.0, 1.0, 1.0, 0.5, None), "min_y"),
    ] {
        for error in [service.grid(&name, &query).await.unwrap_err(), service.region(&name, &query).await.unwrap_err()]
        {
            assert_eq!((error.kind, error.field.as_deref()), (ErrorKind::InvalidRegion, Some(field)));
        }
    }
    for depth in [9, 255, 256, u32::MAX] {
        let query = BoxQuery { depth: Some(depth), ..BoxQuery::default() };
        for error in [
            service.grid(&name, &query).await.unwrap_err(),
            service.region(&name, &query).await.unwrap_err(),
            service.classes(&name, &[(0.0, 0.0)], Some(depth)).await.unwrap_err(),
        ] {
            assert_eq!((error.kind, error.field.as_deref()), (ErrorKind::DepthOutOfRange, Some("depth")));
        }
    }
    for (point, field) in [((f64::NAN, 0.0), "points[1].x"), ((0.0, f64::NEG_INFINITY), "points[1].y")] {
        let error = service.classes(&name, &[(0.0, 0.0), point], None).await.unwrap_err();
        assert_eq!((error.kind, error.field.as_deref()), (ErrorKind::InvalidPoint, Some(field)));
    }
}

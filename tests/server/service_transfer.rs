//! Maps as files through the service: the same map leaf for leaf, or refused with the reason.

#![allow(clippy::unwrap_used, clippy::panic, reason = "tests")]

use super::service_support::{
    Keeping, TestStore, Writes, config, config_of, counts, hall, map_name, open, ring, served, snapshot_name, until,
};
use std::collections::BTreeSet;
use std::io::Read;
use std::sync::atomic::Ordering;
use std::time::Duration;
use ubbmap::mapping::EvidenceRule;
use ubbmap::service::{
    BoxQuery, ChangesQuery, ErrorKind, ExportForm, MapService, Nav2Mode, Raster, ServiceError, ServiceSettings,
};
use ubbmap::store::{MapName, read_map_file};

const NAV2: ExportForm = ExportForm::Nav2 { depth: None, mode: Nav2Mode::Trinary };

async fn filled(service: &MapService, name: &MapName) {
    service.create_map(name, config()).await.unwrap();
    let scan = |i: u64| ring(&format!("r{}", i % 3), Some(i), 0.5 * i as f64 - 4.0);
    for i in 0..17 {
        service.insert(name, vec![scan(i)]).await.unwrap();
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_map_that_is_exported_and_imported_is_the_same_and_goes_on() {
    for keeping in Keeping::all() {
        let service = keeping.service(ServiceSettings { cache_bytes: 2 * 5600, ..ServiceSettings::default() });
        let name = map_name("hall");
        filled(&service, &name).await;
        let file = service.export(&name, None, ExportForm::Ubbmap).await.unwrap();
        assert_eq!((file.file_name.as_str(), file.revision), ("hall-r17.ubbmap", 17));
        assert_eq!(service.export(&name, None, ExportForm::Ubbmap).await.unwrap(), file, "the same bytes");
        // Under another name, and on another server.
        let other = Keeping::all().pop().unwrap();
        let elsewhere = other.service(ServiceSettings::default());
        for (service, copy) in [(&service, map_name("copy")), (&elsewhere, name.clone())] {
            assert_eq!(service.import(&copy, file.bytes.clone()).await.unwrap().revision, 17);
            let (a, b) = (self_described(&keeping, &name).await, service.map(&copy).await.unwrap());
            assert_eq!((a.revision, &a.config, &a.robots), (b.revision, &b.config, &b.robots));
            assert_eq!(served(service, &copy).await, served(&keeping.service(ServiceSettings::default()), &name).await);
            let again =
                service.insert(&copy, vec![ring("r1", Some(17), 0.0), ring("r1", Some(19), 0.3)]).await.unwrap();
            assert_eq!((counts(&again), again.revision), ((2, 0, 0), 18));
            let dup = service.insert(&copy, vec![ring("r1", Some(13), 0.0)]).await.unwrap();
            assert_eq!(counts(&dup), (0, 1, 0), "sequence windows travel with the file");
            // What changed before the import is not known; from there on it is.
            assert!(service.changes(&copy, 16, &ChangesQuery::default()).await.unwrap().everything);
            let since = service.changes(&copy, 17, &ChangesQuery::default()).await.unwrap();
            assert!(!since.everything && !since.blocks.is_empty());
        }
        if other.is_durable() {
            assert_eq!(other.service(ServiceSettings::default()).map(&name).await.unwrap().revision, 18);
        }
    }
}

async fn self_described(keeping: &Keeping, name: &MapName) -> ubbmap::service::MapDescription {
    keeping.service(ServiceSettings::default()).map(name).await.unwrap()
}

#[tokio::test(flavor = "multi_thread")]
async fn a_snapshot_is_exported_as_it_was() {
    for keeping in Keeping::all() {
        let service = keeping.service(ServiceSettings::default());
        let name = map_name("hall");
        filled(&service, &name).await;
        let before = service.export(&name, None, ExportForm::Ubbmap).await.unwrap();
        let drawn = service.export(&name, None, NAV2).await.unwrap();
        service.take_snapshot(&name, &snapshot_name("then")).await.unwrap();
        service.insert(&name, (20..30).map(|i| ring("late", Some(i), 0.2 * i as f64 - 4.0)).collect()).await.unwrap();
        assert_ne!(service.export(&name, None, ExportForm::Ubbmap).await.unwrap().bytes, before.bytes);
        assert_eq!(service.export(&name, Some(&snapshot_name("then")), ExportForm::Ubbmap).await.unwrap(), before);
        assert_eq!(service.export(&name, Some(&snapshot_name("then")), NAV2).await.unwrap(), drawn);
        let missing = service.export(&name, Some(&snapshot_name("them")), NAV2).await.unwrap_err();
        assert_eq!((missing.kind, missing.field.as_deref()), (ErrorKind::SnapshotNotFound, Some("snapshot")));
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_snapshot_of_a_map_that_cannot_be_opened_is_exported() {
    let store = std::sync::Arc::new(ubbmap::store::MemoryStore::new());
    let name = map_name("hall");
    let port = || std::sync::Arc::clone(&store) as std::sync::Arc<dyn ubbmap::store::MapStore>;
    let service = MapService::open(port(), ServiceSettings::default()).unwrap();
    filled(&service, &name).await;
    service.take_snapshot(&name, &snapshot_name("last")).await.unwrap();
    let expected = service.export(&name, None, ExportForm::Ubbmap).await.unwrap();
    service.drain().await;
    let service = MapService::open(port(), ServiceSettings::default()).unwrap();
    for _ in 0..2 {
        store.fail_next_load("planted");
        let error = service.export(&name, None, ExportForm::Ubbmap).await.unwrap_err();
        assert_eq!(error.kind, ErrorKind::MapDamaged);
        assert!(error.detail.contains("snapshot \"last\" of revision 17"), "{}", error.detail);
    }
    store.fail_next_load("planted");
    store.fail_fetches(Some("planted"));
    let rescued = service.export(&name, Some(&snapshot_name("last")), ExportForm::Ubbmap).await.unwrap();
    assert_eq!(rescued, expected);
    assert_eq!(service.snapshots(&name).await.unwrap().len(), 1);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_file_that_was_cut_or_changed_is_refused_with_the_reason_and_leaves_nothing() {
    for keeping in Keeping::all() {
        let service = keeping.service(ServiceSettings::default());
        let name = map_name("hall");
        filled(&service, &name).await;
        let good = service.export(&name, None, ExportForm::Ubbmap).await.unwrap().bytes;
        let mut faults: Vec<(Vec<u8>, &str)> = vec![
            (Vec::new(), "not a map file"),
            (b"PK\x03\x04 something else that is longer than a header".to_vec(), "not a map file"),
            (good[..30].to_vec(), "it ends after 30 bytes"),
            (good[..good.len() - 1].to_vec(), "it is cut"),
            ([&good[..], b"x"].concat(), "something follows its end"),
        ];
        for at in (8..good.len()).step_by(good.len() / 40) {
            let mut changed = good.clone();
            changed[at] ^= 4;
            faults.push((changed, "map file"));
        }
        for (file, words) in faults {
            let error = service.import(&map_name("copy"), file).await.unwrap_err();
            assert_eq!((error.kind, error.field.as_deref()), (ErrorKind::InvalidFile, Some("data")), "{error:?}");
            assert!(error.detail.contains(words), "{words:?} is not in {:?}", error.detail);
        }
        let mut newer = good.clone();
        newer[11] = 2;
        let sum = crc32c::crc32c(&newer[..36]).to_be_bytes();
        newer[36..40].copy_from_slice(&sum);
        let error = service.import(&map_name("copy"), newer).await.unwrap_err();
        assert!(error.detail.contains("format version 2, this program reads up to 1"), "{}", error.detail);
        assert_eq!(service.maps().await.unwrap().len(), 1);
        assert_eq!(keeping.store.list().unwrap().len(), 1);
        assert!(service.create_map(&map_name("copy"), config()).await.unwrap().created, "the name is free");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn of_many_imports_and_creations_of_one_name_exactly_one_wins() {
    for keeping in Keeping::all() {
        let service = keeping.service(ServiceSettings { max_maps: 3, ..ServiceSettings::default() });
        let name = map_name("hall");
        filled(&service, &name).await;
        let file = service.export(&name, None, ExportForm::Ubbmap).await.unwrap().bytes;
        let mut racers = tokio::task::JoinSet::new();
        for at in 0..8 {
            let (service, file) = (service.clone(), file.clone());
            racers.spawn(async move {
                if at % 4 == 3 {
                    let other = config_of(0.1, 8, 12, EvidenceRule::Guaranteed);
                    service.create_map(&map_name("copy"), other).await.map(|created| created.created)
                } else {
                    service.import(&map_name("copy"), file).await.map(|_| true)
                }
            });
        }
        let (mut won, mut found) = (0, 0);
        for outcome in racers.join_all().await {
            match outcome {
                Ok(true) => won += 1,
                // Two creations of one configuration: the second finds the map there.
                Ok(false) => found += 1,
                Err(error) => assert_eq!(error.kind, ErrorKind::MapExists, "{error:?}"),
            }
        }
        assert!(won == 1 && found <= 1, "{won} {found}");
        assert_eq!(service.import(&name, file.clone()).await.unwrap_err().kind, ErrorKind::MapExists);
        service.import(&map_name("third"), file.clone()).await.unwrap();
        let full = service.import(&map_name("fourth"), file).await.unwrap_err();
        assert_eq!(full.kind, ErrorKind::TooManyMaps);
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn an_import_that_fails_leaves_nothing_and_one_whose_client_leaves_goes_on() {
    let store = TestStore::new();
    let (service, name) = hall(&store, ServiceSettings::default()).await;
    service.insert(&name, vec![ring("a", Some(1), 0.0)]).await.unwrap();
    let file = service.export(&name, None, ExportForm::Ubbmap).await.unwrap().bytes;
    let copy = map_name("copy");
    for (writes, kind) in [(Writes::FailOnce, ErrorKind::StoreFailed), (Writes::PanicOnce, ErrorKind::Internal)] {
        store.set_writes(writes);
        assert_eq!(service.import(&copy, file.clone()).await.unwrap_err().kind, kind);
        assert_eq!(service.map(&copy).await.unwrap_err().kind, ErrorKind::MapNotFound);
    }
    let few = open(&store, ServiceSettings { max_robots: 0, ..ServiceSettings::default() });
    let error = few.import(&copy, file.clone()).await.unwrap_err();
    assert_eq!(error.kind, ErrorKind::InvalidFile);
    assert!(error.detail.contains("robots 1, the limit is 0"), "{}", error.detail);
    let small = open(&store, ServiceSettings { max_import_bytes: 50, ..ServiceSettings::default() });
    assert_eq!(small.import(&copy, file.clone()).await.unwrap_err().kind, ErrorKind::InvalidFile);
    drop((few, small));
    store.hold();
    let importing = tokio::spawn({
        let (service, copy, file) = (service.clone(), copy.clone(), file.clone());
        async move { service.import(&copy, file).await }
    });
    until("the import hangs", || store.waiting.load(Ordering::SeqCst) == 1).await;
    // Its name is taken, and other maps are made meanwhile.
    assert_eq!(service.import(&copy, file).await.unwrap_err().kind, ErrorKind::MapExists);
    assert_eq!(service.create_map(&copy, config()).await.unwrap_err().kind, ErrorKind::MapExists);
    let made = tokio::time::timeout(Duration::from_secs(5), service.create_map(&map_name("other"), config())).await;
    assert!(made.unwrap().unwrap().created);
    importing.abort();
    store.release();
    service.drain().await;
    assert_eq!(service.map(&copy).await.unwrap().revision, 1);
}

/// What Nav2's map server would read (nav2_map_server, map_io.cpp): the lower left corner, and -1, 0..100 row by row
/// from below.
struct Nav2Map {
    yaml: String,
    size: (usize, usize),
    cells: Vec<i32>,
}

impl Nav2Map {
    fn of(zip: &[u8]) -> Self {
        let mut archive = zip::ZipArchive::new(std::io::Cursor::new(zip)).unwrap();
        let mut part = |name: &str| {
            let mut bytes = Vec::new();
            archive.by_name(name).unwrap().read_to_end(&mut bytes).unwrap();
            bytes
        };
        let (yaml, pgm) = (String::from_utf8(part("map.yaml")).unwrap(), part("map.pgm"));
        let mut words = pgm.split(|byte| *byte == b' ' || *byte == b'\n');
        assert_eq!(words.next().unwrap(), b"P5");
        let mut number = || std::str::from_utf8(words.next().unwrap()).unwrap().parse::<usize>().unwrap();
        let size = (number(), number());
        assert_eq!(number(), 255);
        let pixels = &pgm[pgm.len() - size.0 * size.1..];
        let map = Self { yaml, size, cells: Vec::new() };
        let (free, occupied) = (map.value("free_thresh"), map.value("occupied_thresh"));
        let scale = map.text("mode") == "scale";
        let cell = |pixel: &u8| {
            let occ = 1.0 - f64::from(*pixel) / 255.0;
            if occupied < occ {
                100
            } else if occ < free {
                0
            } else if scale {
                ((occ - free) / (occupied - free) * 100.0).round() as i32
            } else {
                -1
            }
        };
        Self { cells: pixels.chunks(size.0).rev().flatten().map(cell).collect(), ..map }
    }

    fn text(&self, key: &str) -> &str {
        let line = self.yaml.lines().find(|line| line.starts_with(&format!("{key}: "))).unwrap();
        line.split_once(": ").unwrap().1
    }

    fn value(&self, key: &str) -> f64 {
        self.text(key).parse().unwrap()
    }

    /// The cells of a grid that the image covers; all others must be unknown.
    fn part_of(&self, grid: &Raster, unknown: u8) -> Vec<u8> {
        let origin: Vec<f64> =
            self.text("origin").trim_matches(['[', ']']).split(", ").map(|word| word.parse().unwrap()).collect();
        let place = |value: f64, min: f64| ((value - min) / grid.cell_size).round() as usize;
        let (x, y) = (place(origin[0], grid.min.0), place(origin[1], grid.min.1));
        let width = grid.width as usize;
        let inside =
            |at: usize| (x..x + self.size.0).contains(&(at % width)) && (y..y + self.size.1).contains(&(at / width));
        assert!(grid.classes.iter().enumerate().all(|(at, class)| inside(at) || *class == unknown));
        grid.classes.iter().enumerate().filter(|(at, _)| inside(*at)).map(|(_, class)| *class).collect()
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_map_for_nav2_says_free_exactly_where_the_grid_is_below_unknown() {
    let store = TestStore::new();
    let service = open(&store, ServiceSettings::default());
    for classes in [4, 5, 10, 255] {
        let name = map_name(&format!("k{classes}"));
        let unknown = (classes / 2) as u8;
        service.create_map(&name, config_of(0.1, 8, classes, EvidenceRule::Guaranteed)).await.unwrap();
        for step in 0..6 {
            service.insert(&name, vec![ring("a", Some(step), 0.5 * step as f64)]).await.unwrap();
        }
        for depth in [8, 7, 5, 0] {
            let grid = BoxQuery { depth: Some(depth), ..BoxQuery::default() };
            let grid = service.grid(&name, &grid).await.unwrap();
            let form = |mode| ExportForm::Nav2 { depth: Some(depth), mode };
            let file = service.export(&name, None, form(Nav2Mode::Trinary)).await.unwrap();
            assert_eq!((file.file_name, file.revision), (format!("{name}-r6-nav2.zip"), 6));
            let map = Nav2Map::of(&file.bytes);
            assert_eq!((map.text("image"), map.text("negate"), map.text("mode")), ("map.pgm", "0", "trinary"));
            assert_eq!(map.value("resolution"), grid.cell_size);
            // Leaves of 0.1 m begin at tenths; a sum of binary numbers wrote -24.699999999999818.
            let origin = map.text("origin").trim_matches(['[', ']']).split(", ");
            assert!(origin.clone().count() == 3 && origin.clone().all(|word| word.len() < 7), "{}", map.text("origin"));
            let part = map.part_of(&grid, unknown);
            let expected = part.iter().map(|class| match class.cmp(&unknown) {
                std::cmp::Ordering::Less => 0,
                std::cmp::Ordering::Equal => -1,
                std::cmp::Ordering::Greater => 100,
            });
            assert_eq!(map.cells, expected.collect::<Vec<i32>>(), "k {classes}, depth {depth}");
            // In shades nothing that is not proven free is free, and more occupied is never lighter.
            let map = Nav2Map::of(&service.export(&name, None, form(Nav2Mode::Scale)).await.unwrap().bytes);
            assert_eq!(map.text("mode"), "scale");
            let part = map.part_of(&grid, unknown);
            let pairs: BTreeSet<(u8, i32)> = part.iter().copied().zip(map.cells.iter().copied()).collect();
            assert!(pairs.iter().all(|(class, cell)| *class < unknown || *cell > 0), "{pairs:?}");
            let shades: Vec<i32> = pairs.iter().map(|(_, cell)| *cell).collect();
            assert!(shades.is_sorted() && shades.len() == part.iter().collect::<BTreeSet<_>>().len(), "{pairs:?}");
        }
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_map_for_nav2_has_a_cell_and_a_limit() {
    let store = TestStore::new();
    let (service, name) = hall(&store, ServiceSettings { max_cells: 100, ..ServiceSettings::default() }).await;
    let map = Nav2Map::of(&service.export(&name, None, NAV2).await.unwrap().bytes);
    assert_eq!((map.size, map.cells.as_slice()), ((1, 1), &[-1][..]), "an empty map");
    service.insert(&name, vec![ring("a", Some(0), 0.0)]).await.unwrap();
    let form = |depth| ExportForm::Nav2 { depth: Some(depth), mode: Nav2Mode::Trinary };
    let error: ServiceError = service.export(&name, None, form(8)).await.unwrap_err();
    assert_eq!((error.kind, error.field.as_deref()), (ErrorKind::RegionTooLarge, Some("depth")));
    let fits: u32 = error.detail.rsplit("depth ").next().unwrap().split(" fits").next().unwrap().parse().unwrap();
    let drawn = Nav2Map::of(&service.export(&name, None, form(fits)).await.unwrap().bytes);
    assert!(drawn.cells.len() <= 100 && drawn.cells.contains(&100), "{:?}", drawn.size);
    assert_eq!(service.export(&name, None, form(fits + 1)).await.unwrap_err().kind, ErrorKind::RegionTooLarge);
    assert_eq!(service.export(&name, None, form(9)).await.unwrap_err().kind, ErrorKind::DepthOutOfRange);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_file_is_of_one_revision_while_robots_write() {
    let keeping = Keeping::all().remove(0);
    let service = keeping.service(ServiceSettings { cache_bytes: 2 * 5600, ..ServiceSettings::default() });
    let name = map_name("hall");
    service.create_map(&name, config()).await.unwrap();
    let scans: Vec<_> = (0..150).map(|i| ring("a", Some(i), f64::from(i as u32 * 7 % 19) - 9.0)).collect();
    let writing = tokio::spawn({
        let (service, name, scans) = (service.clone(), name.clone(), scans.clone());
        async move {
            for scan in scans {
                service.insert(&name, vec![scan]).await.unwrap();
            }
        }
    });
    let mut revisions = BTreeSet::new();
    while !writing.is_finished() {
        let file = service.export(&name, None, ExportForm::Ubbmap).await.unwrap();
        let (_, map) = read_map_file(&mut file.bytes.as_slice()).unwrap();
        assert_eq!(map.revision, file.revision);
        if revisions.insert(map.revision) {
            let expected = super::service_support::applied(&config(), &scans[..map.revision as usize]);
            assert!(map.tree == expected, "at {}", map.revision);
            assert_eq!(map.windows.values().map(|window| window.count()).sum::<u64>(), map.revision);
        }
    }
    writing.await.unwrap();
    assert!(revisions.len() > 3, "{revisions:?}");
}

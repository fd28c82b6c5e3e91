//! Keys and gaps.
#![allow(clippy::unwrap_used, reason = "tests")]

use super::gaps::{Came, Gaps};
use super::keys::{self, Operation, Target, target};
use crate::service::ErrorKind;
use crate::store::MapName;

#[test]
fn every_key_of_the_interface_names_its_operation() {
    let hall = || MapName::new("hall").unwrap();
    let operation = |operation| Target::Operation(hall(), operation);
    for (key, expected) in [
        ("ubbmap", Target::Maps),
        ("ubbmap/*", Target::Maps),
        ("ubbmap/hall", Target::Map(hall())),
        ("ubbmap/hall/create", operation(Operation::Create)),
        ("ubbmap/hall/delete", operation(Operation::Delete)),
        ("ubbmap/hall/insert/amr-7", operation(Operation::Insert("amr-7".to_owned()))),
        ("ubbmap/hall/classes", operation(Operation::Classes)),
        ("ubbmap/hall/region", operation(Operation::Region)),
        ("ubbmap/hall/grid", operation(Operation::Grid)),
        ("ubbmap/hall/tiles/8/127/3", operation(Operation::Tile(["8", "127", "3"].map(str::to_owned)))),
        ("ubbmap/hall/guaranteed-free", operation(Operation::GuaranteedFree)),
        ("ubbmap/hall/changes", operation(Operation::Changes)),
    ] {
        assert_eq!(target("ubbmap", key).unwrap().unwrap(), expected, "{key}");
        let deep = format!("site/two/{key}");
        assert_eq!(target("site/two/ubbmap", &deep).unwrap().unwrap(), expected, "{deep}");
    }
    for (key, kind) in [
        ("ubbmap/hall/nothing", ErrorKind::RouteNotFound),
        ("ubbmap/hall/insert", ErrorKind::RouteNotFound),
        ("ubbmap/hall/tiles/1/2", ErrorKind::RouteNotFound),
        ("ubbmap/hall/**", ErrorKind::RouteNotFound),
        ("ubbmap/*/region", ErrorKind::InvalidName),
        ("ubbmap/Hall", ErrorKind::InvalidName),
        ("ubbmap/**", ErrorKind::InvalidName),
    ] {
        assert_eq!(target("ubbmap", key).unwrap().unwrap_err().kind, kind, "{key}");
    }
    for key in ["**", "*", "*/hall", "ubbmaps", "other/hall"] {
        assert!(target("ubbmap", key).is_none(), "{key}");
    }
    assert_eq!(keys::scans("ubbmap", "ubbmap/hall/scans/amr-7"), Some(("hall", "amr-7")));
    for key in ["ubbmap/hall/scans", "ubbmap/hall/insert/amr-7", "ubbmap/hall/scans/a/b", "x/hall/scans/a"] {
        assert_eq!(keys::scans("ubbmap", key), None, "{key}");
    }
}

#[test]
fn numbers_that_did_not_come_are_counted() {
    let mut gaps = Gaps::default();
    let came: Vec<_> = [5, 6, 9, 8, 9, 10].iter().map(|sequence| gaps.note("hall", "a", *sequence)).collect();
    assert_eq!(came, [Came::InOrder, Came::InOrder, Came::After(2), Came::Late, Came::Late, Came::InOrder]);
    assert_eq!(gaps.note("hall", "b", 100), Came::InOrder);
    assert_eq!(gaps.note("yard", "a", 100), Came::InOrder);
    assert_eq!(gaps.note("hall", "a", u64::MAX), Came::After(u64::MAX - 11));
}

//! Grids and tiles over HTTP: each form says the same cells.

#![allow(clippy::unwrap_used, reason = "a test may end where its ground is not as it should be")]

use crate::http_support::{Answer, Site, ring};
use prost::Message;
use serde_json::json;
use ubbmap::wire::v1;

const GRID: &str = "/v1/maps/hall/grid";
const PART: &str = "min_x=-4&min_y=-2&max_x=6&max_y=3";

fn mapped() -> Site {
    let site = Site::hall();
    for _ in 0..5 {
        assert_eq!(site.post("/v1/maps/hall/scans", &ring("a", None).to_string()).json()["applied"], 1);
    }
    site
}

fn npy(answer: &Answer) -> (Vec<u64>, Vec<u8>) {
    let file = npyz::NpyFile::new(&answer.body[..]).unwrap();
    assert_eq!(file.order(), npyz::Order::C);
    (file.shape().to_vec(), file.into_vec().unwrap())
}

fn png(answer: &Answer) -> (u32, u32, Vec<u8>) {
    let mut reader = png::Decoder::new(std::io::Cursor::new(&answer.body)).read_info().unwrap();
    let mut pixels = vec![0; reader.output_buffer_size().unwrap()];
    let info = reader.next_frame(&mut pixels).unwrap();
    assert_eq!((info.color_type, info.bit_depth), (png::ColorType::Grayscale, png::BitDepth::Eight));
    (info.width, info.height, pixels)
}

#[test]
fn every_form_of_a_grid_says_the_same_cells() {
    let site = mapped();
    let path = format!("{GRID}?{PART}");
    let wire = site.send("GET", &path, &[("accept", "application/x-protobuf")], b"");
    let grid = v1::GetGridResponse::decode(&wire.body[..]).unwrap();
    assert_eq!((grid.width, grid.height, grid.depth, grid.revision), (100, 50, 8, 5));
    assert_eq!((grid.x, grid.y, grid.class_count), (88, 108, 10));
    assert!((grid.min_x + 4.0).abs() < 1e-9 && (grid.min_y + 2.0).abs() < 1e-9 && grid.cell_size == 0.1);
    assert!([1, 5, 10].iter().all(|class| grid.classes.contains(class)));
    // The cell of (1, 1) is free, that of (5.5, 2.5) unknown: row 0 is at min_y.
    assert_eq!((grid.classes[30 * 100 + 50], grid.classes[45 * 100 + 95]), (1, 5));

    let array = site.send("GET", &path, &[("accept", "application/x-npy")], b"");
    assert_eq!(array.header("content-type"), Some("application/x-npy"));
    assert_eq!(array.header("ubbmap-revision"), Some("5"));
    assert_eq!(array.header("ubbmap-cell-size"), Some("0.1"));
    assert_eq!(npy(&array), (vec![50, 100], grid.classes.clone()));
    assert_eq!(npy(&site.get(&format!("{path}&format=npy"))).1, grid.classes);

    let value = site.get(&path).json();
    let from_json: v1::GetGridResponse = serde_json::from_value(value.clone()).unwrap();
    assert_eq!(from_json, grid);
    assert_eq!(value["revision"], "5");

    let image = site.get(&format!("{path}&format=png"));
    assert_eq!(image.header("content-type"), Some("image/png"));
    assert_eq!(image.header("vary"), Some("accept"));
    let (width, height, pixels) = png(&image);
    assert_eq!((width, height), (100, 50));
    for row in 0..50 {
        for column in 0..100 {
            let grey = pixels[row * 100 + column];
            match grid.classes[(49 - row) * 100 + column] {
                1 => assert_eq!(grey, 255),
                10 => assert_eq!(grey, 0),
                class if class < 5 => assert!(grey > 160, "{class} {grey}"),
                5 => assert_eq!(grey, 160),
                class => assert!(grey < 160, "{class} {grey}"),
            }
        }
    }
}

#[test]
fn coarse_grids_have_the_largest_classes() {
    let site = mapped();
    let fine = npy(&site.get(&format!("{GRID}?format=npy")));
    let coarse = npy(&site.get(&format!("{GRID}?format=npy&depth=6")));
    assert_eq!((fine.0, coarse.0), (vec![256, 256], vec![64, 64]));
    for row in 0..64 {
        for column in 0..64 {
            let cells = (0..16).map(|i| fine.1[(row * 4 + i / 4) * 256 + column * 4 + i % 4]);
            assert_eq!(Some(coarse.1[row * 64 + column]), cells.max());
        }
    }
}

#[test]
fn forms_that_a_grid_has_not_are_refused() {
    let site = Site::hall();
    let (field, detail) = site.get(&format!("{GRID}?format=bmp")).problem(400, "INVALID_REQUEST");
    assert_eq!(field, "format");
    assert!(["json", "npy", "png", "protobuf"].iter().all(|form| detail.contains(form)), "{detail}");
    let answer = site.send("GET", GRID, &[("accept", "image/webp, text/html")], b"");
    let (_, detail) = answer.problem(406, "NOT_ACCEPTABLE");
    assert!(detail.contains("image/png") && detail.contains("application/x-npy"), "{detail}");
    let site = Site::with(|config| config.limits.cells_per_answer = 1000);
    site.make_hall();
    let (_, detail) = site.get(GRID).problem(400, "REGION_TOO_LARGE");
    assert!(detail.contains("1000") && detail.contains("depth"), "{detail}");
    assert_eq!(site.get(&format!("{GRID}?depth=4")).status, 200);
}

#[test]
fn an_empty_box_is_an_empty_grid() {
    let site = Site::hall();
    let outside = "min_x=100&min_y=100&max_x=101&max_y=101";
    let (shape, cells) = npy(&site.get(&format!("{GRID}?format=npy&{outside}")));
    assert_eq!((shape.iter().product::<u64>(), cells.len()), (0, 0));
    let wire = site.send("GET", &format!("{GRID}?{outside}"), &[("accept", "application/x-protobuf")], b"");
    assert!(v1::GetGridResponse::decode(&wire.body[..]).unwrap().classes.is_empty());
    site.get(&format!("{GRID}?format=png&{outside}")).problem(400, "INVALID_REGION");
}

#[test]
fn a_tile_is_a_node_of_256_cells_a_side() {
    let site = mapped();
    let whole = npy(&site.get(&format!("{GRID}?format=npy")));
    let tile = site.get("/v1/maps/hall/tiles/0/0/0.npy");
    assert_eq!(npy(&tile), whole);
    let wire = site.get("/v1/maps/hall/tiles/0/0/0.pb");
    let message = v1::GetTileResponse::decode(&wire.body[..]).unwrap();
    assert_eq!((message.z, message.x, message.y), (0, 0, 0));
    assert_eq!((message.width, message.height, &message.classes), (256, 256, &whole.1));
    let (width, height, _) = png(&site.get("/v1/maps/hall/tiles/0/0/0.png"));
    assert_eq!((width, height), (256, 256));
    // One level down each leaf is two cells wide.
    let (shape, quarter) = npy(&site.get("/v1/maps/hall/tiles/1/1/0.npy"));
    assert_eq!(shape, [256, 256]);
    for row in [0, 37, 200, 255] {
        for column in [0, 1, 100, 255] {
            assert_eq!(quarter[row * 256 + column], whole.1[(row / 2) * 256 + 128 + column / 2]);
        }
    }
}

#[test]
fn a_tile_that_did_not_change_is_not_sent_again() {
    let site = mapped();
    for ending in ["png", "npy", "pb"] {
        // The tile of the corner away from the wall, and the one of the whole map.
        for (tile, changes) in [("1/1/1", ending == "pb"), ("0/0/0", true)] {
            let path = format!("/v1/maps/hall/tiles/{tile}.{ending}");
            let first = site.get(&path);
            let tag = first.header("etag").unwrap().to_owned();
            assert!(tag.starts_with('"') && tag.ends_with('"'), "{tag}");
            assert_eq!(first.header("cache-control"), Some("no-cache"));
            for known in [tag.clone(), format!("W/{tag}"), format!("\"x\", {tag}"), "*".to_owned()] {
                let again = site.send("GET", &path, &[("if-none-match", &known)], b"");
                assert_eq!((again.status, again.body.len()), (304, 0), "{known}");
                assert_eq!(again.header("etag"), Some(tag.as_str()));
            }
            assert_eq!(site.send("GET", &path, &[("if-none-match", "\"x\"")], b"").status, 200);
            let mut beside = ring("a", None);
            beside["pose"]["x"] = json!({"min": -4, "max": -4});
            beside["pose"]["y"] = json!({"min": -4, "max": -4});
            assert_eq!(site.post("/v1/maps/hall/scans", &beside.to_string()).json()["applied"], 1);
            let later = site.send("GET", &path, &[("if-none-match", &tag)], b"");
            assert_eq!(later.status == 200, changes, "{path}");
            // Back to where it was, so that the next round begins alike.
            site.send("DELETE", "/v1/maps/hall", &[], b"");
            site.make_hall();
            for _ in 0..5 {
                site.post("/v1/maps/hall/scans", &ring("a", None).to_string());
            }
        }
    }
}

#[test]
fn tiles_that_are_not_there_are_named() {
    let site = Site::hall();
    for (tile, status, code, field) in [
        ("0/1/0.png", 404, "TILE_OUT_OF_RANGE", ""),
        ("99/0/0.png", 404, "TILE_OUT_OF_RANGE", ""),
        ("1/0/2.npy", 404, "TILE_OUT_OF_RANGE", ""),
        ("0/0/0.gif", 406, "NOT_ACCEPTABLE", "y"),
        ("0/0/0", 406, "NOT_ACCEPTABLE", "y"),
        ("a/0/0.png", 400, "INVALID_REQUEST", "z"),
        ("0/-1/0.png", 400, "INVALID_REQUEST", "x"),
        ("0/0/4294967296.png", 400, "INVALID_REQUEST", "y"),
        ("0/0/.png", 400, "INVALID_REQUEST", "y"),
        ("0/0/0.png?depth=3", 400, "INVALID_REQUEST", "depth"),
    ] {
        let (named, _) = site.get(&format!("/v1/maps/hall/tiles/{tile}")).problem(status, code);
        assert!(named.starts_with(field), "{tile}: {named}");
    }
    site.get("/v1/maps/nowhere/tiles/0/0/0.png").problem(404, "MAP_NOT_FOUND");
}

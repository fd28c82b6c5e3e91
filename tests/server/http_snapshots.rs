//! Snapshots over REST.

#![allow(clippy::unwrap_used, reason = "a test may end where its ground is not as it should be")]

use crate::http_support::{Site, ring};
use prost::Message;
use serde_json::json;
use ubbmap::wire::v1;

const SNAPSHOTS: &str = "/v1/maps/hall/snapshots";

fn insert(site: &Site, sequence: u64) -> serde_json::Value {
    site.post("/v1/maps/hall/scans", &ring("a", Some(sequence)).to_string()).json()
}

#[test]
fn a_snapshot_is_taken_listed_restored_and_deleted() {
    let site = Site::hall();
    insert(&site, 1);
    let before = site.get("/v1/maps/hall/region").json()["leaves"].clone();
    let taken = site.post(SNAPSHOTS, r#"{"name": "one"}"#);
    assert_eq!(taken.status, 201);
    let taken = taken.json();
    assert_eq!((&taken["name"], &taken["revision"]), (&json!("one"), &json!("1")));
    assert!(taken["created"].as_f64().unwrap() > 1e9, "{taken}");
    insert(&site, 2);
    insert(&site, 3);
    let protobuf = [("content-type", "application/x-protobuf"), ("accept", "application/x-protobuf")];
    let request = v1::CreateSnapshotRequest { map: "hall".to_owned(), name: "three".to_owned() };
    let answer = site.send("POST", SNAPSHOTS, &protobuf, &request.encode_to_vec());
    assert_eq!(v1::CreateSnapshotResponse::decode(&answer.body[..]).unwrap().revision, 3);
    let list = site.get(SNAPSHOTS).json();
    assert_eq!(list["snapshots"][0], taken);
    assert_eq!((&list["snapshots"][1]["name"], list["snapshots"].as_array().unwrap().len()), (&json!("three"), 2));

    // Without a body, as curl sends it, and with one.
    assert_eq!(site.send("POST", &format!("{SNAPSHOTS}/one/restore"), &[], b"").json(), json!({"revision": "4"}));
    assert_eq!(site.get("/v1/maps/hall/region").json()["leaves"], before);
    assert_eq!(site.post(&format!("{SNAPSHOTS}/three/restore"), "{}").json()["revision"], "5");
    assert_eq!(site.post(&format!("{SNAPSHOTS}/one/restore"), r#"{"map": "hall", "name": "one"}"#).status, 200);
    assert_eq!(insert(&site, 2)["applied"], 1, "it can be sent again");

    let deleted = site.send("DELETE", &format!("{SNAPSHOTS}/one"), &[], b"");
    assert_eq!((deleted.status, deleted.body.len()), (204, 0));
    site.send("DELETE", &format!("{SNAPSHOTS}/one"), &[], b"").problem(404, "SNAPSHOT_NOT_FOUND");
    assert_eq!(site.get(SNAPSHOTS).json()["snapshots"].as_array().unwrap().len(), 1);
}

#[test]
fn requests_about_snapshots_that_make_no_sense_change_nothing() {
    let site = Site::hall();
    insert(&site, 1);
    site.post(SNAPSHOTS, r#"{"name": "one"}"#);
    insert(&site, 2);
    for (path, body, code, field) in [
        (SNAPSHOTS, r#"{"nam": "x"}"#, "INVALID_REQUEST", "nam"),
        (SNAPSHOTS, r#"{"map": "other", "name": "x"}"#, "INVALID_REQUEST", "map"),
        (SNAPSHOTS, r#"{"name": "a/b"}"#, "INVALID_NAME", "name"),
        (SNAPSHOTS, "", "INVALID_REQUEST", ""),
        ("/v1/maps/hall/snapshots/one/restore", r#"{"name": "two"}"#, "INVALID_REQUEST", "name"),
        ("/v1/maps/hall/snapshots/one/restore", r#"{"map": "two"}"#, "INVALID_REQUEST", "map"),
        ("/v1/maps/hall/snapshots/one/restore?now=1", "{}", "INVALID_REQUEST", "now"),
        ("/v1/maps/hall/snapshots/%20/restore", "{}", "INVALID_NAME", "name"),
    ] {
        assert_eq!(site.post(path, body).problem(400, code).0, field, "{path} {body}");
    }
    // What a page of another site may send without being asked for: it restores nothing.
    let page = [("origin", "http://example.org")];
    site.send("POST", &format!("{SNAPSHOTS}/one/restore"), &page, b"").problem(415, "UNSUPPORTED_MEDIA_TYPE");
    let text = [("origin", "http://example.org"), ("content-type", "text/plain")];
    site.send("POST", &format!("{SNAPSHOTS}/one/restore"), &text, b"{}").problem(415, "UNSUPPORTED_MEDIA_TYPE");
    site.send("POST", SNAPSHOTS, &text, br#"{"name": "two"}"#).problem(415, "UNSUPPORTED_MEDIA_TYPE");
    assert_eq!(site.get("/v1/maps/hall").json()["revision"], "2");
    assert_eq!(site.get(SNAPSHOTS).json()["snapshots"].as_array().unwrap().len(), 1);
}

#[test]
fn blocks_and_their_times_are_in_the_answers() {
    let site = Site::hall();
    assert!(site.get("/v1/maps/hall").json().get("last_change").is_none());
    insert(&site, 1);
    let last = site.get("/v1/maps/hall").json()["last_change"].as_f64().unwrap();
    assert!(last > 1e9);
    let region = site.get("/v1/maps/hall/region?blocks=true&depth=4").json();
    assert_eq!(region["last_change"].as_f64(), Some(last));
    let changes = site.get("/v1/maps/hall/changes?since=0&depth=4").json();
    assert_eq!(region["blocks"], changes["blocks"]);
    assert_eq!(region["blocks"][0]["changed"].as_f64(), Some(last));
    assert_eq!(site.get("/v1/maps/hall/region").json()["blocks"], json!([]));
    site.get("/v1/maps/hall/region?blocks=1").problem(400, "INVALID_REQUEST");
}

#[test]
fn rasters_and_questions_of_a_snapshot_stay_as_they_were() {
    let site = Site::hall();
    insert(&site, 1);
    site.post(SNAPSHOTS, r#"{"name": "one"}"#);
    let paths = ["grid?depth=6", "tiles/0/0/0.png", "tiles/1/1/0.npy", "region?depth=5"];
    let ask = |path: &str, more: &str| {
        let mark = if path.contains('?') { '&' } else { '?' };
        let more = if more.is_empty() { String::new() } else { format!("{mark}{more}") };
        site.get(&format!("/v1/maps/hall/{path}{more}"))
    };
    let then: Vec<_> = paths.map(|path| ask(path, "")).into();
    for sequence in 2..5 {
        let mut scan = ring("a", Some(sequence));
        scan["pose"]["x"] = json!({"min": 0.5 * sequence as f64, "max": 0.5 * sequence as f64});
        site.post("/v1/maps/hall/scans", &scan.to_string());
    }
    for (path, then) in paths.iter().zip(&then) {
        let kept = ask(path, "snapshot=one");
        assert_eq!(kept.status, 200, "{path}");
        assert_ne!(ask(path, "").body, then.body, "{path}");
        if path.starts_with("region") {
            assert_eq!(kept.json()["leaves"], then.json()["leaves"]);
        } else {
            assert_eq!((&kept.body, kept.header("ubbmap-revision")), (&then.body, Some("1")), "{path}");
        }
        assert_eq!(kept.header("etag"), then.header("etag"), "{path}");
        assert_eq!(ask(path, "snapshot=").problem(400, "INVALID_REQUEST").0, "snapshot");
        assert_eq!(ask(path, "snapshot=two").problem(404, "SNAPSHOT_NOT_FOUND").0, "snapshot");
        assert_eq!(ask(path, "snapshot=a%20b").problem(400, "INVALID_NAME").0, "snapshot");
    }
    let tag = then[1].header("etag").unwrap();
    let again = site.send("GET", "/v1/maps/hall/tiles/0/0/0.png?snapshot=one", &[("if-none-match", tag)], b"");
    assert_eq!((again.status, again.body.len()), (304, 0));
    let points = r#"{"points": [{"x": 4.5, "y": 0}], "snapshot": "one"}"#;
    assert_eq!(site.post("/v1/maps/hall/classes", points).json()["classes"], json!([5]));
    let disc = r#"{"regions": [{"disc": {"center": {"x": 4.5, "y": 0}, "radius": 0.1}}], "snapshot": "one"}"#;
    let answer = site.post("/v1/maps/hall/guaranteed-free", disc).json();
    assert_eq!((&answer["revision"], &answer["results"][0]["reason"]), (&json!("1"), &json!("REASON_UNKNOWN")));
}

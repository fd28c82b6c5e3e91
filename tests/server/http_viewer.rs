//! The viewer's page and files: what they are, how they may be kept, and that the interface goes on beside them.

#![allow(clippy::unwrap_used, reason = "a test may end where its ground is not as it should be")]

use crate::http_support::{Answer, Site};
use serde_json::json;
use std::fs;
use std::path::{Path, PathBuf};

/// What Chromium sends for a page.
const BROWSER: (&str, &str) =
    ("accept", "text/html,application/xhtml+xml,application/xml;q=0.9,image/avif,image/webp,*/*;q=0.8");

fn bundle() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("viewer/prebuilt")
}

fn page(site: &Site) -> Answer {
    site.send("GET", "/", &[BROWSER], b"")
}

fn names(folder: &Path, under: &str, out: &mut Vec<String>) {
    for entry in fs::read_dir(folder).unwrap().map(|entry| entry.unwrap()) {
        let name = format!("{under}{}", entry.file_name().to_str().unwrap());
        if entry.path().is_dir() {
            names(&entry.path(), &format!("{name}/"), out);
        } else {
            out.push(name);
        }
    }
}

/// The page's own references: what stands in `src` and `href`.
fn references(html: &str) -> Vec<&str> {
    let after = |word| html.split(word).skip(1).map(|rest| rest.split('"').next().unwrap());
    after("src=\"").chain(after("href=\"")).collect()
}

#[test]
fn a_browser_gets_the_page_and_a_program_the_routes() {
    let site = Site::hall();
    let answer = page(&site);
    assert_eq!((answer.status, answer.header("content-type")), (200, Some("text/html; charset=utf-8")));
    assert!(answer.body == fs::read(bundle().join("index.html")).unwrap());
    assert_eq!(answer.header("vary"), Some("accept"));
    assert_eq!(site.get("/").json()["name"], json!("ubbmap"));
    assert_eq!(site.send("GET", "/", &[("accept", "*/*")], b"").json()["name"], json!("ubbmap"));
    site.send("GET", "/", &[("accept", "image/png")], b"").problem(406, "NOT_ACCEPTABLE");
    assert_eq!(site.send("HEAD", "/", &[BROWSER], b"").status, 200);
}

#[test]
fn everything_that_the_page_names_comes_from_this_server() {
    let site = Site::hall();
    let answer = page(&site);
    let policy = answer.header("content-security-policy").unwrap();
    assert!(policy.starts_with("default-src 'self';") && !policy.contains("unsafe"), "{policy}");
    assert_eq!(answer.header("x-content-type-options"), Some("nosniff"));
    let html = String::from_utf8(answer.body).unwrap();
    let named = references(&html);
    assert!(named.len() >= 3, "{named:?}");
    for path in named {
        assert!(path.starts_with("/viewer/"), "{path}");
        assert_eq!(site.get(path).status, 200, "{path}");
    }
    // A script or style within the page would be refused by the policy.
    assert!(!html.contains("<script>") && !html.contains("<style") && !html.contains("style=\""));
}

#[test]
fn every_file_of_the_bundle_is_served_with_its_type_and_may_be_kept_when_its_name_is_a_hash() {
    let site = Site::hall();
    let mut files = Vec::new();
    names(&bundle(), "", &mut files);
    assert!(files.len() >= 4, "{files:?}");
    for name in files {
        let path = format!("/viewer/{name}");
        let answer = site.get(&path);
        assert_eq!(answer.status, 200, "{path}");
        assert!(answer.body == fs::read(bundle().join(&name)).unwrap(), "{path}");
        let expected = match name.rsplit('.').next().unwrap() {
            "html" => "text/html; charset=utf-8",
            "js" => "text/javascript; charset=utf-8",
            "css" => "text/css; charset=utf-8",
            "svg" => "image/svg+xml",
            "md" => "text/plain; charset=utf-8",
            other => panic!("{name}: no type for .{other}"),
        };
        assert_eq!(answer.header("content-type"), Some(expected), "{path}");
        let caching = answer.header("cache-control").unwrap();
        assert_eq!(caching.contains("immutable"), name.starts_with("assets/"), "{path}: {caching}");
        let tag = answer.header("etag").unwrap();
        let again = site.send("GET", &path, &[("if-none-match", tag)], b"");
        assert_eq!((again.status, again.body.len(), again.header("etag")), (304, 0, Some(tag)), "{path}");
        assert_eq!(site.send("GET", &path, &[("if-none-match", "\"0\"")], b"").status, 200, "{path}");
    }
}

#[test]
fn what_is_not_in_the_bundle_is_a_problem() {
    let site = Site::hall();
    for path in [
        "/viewer/nothing.js",
        "/viewer/assets",
        "/viewer/assets/",
        "/viewer/..%2f..%2fCargo.toml",
        "/viewer/%00",
        "/viewer",
    ] {
        site.get(path).problem(404, "ROUTE_NOT_FOUND");
    }
    // The path as it is: a client would take the dots away.
    let raw = site.raw(b"GET /viewer/../Cargo.toml HTTP/1.1\r\nHost: x\r\nConnection: close\r\n\r\n");
    assert!(raw.starts_with(b"HTTP/1.1 404"), "{}", String::from_utf8_lossy(&raw));
    site.send("POST", "/viewer/index.html", &[], b"").problem(405, "METHOD_NOT_ALLOWED");
}

#[test]
fn the_interface_answers_a_browser_as_it_answers_a_program() {
    let site = Site::hall();
    for path in ["/healthz", "/v1/maps/hall"] {
        let (program, browser) = (site.get(path), site.send("GET", path, &[BROWSER], b""));
        assert_eq!((program.status, &program.body), (200, &browser.body), "{path}");
        assert_eq!(browser.header("content-type"), Some("application/json"), "{path}");
    }
}

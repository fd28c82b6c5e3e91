//! The description of the interface: it is what is committed, its examples work, and its page is whole.

#![allow(clippy::unwrap_used, clippy::print_stderr, reason = "a test may end where its ground is not as it should be")]

use crate::http_support::{Answer, Site};
use serde_json::Value;
use std::fs;
use std::path::{Path, PathBuf};

fn committed() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("docs/openapi.json")
}

/// With `UBBMAP_BLESS=1` what is served becomes what is committed.
#[test]
fn the_description_that_is_served_is_the_one_in_the_repository() {
    let answer = Site::new().get("/openapi.json");
    assert_eq!((answer.status, answer.header("content-type")), (200, Some("application/json")));
    let served = String::from_utf8(answer.body).unwrap();
    if std::env::var("UBBMAP_BLESS").is_ok_and(|value| value == "1") {
        fs::write(committed(), &served).unwrap();
    }
    let committed = fs::read_to_string(committed()).unwrap_or_default();
    let differs = served.lines().zip(committed.lines()).find(|(served, committed)| served != committed);
    assert!(
        served == committed,
        "docs/openapi.json is not what the server tells of itself, first at {differs:?}: run this test with UBBMAP_BLESS=1 \
         and commit what it writes"
    );
}

#[test]
fn a_client_that_has_the_description_is_not_sent_it_again() {
    let site = Site::new();
    let tag = site.get("/openapi.json").header("etag").unwrap().to_owned();
    let again = site.send("GET", "/openapi.json", &[("if-none-match", &tag)], b"");
    assert_eq!((again.status, again.body.len()), (304, 0));
    site.get("/openapi.json?version=2").problem(400, "INVALID_REQUEST");
}

/// An example with the media type it is of.
fn examples(operation: &Value) -> Vec<(String, Vec<u8>)> {
    let mut all = Vec::new();
    let Some(content) = operation["requestBody"]["content"].as_object() else { return all };
    for (media, body) in content {
        let named = body["examples"].as_object().into_iter().flat_map(|examples| examples.values());
        for value in named.map(|example| &example["value"]).chain(body.get("example")) {
            // What is not JSON stands there as the text that it is.
            all.push((media.clone(), value.as_str().map_or_else(|| value.to_string(), str::to_owned).into_bytes()));
        }
    }
    all
}

/// The path of an operation with the examples of its parameters.
fn filled(path: &str, operation: &Value) -> String {
    let mut path = path.to_owned();
    let mut query = Vec::new();
    for parameter in operation["parameters"].as_array().into_iter().flatten() {
        let name = parameter["name"].as_str().unwrap();
        let Some(example) = parameter.get("example") else {
            assert_eq!(parameter["required"], false, "{name} is needed and has no example");
            continue;
        };
        let example = example.as_str().map_or_else(|| example.to_string(), str::to_owned);
        match parameter["in"].as_str().unwrap() {
            "path" => path = path.replace(&format!("{{{name}}}"), &example),
            "query" => query.push(format!("{name}={example}")),
            _ => {}
        }
    }
    assert!(!path.contains('{'), "{path}");
    if query.is_empty() { path } else { format!("{path}?{}", query.join("&")) }
}

/// Holds that the answer is one that the description tells of.
#[track_caller]
fn is_described(operation: &Value, answer: &Answer) {
    let id = &operation["operationId"];
    let told = &operation["responses"][answer.status.to_string()];
    assert!(told.is_object(), "{id}: {answer:?}");
    if let Some(content) = told["content"].as_object() {
        let media = answer.header("content-type").unwrap().split(';').next().unwrap();
        assert!(content.contains_key(media), "{id}: {media}");
    }
}

#[test]
fn every_request_that_the_description_shows_is_answered_as_it_says() {
    let site = Site::new();
    let description = site.get("/openapi.json").json();
    let paths = description["paths"].as_object().unwrap();
    let operation = |id: &str| {
        let find = |(path, methods): (&String, &Value)| {
            let of = |(method, operation): (&String, &Value)| {
                (operation["operationId"] == id).then(|| (path.clone(), method.to_uppercase(), operation.clone()))
            };
            methods.as_object().unwrap().iter().find_map(of)
        };
        paths.iter().find_map(find).unwrap()
    };
    let try_it = |id: &str| {
        let (path, method, operation) = operation(id);
        let path = filled(&path, &operation);
        let mut bodies = examples(&operation);
        if bodies.is_empty() {
            bodies.push((String::new(), Vec::new()));
        }
        for (media, body) in bodies {
            let headers = if media.is_empty() { vec![] } else { vec![("content-type", media.as_str())] };
            let answer = site.send(&method, &path, &headers, &body);
            assert!((200..300).contains(&answer.status), "{id}: {}", String::from_utf8_lossy(&answer.body));
            is_described(&operation, &answer);
        }
    };
    let tried = [
        "CreateMap",
        "ListMaps",
        "GetMap",
        "InsertScans",
        "GetClasses",
        "CheckGuaranteedFree",
        "GetRegion",
        "GetGrid",
        "GetTile",
        "ListRobots",
        "GetChanges",
        "CreateSnapshot",
        "ListSnapshots",
        "RestoreSnapshot",
        "ExportMap",
        "DeleteSnapshot",
        "GetIndex",
        "GetHealth",
        "GetReadiness",
        "GetMetrics",
        "GetDescription",
        "GetDocs",
    ];
    tried.iter().for_each(|id| try_it(id));
    let robot = &site.get("/v1/maps/hall").json()["robots"][0];
    assert_eq!(robot["applied"], "2", "the scans that the description shows are those of one robot: {robot}");
    let file = site.get("/v1/maps/hall/export").body;
    try_it("DeleteMap");
    let (path, method, import) = operation("ImportMap");
    let answer = site.send(&method, &filled(&path, &import), &[], &file);
    assert_eq!(answer.status, 201);
    is_described(&import, &answer);
    // All but the one whose answer does not end, which is asked for a form that it has not.
    let (path, _, watch) = operation("WatchMap");
    let answer = site.send("GET", &filled(&path, &watch), &[("accept", "image/png")], b"");
    answer.problem(406, "NOT_ACCEPTABLE");
    is_described(&watch, &answer);
    let known: usize = paths.values().map(|methods| methods.as_object().unwrap().len()).sum();
    assert_eq!(known, tried.len() + 3);
}

#[test]
fn the_page_of_the_description_comes_whole_from_this_server() {
    let site = Site::new();
    let answer = site.get("/docs");
    assert_eq!((answer.status, answer.header("content-type")), (200, Some("text/html; charset=utf-8")));
    let policy = answer.header("content-security-policy").unwrap();
    assert!(policy.starts_with("default-src 'self';") && !policy.contains("unsafe"), "{policy}");
    assert_eq!(answer.header("x-content-type-options"), Some("nosniff"));
    let html = String::from_utf8(answer.body).unwrap();
    let named: Vec<_> =
        html.split("src=\"").chain(html.split("href=\"")).filter(|part| part.starts_with('/')).collect();
    assert!(named.len() >= 4, "{html}");
    for path in named.iter().map(|part| part.split('"').next().unwrap()) {
        assert_eq!(site.get(path).status, 200, "{path}");
    }
    assert!(!html.contains("<script>") && !html.contains("<style") && !html.contains("style=\""));
    site.get("/docs?version=2").problem(400, "INVALID_REQUEST");
}

//! The house rules that a program can check: sizes, module headers, and the arrows between the floors.

#![allow(clippy::unwrap_used, clippy::panic, reason = "a test may fail loudly")]

use std::fs;
use std::path::{Path, PathBuf};

const MAX_FILE_LINES: usize = 500;
const MAX_FUNCTION_LINES: usize = 70;

/// Modules by floor, lowest first. A module may use its own floor's modules only where [`SAME_FLOOR`] says so.
const FLOORS: [&[&str]; 7] = [
    &["interval", "sync", "vector"],
    &["sensor", "quadtree"],
    &["mapping", "simulation"],
    &["store"],
    &["service"],
    &["wire", "transport"],
    &["config", "telemetry", "reload", "app", "cli", "experiment", "logs", "picture"],
];

/// Arrows within a floor that are meant: from, to.
const SAME_FLOOR: [(&str, &str); 1] = [("transport", "wire")];

fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

fn rust_files(folder: &Path, out: &mut Vec<PathBuf>) {
    let Ok(entries) = fs::read_dir(folder) else { return };
    for entry in entries.map(|entry| entry.unwrap().path()) {
        if entry.is_dir() {
            rust_files(&entry, out);
        } else if entry.extension().is_some_and(|extension| extension == "rs") {
            out.push(entry);
        }
    }
}

fn sources(folders: &[&str]) -> Vec<(String, String)> {
    let mut files = Vec::new();
    for folder in folders {
        rust_files(&root().join(folder), &mut files);
    }
    assert!(!files.is_empty());
    let name = |path: &Path| path.strip_prefix(root()).unwrap().to_string_lossy().replace('\\', "/");
    files.iter().map(|path| (name(path), fs::read_to_string(path).unwrap())).collect()
}

fn floor_of(module: &str) -> Option<usize> {
    FLOORS.iter().position(|floor| floor.contains(&module))
}

/// The top-level module of a file under `src/`.
fn module_of(name: &str) -> &str {
    let path = name.strip_prefix("src/").unwrap();
    path.split('/').next().unwrap().trim_end_matches(".rs")
}

/// The crate's modules that a source names, with the line.
fn named_modules(text: &str) -> Vec<(usize, String)> {
    let mut out = Vec::new();
    for (number, line) in text.lines().enumerate() {
        let code = line.split("//").next().unwrap();
        for start in code.match_indices("crate::").map(|(at, word)| at + word.len()) {
            let module: String = code[start..].chars().take_while(|c| c.is_alphanumeric() || *c == '_').collect();
            if !module.is_empty() {
                out.push((number + 1, module));
            }
        }
    }
    out
}

/// `(name, lines)` of every function, found by matching braces outside of strings and comments, roughly.
fn functions(text: &str) -> Vec<(String, usize)> {
    let lines: Vec<&str> = text.lines().collect();
    let mut out = Vec::new();
    for (i, line) in lines.iter().enumerate() {
        let trimmed = line.trim_start();
        let Some(at) = trimmed.find("fn ").filter(|at| trimmed[..*at].split(' ').all(is_modifier)) else { continue };
        let indent = line.len() - trimmed.len();
        let close = format!("{}}}", " ".repeat(indent));
        let Some(length) = lines[i..].iter().position(|line| **line == *close) else { continue };
        let name = trimmed[at + 3..].chars().take_while(|c| c.is_alphanumeric() || *c == '_').collect();
        out.push((name, length + 1));
    }
    out
}

fn is_modifier(word: &str) -> bool {
    word.is_empty() || word.starts_with("pub") || ["const", "async", "unsafe", "extern", "in", "super)"].contains(&word)
}

#[test]
fn every_file_opens_with_its_purpose_and_stays_short() {
    let mut faults = Vec::new();
    for (name, text) in sources(&["src", "tests", "benches"]) {
        if !text.starts_with("//!") {
            faults.push(format!("{name}: does not open with //!"));
        }
        let lines = text.lines().count();
        if lines > MAX_FILE_LINES {
            faults.push(format!("{name}: {lines} lines, at most {MAX_FILE_LINES}"));
        }
        for (function, lines) in functions(&text) {
            if lines > MAX_FUNCTION_LINES {
                faults.push(format!("{name}: fn {function} has {lines} lines, at most {MAX_FUNCTION_LINES}"));
            }
        }
    }
    assert!(faults.is_empty(), "{}", faults.join("\n"));
}

#[test]
fn arrows_between_floors_point_down() {
    let mut faults = Vec::new();
    let mut arrows = 0;
    for (name, text) in sources(&["src"]) {
        let module = module_of(&name);
        if module == "lib" || module == "main" {
            continue;
        }
        let floor = floor_of(module).unwrap_or_else(|| panic!("{name}: module {module} has no floor"));
        for (line, used) in named_modules(&text) {
            let Some(below) = floor_of(&used) else { continue };
            let meant = SAME_FLOOR.contains(&(module, used.as_str())) || floor == FLOORS.len() - 1;
            arrows += 1;
            if used != module && (below > floor || (below == floor && !meant)) {
                faults.push(format!("{name}:{line}: {module} (floor {floor}) uses {used} (floor {below})"));
            }
        }
    }
    assert!(arrows > 50, "only {arrows} arrows found: the test no longer sees the imports");
    assert!(faults.is_empty(), "{}", faults.join("\n"));
}

#[test]
fn the_core_knows_no_io_clock_or_async() {
    let forbidden = [
        "std::fs",
        "std::net",
        "std::io",
        "std::time",
        "std::env",
        "std::thread",
        "tokio",
        "async fn",
        "println!",
        "sled::",
    ];
    for (name, text) in
        sources(&["src/vector", "src/interval", "src/sensor", "src/quadtree", "src/mapping", "src/simulation"])
    {
        for (number, line) in text.lines().enumerate() {
            let code = line.split("//").next().unwrap();
            for word in forbidden {
                assert!(!code.contains(word), "{name}:{}: {word}", number + 1);
            }
        }
    }
}

/// Where what is shared by tasks is not to come from, and what of it.
const UNSEEN: [(&str, &[&str]); 5] = [
    ("std::sync", &["Mutex", "RwLock", "Condvar", "Atomic", "OnceLock"]),
    ("std::thread", &["std::thread"]),
    ("arc_swap", &["arc_swap"]),
    ("tokio::", &["mpsc", "oneshot", "watch", "OnceCell", "spawn", "sleep"]),
    ("tokio_util", &["tokio_util"]),
];

/// What `shuttle` does not see, a test of schedules cannot interleave, and a lock of `std` that is held while another task
/// goes on would stop it for good.
#[test]
fn what_tasks_share_comes_from_where_schedules_are_chosen() {
    let mut imports = 0;
    for (name, text) in sources(&["src/service", "src/quadtree"]) {
        // The metrics have a set of names, held for a look.
        let apart = ["/schedules", "_tests.rs", "service/tasks", "service/metrics.rs"];
        if apart.iter().any(|part| name.contains(part)) {
            continue;
        }
        for (number, line) in text.lines().enumerate() {
            let code = line.split("//").next().unwrap();
            imports += usize::from(code.contains("crate::sync::") || code.contains("super::tasks::"));
            let unseen = |(path, words): &(&str, &[&str])| {
                code.contains(path) && words.iter().any(|word| code.replace("std::sync::atomic", "").contains(word))
            };
            assert!(!UNSEEN.iter().any(unseen), "{name}:{}: take it from crate::sync or super::tasks", number + 1);
        }
    }
    assert!(imports > 10, "only {imports} imports found");
}

#[test]
fn transports_do_not_import_each_other() {
    for (name, text) in sources(&["src/transport"]) {
        let Some(own) = ["http", "grpc", "zenoh"].iter().find(|t| name.contains(&format!("transport/{t}"))) else {
            continue;
        };
        for other in ["http", "grpc", "zenoh"].iter().filter(|t| *t != own) {
            assert!(!text.contains(&format!("transport::{other}")), "{name} imports transport::{other}");
        }
    }
}

#[test]
fn the_function_counter_counts() {
    let text =
        "impl A {\n    pub(crate) async fn long(\n        a: u8,\n    ) {\n        b();\n    }\n}\nfn short() {\n}\n";
    assert_eq!(functions(text), [("long".to_owned(), 5), ("short".to_owned(), 2)]);
    assert_eq!(named_modules("use crate::store::X; // crate::cli\n"), [(1, "store".to_owned())]);
}

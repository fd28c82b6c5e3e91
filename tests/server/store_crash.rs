//! The database rewritten on a full disk, and by a process that is gone in the middle of a step.

use crate::store_rewrite::{STEPS, databases, kind, open, rewrite, wide};
use crate::store_support::{Model, assert_same, config, fill, name};
use std::fs;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, Instant};
use ubbmap::store::{MapStore, StoreError};

/// Run by the test below in a process whose files may not grow beyond a limit from a moment on.
#[test]
#[ignore = "run by a_full_disk_fails_a_rewrite_and_loses_nothing"]
fn full_disk_rewrite_child() {
    let Ok(directory) = std::env::var("UBBMAP_TEST_FULL_DISK") else { return };
    let store = open(Path::new(&directory));
    let (id, mut model) = wide(&store);
    let limit = |soft: &str| {
        let own = std::process::id().to_string();
        let run = std::process::Command::new("prlimit").args(["--pid", &own, &format!("--fsize={soft}:")]).status();
        assert!(run.unwrap().success());
    };
    // A first rewrite, whose comparison has read all of the new one: sled writes when it reads what it has not settled yet,
    // and then it is the store itself whose disk is full.
    rewrite(&store);
    limit("1500000");
    let outcome = store.rewrite(&mut |_| Ok(()));
    assert!(outcome.is_err(), "{outcome:?}");
    limit("unlimited");
    assert_eq!(databases(Path::new(&directory)), ["sled-2"]);
    let before = model.loaded();
    let commit = model.step(4);
    let store = match store.commit(id, &commit) {
        Ok(()) => store,
        // sled may still write while it is read to be copied: then the store itself has met the full disk, and is as after
        // any failed write.
        Err(StoreError::FailStop(_)) => {
            assert_same(&store.load(id).unwrap(), &before);
            drop(store);
            let store = open(Path::new(&directory));
            if store.load(id).unwrap().revision == before.revision {
                store.commit(id, &commit).unwrap();
            }
            store
        }
        Err(other) => panic!("{other}"),
    };
    rewrite(&store);
    assert_same(&store.load(id).unwrap(), &model.loaded());
}

/// Waits for a child; one that hangs is a failure.
#[track_caller]
fn ends(mut child: std::process::Child) -> std::process::ExitStatus {
    let start = Instant::now();
    loop {
        if let Some(status) = child.try_wait().unwrap() {
            return status;
        }
        if start.elapsed() > Duration::from_secs(120) {
            child.kill().unwrap();
            panic!("it hangs");
        }
        std::thread::sleep(Duration::from_millis(10));
    }
}

#[test]
#[cfg(target_os = "linux")]
fn a_full_disk_fails_a_rewrite_and_loses_nothing() {
    let directory = tempfile::tempdir().unwrap();
    let child = std::process::Command::new("sh")
        // Without the trap the signal would end the process.
        .args(["-c", "trap '' XFSZ; exec \"$0\" --exact store_crash::full_disk_rewrite_child --ignored"])
        .arg(std::env::current_exe().unwrap())
        .env("UBBMAP_TEST_FULL_DISK", directory.path())
        .spawn()
        .unwrap();
    assert!(ends(child).success());
}

const MAPS: u64 = 3;

/// Run by the test below: writes to some maps, rewrites meanwhile, and is gone in the middle of a step.
#[test]
#[ignore = "run by a_crash_at_any_step_of_a_rewrite_loses_nothing_that_was_acknowledged"]
fn crash_child() {
    let Ok(directory) = std::env::var("UBBMAP_TEST_CRASH") else { return };
    let directory = PathBuf::from(directory);
    let step = std::env::var("UBBMAP_TEST_CRASH_AT").unwrap();
    let store = open(&directory.join("data"));
    wide(&store);
    let begun = AtomicU64::new(0);
    std::thread::scope(|scope| {
        for n in 0..MAPS {
            let (store, directory, begun) = (&store, &directory, &begun);
            scope.spawn(move || {
                let (id, mut model) = fill(store, &format!("m{n}"), config(10, 10, 1), n, 0);
                let acknowledged = directory.join(format!("m{n}"));
                loop {
                    store.commit(id, &model.step(6)).unwrap();
                    let written = directory.join(format!("m{n}.writing"));
                    fs::write(&written, model.revision.to_string()).unwrap();
                    fs::rename(&written, &acknowledged).unwrap();
                    begun.fetch_add(1, Ordering::SeqCst);
                }
            });
        }
        while begun.load(Ordering::SeqCst) < 30 {
            std::thread::sleep(Duration::from_millis(1));
        }
        let outcome = store.rewrite(&mut |at| {
            if kind(at) == step {
                std::process::abort();
            }
            Ok(())
        });
        panic!("it never came to {step}: {outcome:?}");
    });
}

#[test]
fn a_crash_at_any_step_of_a_rewrite_loses_nothing_that_was_acknowledged() {
    for (at, step) in STEPS.into_iter().enumerate() {
        let directory = tempfile::tempdir().unwrap();
        let child = std::process::Command::new(std::env::current_exe().unwrap())
            .args(["--exact", "store_crash::crash_child", "--ignored"])
            .env("UBBMAP_TEST_CRASH", directory.path())
            .env("UBBMAP_TEST_CRASH_AT", step)
            .stdout(std::process::Stdio::null())
            .stderr(std::process::Stdio::null())
            .spawn()
            .unwrap();
        assert_eq!(ends(child).code(), None, "{step}: it was to be aborted");
        let data = directory.path().join("data");
        let past = at >= STEPS.iter().position(|step| *step == "Pointed").unwrap();
        let mut models = Vec::new();
        {
            let store = open(&data);
            assert_eq!(databases(&data), [if past { "sled-2" } else { "sled" }], "after {step}");
            assert_eq!(store.verify().unwrap().problems, Vec::<String>::new(), "after {step}");
            for map in store.list().unwrap().into_iter().filter(|map| map.name != name("wide")) {
                let n = map.name.as_str()[1..].parse().unwrap();
                let acknowledged: u64 =
                    fs::read_to_string(directory.path().join(format!("m{n}"))).unwrap().parse().unwrap();
                assert!((acknowledged..=acknowledged + 1).contains(&map.revision), "{step}: {acknowledged}, {map:?}");
                let mut model = Model::new(config(10, 10, 1), n);
                for _ in 0..map.revision {
                    model.step(6);
                }
                models.push((map.id, model));
            }
            assert_eq!(models.len() as u64, MAPS);
        }
        let store = open(&data);
        for (id, model) in &mut models {
            assert_same(&store.load(*id).unwrap(), &model.loaded());
            store.commit(*id, &model.step(6)).unwrap();
        }
        rewrite(&store);
        for (id, model) in &models {
            assert_same(&store.load(*id).unwrap(), &model.loaded());
        }
    }
}

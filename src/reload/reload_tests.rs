//! When files are read anew, and what is in use when they cannot be.
#![allow(clippy::unwrap_used, reason = "tests")]

use super::{Watch, Watched};
use std::fs;
use std::path::PathBuf;
use std::sync::{Arc, Mutex};
use std::time::Duration;

/// A file whose text is in use as long as it is a number.
struct Trial {
    _folder: tempfile::TempDir,
    path: PathBuf,
    used: Arc<Mutex<u32>>,
}

impl Trial {
    fn new() -> (Self, Watched) {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("number");
        fs::write(&path, "1").unwrap();
        let used = Arc::new(Mutex::new(1));
        let (file, number) = (path.clone(), Arc::clone(&used));
        let watched = Watched::new("trial", vec![path.clone()], move || {
            let text = fs::read_to_string(&file).map_err(|error| error.to_string())?;
            *number.lock().unwrap() = text.parse().map_err(|_| format!("{text} is no number"))?;
            Ok(text)
        });
        (Self { _folder: folder, path, used }, watched)
    }

    fn used(&self) -> u32 {
        *self.used.lock().unwrap()
    }

    /// Another file of the same length under the name, as `mv` makes it.
    fn replace(&self, text: &str) {
        let other = self.path.with_extension("new");
        fs::write(&other, text).unwrap();
        fs::rename(other, &self.path).unwrap();
    }
}

#[test]
fn a_file_is_read_when_it_has_stayed_the_same_for_a_look() {
    let (trial, watched) = Trial::new();
    assert!(!watched.look(false) && !watched.look(false));
    trial.replace("2");
    assert!(!watched.look(false), "it may still be written");
    trial.replace("3");
    assert!(!watched.look(false), "it changed again");
    assert_eq!(trial.used(), 1);
    assert!(watched.look(false));
    assert_eq!(trial.used(), 3);
    assert!(!watched.look(false));
}

#[test]
fn what_cannot_be_read_leaves_the_old_in_use_and_is_not_tried_again_until_it_changes() {
    let (trial, watched) = Trial::new();
    trial.replace("x");
    assert!(!watched.look(false) && watched.look(false));
    assert!(!watched.look(false) && !watched.look(false));
    assert_eq!(trial.used(), 1);
    fs::remove_file(&trial.path).unwrap();
    assert!(!watched.look(false) && watched.look(false) && !watched.look(false));
    assert_eq!(trial.used(), 1);
    trial.replace("4");
    assert!(!watched.look(false) && watched.look(false));
    assert_eq!(trial.used(), 4);
}

#[test]
fn whoever_asks_has_it_read_at_once() {
    let (trial, watched) = Trial::new();
    trial.replace("2");
    assert!(watched.look(true));
    assert_eq!(trial.used(), 2);
    assert!(!watched.look(false) && !watched.look(false), "it was read already");
}

#[test]
fn a_watch_reads_what_changed_until_it_is_dropped() {
    let (trial, watched) = Trial::new();
    let used = Arc::downgrade(&trial.used);
    let runtime = tokio::runtime::Builder::new_multi_thread().worker_threads(1).enable_all().build().unwrap();
    runtime.block_on(async {
        let watch = Watch::start(vec![watched], Duration::from_millis(5)).unwrap();
        trial.replace("2");
        while trial.used() != 2 {
            tokio::time::sleep(Duration::from_millis(5)).await;
        }
        drop(watch);
        // The trial's own hold is left when the watch has let go.
        while used.strong_count() > 1 {
            tokio::time::sleep(Duration::from_millis(5)).await;
        }
    });
}

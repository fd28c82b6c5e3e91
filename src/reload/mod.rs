//! Floor 6: files that are read anew while the server runs: certificates, tokens.
//!
//! A SIGHUP reads all of them. Without one, those that changed are read when they have stayed the same from one look to
//! the next, so that a key and its certificate, written one after the other, are not read between the two. What cannot be
//! read leaves in use what was read before.

#[cfg(test)]
mod reload_tests;

use metrics::{counter, describe_counter};
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, SystemTime};
use tokio::task::JoinHandle;

/// How often the files are looked at. What changed is in use after two looks.
pub const LOOK: Duration = Duration::from_secs(2);

const RELOADS: &str = "ubbmap_reloads_total";

/// Tells the recorder what each metric means. Call it once, after the recorder is installed.
pub fn describe_metrics() {
    describe_counter!(RELOADS, "Files read anew while the server runs, by what is in them and outcome: done, failed");
}

/// Reads the files: a word for the log about what is in use now, or why they cannot be used. It may take its time.
type Read = Box<dyn Fn() -> Result<String, String> + Send + Sync>;

/// What tells one state of a file from another; `None` where it cannot be looked at.
type Print = Vec<Option<(SystemTime, u64, u64)>>;

/// Files that belong together and are read as one.
pub struct Watched {
    what: &'static str,
    files: Vec<PathBuf>,
    read: Read,
    state: Mutex<State>,
}

#[derive(Debug)]
struct State {
    /// The files as they were when they were read last.
    used: Print,
    /// The files at the last look.
    seen: Print,
}

impl std::fmt::Debug for Watched {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Watched").field("what", &self.what).field("files", &self.files).finish_non_exhaustive()
    }
}

impl Watched {
    /// Files under a name, such as `tls`, which is a label of the metric and stands in the log. `read` reads them anew and
    /// puts what it read in use, or changes nothing and says why.
    ///
    /// To be made before the files are read for the first time: what changes from now on is seen.
    #[must_use]
    pub fn new(
        what: &'static str,
        files: Vec<PathBuf>,
        read: impl Fn() -> Result<String, String> + Send + Sync + 'static,
    ) -> Self {
        // Shown from the start, so that an alert sees the first failure as an increase.
        for outcome in ["done", "failed"] {
            counter!(RELOADS, "what" => what, "outcome" => outcome).increment(0);
        }
        let print = print(&files);
        let state = Mutex::new(State { used: print.clone(), seen: print });
        Self { what, files, read: Box::new(read), state }
    }

    /// Reads the files if they changed and have stayed so since the last look, or in any case where `ask` is true.
    /// Blocks. True where they were read, for better or worse.
    pub fn look(&self, ask: bool) -> bool {
        let mut state = self.state.lock().unwrap_or_else(PoisonError::into_inner);
        let now = print(&self.files);
        let settled = now == state.seen && now != state.used;
        state.seen.clone_from(&now);
        if !settled && !ask {
            return false;
        }
        // Not tried again until they change: one line in the log for each failure.
        state.used = now;
        let (what, outcome) = match (self.read)() {
            Ok(word) => {
                tracing::info!(what = self.what, "read anew: {word}");
                (self.what, "done")
            }
            Err(problem) => {
                tracing::error!(what = self.what, "not read anew, what was read before stays in use: {problem}");
                (self.what, "failed")
            }
        };
        counter!(RELOADS, "what" => what, "outcome" => outcome).increment(1);
        true
    }
}

fn print(files: &[PathBuf]) -> Print {
    files.iter().map(|path| print_of(path)).collect()
}

fn print_of(path: &Path) -> Option<(SystemTime, u64, u64)> {
    let known = std::fs::metadata(path).ok()?;
    Some((known.modified().ok()?, known.len(), inode(&known)))
}

/// Files that are put in place by a rename are told apart although their times and lengths may be the same.
#[cfg(unix)]
fn inode(known: &std::fs::Metadata) -> u64 {
    std::os::unix::fs::MetadataExt::ino(known)
}

#[cfg(not(unix))]
fn inode(_: &std::fs::Metadata) -> u64 {
    0
}

/// Looks at files until it is dropped.
#[derive(Debug)]
pub struct Watch(JoinHandle<()>);

impl Drop for Watch {
    fn drop(&mut self) {
        self.0.abort();
    }
}

impl Watch {
    /// Starts looking every `every`, and at each SIGHUP, which from now on does not end the process, even where there is
    /// nothing to read.
    ///
    /// # Errors
    /// When the signal cannot be waited for.
    pub fn start(watched: Vec<Watched>, every: Duration) -> std::io::Result<Self> {
        let mut hangup = Hangup::new()?;
        let watched = Arc::new(watched);
        Ok(Self(tokio::spawn(async move {
            loop {
                let ask = tokio::select! {
                    () = tokio::time::sleep(every) => false,
                    () = hangup.wait() => true,
                };
                if ask && watched.is_empty() {
                    tracing::info!("SIGHUP: there is nothing to read anew");
                }
                let watched = Arc::clone(&watched);
                let looked = tokio::task::spawn_blocking(move || {
                    for files in watched.iter() {
                        files.look(ask);
                    }
                });
                if let Err(error) = looked.await {
                    tracing::error!(%error, "looking at files failed");
                }
            }
        })))
    }
}

#[cfg(unix)]
struct Hangup(tokio::signal::unix::Signal);

#[cfg(unix)]
impl Hangup {
    fn new() -> std::io::Result<Self> {
        tokio::signal::unix::signal(tokio::signal::unix::SignalKind::hangup()).map(Self)
    }

    async fn wait(&mut self) {
        if self.0.recv().await.is_none() {
            std::future::pending::<()>().await;
        }
    }
}

#[cfg(not(unix))]
struct Hangup;

#[cfg(not(unix))]
impl Hangup {
    fn new() -> std::io::Result<Self> {
        Ok(Self)
    }

    async fn wait(&mut self) {
        std::future::pending::<()>().await;
    }
}

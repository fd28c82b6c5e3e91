//! `ubbmap store`: a data directory that no server has open.

use super::output::{Failure, Progress, say, say_json};
use crate::store::{RewriteOptions, RewriteStep, SledOptions, SledStore, StoreError, Verification};
use anyhow::anyhow;
use clap::{Args, Subcommand};
use serde_json::json;
use std::path::PathBuf;
use std::time::Duration;

/// Checks and rewrites a data directory that no server has open.
#[derive(Debug, Args)]
#[command(arg_required_else_help = true)]
#[command(after_help = "Example:\n  ubbmap store verify --data maps")]
pub(super) struct Store {
    #[command(subcommand)]
    action: Action,
}

#[derive(Debug, Subcommand)]
enum Action {
    /// Reads every record and names all that is damaged; exit code 1 when anything is
    #[command(
        after_help = "The directory is opened as a server opens it: an older format is brought to that of this program, \
        and what an interrupted deletion or rewrite left is removed. Where damage is suspected, verify a copy.\n\n\
        Example:\n  ubbmap store verify --data maps --json"
    )]
    Verify(OfDirectory),
    /// Rewrites the database, so that it takes no more room than what it holds needs
    #[command(
        after_help = "A server does this by itself, while it serves, when its database has grown beyond `rewrite.factor` \
        times what it holds. The old database stays until the new one is whole: there must be room for both.\n\n\
        Example:\n  ubbmap store rewrite --data maps"
    )]
    Rewrite(OfDirectory),
}

#[derive(Debug, Args)]
struct OfDirectory {
    /// Directory of the store
    #[arg(long, value_name = "DIR", default_value = "ubbmap-data")]
    data: PathBuf,
    /// Print the answer as JSON
    #[arg(long, help_heading = "Output")]
    json: bool,
    /// Show no progress on stderr
    #[arg(long, help_heading = "Output")]
    quiet: bool,
}

impl Store {
    /// Runs the command.
    pub(super) fn run(self) -> Result<(), Failure> {
        match self.action {
            Action::Verify(directory) => directory.verify(),
            Action::Rewrite(directory) => directory.rewrite(),
        }
    }
}

impl OfDirectory {
    /// Prints an error as JSON too, where that is asked for: a program that reads it finds an object in every case.
    fn told(&self, error: StoreError) -> Failure {
        if self.json {
            // The exit code tells of the failure, whoever reads the object.
            let _ = say_json(&json!({ "directory": self.data.display().to_string(), "error": error.to_string() }));
        }
        error.into()
    }

    /// Opens the store that is there; none is made.
    fn open(&self) -> Result<SledStore, StoreError> {
        if !SledStore::is_in(&self.data)? {
            let why = "there is no store in it".to_owned();
            return Err(StoreError::NoStore { directory: self.data.display().to_string(), why });
        }
        // It is rewritten when that is asked for, not by itself.
        let rewrite = RewriteOptions { check: Duration::from_secs(86_400), ..RewriteOptions::default() };
        SledStore::open(&self.data, SledOptions { rewrite, ..SledOptions::default() })
    }

    fn verify(&self) -> Result<(), Failure> {
        let (found, disk_bytes) = match self.open() {
            Ok(store) => {
                let mut progress = Progress::new(2 * store.about_records(), "records read", self.quiet);
                let found = store.verify_with(&mut |records| progress.update(records, records));
                progress.finish();
                let found = found.map_err(|error| self.told(error))?;
                (found, store.disk_bytes().map_err(|error| self.told(error))?)
            }
            // Damage that keeps it from opening is what was asked for as well.
            Err(error @ StoreError::Damaged { .. }) => {
                (Verification { problems: vec![error.to_string()], ..Verification::default() }, 0)
            }
            Err(error) => return Err(self.told(error)),
        };
        let Verification { maps, records, bytes, problems } = &found;
        if self.json {
            say_json(&json!({
                "directory": self.data.display().to_string(), "maps": maps, "records": records, "live_bytes": bytes,
                "disk_bytes": disk_bytes, "problems": problems,
            }))?;
        } else {
            say(&format!("maps     {maps}"))?;
            say(&format!("records  {records}"))?;
            say(&format!("size     {} held, {} on disk", megabytes(*bytes), megabytes(disk_bytes)))?;
            for problem in problems {
                say(&format!("damaged  {problem}"))?;
            }
        }
        match problems.len() {
            0 if self.json => Ok(()),
            0 => say("every record is sound"),
            count => {
                let what = if count == 1 { "1 problem".to_owned() } else { format!("{count} problems") };
                Err(anyhow!("{}: {what} found", self.data.display()).into())
            }
        }
    }

    fn rewrite(&self) -> Result<(), Failure> {
        let store = self.open().map_err(|error| self.told(error))?;
        // Each is copied and then compared.
        let total = store.about_records();
        let mut progress = Progress::new(2 * total, "records copied or compared", self.quiet);
        let done = store.rewrite(&mut |step| {
            match step {
                RewriteStep::Copying(records) => progress.update(records, records),
                RewriteStep::Comparing(records) => progress.update(total + records, total + records),
                _ => {}
            }
            Ok(())
        });
        progress.finish();
        let done = done.map_err(|error| self.told(error))?;
        drop(store);
        if self.json {
            return say_json(&json!({
                "directory": self.data.display().to_string(), "records": done.records, "live_bytes": done.live_bytes,
                "before_bytes": done.before_bytes, "after_bytes": done.after_bytes,
            }));
        }
        say(&format!(
            "{} records, {} held: {} on disk before, {} now",
            done.records,
            megabytes(done.live_bytes),
            megabytes(done.before_bytes),
            megabytes(done.after_bytes)
        ))
    }
}

fn megabytes(bytes: u64) -> String {
    format!("{:.1} MB", bytes as f64 / 1e6)
}

//! `ubbmap map snapshot`, `snapshots`, `restore` and `delete-snapshot`.

use super::client::{Client, ServerOptions, map_name, snapshot_name};
use super::output::{Failure, note, say, say_json, time_text};
use crate::store::{MapName, SnapshotName};
use clap::Args;

/// One snapshot of one map.
#[derive(Debug, Args)]
pub(super) struct OneSnapshot {
    /// The map's name
    #[arg(value_parser = map_name)]
    map: MapName,
    /// The snapshot's name: letters, digits, `_`, `-` and dots
    #[arg(value_parser = snapshot_name)]
    name: SnapshotName,
    #[command(flatten)]
    server: ServerOptions,
    /// Print the answer as JSON
    #[arg(long, help_heading = "Output")]
    json: bool,
}

/// All snapshots of one map.
#[derive(Debug, Args)]
pub(super) struct Snapshots {
    /// The map's name
    #[arg(value_parser = map_name)]
    map: MapName,
    #[command(flatten)]
    server: ServerOptions,
    /// Print the answer as JSON
    #[arg(long, help_heading = "Output")]
    json: bool,
}

impl OneSnapshot {
    /// Keeps the map as it is.
    pub(super) fn take(&self) -> Result<(), Failure> {
        let client = Client::new(&self.server)?;
        let taken = client.take_snapshot(&self.map, &self.name).map_err(|error| client.explain(&self.map, error))?;
        if self.json {
            return say_json(&taken);
        }
        say(&format!("snapshot '{}' of map '{}' taken, revision {}", taken.name, self.map, taken.revision))
    }

    /// Makes the snapshot's content the map's.
    pub(super) fn restore(&self) -> Result<(), Failure> {
        let client = Client::new(&self.server)?;
        let restored = client.restore(&self.map, &self.name);
        let restored = restored.map_err(|error| client.explain_snapshot(&self.map, &self.name, error))?;
        if self.json {
            return say_json(&restored);
        }
        say(&format!("map '{}' is as in snapshot '{}', at revision {}", self.map, self.name, restored.revision))
    }

    /// Removes the snapshot.
    pub(super) fn delete(&self) -> Result<(), Failure> {
        let client = Client::new(&self.server)?;
        let deleted = client.delete_snapshot(&self.map, &self.name);
        let deleted = deleted.map_err(|error| client.explain_snapshot(&self.map, &self.name, error))?;
        if self.json { say_json(&deleted) } else { say(&format!("snapshot '{}' deleted", self.name)) }
    }
}

impl Snapshots {
    /// Lists them.
    pub(super) fn run(&self) -> Result<(), Failure> {
        let client = Client::new(&self.server)?;
        let list = client.snapshots(&self.map).map_err(|error| client.explain(&self.map, error))?;
        if self.json {
            return say_json(&list);
        }
        if list.snapshots.is_empty() {
            note(&format!("map '{}' has no snapshots", self.map));
            return Ok(());
        }
        let longest = list.snapshots.iter().map(|snapshot| snapshot.name.len()).max().unwrap_or(0).max(4);
        say(&format!("{:<longest$}  {:>8}  taken", "name", "revision"))?;
        for snapshot in &list.snapshots {
            let taken = time_text(snapshot.created);
            say(&format!("{:<longest$}  {:>8}  {taken}", snapshot.name, snapshot.revision))?;
        }
        Ok(())
    }
}

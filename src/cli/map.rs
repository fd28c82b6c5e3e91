//! `ubbmap map`: maps of a server. Snapshots and files have modules of their own.

use super::client::{Client, ServerOptions, map_name};
use super::options::{MapOptions, SensorOptions, map_config};
use super::output::{Failure, note, say, say_json, time_text};
use super::snapshots::{OneSnapshot, Snapshots};
use super::transfer::{EXPORT_HELP, Export, Import};
use crate::logs::LogSensor;
use crate::store::MapName;
use crate::wire::v1;
use clap::{Args, Subcommand};

/// Creates, lists, shows, keeps, exports, imports and deletes maps of a server.
#[derive(Debug, Args)]
#[command(arg_required_else_help = true)]
#[command(
    after_help = "Example:\n  ubbmap map create hall --resolution 0.05 --min-obstacle-width 0.05\n  ubbmap map list"
)]
pub(super) struct Map {
    #[command(subcommand)]
    action: Action,
}

#[derive(Debug, Subcommand)]
enum Action {
    /// Creates a map; the same configuration again finds it there
    #[command(allow_negative_numbers = true)]
    #[command(after_help = "Example:\n  ubbmap map create hall --resolution 0.05 --min-obstacle-width 0.05")]
    Create(Box<Create>),
    /// Lists the maps
    #[command(after_help = "Example:\n  ubbmap map list --server http://127.0.0.1:8080")]
    List(List),
    /// Shows a map's configuration, revision and robots
    #[command(after_help = "Example:\n  ubbmap map show hall --json")]
    Show(Named),
    /// Keeps the map as it is now under a name
    #[command(after_help = "Example:\n  ubbmap map snapshot hall before-the-move")]
    Snapshot(OneSnapshot),
    /// Lists the snapshots of a map
    #[command(after_help = "Example:\n  ubbmap map snapshots hall")]
    Snapshots(Snapshots),
    /// Makes a snapshot's content the map's, as a new revision
    #[command(after_help = "Example:\n  ubbmap map restore hall before-the-move")]
    Restore(OneSnapshot),
    /// Removes a snapshot; the map stays as it is
    #[command(after_help = "Example:\n  ubbmap map delete-snapshot hall before-the-move")]
    DeleteSnapshot(OneSnapshot),
    /// Writes a map to a file: a map file, or a map for Nav2
    #[command(after_help = EXPORT_HELP)]
    Export(Export),
    /// Makes a new map from a map file
    #[command(after_help = "Example:\n  ubbmap map import hall-2 hall.ubbmap")]
    Import(Import),
    /// Deletes a map and all that belongs to it, for ever
    #[command(after_help = "Example:\n  ubbmap map delete hall")]
    Delete(Named),
}

#[derive(Debug, Args)]
struct Create {
    /// The map's name: lower-case letters, digits, _ and -
    #[arg(value_parser = map_name)]
    name: MapName,
    #[command(flatten)]
    map: MapOptions,
    #[command(flatten)]
    sensor: SensorOptions,
    #[command(flatten)]
    server: ServerOptions,
    /// Print the answer as JSON
    #[arg(long, help_heading = "Output")]
    json: bool,
}

#[derive(Debug, Args)]
struct List {
    #[command(flatten)]
    server: ServerOptions,
    /// Print the answer as JSON
    #[arg(long, help_heading = "Output")]
    json: bool,
}

#[derive(Debug, Args)]
struct Named {
    /// The map's name
    #[arg(value_parser = map_name)]
    name: MapName,
    #[command(flatten)]
    server: ServerOptions,
    /// Print the answer as JSON
    #[arg(long, help_heading = "Output")]
    json: bool,
}

impl Map {
    /// Runs the command.
    pub(super) fn run(self) -> Result<(), Failure> {
        match self.action {
            Action::Create(create) => create.run(),
            Action::List(list) => list.run(),
            Action::Show(named) => named.show(),
            Action::Delete(named) => named.delete(),
            Action::Snapshot(one) => one.take(),
            Action::Snapshots(list) => list.run(),
            Action::Restore(one) => one.restore(),
            Action::DeleteSnapshot(one) => one.delete(),
            Action::Export(export) => export.run(),
            Action::Import(import) => import.run(),
        }
    }
}

impl Create {
    fn run(&self) -> Result<(), Failure> {
        let config = map_config(&self.map, &self.sensor, &LogSensor::default())?;
        let client = Client::new(&self.server)?;
        let made = client.create_map(&self.name, &config).map_err(|error| client.explain(&self.name, error))?;
        if self.json {
            return say_json(&made);
        }
        let what = if made.existed { "was there with this configuration, at" } else { "created," };
        say(&format!("map '{}' {what} revision {}", made.name, made.revision))
    }
}

impl List {
    fn run(&self) -> Result<(), Failure> {
        let list = Client::new(&self.server)?.maps()?;
        if self.json {
            return say_json(&list);
        }
        if list.maps.is_empty() {
            note("the server has no maps");
            return Ok(());
        }
        let longest = list.maps.iter().map(|map| map.name.len()).max().unwrap_or(0).max(4);
        say(&format!("{:<longest$}  {:>8}  {:>10}  evidence", "name", "revision", "resolution"))?;
        for map in &list.maps {
            let config = map.config.clone().unwrap_or_default();
            let resolution = format!("{} m", config.resolution.unwrap_or_default());
            let evidence = evidence_word(&config);
            say(&format!("{:<longest$}  {:>8}  {resolution:>10}  {evidence}", map.name, map.revision))?;
        }
        Ok(())
    }
}

impl Named {
    fn show(&self) -> Result<(), Failure> {
        let client = Client::new(&self.server)?;
        let map = client.map(&self.name).map_err(|error| client.explain(&self.name, error))?;
        if self.json {
            return say_json(&map);
        }
        let config = map.config.clone().unwrap_or_default();
        let bounds = map.bounds.unwrap_or_default();
        say(&format!("name        {}", map.name))?;
        say(&format!("revision    {}", map.revision))?;
        if let Some(last) = map.last_change {
            say(&format!("changed     {}", time_text(last)))?;
        }
        say(&format!("evidence    {}", evidence_word(&config)))?;
        say(&format!(
            "resolution  {} m, depth {}",
            config.resolution.unwrap_or_default(),
            config.depth.unwrap_or_default()
        ))?;
        say(&format!(
            "bounds      x {} to {} m, y {} to {} m",
            bounds.min_x, bounds.max_x, bounds.min_y, bounds.max_y
        ))?;
        say(&format!("classes     {}, unknown is {}", config.classes.unwrap_or_default(), map.unknown_class))?;
        say(&format!("obstacles   at least {} m wide", config.min_obstacle_width.unwrap_or_default()))?;
        say(&format!("sensors     {}", config.sensors.keys().cloned().collect::<Vec<_>>().join(", ")))?;
        for robot in &map.robots {
            let highest = robot.highest_sequence.map_or_else(|| "none".to_owned(), |n| n.to_string());
            say(&format!("robot       {}: {} scans, highest sequence {highest}", robot.robot, robot.applied))?;
        }
        Ok(())
    }

    fn delete(&self) -> Result<(), Failure> {
        let client = Client::new(&self.server)?;
        let answer = client.delete_map(&self.name).map_err(|error| client.explain(&self.name, error))?;
        if self.json { say_json(&answer) } else { say(&format!("map '{}' deleted", self.name)) }
    }
}

fn evidence_word(config: &v1::MapConfig) -> String {
    config.evidence().as_str_name().trim_start_matches("EVIDENCE_").to_lowercase()
}

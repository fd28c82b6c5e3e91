//! `ubbmap experiment`: the paper's experiment on a log, as a report.

use super::bag::BagFlags;
use super::build::{check_first, open_log, tell_choice};
use super::options::SensorOptions;
use super::output::{Failure, note, say, say_json};
use crate::experiment::Experiment;
use crate::experiment::report::{Block, Cell, Report, Table};
use crate::logs::{LogReader, PoseError};
use crate::sensor::{PoseBox, PoseLimits, Scan, ScanLimits, ScanSpec, SensorModel};
use anyhow::Context;
use clap::Args;
use serde_json::{Map, Value, json};
use std::num::NonZeroUsize;
use std::path::PathBuf;

/// Repeats the paper's experiment on a log and writes a report.
///
/// Maps of the log by each evidence rule and by an occupancy grid with Gaussian errors, their size, run time and figures;
/// what each error costs; how much of what was seen is called free; what happens when bounds do not hold.
#[derive(Debug, Args)]
#[command(
    allow_negative_numbers = true,
    after_help = "Example:\n  ubbmap experiment fr079.jsonl.gz --out report --pose-error 0.03,0.7deg"
)]
pub(super) struct RunExperiment {
    /// The log: CARMEN or JSON lines, plain or gzip; or a ROS 2 bag: MCAP, .db3 or a folder of them
    log: PathBuf,
    /// Folder for report.md, report.html, figures and tables; made where it is not there
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// Side of a leaf, metres
    #[arg(long, default_value_t = 0.1, value_name = "M", help_heading = "Map")]
    resolution: f64,
    /// Number of classes, 4 to 255
    #[arg(long, default_value_t = 10, value_name = "K", help_heading = "Map")]
    classes: u32,
    /// Width of the thinnest obstacle in the log's world, metres
    #[arg(long, default_value_t = 0.05, value_name = "M", help_heading = "Map")]
    min_obstacle_width: f64,
    #[command(flatten)]
    sensor: SensorOptions,
    #[command(flatten)]
    bag: BagFlags,
    /// How far poses may be off where the experiment takes them as uncertain
    #[arg(long, default_value = "0.03,0.7deg", value_name = "M,ANGLE", help_heading = "Scans")]
    pose_error: PoseError,
    /// Scans of the log, evenly picked, for the sweeps over errors, resolution and beams
    #[arg(long, default_value = "500", value_name = "N", help_heading = "Run")]
    sample: NonZeroUsize,
    /// Scans of the simulated building
    #[arg(long, default_value = "1200", value_name = "N", help_heading = "Run")]
    simulated: NonZeroUsize,
    /// Seed of the simulation
    #[arg(long, default_value_t = 1, value_name = "N", help_heading = "Run")]
    seed: u64,
    /// Set OctoMap beside: the driver that benches/peers/run --build makes
    #[arg(long, value_name = "FILE", help_heading = "Run")]
    octomap: Option<PathBuf>,
    /// Print the tables as one JSON object
    #[arg(long, help_heading = "Run")]
    json: bool,
}

impl RunExperiment {
    /// Runs the command.
    pub(super) fn run(&self) -> Result<(), Failure> {
        let experiment = self.experiment()?;
        std::fs::create_dir_all(&self.out).with_context(|| format!("cannot make {}", self.out.display()))?;
        let report = experiment.run(&mut |what| {
            if !self.json {
                note(what);
            }
        })?;
        report.write(&self.out).with_context(|| format!("cannot write to {}", self.out.display()))?;
        if self.json {
            return say_json(&tables(&report));
        }
        say(&summary(&report))?;
        say(&format!("report    {}", self.out.join("report.md").display()))
    }

    fn experiment(&self) -> Result<Experiment, Failure> {
        if let Some(driver) = self.octomap.as_ref().filter(|driver| !driver.is_file()) {
            let driver = driver.display();
            return Err(Failure::Usage(format!(
                "--octomap: no file {driver}; benches/peers/run --build makes the driver"
            )));
        }
        let reader = open_log(&self.log, &self.bag, self.pose_error)?;
        check_first(&self.log, &reader)?;
        tell_choice(&reader);
        let model = self.sensor.model(reader.sensor())?;
        let experiment = Experiment {
            log: self.log.file_name().unwrap_or_default().to_string_lossy().into_owned(),
            scans: exact_scans(reader, &model)?,
            sensor: model,
            resolution: self.resolution,
            classes: self.classes,
            min_obstacle_width: self.min_obstacle_width,
            pose_error: (self.pose_error.position, self.pose_error.heading),
            sample: self.sample.get(),
            simulated: self.simulated.get(),
            seed: self.seed,
            octomap: self.octomap.clone(),
            folder: self.out.clone(),
        };
        if experiment.scans.is_empty() {
            return Err(anyhow::anyhow!("{}: no scans", self.log.display()).into());
        }
        // What is refused is refused before anything is written.
        let checked = experiment.setup().config(crate::mapping::EvidenceRule::Outer, model);
        checked.map_err(|error| Failure::Usage(error.to_string()))?;
        Ok(experiment)
    }
}

/// The scans of a log, each at the middle of its pose.
fn exact_scans(reader: LogReader, sensor: &SensorModel) -> anyhow::Result<Vec<Scan>> {
    let unit = reader.unit();
    reader
        .map(|item| {
            let scan = item?;
            let (x, y, theta) = scan.pose.bounds(&PoseError::default());
            let middle = |(lo, hi): (f64, f64)| {
                let middle = lo + 0.5 * (hi - lo);
                (middle, middle)
            };
            let spec = ScanSpec {
                pose: PoseBox::new(middle(x), middle(y), middle(theta), &PoseLimits::default())
                    .with_context(|| format!("{unit} {}", scan.line))?,
                angles: scan.angles,
                ranges: scan.ranges,
                footprint_radius: 0.0,
                sweep_rotation: 0.0,
                sweep_translation: 0.0,
            };
            Scan::new(spec, *sensor, &ScanLimits::default()).with_context(|| format!("{unit} {}", scan.line))
        })
        .collect()
}

fn report_tables(report: &Report) -> impl Iterator<Item = &Table> {
    report.blocks.iter().filter_map(|block| if let Block::Table(table) = block { Some(table) } else { None })
}

fn value(cell: &Cell) -> Value {
    match cell {
        Cell::Text(text) => json!(text),
        Cell::Number(value, _) => json!(value),
        Cell::Missing => Value::Null,
    }
}

/// Each table by its name: a list of rows, each an object by column.
fn tables(report: &Report) -> Value {
    let rows = |table: &Table| -> Vec<Value> {
        let row = |row: &Vec<Cell>| table.columns.iter().cloned().zip(row.iter().map(value)).collect::<Map<_, _>>();
        table.rows.iter().map(|cells| Value::Object(row(cells))).collect()
    };
    Value::Object(report_tables(report).map(|table| (table.name.to_owned(), json!(rows(table)))).collect())
}

/// The figures that a reader asks for first.
fn summary(report: &Report) -> String {
    let number = |cell: Option<&Cell>| match cell {
        Some(Cell::Number(value, decimals)) => format!("{value:.decimals$}"),
        _ => "-".to_owned(),
    };
    let lines = report_tables(report).flat_map(|table| {
        let (name, column, what) = match table.name {
            "size" => ("leaves", 3, "leaves to the grid's cells"),
            "run-time" => ("run time", 3, "times the grid's run time"),
            "seen-building" => ("building", 5, "% of seen obstacle points called free"),
            _ => return Vec::new(),
        };
        let words = |row: &Vec<Cell>| {
            row.iter()
                .map_while(|cell| if let Cell::Text(text) = cell { Some(text.as_str()) } else { None })
                .collect::<Vec<_>>()
                .join(", ")
        };
        table.rows.iter().map(|row| format!("{name:<9} {}: {} {what}", words(row), number(row.get(column)))).collect()
    });
    lines.collect::<Vec<_>>().join("\n")
}

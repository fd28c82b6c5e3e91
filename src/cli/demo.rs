//! `ubbmap demo`: a server, a simulated building, and a fleet of robots that map it live.

use super::client::{Client, map_name};
use super::output::{Failure, note, say, say_json};
use super::replay::sender::{Numbered, Running, Tally, Team};
use crate::app::{AppError, Server, bind};
use crate::config::Config;
use crate::mapping::{EvidenceRule, MapConfig};
use crate::picture::Picture;
use crate::quadtree::{ClassScale, Grid};
use crate::sensor::{Angles, SensorModel};
use crate::simulation::{Fleet, SimulatedScan};
use crate::store::{LoadedMap, MapName, MapStore, RobotName, SledOptions, SledStore};
use crate::telemetry;
use crate::wire::v1::{self, region::Shape};
use anyhow::Context;
use clap::Args;
use serde_json::json;
use std::collections::BTreeMap;
use std::io::ErrorKind;
use std::net::SocketAddr;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

/// Leaves of the demo's map, metres.
const RESOLUTION: f64 = 0.05;

/// Width of the thinnest obstacle in the building, metres.
const THINNEST: f64 = 0.02;

/// Simulated time from one scan of a robot to its next, seconds.
const STEP: f64 = 0.2;

/// Maps for so long with `--exit` unless told otherwise, seconds.
const EXIT_AFTER: f64 = 20.0;

/// Radius of the discs that the summary asks about, metres: that of a robot's body.
const EXAMPLE_RADIUS: f64 = 0.25;

/// How often a line tells of the progress.
const TELL_EVERY: Duration = Duration::from_secs(5);

/// Serves a simulated building that a fleet of robots maps live.
#[derive(Debug, Args)]
#[command(allow_negative_numbers = true)]
#[command(after_help = "Example:\n  ubbmap demo --robots 8\n  ubbmap demo --duration 10 --exit --png demo.png")]
pub(super) struct Demo {
    /// Shifts the building's furniture and the robots' errors; the same seed gives the same scans
    #[arg(long, default_value_t = 1, value_name = "N")]
    seed: u64,
    /// Robots
    #[arg(long, default_value_t = 5, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=100))]
    robots: u16,
    /// Seconds of the building's time that pass in one of ours
    #[arg(long, default_value_t = 6.0, value_name = "X", value_parser = super::replay::positive)]
    speed: f64,
    /// Map for so many seconds [default: until stopped, or 20 with --exit]
    #[arg(long, value_name = "S", value_parser = super::options::span)]
    duration: Option<f64>,
    /// End after the duration, with a summary; else serve on until stopped
    #[arg(long)]
    exit: bool,
    /// Address to listen on; port 0 takes a free one [default: 127.0.0.1:8080, or a free port where that is taken]
    #[arg(long, value_name = "ADDRESS", value_parser = crate::config::address)]
    listen: Option<SocketAddr>,
    /// Directory of the store, kept afterwards [default: a new one, deleted afterwards]
    #[arg(long, value_name = "DIR")]
    data: Option<PathBuf>,
    /// Draw the map at the end
    #[arg(long, value_name = "FILE")]
    png: Option<PathBuf>,
    /// Print the summary as one JSON object
    #[arg(long)]
    json: bool,
}

/// A directory that may go when its owner does.
struct Directory {
    path: PathBuf,
    temporary: bool,
}

impl Drop for Directory {
    fn drop(&mut self) {
        if self.temporary {
            // What cannot be deleted stays in the system's directory for what may go.
            let _ = std::fs::remove_dir_all(&self.path);
        }
    }
}

impl Demo {
    /// Runs the command.
    pub(super) fn run(self) -> Result<(), Failure> {
        super::options::check_png(self.png.as_deref())?;
        let directory = self.directory()?;
        let mut config = Config {
            listen: self.listen.unwrap_or(Config::default().listen),
            data_dir: directory.path.clone(),
            log: "warn".to_owned(),
            ..Config::default()
        };
        telemetry::init(&config.log, config.log_format, None);
        let refused = |error| match error {
            AppError::Config(error) => Failure::Configuration(error.to_string()),
            error => Failure::Failed(error.into()),
        };
        let runtime = tokio::runtime::Builder::new_multi_thread().enable_all().build()?;
        config.check().map_err(|error| refused(error.into()))?;
        let bound = match runtime.block_on(bind(&config)) {
            // Nobody asked for this port, so a free one is as good.
            Err(AppError::Listen { source, .. }) if self.listen.is_none() && source.kind() == ErrorKind::AddrInUse => {
                config.listen.set_port(0);
                runtime.block_on(bind(&config))
            }
            bound => bound,
        };
        let bound = bound.map_err(refused)?;
        let store: Arc<dyn MapStore> = Arc::new(
            SledStore::open(&directory.path, SledOptions::default())
                .with_context(|| format!("cannot open the store in {}", directory.path.display()))?,
        );
        let started = Server::start_on(bound, &config, Arc::clone(&store));
        let server = runtime.block_on(started).map_err(refused)?;
        let stop = Arc::new(AtomicBool::new(false));
        let told = Arc::clone(&stop);
        // Heard from here on: whoever reads that the demo is ready may ask it to stop at once.
        let asked = {
            let _inside = runtime.enter();
            asked_to_stop()?
        };
        runtime.spawn(async move {
            asked.await;
            told.store(true, Ordering::Relaxed);
        });
        let map = map_name(&format!("demo-{}", self.seed)).map_err(Failure::Usage)?;
        // The JSON object is the only line on stdout, so that a program can read it.
        let ready = format!("ubbmap demo on {}, map '{map}'", server.url());
        if self.json {
            note(&ready);
        } else {
            say(&ready)?;
        }
        let mapped = self.map(&server.url(), &map, &store, &stop);
        let ended = runtime.block_on(server.shutdown());
        mapped?;
        Ok(ended?)
    }

    fn directory(&self) -> Result<Directory, Failure> {
        if let Some(path) = &self.data {
            return Ok(Directory { path: path.clone(), temporary: false });
        }
        let now = std::time::SystemTime::now().duration_since(std::time::UNIX_EPOCH).unwrap_or_default();
        let name = format!("ubbmap-demo-{}-{}", std::process::id(), now.subsec_nanos());
        let path = std::env::temp_dir().join(name);
        std::fs::create_dir(&path).with_context(|| format!("cannot create {}", path.display()))?;
        Ok(Directory { path, temporary: true })
    }

    /// Creates the map, lets the robots map it, and tells what came of it.
    fn map(&self, url: &str, map: &MapName, store: &Arc<dyn MapStore>, stop: &AtomicBool) -> Result<(), Failure> {
        let client = Client::of(url)?;
        let made = client.create_map(map, &config()?).map_err(|error| client.explain(map, error))?;
        let done: BTreeMap<String, u64> =
            made.robots.into_iter().filter_map(|robot| Some((robot.robot, robot.highest_sequence?))).collect();
        let mut drive =
            Drive { demo: self, fleet: Fleet::new(self.seed, usize::from(self.robots)).with_glass(), done, last: None };
        let names = (0..self.robots).map(|i| RobotName::new(&format!("robot-{i}"))).collect::<Result<Vec<_>, _>>()?;
        let team =
            Team { client, map: map.clone(), patience: Duration::from_secs(10), batch: 32, whole: false, unit: "scan" };
        let mut tally = team.run(&names, |hand_over, running| drive.run(&names, hand_over, running, stop));
        if let Some(error) = tally.failure.take() {
            return Err(team.client.explain(map, error));
        }
        if self.exit {
            self.sum_up(&team, &tally, store, &drive)?;
        } else {
            note(&format!("{} scans applied; serving until stopped", tally.applied));
            while !stop.load(Ordering::Relaxed) {
                std::thread::sleep(Duration::from_millis(50));
            }
        }
        self.draw(store, map, &tally)
    }

    fn draw(&self, store: &Arc<dyn MapStore>, map: &MapName, tally: &Tally) -> Result<(), Failure> {
        let Some(path) = &self.png else { return Ok(()) };
        let caption =
            format!("simulated building, guaranteed evidence, {RESOLUTION} m leaves, {} scans", tally.applied);
        let picture = Picture::of_map(&load(store, map)?.tree, config()?.grid(), &caption);
        picture.save(path).with_context(|| format!("cannot write {}", path.display()))?;
        Ok(())
    }

    fn sum_up(&self, team: &Team, tally: &Tally, store: &Arc<dyn MapStore>, drive: &Drive<'_>) -> Result<(), Failure> {
        let statistics = load(store, &team.map)?.tree.statistics();
        let leaf = RESOLUTION * RESOLUTION;
        let (free, occupied) = (statistics.free_cells as f64 * leaf, statistics.occupied_cells as f64 * leaf);
        let (x, y) = drive.last.as_ref().map_or((0.0, 0.0), |scan| (scan.truth.x, scan.truth.y));
        let disc = |x: f64, y: f64, radius: f64| {
            let center = Some(v1::Point { x: Some(x), y: Some(y) });
            v1::Region { shape: Some(Shape::Disc(v1::DiscRegion { center, radius: Some(radius) })) }
        };
        // Around a robot, and in the outer wall, whose corner is the origin.
        let regions = vec![disc(x, y, EXAMPLE_RADIUS), disc(0.0, 0.0, EXAMPLE_RADIUS)];
        let answer =
            team.client.check(&team.map, None, regions, 0).map_err(|error| team.client.explain(&team.map, error))?;
        let verdict = |index: usize| answer.results.get(index).is_some_and(|result| result.free);
        if self.json {
            return say_json(&json!({
                "map": team.map.as_str(), "robots": self.robots, "applied": tally.applied,
                "rejected": tally.rejected, "revision": tally.revision.to_string(),
                "area_free": free, "area_occupied": occupied,
                "examples": [
                    {"disc": {"x": x, "y": y, "radius": EXAMPLE_RADIUS}, "free": verdict(0)},
                    {"disc": {"x": 0.0, "y": 0.0, "radius": EXAMPLE_RADIUS}, "free": verdict(1)},
                ],
            }));
        }
        let word = |free: bool| if free { "guaranteed free" } else { "not guaranteed free" };
        say(&format!("{} scans applied, {} rejected, revision {}", tally.applied, tally.rejected, tally.revision))?;
        say(&format!("{free:.1} m2 proven free, {occupied:.1} m2 occupied"))?;
        say(&format!("a disc of {EXAMPLE_RADIUS} m where robot-0 is ({x:.2},{y:.2}): {}", word(verdict(0))))?;
        say(&format!("a disc of {EXAMPLE_RADIUS} m at the building's corner (0,0): {}", word(verdict(1))))
    }
}

/// The fleet at work.
struct Drive<'a> {
    demo: &'a Demo,
    fleet: Fleet,
    /// What the map has of each robot: a store that is kept goes on behind it.
    done: BTreeMap<String, u64>,
    /// The last scan of the first robot.
    last: Option<SimulatedScan>,
}

impl Drive<'_> {
    fn run(
        &mut self,
        names: &[RobotName],
        hand_over: &dyn Fn(usize, Numbered) -> bool,
        running: &Running,
        stop: &AtomicBool,
    ) {
        let started = Instant::now();
        let mut told = started;
        let forever = if self.demo.exit { EXIT_AFTER } else { f64::INFINITY };
        let duration = self.demo.duration.unwrap_or(forever);
        for step in 0_u64.. {
            let due = step as f64 * STEP / self.demo.speed;
            if due > duration || stop.load(Ordering::Relaxed) {
                return;
            }
            std::thread::sleep(Duration::from_secs_f64(due).saturating_sub(started.elapsed()));
            for scan in self.fleet.step() {
                let Some(robot) = names.iter().position(|name| name.as_str() == scan.robot) else { continue };
                let behind = self.done.get(&scan.robot).copied().unwrap_or(0);
                if !hand_over(robot, Numbered { line: 0, scan: wire_scan(&scan, behind) }) {
                    return;
                }
                if robot == 0 {
                    self.last = Some(scan);
                }
            }
            if told.elapsed() >= TELL_EVERY {
                told = Instant::now();
                note(&format!("{} scans sent", running.sent.load(Ordering::Relaxed)));
            }
        }
    }
}

/// The demo's map: leaves small enough to show chair legs.
fn config() -> anyhow::Result<MapConfig> {
    let sensors = BTreeMap::from([("default".to_owned(), SensorModel::new(Fleet::sensor())?)]);
    let grid = Grid::new(RESOLUTION, 16, None)?;
    Ok(MapConfig::new(grid, ClassScale::new(10)?, EvidenceRule::Guaranteed, THINNEST, sensors)?)
}

fn load(store: &Arc<dyn MapStore>, map: &MapName) -> anyhow::Result<LoadedMap> {
    let stored = store.list()?.into_iter().find(|stored| stored.name == *map).context("the map is gone")?;
    Ok(store.load(stored.id)?)
}

fn wire_scan(scan: &SimulatedScan, behind: u64) -> v1::Scan {
    let spec = &scan.scan;
    let interval = |i: crate::interval::Interval| Some(v1::Interval { min: Some(i.lo()), max: Some(i.hi()) });
    let (angle_min, angle_increment, angles) = match &spec.angles {
        Angles::Uniform { min, increment } => (Some(*min), Some(*increment), Vec::new()),
        Angles::Listed(angles) => (None, None, angles.clone()),
    };
    v1::Scan {
        robot: scan.robot.clone(),
        sequence: Some(behind + scan.sequence),
        stamp: scan.stamp,
        sensor: "default".to_owned(),
        pose: Some(v1::PoseBox {
            x: interval(spec.pose.x()),
            y: interval(spec.pose.y()),
            theta: interval(spec.pose.theta()),
        }),
        angle_min,
        angle_increment,
        angles,
        ranges: spec.ranges.clone(),
        footprint_radius: spec.footprint_radius,
        sweep_rotation: spec.sweep_rotation,
        sweep_translation: spec.sweep_translation,
    }
}

#[cfg(unix)]
fn asked_to_stop() -> std::io::Result<impl Future<Output = ()>> {
    use tokio::signal::unix::{SignalKind, signal};
    let mut terminate = signal(SignalKind::terminate())?;
    let mut interrupt = signal(SignalKind::interrupt())?;
    Ok(async move {
        tokio::select! {
            _ = terminate.recv() => {}
            _ = interrupt.recv() => {}
        }
    })
}

#[cfg(not(unix))]
fn asked_to_stop() -> std::io::Result<impl Future<Output = ()>> {
    Ok(async {
        // Without a way to be told, the demo runs until the process ends.
        if tokio::signal::ctrl_c().await.is_err() {
            std::future::pending::<()>().await;
        }
    })
}

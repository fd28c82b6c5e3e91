//! `ubbmap replay`: a log to a server, by one or more robots, acknowledged and resumable.
//!
//! Scan `i` of the log goes to robot `i % N`, which counts its own scans from 1. A robot sends its scans in order and
//! waits for each answer, so what the server has of it is a beginning of its scans: a replay that starts again asks
//! for the highest number of each robot and goes on behind it. A robot's name holds the log's name and `N`, so that
//! another log or another number of robots is not taken for the same scans.

pub(super) mod sender;

use super::bag::BagFlags;
use super::build::{ScanOptions, check_first, open_log, tell_choice, tell_left_out};
use super::client::{Client, ClientError, ServerOptions, map_name};
use super::options::{MapOptions, SENSOR, SensorOptions, at_least_one, given, map_config, span};
use super::output::{Failure, Progress, note, rate_text, say, say_json};
use crate::logs::{LogReader, LogScan};
use crate::sensor::Angles;
use crate::store::{MapName, RobotName, WINDOW_LENGTH};
use crate::wire::{to_wire_config, v1};
use clap::{ArgMatches, Args};
use sender::{Numbered, Running, Tally, Team, Waiting};
use serde_json::{Value, json};
use std::collections::BTreeMap;
use std::num::{NonZeroU64, NonZeroUsize};
use std::path::PathBuf;
use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};

/// Most robots of one replay: a thread and a connection each.
const MAX_ROBOTS: usize = 256;

/// How often the progress is shown while nothing happens.
const SHOW_EVERY: Duration = Duration::from_secs(1);

/// Sends a recorded log to a server; the same command again goes on where it was stopped.
#[derive(Debug, Args)]
#[command(
    allow_negative_numbers = true,
    after_help = "Example:\n  ubbmap replay fr079.jsonl.gz --map fr079 --robots 4 --pose-error 0.03,0.7deg"
)]
pub(in crate::cli) struct Replay {
    /// The log: CARMEN or JSON lines, plain or gzip; or a ROS 2 bag: MCAP, .db3 or a folder of them
    log: PathBuf,
    /// The map
    #[arg(long, value_name = "NAME", value_parser = map_name)]
    map: MapName,
    #[command(flatten)]
    server: ServerOptions,
    /// Robots that share the scans in turn
    #[arg(long, default_value = "1", value_name = "N", value_parser = at_least_one::<NonZeroUsize>, help_heading = "Run")]
    robots: NonZeroUsize,
    /// Scans a second, all robots together [default: as fast as they are acknowledged]
    #[arg(long, value_name = "X", value_parser = positive, help_heading = "Run")]
    rate: Option<f64>,
    /// Most scans of one request
    #[arg(long, default_value = "64", value_name = "N", value_parser = clap::value_parser!(u16).range(1..=1024), help_heading = "Run")]
    batch: u16,
    /// Stop after the log's first N scans
    #[arg(long, value_name = "N", value_parser = at_least_one::<NonZeroU64>, help_heading = "Run")]
    limit: Option<NonZeroU64>,
    /// Begin the robots' names with this [default: the log's name]
    #[arg(long, value_name = "NAME", help_heading = "Run")]
    robot_prefix: Option<String>,
    /// How long to go on trying while the server does not answer or is busy, seconds
    #[arg(long, default_value_t = 60.0, value_name = "S", value_parser = span, help_heading = "Run")]
    retry_for: f64,
    /// Print the counts as one JSON object
    #[arg(long, help_heading = "Run")]
    json: bool,
    #[command(flatten)]
    scans: ScanOptions,
    #[command(flatten)]
    bag: BagFlags,
    /// Fail if the map is not there, instead of creating it as the flags below and the log describe it
    #[arg(long, help_heading = "Map")]
    existing: bool,
    /// Whether a flag describes the map: then it must be as described.
    #[arg(skip)]
    described: bool,
    #[command(flatten)]
    new_map: MapOptions,
    #[command(flatten)]
    sensor: SensorOptions,
}

/// What the map has before the replay.
struct Known {
    revision: u64,
    /// The sequence number of each robot behind which its scans are sent.
    robots: BTreeMap<String, u64>,
}

impl Replay {
    /// Takes note of flags that describe the map, and refuses them where none is to be made.
    pub(in crate::cli) fn check_flags(&mut self, matches: &ArgMatches) -> Result<(), Failure> {
        let flag = given(matches);
        self.described = flag.is_some();
        match flag {
            Some(flag) if self.existing => {
                Err(Failure::Usage(format!("--{flag} describes a new map, and --existing makes none")))
            }
            _ => Ok(()),
        }
    }

    /// Runs the command.
    pub(in crate::cli) fn run(self) -> Result<(), Failure> {
        if self.robots.get() > MAX_ROBOTS {
            return Err(Failure::Usage(format!("--robots must be at most {MAX_ROBOTS}")));
        }
        let names = self.robot_names()?;
        let client = Client::new(&self.server)?;
        let mut reader = open_log(&self.log, &self.bag, self.scans.pose_error)?;
        // A log without a scan makes no map.
        check_first(&self.log, &reader)?;
        tell_choice(&reader);
        let total = self.count()?;
        let known = self.known(&client, &reader)?;
        let done = self.already_done(&names, &known.robots)?;
        let started = Instant::now();
        let patience = Duration::from_secs_f64(self.retry_for);
        let team = Team {
            client,
            map: self.map.clone(),
            patience,
            batch: usize::from(self.batch),
            whole: self.rate.is_none(),
            unit: reader.unit(),
        };
        let (damage, mut tally) = self.send(&team, &names, &done, &mut reader, total);
        tell_left_out(&reader);
        tally.revision = tally.revision.max(known.revision);
        let failure = tally.failure.take();
        self.report(&tally, started.elapsed())?;
        self.tell_what_is_missing(&team.client, &names);
        if let Some(error) = failure {
            let total = tally.skipped + tally.sent;
            let error = team.client.explain(&self.map, error);
            let Failure::Failed(error) = error else { return Err(error) };
            let context = format!("stopped with {total} scans acknowledged; the same command goes on from there");
            return Err(error.context(context).into());
        }
        if let Some(damage) = damage {
            let whole = tally.skipped + tally.sent;
            return Err(damage
                .context(format!("{} is damaged; the {whole} scans before were sent", self.log.display()))
                .into());
        }
        if tally.rejected > 0 {
            return Err(anyhow::anyhow!("{} scans were rejected", tally.rejected).into());
        }
        Ok(())
    }

    /// `LOG-1of4`, ..
    fn robot_names(&self) -> Result<Vec<RobotName>, Failure> {
        let prefix = self.prefix();
        let count = self.robots.get();
        (1..=count)
            .map(|robot| {
                RobotName::new(&format!("{prefix}-{robot}of{count}")).map_err(|error| Failure::Usage(error.to_string()))
            })
            .collect()
    }

    fn prefix(&self) -> String {
        if let Some(prefix) = &self.robot_prefix {
            return prefix.clone();
        }
        let file = self.log.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default();
        let stem = file.trim_end_matches(".gz").trim_end_matches(".jsonl").trim_end_matches(".log");
        let stem = stem.trim_end_matches(".mcap").trim_end_matches(".db3");
        let allowed = |c: char| if c.is_ascii_alphanumeric() || "_.-".contains(c) { c } else { '_' };
        // "-256of256" is the longest that follows.
        let name: String = stem.chars().map(allowed).take(50).collect();
        if name.starts_with(|c: char| c.is_ascii_alphanumeric()) {
            name
        } else {
            format!("log{name}").chars().take(50).collect()
        }
    }

    /// What the map knows of robots. A map that is not there is created; one that is must be as the flags describe it.
    fn known(&self, client: &Client, reader: &LogReader) -> Result<Known, Failure> {
        let patience = Duration::from_secs_f64(self.retry_for.min(10.0));
        let waiting = Waiting::new();
        let told = |attempt: u32, error: &ClientError| waiting.failed(attempt, error);
        let found = if self.described {
            None
        } else {
            match Client::patiently(patience, || false, told, || client.map(&self.map)) {
                Ok(map) => {
                    self.tell_what_differs(map.config.as_ref(), reader)?;
                    Some((map.revision, map.robots))
                }
                Err(error) if error.is("MAP_NOT_FOUND") && !self.existing => None,
                Err(error) => return Err(client.explain(&self.map, error)),
            }
        };
        let (revision, robots) = match found {
            Some(found) => found,
            None => {
                let config = map_config(&self.new_map, &self.sensor, reader.sensor())?;
                let map = Client::patiently(patience, || false, told, || client.create_map(&self.map, &config))
                    .map_err(|error| client.explain(&self.map, error))?;
                if !map.existed {
                    note(&format!("created map '{}'", self.map));
                }
                (map.revision, map.robots)
            }
        };
        let robots = robots.into_iter().filter_map(|robot| {
            let highest = robot.highest_sequence?;
            // Numbers begin with 1. Some are missing where a snapshot was restored while others were on their way: all that
            // can be told apart are sent again, and count as duplicates where they are there.
            let whole = robot.applied >= highest;
            Some((robot.robot, if whole { highest } else { highest.saturating_sub(WINDOW_LENGTH - 1) }))
        });
        Ok(Known { revision, robots: robots.collect() })
    }

    /// Says how a map that is used as it is there differs from the one that the log and the defaults describe: what it
    /// proves is by its own configuration.
    fn tell_what_differs(&self, there: Option<&v1::MapConfig>, reader: &LogReader) -> Result<(), Failure> {
        let described = to_wire_config(&map_config(&self.new_map, &self.sensor, reader.sensor())?);
        let (there, described) = (serde_json::to_value(there)?, serde_json::to_value(described)?);
        let words = differences(&there, &described);
        if !words.is_empty() {
            let words = words.join(", ");
            note(&format!(
                "map '{}' is used as it is there; by the log and the defaults it would differ: {words}",
                self.map
            ));
        }
        Ok(())
    }

    /// Says which robots' scans are not all in the map, though later ones are.
    fn tell_what_is_missing(&self, client: &Client, names: &[RobotName]) {
        // The scans are acknowledged; a server that is gone by now is no failure.
        let Ok(map) = client.map(&self.map) else { return };
        for robot in map.robots.iter().filter(|robot| names.iter().any(|name| name.as_str() == robot.robot)) {
            let missing = robot.highest_sequence.unwrap_or_default().saturating_sub(robot.applied);
            if missing > 0 {
                note(&format!(
                    "{missing} scans of {} are not in the map, though later ones are: was a snapshot restored meanwhile? The \
                     same command sends those again that are not too old",
                    robot.robot
                ));
            }
        }
    }

    /// How many scans of each robot the map has.
    fn already_done(&self, names: &[RobotName], known: &BTreeMap<String, u64>) -> Result<Vec<u64>, Failure> {
        let beginning = format!("{}-", self.prefix());
        let other = known.keys().find(|name| {
            let rest = name.strip_prefix(&beginning).and_then(|rest| rest.split_once("of"));
            rest.is_some_and(|(robot, count)| {
                robot.parse::<u64>().is_ok() && count.parse().is_ok_and(|count: usize| count != self.robots.get())
            })
        });
        if let Some(name) = other {
            return Err(Failure::Failed(anyhow::anyhow!(
                "map '{}' has scans of this log from {name}: go on with that many --robots, or tell another --robot-prefix to \
                 send all scans once more",
                self.map
            )));
        }
        Ok(names.iter().map(|name| known.get(name.as_str()).copied().unwrap_or(0)).collect())
    }

    /// The scans of the log, where a rate is kept: bytes are read far ahead of it, so they do not tell how far it is.
    fn count(&self) -> Result<Option<u64>, Failure> {
        if self.rate.is_none() {
            return Ok(None);
        }
        let limit = self.limit.map_or(u64::MAX, NonZeroU64::get);
        let scans = open_log(&self.log, &self.bag, self.scans.pose_error)?.take_while(Result::is_ok).map(drop);
        Ok(Some((0..limit).zip(scans).count() as u64))
    }

    /// Reads the log and hands each scan to its robot; returns what ended the log early, and the counts.
    fn send(
        &self,
        team: &Team,
        names: &[RobotName],
        done: &[u64],
        reader: &mut LogReader,
        total: Option<u64>,
    ) -> (Option<anyhow::Error>, Tally) {
        let size = total.unwrap_or_else(|| reader.size());
        let read = reader.bytes_read();
        let mut progress = Progress::new(size, "scans", false);
        let mut show = |tally: &Running| {
            let (sent, skipped) = (tally.sent.load(Ordering::Relaxed), tally.skipped.load(Ordering::Relaxed));
            let position = if total.is_some() { sent + skipped } else { read.load(Ordering::Relaxed) };
            progress.update(position, sent);
        };
        let mut damage = None;
        let tally = team.run(names, |hand_over, tally| {
            let started = Instant::now();
            let mut handed = 0_u64;
            for index in 0..self.limit.map_or(u64::MAX, NonZeroU64::get) {
                let scan = match reader.next() {
                    None => break,
                    Some(Ok(scan)) => scan,
                    Some(Err(error)) => {
                        damage = Some(anyhow::Error::from(error));
                        break;
                    }
                };
                let robot = (index % names.len() as u64) as usize;
                let sequence = index / names.len() as u64 + 1;
                if sequence <= done[robot] {
                    tally.skipped.fetch_add(1, Ordering::Relaxed);
                    continue;
                }
                self.keep_the_rate(started, handed, || show(tally));
                handed += 1;
                let scan = Numbered { line: scan.line, scan: self.wire_scan(scan, &names[robot], sequence) };
                if !hand_over(robot, scan) {
                    break;
                }
                show(tally);
            }
        });
        progress.finish();
        (damage, tally)
    }

    /// Waits until the next scan is due, and tells of the progress meanwhile.
    fn keep_the_rate(&self, started: Instant, handed: u64, mut show: impl FnMut()) {
        let Some(rate) = self.rate else { return };
        let due = Duration::try_from_secs_f64(handed as f64 / rate).unwrap_or(Duration::MAX);
        loop {
            let left = due.saturating_sub(started.elapsed());
            if left.is_zero() {
                return;
            }
            std::thread::sleep(left.min(SHOW_EVERY));
            show();
        }
    }

    fn wire_scan(&self, scan: LogScan, robot: &RobotName, sequence: u64) -> v1::Scan {
        let (x, y, theta) = scan.pose.bounds(&self.scans.pose_error);
        let interval = |(min, max)| Some(v1::Interval { min: Some(min), max: Some(max) });
        let (angle_min, angle_increment, angles) = match scan.angles {
            Angles::Uniform { min, increment } => (Some(min), Some(increment), Vec::new()),
            Angles::Listed(angles) => (None, None, angles),
        };
        v1::Scan {
            robot: robot.as_str().to_owned(),
            sequence: Some(sequence),
            stamp: scan.stamp,
            sensor: SENSOR.to_owned(),
            pose: Some(v1::PoseBox { x: interval(x), y: interval(y), theta: interval(theta) }),
            angle_min,
            angle_increment,
            angles,
            ranges: scan.ranges,
            footprint_radius: self.scans.footprint_radius.or(scan.footprint_radius).unwrap_or(0.0),
            sweep_rotation: scan.sweep_rotation,
            sweep_translation: scan.sweep_translation,
        }
    }

    fn report(&self, tally: &Tally, elapsed: Duration) -> Result<(), Failure> {
        let seconds = elapsed.as_secs_f64();
        if self.json {
            return say_json(&json!({
                "sent": tally.sent,
                "skipped": tally.skipped,
                "applied": tally.applied,
                "duplicates": tally.duplicates,
                "rejected": tally.rejected,
                // A string, as 64-bit numbers are in the interface.
                "revision": tally.revision.to_string(),
                "seconds": seconds,
            }));
        }
        if tally.sent == 0 && tally.skipped > 0 && tally.failure.is_none() {
            note("scans that are in the map stay there with the poses that they were sent with");
            let (scans, revision) = (tally.skipped, tally.revision);
            return say(&format!("nothing to send: all {scans} scans were there before; revision {revision}"));
        }
        say(&format!(
            "{} scans sent in {seconds:.1} s ({}): {} applied, {} duplicates, {} rejected; {} were there before; revision {}",
            tally.sent,
            rate_text(tally.sent as f64 / seconds.max(1e-3)),
            tally.applied,
            tally.duplicates,
            tally.rejected,
            tally.skipped,
            tally.revision
        ))
    }
}

/// What two configurations do not have in common, as `resolution 0.05, not 0.1`; of what is no single value, its name.
fn differences(there: &Value, described: &Value) -> Vec<String> {
    let Value::Object(described) = described else { return Vec::new() };
    let differing = described.iter().filter(|(key, value)| there.get(key.as_str()) != Some(value));
    let told = differing.map(|(key, value)| match (there.get(key), value) {
        (Some(Value::Object(_) | Value::Array(_)), _) | (_, Value::Object(_) | Value::Array(_)) => key.clone(),
        (Some(there), value) => format!("{key} {there}, not {value}"),
        (None, value) => format!("{key} the default, not {value}"),
    });
    told.collect()
}

pub(super) fn positive(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(value) if value > 0.0 && value <= 1e9 => Ok(value),
        _ => Err("must be a number above 0".to_owned()),
    }
}

//! `ubbmap build`: a log to a map file, offline.

use super::bag::BagFlags;
use super::mapper::{BATCH, Mapper};
use super::options::{MapOptions, SENSOR, SensorOptions, at_least_one, check_png, map_config, rule_name};
use super::output::{Failure, Progress, causes, note, say, say_json, write_whole};
use crate::interval::Interval;
use crate::logs::{BagOptions, LogReader, LogScan, PoseError};
use crate::mapping::Surveyor;
use crate::picture::{Picture, known_range};
use crate::quadtree::{Grid, LeafRange, TreeStatistics};
use crate::sensor::{PoseBox, PoseLimits, Scan, ScanError, ScanLimits, ScanSpec, SensorModel};
use crate::store::{LoadedMap, write_map_file};
use anyhow::Context;
use clap::Args;
use serde_json::{Value, json};
use std::collections::BTreeMap;
use std::num::{NonZeroU64, NonZeroUsize};
use std::path::{Path, PathBuf};
use std::sync::atomic::Ordering;

/// Builds a map file from a recorded log.
#[derive(Debug, Args)]
#[command(
    allow_negative_numbers = true,
    after_help = "Example:\n  ubbmap build fr079.jsonl.gz --out fr079.ubbmap --png fr079.png --pose-error 0.03,0.7deg\n  \
    ubbmap build drive/ --out hall.ubbmap --scan-topic /scan --pose-error 0.05,1deg"
)]
pub(super) struct Build {
    /// The log: CARMEN or JSON lines, plain or gzip; or a ROS 2 bag: MCAP, .db3 or a folder of them
    log: PathBuf,
    /// Map file to write
    #[arg(long, value_name = "FILE")]
    out: PathBuf,
    /// Also draw the map as a picture
    #[arg(long, value_name = "FILE")]
    png: Option<PathBuf>,
    #[command(flatten)]
    map: MapOptions,
    #[command(flatten)]
    sensor: SensorOptions,
    #[command(flatten)]
    scans: ScanOptions,
    #[command(flatten)]
    bag: BagFlags,
    /// Use every Nth scan of the log
    #[arg(long, default_value = "1", value_name = "N", value_parser = at_least_one::<NonZeroUsize>, help_heading = "Run")]
    every: NonZeroUsize,
    /// Stop after N scans
    #[arg(long, value_name = "N", value_parser = at_least_one::<NonZeroU64>, help_heading = "Run")]
    limit: Option<NonZeroU64>,
    /// Threads that compute evidence; 1 holds the whole build to one core [default: one a core]
    #[arg(long, value_name = "N", value_parser = at_least_one::<NonZeroUsize>, help_heading = "Run")]
    threads: Option<NonZeroUsize>,
    /// Print the counts as one JSON object
    #[arg(long, help_heading = "Run")]
    json: bool,
}

/// What the log may leave open of its scans.
#[derive(Debug, Clone, Args)]
#[command(next_help_heading = "Scans")]
pub(super) struct ScanOptions {
    /// How far poses may be off, where the log has no boxes for them: metres, then an angle with its unit, as 0.02,0.5deg
    #[arg(long, default_value = "0,0deg", value_name = "M,ANGLE", allow_hyphen_values = true)]
    pub(super) pose_error: PoseError,
    /// Radius about the laser that holds nothing but the robot, metres [default: the log's, or 0]
    #[arg(long, value_name = "M")]
    pub(super) footprint_radius: Option<f64>,
}

impl ScanOptions {
    /// The checked scan of a log.
    ///
    /// # Errors
    /// [`ScanError`] naming the field.
    pub(super) fn scan(&self, scan: LogScan, sensor: &SensorModel) -> Result<Scan, ScanError> {
        let (x, y, theta) = scan.pose.bounds(&self.pose_error);
        let spec = ScanSpec {
            pose: PoseBox::new(x, y, theta, &PoseLimits::default())?,
            angles: scan.angles,
            ranges: scan.ranges,
            footprint_radius: self.footprint_radius.or(scan.footprint_radius).unwrap_or(0.0),
            sweep_rotation: scan.sweep_rotation,
            sweep_translation: scan.sweep_translation,
        };
        Scan::new(spec, *sensor, &ScanLimits::default())
    }
}

/// Opens a log.
///
/// # Errors
/// Names the file.
pub(super) fn open_log(path: &Path, bag: &BagFlags, pose_error: PoseError) -> Result<LogReader, Failure> {
    let options = BagOptions { pose_error, ..bag.options() };
    let reader = LogReader::open_with(path, ScanLimits::default(), &options).context("cannot read the log")?;
    if let Some(flag) = bag.given().filter(|_| reader.chosen().is_none()) {
        return Err(Failure::Usage(format!("--{flag} is for ROS 2 bags, and {} is none", path.display())));
    }
    Ok(reader)
}

/// Says what is read of a bag.
pub(super) fn tell_choice(reader: &LogReader) {
    if let Some(chosen) = reader.chosen() {
        note(chosen);
    }
}

/// Says how many scans of a log were passed over, and why.
pub(super) fn tell_left_out(reader: &LogReader) {
    let (count, why) = reader.left_out();
    if let Some(why) = why {
        note(&format!("{count} scans were left out: {why}"));
    }
}

/// Refuses a log whose first scan cannot be read, and one without a scan.
///
/// # Errors
/// Names the file, and what it has in place of scans.
pub(super) fn check_first(path: &Path, reader: &LogReader) -> Result<(), Failure> {
    match reader.first() {
        Some(Ok(_)) => Ok(()),
        Some(Err(error)) => Err(anyhow::anyhow!("{}: no scans: {error}", path.display()).into()),
        None => Err(anyhow::anyhow!("{}: no scans: {}", path.display(), reader.nothing()).into()),
    }
}

impl Build {
    /// Runs the command.
    pub(super) fn run(self) -> Result<(), Failure> {
        self.check_targets()?;
        let mut reader = open_log(&self.log, &self.bag, self.scans.pose_error)?;
        check_first(&self.log, &reader)?;
        tell_choice(&reader);
        let config = map_config(&self.map, &self.sensor, reader.sensor())?;
        let threads = self.threads.or_else(|| std::thread::available_parallelism().ok()).map_or(1, NonZeroUsize::get);
        let mut mapper = Mapper::new(config, threads)?;
        let damage = self.feed(&mut mapper, &mut reader)?;
        tell_left_out(&reader);
        if mapper.scans() == 0 {
            // The first scan could be read, so it is one that is refused.
            let why = damage.map_or_else(String::new, |damage| format!(": {}", causes(&damage)));
            return Err(anyhow::anyhow!("{}: no scans{why}", self.log.display()).into());
        }
        let file_bytes = self.write(&mapper)?;
        let counts = Counts::of(&mapper);
        if self.json {
            say_json(&counts.json(&mapper, &self, threads, file_bytes, reader.left_out().0))?;
        } else {
            say(&counts.table(&mapper, &self.out, file_bytes))?;
        }
        match damage {
            None => Ok(()),
            Some(damage) => Err(damage
                .context(format!(
                    "{} is damaged; the map holds the {} scans before",
                    self.log.display(),
                    mapper.scans()
                ))
                .into()),
        }
    }

    /// Refuses targets that would overwrite the log or each other.
    fn check_targets(&self) -> Result<(), Failure> {
        let png = self.png.as_deref();
        for (flag, target) in [("--out", Some(self.out.as_path())), ("--png", png)] {
            if target.is_some_and(|target| same_file(target, &self.log)) {
                let log = self.log.display();
                return Err(Failure::Usage(format!("{flag} would overwrite the log {log}: name another file")));
            }
        }
        if png.is_some_and(|png| png == self.out || same_file(png, &self.out)) {
            return Err(Failure::Usage("--out and --png name the same file".to_owned()));
        }
        check_png(png)
    }

    /// Reads the log in batches and maps each; returns what ended the log early.
    fn feed(&self, mapper: &mut Mapper, reader: &mut LogReader) -> Result<Option<anyhow::Error>, Failure> {
        let read = reader.bytes_read();
        let (size, unit) = (reader.size(), reader.unit());
        let mut progress = Progress::new(size, "scans", self.json);
        let sensor = *mapper.config().sensors().get(SENSOR).context("the map has no sensor")?;
        let mut left = self.limit.map_or(u64::MAX, NonZeroU64::get);
        let (mut damage, mut outside) = (None, 0_u64);
        let mut scans = Vec::with_capacity(BATCH);
        let mut index = 0_usize;
        while damage.is_none() && left > 0 {
            scans.clear();
            while scans.len() < BATCH && left > 0 {
                let Some(item) = reader.next() else { break };
                index += 1;
                let taken = (index - 1) % self.every == 0;
                let checked = item.map_err(anyhow::Error::from).and_then(|scan| {
                    let line = scan.line;
                    if !taken {
                        return Ok(None);
                    }
                    let scan = self.scans.scan(scan, &sensor);
                    let fitting = scan.and_then(|scan| Surveyor::fits(mapper.config(), &scan).map(|()| Some(scan)));
                    fitting.with_context(|| format!("{unit} {line}"))
                });
                match checked {
                    Ok(Some(scan)) => {
                        outside += u64::from(!is_inside(mapper.config().grid(), &scan));
                        scans.push(scan);
                        left -= 1;
                    }
                    Ok(None) => {}
                    Err(error) => {
                        damage = Some(error);
                        break;
                    }
                }
            }
            if scans.is_empty() {
                break;
            }
            mapper.add(&scans);
            progress.update(read.load(Ordering::Relaxed), mapper.scans());
        }
        progress.finish();
        tell_outside(mapper.config().grid(), outside);
        Ok(damage)
    }

    /// Writes the map file and the picture; returns the map file's size.
    fn write(&self, mapper: &Mapper) -> Result<u64, Failure> {
        let bytes = write_map(&self.out, mapper).with_context(|| format!("cannot write {}", self.out.display()))?;
        if let Some(path) = &self.png {
            let caption = format!(
                "{} evidence, {} m leaves, {} scans",
                rule_name(mapper.config().rule()),
                mapper.config().grid().resolution(),
                mapper.scans()
            );
            let picture = Picture::of_map(mapper.tree(), mapper.config().grid(), &caption);
            picture.save(path).with_context(|| format!("cannot write {}", path.display()))?;
        }
        Ok(bytes)
    }
}

/// What a build has made.
struct Counts {
    tree: TreeStatistics,
    /// The smallest box of leaves that holds all that is known.
    known: Option<LeafRange>,
    /// Area of a leaf, square metres.
    leaf: f64,
    seconds: f64,
}

impl Counts {
    fn of(mapper: &Mapper) -> Self {
        let resolution = mapper.config().grid().resolution();
        Self {
            tree: mapper.tree().statistics(),
            known: known_range(mapper.tree()),
            leaf: resolution * resolution,
            seconds: mapper.busy().as_secs_f64(),
        }
    }

    fn scans_per_second(&self, mapper: &Mapper) -> f64 {
        mapper.scans() as f64 / self.seconds.max(1e-9)
    }

    fn area(&self, cells: u64) -> f64 {
        cells as f64 * self.leaf
    }

    /// Unknown leaves within the box of what is known.
    fn unknown_in_view(&self) -> u64 {
        self.known.map_or(0, |known| {
            let cells = u64::from(known.max_x - known.min_x) * u64::from(known.max_y - known.min_y);
            cells - self.tree.free_cells - self.tree.occupied_cells
        })
    }

    /// The object of `--json`: areas are those of the whole map, whose root is mostly unknown; `bounds` is the box of
    /// what is known, with the unknown area inside it.
    fn json(&self, mapper: &Mapper, build: &Build, threads: usize, file_bytes: u64, left_out: u64) -> Value {
        let grid = mapper.config().grid();
        let bounds = self.known.map(|known| {
            // Without the last digits of the arithmetic, which say nothing: rounded to nanometres.
            let at = |origin: f64, index: u32| ((origin + f64::from(index) * grid.resolution()) * 1e9).round() / 1e9;
            let (x, y) = grid.origin();
            json!({
                "min_x": at(x, known.min_x), "min_y": at(y, known.min_y),
                "max_x": at(x, known.max_x), "max_y": at(y, known.max_y),
                "leaf_area_unknown": self.area(self.unknown_in_view()),
            })
        });
        json!({
            "scans": mapper.scans(),
            "beams": mapper.beams(),
            "seconds": self.seconds,
            "scans_per_second": self.scans_per_second(mapper),
            "nodes": self.tree.nodes,
            "leaves": self.tree.leaves,
            "leaf_area_free": self.area(self.tree.free_cells),
            "leaf_area_unknown": self.area(self.tree.unknown_cells),
            "leaf_area_occupied": self.area(self.tree.occupied_cells),
            "memory_bytes": self.tree.memory_bytes,
            "file_bytes": file_bytes,
            "revision": mapper.scans(),
            "left_out": left_out,
            "bounds": bounds,
            "settings": build.settings(mapper, threads),
        })
    }

    fn table(&self, mapper: &Mapper, out: &Path, file_bytes: u64) -> String {
        let area = |cells| format!("{:.1} m2", self.area(cells));
        let rows = [
            ("scans", mapper.scans().to_string()),
            ("beams", mapper.beams().to_string()),
            ("leaves", self.tree.leaves.to_string()),
            ("free", area(self.tree.free_cells)),
            ("occupied", area(self.tree.occupied_cells)),
            ("unknown", format!("{} within the box of what is known", area(self.unknown_in_view()))),
            ("scans/s", format!("{:.0} of processor time ({:.3} s)", self.scans_per_second(mapper), self.seconds)),
            ("memory", size(self.tree.memory_bytes)),
            ("file", format!("{} ({})", out.display(), size(file_bytes))),
        ];
        rows.map(|(name, value)| format!("{name:<9} {value}")).join("\n")
    }
}

impl Build {
    fn settings(&self, mapper: &Mapper, threads: usize) -> Value {
        let config = mapper.config();
        let sensor = config.sensors().get(SENSOR).map(|sensor| {
            let spec = sensor.spec();
            json!({
                "range_error": {"minus": spec.range_error_minus, "plus": spec.range_error_plus},
                "beam_opening": spec.beam_opening,
                "beam_diameter": spec.beam_diameter,
                "range_min": spec.range_min,
                "range_max": spec.range_max,
                "no_return_free_to": spec.no_return_free_to,
                "beam_angle_error": spec.beam_angle_error,
            })
        });
        json!({
            "log": self.log.display().to_string(),
            "evidence": rule_name(config.rule()),
            "resolution": config.grid().resolution(),
            "depth": config.grid().depth(),
            "origin": {"x": config.grid().origin().0, "y": config.grid().origin().1},
            "classes": config.scale().count(),
            "min_obstacle_width": config.min_obstacle_width(),
            "pose_error": {"position": self.scans.pose_error.position, "heading": self.scans.pose_error.heading},
            "footprint_radius": self.scans.footprint_radius,
            "bag": self.bag.json(),
            "sensor": sensor,
            "every": self.every,
            "limit": self.limit,
            "threads": threads,
        })
    }
}

/// Is the robot in the map for sure?
fn is_inside(grid: &Grid, scan: &Scan) -> bool {
    let (bounds, pose) = (grid.bounds(), &scan.spec().pose);
    let within = |outer: Interval, inner: Interval| outer.lo() <= inner.lo() && inner.hi() <= outer.hi();
    within(bounds.x, pose.x()) && within(bounds.y, pose.y())
}

/// Says how many scans were taken where the map does not reach: what they see there is lost.
fn tell_outside(grid: &Grid, outside: u64) {
    if outside > 0 {
        let ((x, y), side) = (grid.origin(), grid.node_size(0));
        note(&format!(
            "{outside} scans were taken beyond the map, which is {side} m wide from {x},{y} on: another --depth or --origin \
             makes it larger or moves it"
        ));
    }
}

/// Bytes for people.
fn size(bytes: u64) -> String {
    if bytes < 1_000_000 { format!("{:.1} kB", bytes as f64 / 1e3) } else { format!("{:.1} MB", bytes as f64 / 1e6) }
}

/// True when both names lead to one file that is there, also through links.
fn same_file(a: &Path, b: &Path) -> bool {
    let identity = |path: &Path| {
        let path = path.canonicalize().ok()?;
        #[cfg(unix)]
        let inode = {
            use std::os::unix::fs::MetadataExt;
            let metadata = path.metadata().ok()?;
            (metadata.dev(), metadata.ino())
        };
        #[cfg(not(unix))]
        let inode = path;
        Some(inode)
    };
    identity(a).is_some_and(|a| identity(b) == Some(a))
}

/// Writes the map file; returns its size.
fn write_map(path: &Path, mapper: &Mapper) -> anyhow::Result<u64> {
    let map = LoadedMap { revision: mapper.scans(), tree: mapper.tree().clone(), windows: BTreeMap::new() };
    write_whole(path, |file| Ok(write_map_file(file, mapper.config(), &map)?))
}

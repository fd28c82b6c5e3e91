//! What the server takes, looked at every few seconds, and the bounds that it is held to.

use super::process::SETTINGS;
use std::path::Path;
use std::time::Duration;

/// How many times its live bytes the store's files may be before it is rewritten, and how large at least: `rewrite.factor`
/// and, of [`SETTINGS`], `rewrite.least_bytes`.
const FACTOR: f64 = 8.0;

/// Memory beside what settings bound: the program itself, threads, what stands above the blocks, the log of changes,
/// buffers of connections and a map file that is exported, MiB.
const BESIDE: f64 = 96.0;

const MIB: f64 = 1_048_576.0;

/// One look.
#[derive(Debug, Clone, Default)]
pub struct Sample {
    /// Minutes since the beginning.
    pub minute: f64,
    /// Which of the server's processes.
    pub start: usize,
    pub memory: f64,
    pub threads: f64,
    pub files: f64,
    /// Bytes of all files in the data directory.
    pub disk: f64,
    pub live: f64,
    pub cache: f64,
    pub commits: f64,
    pub rewrites: f64,
}

/// The values of a metric, whatever its labels, together.
pub fn metric(text: &str, name: &str) -> f64 {
    let of = |line: &&str| line.strip_prefix(name).is_some_and(|rest| rest.starts_with(['{', ' ']));
    text.lines().filter(of).filter_map(|line| line.rsplit_once(' ')?.1.parse::<f64>().ok()).sum()
}

impl Sample {
    pub fn of(process: u32, data: &Path, metrics: &str) -> Option<Self> {
        let status = std::fs::read_to_string(format!("/proc/{process}/status")).ok()?;
        let field = |name: &str| {
            let line = status.lines().find_map(|line| line.strip_prefix(name))?;
            line.split_whitespace().next()?.parse::<f64>().ok()
        };
        Some(Self {
            memory: 1024.0 * field("VmRSS:")?,
            threads: field("Threads:")?,
            files: std::fs::read_dir(format!("/proc/{process}/fd")).ok()?.count() as f64,
            disk: bytes_in(data),
            live: metric(metrics, "ubbmap_store_live_bytes"),
            cache: metric(metrics, "ubbmap_cache_bytes"),
            commits: metric(metrics, "ubbmap_commits_total"),
            rewrites: metric(metrics, "ubbmap_store_rewrites_total"),
            ..Self::default()
        })
    }
}

impl Sample {
    /// How many times its live bytes the store takes; 0 while they are not known.
    fn factor(&self) -> f64 {
        if self.live > 0.0 { self.disk / self.live } else { 0.0 }
    }
}

/// Files may go while they are counted.
fn bytes_in(directory: &Path) -> f64 {
    let Ok(entries) = std::fs::read_dir(directory) else { return 0.0 };
    let size = |entry: std::fs::DirEntry| match entry.metadata() {
        Ok(about) if about.is_dir() => bytes_in(&entry.path()),
        Ok(about) => about.len() as f64,
        Err(_) => 0.0,
    };
    entries.filter_map(Result::ok).map(size).sum()
}

/// The bounds, derived from the settings before anything is measured.
pub struct Bounds {
    pub memory: f64,
    pub files: f64,
    pub threads: f64,
}

impl Bounds {
    /// With so many connections of clients.
    pub fn new(connections: usize) -> Self {
        let of = |name: &str| SETTINGS.iter().find(|(known, _)| *known == name).map_or(0.0, |(_, bytes)| *bytes as f64);
        let memory = SETTINGS.iter().map(|(_, bytes)| *bytes as f64).sum::<f64>() - of("UBBMAP_REWRITE__LEAST_BYTES");
        Self {
            memory: memory + BESIDE * MIB,
            // Two a connection while it is replaced; the database, a second one while it is rewritten, and the runtime's own.
            files: 2.0 * connections as f64 + 64.0,
            // The runtimes of the server and of Zenoh, the writer, the store, and those that wait for the disk.
            threads: 128.0,
        }
    }

    /// What the store's files may take when so much is live: it is looked at every ten seconds, a rewrite has a second
    /// database of up to three times what is live beside the old one, and what is written until the next look counts.
    pub fn disk(live: f64) -> f64 {
        let least = SETTINGS
            .iter()
            .find(|(name, _)| *name == "UBBMAP_REWRITE__LEAST_BYTES")
            .map_or(0.0, |(_, bytes)| *bytes as f64);
        (FACTOR * live).max(least) + 3.0 * live + 64.0 * MIB
    }

    /// What passes a bound, and what grows.
    pub fn judge(&self, samples: &[Sample], long: usize) -> Vec<String> {
        let mut wrong = Vec::new();
        for sample in samples {
            let mut hold = |what: &str, value: f64, bound: f64| {
                if value > bound {
                    wrong.push(format!("minute {:.1}: {what} {value:.0}, the bound is {bound:.0}", sample.minute));
                }
            };
            hold("memory", sample.memory, self.memory);
            hold("open files", sample.files, self.files);
            hold("threads", sample.threads, self.threads);
            // What is live is measured some seconds after a start.
            if sample.live > 0.0 {
                hold("bytes on disk", sample.disk, Self::disk(sample.live));
            }
        }
        let stretch: Vec<&Sample> = samples.iter().filter(|sample| sample.start == long).collect();
        let quarter = stretch.len() / 4;
        if quarter < 5 {
            return wrong;
        }
        // A tenth of the longest uninterrupted run is for warming up.
        let (first, last) = (&stretch[stretch.len() / 10..][..quarter], &stretch[stretch.len() - quarter..]);
        let mut grows = |what: &str, of: fn(&Sample) -> f64, slack: f64| {
            let (before, after) = (median(first, of), median(last, of));
            println!("  {what}: median {before:.1} in the first quarter of the longest run, {after:.1} in the last");
            if after > 1.1 * before + slack {
                wrong.push(format!("{what} grew from {before:.1} to {after:.1}"));
            }
        };
        grows("memory, MB", |sample| sample.memory / 1e6, 8.0);
        grows("open files", |sample| sample.files, 8.0);
        grows("threads", |sample| sample.threads, 8.0);
        grows("times its live bytes on disk", |sample| sample.factor(), 1.0);
        wrong
    }
}

fn median(samples: &[&Sample], of: fn(&Sample) -> f64) -> f64 {
    let mut values: Vec<f64> = samples.iter().map(|sample| of(sample)).collect();
    values.sort_by(f64::total_cmp);
    values[values.len() / 2]
}

/// A table of the samples in slices of time.
pub fn table(samples: &[Sample], rows: usize, told: Duration) {
    println!(
        "\n| minute | commits/s | memory, MB | blocks in memory, MB | open files | threads | live, MB | on disk, MB | factor | rewrites |"
    );
    println!("| ---: | ---: | ---: | ---: | ---: | ---: | ---: | ---: | ---: | ---: |");
    let slice = told.as_secs_f64() / 60.0 / rows as f64;
    for row in 0..rows {
        let (from, to) = (slice * row as f64, slice * (row + 1) as f64);
        let within: Vec<&Sample> =
            samples.iter().filter(|sample| sample.minute > from && sample.minute <= to).collect();
        let (Some(first), Some(last)) = (within.first(), within.last()) else { continue };
        let most = |of: fn(&Sample) -> f64| within.iter().map(|sample| of(sample)).fold(0.0, f64::max);
        let seconds = 60.0 * (last.minute - first.minute);
        let rate = if first.start == last.start && seconds > 0.0 {
            format!("{:.0}", (last.commits - first.commits) / seconds)
        } else {
            String::new()
        };
        println!(
            "| {to:.0} | {rate} | {:.0} | {:.1} | {:.0} | {:.0} | {:.1} | {:.1} | {:.1} | {:.0} |",
            most(|sample| sample.memory) / 1e6,
            most(|sample| sample.cache) / 1e6,
            most(|sample| sample.files),
            most(|sample| sample.threads),
            most(|sample| sample.live) / 1e6,
            most(|sample| sample.disk) / 1e6,
            most(Sample::factor),
            most(|sample| sample.rewrites),
        );
    }
}

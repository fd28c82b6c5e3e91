//! What a command writes, and how it ends.

use anyhow::Context;
use std::fs::File;
use std::io::{BufWriter, ErrorKind, IsTerminal, Write};
use std::path::Path;
use std::process::ExitCode;
use std::time::{Duration, Instant, SystemTime};

/// Bad usage, as the argument parser has it too.
const BAD_USAGE: u8 = 2;

/// Bad configuration.
const BAD_CONFIGURATION: u8 = 64;

/// The year 10000, seconds since 1970: times from there on are not written as such.
const FAR_FUTURE: u64 = 253_402_300_800;

/// How often a line tells of the progress where there is no terminal.
const LINE_EVERY: Duration = Duration::from_secs(5);

/// Why a command did not do what it was asked for.
#[derive(Debug)]
pub(super) enum Failure {
    /// It failed: exit code 1.
    Failed(anyhow::Error),
    /// Its arguments make no sense together: exit code 2.
    Usage(String),
    /// The server's configuration is refused: exit code 64.
    Configuration(String),
}

impl<E: Into<anyhow::Error>> From<E> for Failure {
    fn from(error: E) -> Self {
        Self::Failed(error.into())
    }
}

impl Failure {
    /// Says on stderr what went wrong, and gives the exit code.
    pub(super) fn report(&self) -> ExitCode {
        let (text, code) = match self {
            Self::Failed(error) => (causes(error), 1),
            Self::Usage(text) => (text.clone(), BAD_USAGE),
            Self::Configuration(text) => (text.clone(), BAD_CONFIGURATION),
        };
        note(&format!("error: {text}"));
        ExitCode::from(code)
    }
}

/// An error and its causes, each once: some repeat theirs in their own words.
pub(super) fn causes(error: &anyhow::Error) -> String {
    let mut text = String::new();
    for cause in error.chain() {
        let cause = cause.to_string();
        if text.is_empty() {
            text = cause;
        } else if !text.contains(&cause) {
            text.push_str(": ");
            text.push_str(&cause);
        }
    }
    text
}

/// Writes a line to stdout.
///
/// # Errors
/// When stdout cannot be written, but for a reader that has seen enough.
pub(super) fn say(text: &str) -> Result<(), Failure> {
    let mut out = std::io::stdout().lock();
    match writeln!(out, "{text}").and_then(|()| out.flush()) {
        Err(error) if error.kind() != ErrorKind::BrokenPipe => {
            Err(anyhow::Error::new(error).context("cannot write to stdout").into())
        }
        _ => Ok(()),
    }
}

/// Writes a line to stderr. Nothing can be done where that fails.
pub(super) fn note(text: &str) {
    let _ = writeln!(std::io::stderr().lock(), "{text}");
}

/// Writes a JSON value to stdout, on one line.
pub(super) fn say_json(value: &impl serde::Serialize) -> Result<(), Failure> {
    say(&serde_json::to_string(value)?)
}

/// Writes a file beside its place and moves it there, so that a file of this name is always whole; returns its size. A link
/// is followed; what is there and no file, a pipe or a device, is refused: it would be replaced.
pub(super) fn write_whole(
    path: &Path,
    write: impl FnOnce(&mut BufWriter<File>) -> anyhow::Result<()>,
) -> anyhow::Result<u64> {
    if std::fs::metadata(path).is_ok_and(|there| !there.is_file()) {
        anyhow::bail!("it is there and is no regular file");
    }
    let followed = std::fs::canonicalize(path);
    let path = followed.as_deref().unwrap_or(path);
    let mut name = std::ffi::OsString::from(".");
    name.push(path.file_name().context("it has no file name")?);
    name.push(format!(".{}.partial", std::process::id()));
    let partial = path.with_file_name(name);
    let mut file = BufWriter::new(made_new(&partial)?);
    let written = write(&mut file)
        .and_then(|()| Ok(file.into_inner().map_err(std::io::IntoInnerError::into_error)?))
        .and_then(|file| Ok((file.metadata()?.len(), file.sync_all()?)))
        .and_then(|(bytes, ())| std::fs::rename(&partial, path).map(|()| bytes).map_err(anyhow::Error::from));
    if written.is_err() {
        // What is left of the attempt is of no use; the first error is the one to tell.
        let _ = std::fs::remove_file(&partial);
    }
    written
}

/// A file that is made now. What has its name, left by a process that ended early or laid there by somebody else, is taken away
/// and not written to: it may be a link to another file.
fn made_new(partial: &Path) -> std::io::Result<File> {
    match File::create_new(partial) {
        Err(error) if error.kind() == std::io::ErrorKind::AlreadyExists => {
            std::fs::remove_file(partial)?;
            File::create_new(partial)
        }
        made => made,
    }
}

/// Writes a file that only its owner may read, as a whole: beside its place, and then moved there. A file that is there keeps
/// its owner and permissions, so that a server that runs as another user goes on reading it.
pub(super) fn write_private(path: &Path, bytes: &[u8]) -> anyhow::Result<()> {
    let there = std::fs::metadata(path).ok();
    write_whole(path, |out| {
        be_like(out.get_ref(), there.as_ref())?;
        Ok(out.write_all(bytes)?)
    })
    .map(drop)
}

#[cfg(unix)]
fn be_like(file: &File, there: Option<&std::fs::Metadata>) -> anyhow::Result<()> {
    use std::os::unix::fs::{MetadataExt, PermissionsExt, fchown};
    let Some(there) = there else { return Ok(file.set_permissions(std::fs::Permissions::from_mode(0o600))?) };
    let made = file.metadata()?;
    if (made.uid(), made.gid()) != (there.uid(), there.gid()) {
        fchown(file, Some(there.uid()), Some(there.gid()))
            .with_context(|| format!("it belongs to user {}, and you may not keep that so", there.uid()))?;
    }
    Ok(file.set_permissions(there.permissions())?)
}

#[cfg(not(unix))]
fn be_like(file: &File, there: Option<&std::fs::Metadata>) -> anyhow::Result<()> {
    there.map_or(Ok(()), |there| Ok(file.set_permissions(there.permissions())?))
}

/// Seconds since the Unix epoch as a time of RFC 3339; as the number where it is none of our calendar.
pub(super) fn time_text(seconds: f64) -> String {
    let since = Duration::try_from_secs_f64(seconds).ok().filter(|since| since.as_secs() < FAR_FUTURE);
    match since.and_then(|since| SystemTime::UNIX_EPOCH.checked_add(since)) {
        Some(time) => humantime::format_rfc3339_seconds(time).to_string(),
        None => format!("{seconds} s since 1970"),
    }
}

/// How many a second, or a minute where that is less than one.
pub(super) fn rate_text(per_second: f64) -> String {
    match per_second {
        slow if slow < 1.0 => format!("{:.1}/min", 60.0 * slow),
        rate if rate < 10.0 => format!("{rate:.1}/s"),
        rate => format!("{rate:.0}/s"),
    }
}

/// Progress of long work: a bar on a terminal, a line now and then elsewhere.
pub(super) struct Progress {
    bar: indicatif::ProgressBar,
    lines: bool,
    what: &'static str,
    total: u64,
    started: Instant,
    told: Instant,
}

impl Progress {
    /// `total` in the unit of [`Progress::update`]'s position; `what` is counted beside it, as `scans`.
    pub(super) fn new(total: u64, what: &'static str, quiet: bool) -> Self {
        let terminal = std::io::stderr().is_terminal();
        let bar =
            if terminal && !quiet { indicatif::ProgressBar::new(total) } else { indicatif::ProgressBar::hidden() };
        let template = "{elapsed_precise} [{wide_bar}] {percent:>3}%  {msg}  ETA {eta}";
        if let Ok(style) = indicatif::ProgressStyle::with_template(template) {
            bar.set_style(style.progress_chars("=> "));
        }
        let now = Instant::now();
        Self { bar, lines: !terminal && !quiet, what, total, started: now, told: now }
    }

    /// Shows how far the work is, and how many things are done.
    pub(super) fn update(&mut self, position: u64, done: u64) {
        let seconds = self.started.elapsed().as_secs_f64();
        if !self.bar.is_hidden() {
            self.bar.set_position(position);
            self.bar.set_message(format!("{done} {}, {}", self.what, rate_text(done as f64 / seconds.max(1e-3))));
        }
        if self.lines && self.told.elapsed() >= LINE_EVERY {
            self.told = Instant::now();
            let share = if self.total == 0 { 1.0 } else { (position as f64 / self.total as f64).min(1.0) };
            let left = if share > 0.0 {
                format!(", about {:.0} s left", seconds * (1.0 - share) / share)
            } else {
                String::new()
            };
            let rate = rate_text(done as f64 / seconds.max(1e-3));
            note(&format!("{done} {}, {:.0} %, {rate}{left}", self.what, 100.0 * share));
        }
    }

    /// Takes the bar away.
    pub(super) fn finish(self) {
        self.bar.finish_and_clear();
    }
}

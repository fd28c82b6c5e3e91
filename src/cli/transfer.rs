//! `ubbmap map export` and `import`: maps as files.

use super::client::{Answer, Client, ClientError, ServerOptions, map_name, snapshot_name};
use super::output::{Failure, Progress, say, say_json, write_whole};
use crate::store::{MAP_FILE_MAGIC, MapName, SnapshotName};
use crate::wire::v1;
use anyhow::Context;
use clap::{Args, ValueEnum};
use prost::Message;
use serde_json::json;
use std::cell::RefCell;
use std::fs::File;
use std::io::{self, Read, Seek, Write};
use std::path::{Path, PathBuf};
use std::time::Duration;
use thiserror::Error;
use ureq::SendBody;

/// Longest time for one file. The server has a limit of its own.
const TRANSFER_TIMEOUT: Duration = Duration::from_secs(3600);

/// Largest file that is received, bytes.
const MAX_FILE_BYTES: u64 = 1 << 32;

/// Bytes that are moved at a time.
const PIECE: usize = 64 << 10;

/// The files of a map for Nav2.
const NAV2_FILES: [&str; 2] = ["map.yaml", "map.pgm"];

/// Help behind that of the flags of `export`.
pub(super) const EXPORT_HELP: &str = "Example:\n  ubbmap map export hall --out hall.ubbmap\n  \
     ubbmap map export hall --format nav2 --out hall-nav2/\n\nA map for Nav2 is a zip of map.yaml and map.pgm, or the two \
     files where --out ends in a slash.";

/// What is written.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum Format {
    /// A map file: everything, to be imported again
    Ubbmap,
    /// map.yaml and map.pgm for Nav2
    Nav2,
}

/// How the pixels of a map for Nav2 are to be read.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum Mode {
    /// Free, unknown or occupied
    Trinary,
    /// A grey for every class; unknown is a middle grey
    Scale,
}

/// Writes a map to a file.
#[derive(Debug, Args)]
pub(super) struct Export {
    /// The map's name
    #[arg(value_parser = map_name)]
    map: MapName,
    /// The file to write; a directory, for nav2, where it ends in a slash
    #[arg(long, value_name = "FILE")]
    out: PathBuf,
    /// A snapshot in place of the map as it is now
    #[arg(long, value_parser = snapshot_name)]
    snapshot: Option<SnapshotName>,
    /// What to write
    #[arg(long, value_enum, default_value = "ubbmap")]
    format: Format,
    /// Depth of the cells for nav2 [default: the map's]
    #[arg(long)]
    depth: Option<u32>,
    /// How the pixels for nav2 are to be read [default: trinary]
    #[arg(long, value_enum)]
    mode: Option<Mode>,
    #[command(flatten)]
    server: ServerOptions,
    /// Print what was written as JSON
    #[arg(long, help_heading = "Output")]
    json: bool,
}

/// Makes a new map from a file.
#[derive(Debug, Args)]
pub(super) struct Import {
    /// The new map's name: lower-case letters, digits, _ and -
    #[arg(value_parser = map_name)]
    map: MapName,
    /// The map file, from `ubbmap map export` or `ubbmap build`
    file: PathBuf,
    #[command(flatten)]
    server: ServerOptions,
    /// Print the answer as JSON
    #[arg(long, help_heading = "Output")]
    json: bool,
}

impl Export {
    /// Runs the command.
    pub(super) fn run(&self) -> Result<(), Failure> {
        if self.format == Format::Ubbmap && (self.depth.is_some() || self.mode.is_some()) {
            return Err(Failure::Usage("--depth and --mode are for --format nav2".to_owned()));
        }
        let directory = self.out.as_os_str().as_encoded_bytes().ends_with(b"/");
        if directory && self.format == Format::Ubbmap {
            return Err(Failure::Usage(format!("--out {}: a map file needs a name", self.out.display())));
        }
        let client = Client::new(&self.server)?;
        let (revision, bytes) = if directory {
            let mut zip = Vec::new();
            let revision = self.receive(&client, &mut zip)?;
            (revision, unpack(&zip, &self.out)?)
        } else {
            let mut revision = 0;
            let mut failure = None;
            let written = write_whole(&self.out, |file| match self.receive(&client, file) {
                Ok(found) => {
                    revision = found;
                    Ok(())
                }
                Err(error) => {
                    failure = Some(error);
                    Err(anyhow::anyhow!("not received"))
                }
            });
            if let Some(failure) = failure {
                return Err(failure);
            }
            (revision, written.with_context(|| format!("cannot write {}", self.out.display()))?)
        };
        if self.json {
            return say_json(
                &json!({ "map": self.map.as_str(), "revision": revision.to_string(), "bytes": bytes, "out": self.out }),
            );
        }
        say(&format!("map '{}', revision {revision}, written to {}: {bytes} bytes", self.map, self.out.display()))
    }

    /// Receives the file; returns the revision that it holds.
    fn receive(&self, client: &Client, out: &mut impl Write) -> Result<u64, Failure> {
        let mut path = format!("/v1/maps/{}/export?format={}", self.map, word(&self.format));
        if let Some(depth) = self.depth {
            path.push_str(&format!("&depth={depth}"));
        }
        if let Some(mode) = self.mode {
            path.push_str(&format!("&mode={}", word(&mode)));
        }
        if let Some(snapshot) = &self.snapshot {
            path.push_str(&format!("&snapshot={snapshot}"));
        }
        let answer = client.begin_download(&path).map_err(|error| match &self.snapshot {
            Some(snapshot) => client.explain_snapshot(&self.map, snapshot, error),
            None => client.explain(&self.map, error),
        })?;
        let header = |name: &str| answer.headers().get(name).and_then(|value| value.to_str().ok()?.parse::<u64>().ok());
        let (revision, total) = (header("ubbmap-revision").unwrap_or_default(), header("content-length"));
        let mut progress = Progress::new(total.unwrap_or_default(), "bytes", self.json);
        let mut body = answer.into_body().into_with_config().limit(MAX_FILE_BYTES).reader();
        let moved = move_all(&mut body, out, |moved| progress.update(moved, moved));
        progress.finish();
        let moved = moved.map_err(|error| match error {
            MoveError::Read(source) => {
                anyhow::Error::new(source).context(format!("{} broke off in the middle of the file", client.server()))
            }
            MoveError::Write(source) => {
                anyhow::Error::new(source).context(format!("cannot write {}", self.out.display()))
            }
        })?;
        match total {
            Some(total) if total != moved => {
                Err(anyhow::anyhow!("{} broke off after {moved} of {total} bytes", client.server()).into())
            }
            _ => Ok(revision),
        }
    }
}

impl Import {
    /// Runs the command.
    pub(super) fn run(&self) -> Result<(), Failure> {
        let (file, total) = open_map_file(&self.file)?;
        let client = Client::new(&self.server)?;
        // A name that is taken is told before the file is sent.
        match client.map(&self.map) {
            Err(error) if error.is("MAP_NOT_FOUND") => {}
            Err(error) => return Err(Failure::Failed(error.into())),
            Ok(_) => return Err(anyhow::anyhow!("there is a map '{}' already (MAP_EXISTS)", self.map).into()),
        }
        let progress = RefCell::new(Progress::new(total, "bytes", self.json));
        let tell = |moved| progress.borrow_mut().update(moved, moved);
        let mut counted = Counted { file: file.take(total), moved: 0, tell, failed: None };
        let imported = client.upload(&format!("/v1/maps/{}/import", self.map), &mut counted, total);
        let failed = counted.failed.take();
        progress.into_inner().finish();
        if let Some(failed) = failed {
            return Err(anyhow::Error::new(failed).context(format!("cannot read {}", self.file.display())).into());
        }
        let imported = imported.map_err(|error| Failure::Failed(error.into()))?;
        if self.json {
            return say_json(&imported);
        }
        say(&format!("map '{}' imported, revision {}", imported.name, imported.revision))
    }
}

impl Client {
    /// An answer whose body is a file.
    fn begin_download(&self, path: &str) -> Result<Answer, ClientError> {
        let request = self.head("GET", path).body(()).map_err(|error| self.unreachable(&error))?;
        let request = self.agent().configure_request(request).timeout_global(Some(TRANSFER_TIMEOUT)).build();
        let answer = self.agent().run(request).map_err(|error| self.unreachable(&error))?;
        if answer.status().is_success() {
            return Ok(answer);
        }
        self.answered(path, answer)?;
        Err(ClientError::NotUnderstood(format!("the answer to {path} is no file")))
    }

    fn upload(&self, path: &str, file: &mut dyn Read, total: u64) -> Result<v1::ImportMapResponse, ClientError> {
        let request = self
            .head("PUT", path)
            .header("accept", "application/x-protobuf, application/problem+json")
            .header("content-type", "application/octet-stream")
            .header("content-length", total)
            .body(SendBody::from_reader(file))
            .map_err(|error| self.unreachable(&error))?;
        let request = self.agent().configure_request(request).timeout_global(Some(TRANSFER_TIMEOUT)).build();
        let answer = self.agent().run(request).map_err(|error| self.unreachable(&error))?;
        let bytes = self.answered(path, answer)?;
        v1::ImportMapResponse::decode(bytes.as_slice())
            .map_err(|error| ClientError::NotUnderstood(format!("the answer to {path}: {error}")))
    }
}

/// Opens a map file, and sees that it is one before anything is sent.
fn open_map_file(path: &Path) -> anyhow::Result<(File, u64)> {
    let shown = || format!("cannot read {}", path.display());
    // Before it is opened: that of a pipe waits for its other end.
    let there = std::fs::metadata(path).with_context(shown)?;
    anyhow::ensure!(!there.is_dir(), "{} is a folder, no map file", path.display());
    anyhow::ensure!(there.is_file(), "{} is no regular file", path.display());
    let mut file = File::open(path).with_context(shown)?;
    let mut head = Vec::new();
    (&mut file).take(MAP_FILE_MAGIC.len() as u64).read_to_end(&mut head).with_context(shown)?;
    anyhow::ensure!(
        head == MAP_FILE_MAGIC,
        "{} is no map file: it does not begin as those of `ubbmap map export` and `ubbmap build` do",
        path.display()
    );
    file.rewind().with_context(shown)?;
    Ok((file, there.len()))
}

/// A file that tells how much of it was read, and keeps what failed: the connection is not to blame for it.
struct Counted<F: FnMut(u64)> {
    file: io::Take<File>,
    moved: u64,
    tell: F,
    failed: Option<io::Error>,
}

impl<F: FnMut(u64)> Read for Counted<F> {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        let count = self.file.read(buffer).map_err(|error| {
            let kind = error.kind();
            self.failed = Some(error);
            io::Error::from(kind)
        })?;
        self.moved += count as u64;
        (self.tell)(self.moved);
        Ok(count)
    }
}

fn word(value: &impl ValueEnum) -> String {
    value.to_possible_value().map(|value| value.get_name().to_owned()).unwrap_or_default()
}

/// Which end of a move has failed.
#[derive(Debug, Error)]
enum MoveError {
    #[error("reading: {0}")]
    Read(io::Error),
    #[error("writing: {0}")]
    Write(io::Error),
}

fn move_all(from: &mut impl Read, to: &mut impl Write, mut tell: impl FnMut(u64)) -> Result<u64, MoveError> {
    let mut piece = vec![0; PIECE];
    let mut moved = 0;
    loop {
        let count = match from.read(&mut piece) {
            Ok(0) => return Ok(moved),
            Ok(count) => count,
            Err(error) if error.kind() == io::ErrorKind::Interrupted => continue,
            Err(error) => return Err(MoveError::Read(error)),
        };
        to.write_all(&piece[..count]).map_err(MoveError::Write)?;
        moved += count as u64;
        tell(moved);
    }
}

/// Writes the two files of a zip for Nav2 into a directory, which is made where it is missing; returns their bytes. The
/// one that names the other comes last.
fn unpack(zip: &[u8], directory: &Path) -> anyhow::Result<u64> {
    std::fs::create_dir_all(directory).with_context(|| format!("cannot make {}", directory.display()))?;
    let mut archive = zip::ZipArchive::new(io::Cursor::new(zip)).context("the answer is no zip")?;
    let mut total = 0;
    for name in NAV2_FILES.into_iter().rev() {
        let path = directory.join(name);
        let mut file = archive.by_name(name).with_context(|| format!("the answer has no {name}"))?;
        let written = write_whole(&path, |out| Ok(move_all(&mut file, out, |_| ()).map(drop)?));
        total += written.with_context(|| format!("cannot write {}", path.display()))?;
    }
    Ok(total)
}

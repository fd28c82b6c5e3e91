//! `ubbmap token`: the file of tokens, entry by entry. The server that reads the file need not run, and takes over what is
//! changed while it does.

mod file;

use super::output::{Failure, note, say, say_json};
use crate::store::RobotName;
use crate::transport::access::{Grant, MapScope, Proof, Role, Secret, TokenHash, entry_name, expiry};
use clap::{Args, Subcommand};
use file::{TokenFile, time};
use serde_json::json;
use std::path::PathBuf;
use std::time::{Duration, SystemTime};

/// The variable by which the server is told its file.
const VARIABLE: &str = "UBBMAP_ACCESS__TOKENS";

/// Makes, lists and revokes the tokens of a server.
#[derive(Debug, Args)]
#[command(arg_required_else_help = true)]
#[command(
    after_help = "Example:\n  ubbmap token create --file tokens.toml --name planner --role read --expires 90d\n  ubbmap serve --tokens tokens.toml"
)]
pub(super) struct Token {
    #[command(subcommand)]
    action: Action,
}

#[derive(Debug, Subcommand)]
enum Action {
    /// Makes a token, prints it this once, and adds its entry to the file
    #[command(
        after_help = "Example:\n  ubbmap token create --file tokens.toml --name amr-7 --role write --maps hall,yard-* --robot amr-7"
    )]
    Create(Create),
    /// Lists the entries of the file
    #[command(after_help = "Example:\n  ubbmap token list --file tokens.toml")]
    List(List),
    /// Takes an entry out of the file: its token is refused from then on, and its open streams end
    #[command(after_help = "Example:\n  ubbmap token revoke --file tokens.toml planner")]
    Revoke(Revoke),
}

#[derive(Debug, Args)]
struct FileOption {
    /// The file of tokens, the server's setting access.tokens [default: $UBBMAP_ACCESS__TOKENS]
    #[arg(long, value_name = "FILE")]
    file: Option<PathBuf>,
}

#[derive(Debug, Args)]
struct Create {
    /// What logs and refusals call its holder by
    #[arg(long, value_parser = checked_name)]
    name: String,
    /// What it may do: read, write (and send scans), or admin (and create, replace and delete)
    #[arg(long, value_parser = role)]
    role: Role,
    /// The maps it may use, with commas between: names, or beginnings of names such as hall-*
    #[arg(long, default_value = "*", value_name = "MAPS")]
    maps: String,
    /// For how long, as in 90d, or until when, as in 2027-01-31T00:00:00Z [default: for ever]
    #[arg(long, value_name = "TIME", value_parser = until)]
    expires: Option<SystemTime>,
    /// The one robot whose scans it may send [default: any]
    #[arg(long, value_parser = robot)]
    robot: Option<RobotName>,
    #[command(flatten)]
    file: FileOption,
    /// Print the answer as JSON
    #[arg(long, help_heading = "Output")]
    json: bool,
}

#[derive(Debug, Args)]
struct List {
    #[command(flatten)]
    file: FileOption,
    /// Print the answer as JSON
    #[arg(long, help_heading = "Output")]
    json: bool,
}

#[derive(Debug, Args)]
struct Revoke {
    /// The entry's name
    name: String,
    #[command(flatten)]
    file: FileOption,
    /// Print what was done as JSON
    #[arg(long, help_heading = "Output")]
    json: bool,
}

impl Token {
    /// Runs the command.
    pub(super) fn run(self) -> Result<(), Failure> {
        match self.action {
            Action::Create(create) => create.run(),
            Action::List(list) => list.run(),
            Action::Revoke(revoke) => revoke.run(),
        }
    }
}

impl FileOption {
    fn given(&self) -> Option<PathBuf> {
        self.file.clone().or_else(|| std::env::var_os(VARIABLE).filter(|file| !file.is_empty()).map(PathBuf::from))
    }

    fn needed(&self) -> Result<PathBuf, Failure> {
        self.given().ok_or_else(|| Failure::Usage(format!("--file (or {VARIABLE}) must name the file of tokens")))
    }
}

impl Create {
    fn run(&self) -> Result<(), Failure> {
        if self.robot.is_some() && self.role == Role::Read {
            let problem = "--robot is whose scans a token may send, and one with --role read may send none";
            return Err(Failure::Usage(format!("{problem}: say --role write, or leave --robot out")));
        }
        let maps: Vec<&str> = self.maps.split(',').map(str::trim).filter(|map| !map.is_empty()).collect();
        let maps = MapScope::new(&maps).map_err(|problem| Failure::Usage(format!("--maps: {problem}")))?;
        let grant = Grant { role: self.role, maps, robot: self.robot.clone(), expires: self.expires };
        let secret = Secret::generate().map_err(|error| anyhow::anyhow!("the system gives no random bits: {error}"))?;
        let entry = file::entry(&self.name, &TokenHash::of(secret.reveal()), &grant)?;
        let path = self.file.given();
        if let Some(path) = &path {
            let file = TokenFile::read_or_begin(path)?;
            if file.has(&self.name) {
                let (path, name) = (path.display(), &self.name);
                let way = format!("choose another name, or take it out: ubbmap token revoke {name:?}");
                return Err(Failure::Failed(anyhow::anyhow!("{path} has an entry {name:?}: {way}")));
            }
            file.add(&entry)?;
        }
        if self.json {
            let path = path.map(|path| path.display().to_string());
            return say_json(&json!({"name": self.name, "token": secret.reveal(), "file": path, "entry": entry}));
        }
        match path {
            Some(path) => {
                note(&format!(
                    "the entry {:?} was added to {}; its token, shown this once:",
                    self.name,
                    path.display()
                ));
            }
            None => {
                note("no --file: put these lines into the server's file of tokens");
                note(entry.trim_end());
            }
        }
        // Alone on stdout, so that a script can take it.
        say(secret.reveal())
    }
}

impl List {
    fn run(&self) -> Result<(), Failure> {
        let file = TokenFile::read(&self.file.needed()?)?;
        let roll = file.roll();
        let now = SystemTime::now();
        if self.json {
            let entries = roll.entries().iter().map(|entry| {
                let grant = entry.caller.grant();
                json!({
                    "name": entry.caller.name(), "kind": kind(&entry.proof), "role": grant.role.word(),
                    "maps": grant.maps.patterns(), "robot": grant.robot.as_ref().map(RobotName::as_str),
                    "expires": grant.expires.map(time), "expired": grant.expires.is_some_and(|at| at <= now),
                })
            });
            return say_json(&json!({ "entries": entries.collect::<Vec<_>>() }));
        }
        if roll.entries().is_empty() {
            note("the file has no entries");
            return Ok(());
        }
        let longest = roll.entries().iter().map(|entry| entry.caller.name().chars().count()).max().unwrap_or(0).max(4);
        say(&format!("{:<longest$}  {:<11}  {:<5}  {:<26}  maps", "name", "kind", "role", "expires"))?;
        for entry in roll.entries() {
            let grant = entry.caller.grant();
            let expires = match grant.expires {
                None => "never".to_owned(),
                Some(at) if at <= now => format!("{} (!)", time(at)),
                Some(at) => time(at),
            };
            let robot = grant.robot.as_ref().map(|robot| format!(" (robot {})", robot.as_str())).unwrap_or_default();
            let (name, kind, role) = (entry.caller.name(), kind(&entry.proof), grant.role.word());
            say(&format!("{name:<longest$}  {kind:<11}  {role:<5}  {expires:<26}  {}{robot}", grant.maps))?;
        }
        Ok(())
    }
}

impl Revoke {
    fn run(&self) -> Result<(), Failure> {
        let file = self.file.needed()?;
        TokenFile::read_to_change(&file)?.remove(&self.name)?;
        if self.json {
            return say_json(&json!({ "revoked": self.name, "file": file.display().to_string() }));
        }
        say(&format!("the entry {:?} was taken out of {}", self.name, file.display()))
    }
}

fn kind(proof: &Proof) -> &'static str {
    match proof {
        Proof::Token(_) => "token",
        Proof::Certificate { .. } => "certificate",
    }
}

fn checked_name(text: &str) -> Result<String, String> {
    entry_name(text).map(|()| text.to_owned())
}

fn role(text: &str) -> Result<Role, String> {
    text.parse()
}

fn robot(text: &str) -> Result<RobotName, String> {
    RobotName::new(text).map_err(|error| error.to_string())
}

/// A span from now on, or a time. Whole seconds: so it is written.
fn until(text: &str) -> Result<SystemTime, String> {
    if let Ok(at) = expiry(text) {
        return Ok(at);
    }
    let span = humantime::parse_duration(text).map_err(|_| {
        format!("must be a span such as 90d or 12h, or a time such as 2027-01-31T00:00:00Z, got {text:?}")
    })?;
    let at = SystemTime::now().checked_add(span).filter(|at| *at < last());
    at.ok_or_else(|| format!("{text:?} is beyond the year 9999: leave it out for a token that does not expire"))
}

/// The end of the calendar that times are written in.
fn last() -> SystemTime {
    SystemTime::UNIX_EPOCH + Duration::from_secs(253_402_300_799)
}

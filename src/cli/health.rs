//! `ubbmap health`: does a server take work?

use super::client::{Client, ServerOptions};
use super::output::{Failure, say, say_json};
use clap::Args;
use serde_json::json;

/// Asks a server whether it takes work; exit code 1 when it does not, or does not answer.
#[derive(Debug, Args)]
#[command(
    after_help = "It is what /readyz tells: the server is not draining, its store takes writes, and where Zenoh is on \
    it reaches itself through it.\n\nExample:\n  ubbmap health --server http://127.0.0.1:8080"
)]
pub(super) struct Health {
    #[command(flatten)]
    server: ServerOptions,
    /// Print the answer as JSON
    #[arg(long, help_heading = "Output")]
    json: bool,
}

impl Health {
    /// Runs the command.
    pub(super) fn run(&self) -> Result<(), Failure> {
        let client = Client::new(&self.server)?;
        let answer = client.ready();
        if self.json {
            let why = answer.as_ref().err().map(ToString::to_string);
            say_json(&json!({ "server": client.server(), "ready": answer.is_ok(), "problem": why }))?;
        }
        answer?;
        if self.json { Ok(()) } else { say(&format!("{} is ready", client.server())) }
    }
}

//! `ubbmap completions` and `ubbmap man`: what a shell and `man` want to know of the command line.

use super::Cli;
use super::output::{Failure, say};
use anyhow::Context;
use clap::{Args, CommandFactory};
use clap_complete::Shell;
use std::path::PathBuf;

/// Prints a script by which a shell completes commands and flags.
#[derive(Debug, Args)]
#[command(after_help = "For bash: ubbmap completions bash > ~/.local/share/bash-completion/completions/ubbmap\n\n\
    Example:\n  ubbmap completions bash")]
pub(super) struct Completions {
    /// The shell
    shell: Shell,
}

/// Prints the manual page, or writes that of every command to a folder.
#[derive(Debug, Args)]
#[command(after_help = "Example:\n  ubbmap man\n  ubbmap man --out man1")]
pub(super) struct Man {
    /// Folder for ubbmap.1, ubbmap-build.1, ..; made where it is not there
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
}

impl Completions {
    /// Runs the command.
    pub(super) fn run(&self) -> Result<(), Failure> {
        let mut script = Vec::new();
        clap_complete::generate(self.shell, &mut Cli::command(), "ubbmap", &mut script);
        say(String::from_utf8_lossy(&script).trim_end())
    }
}

impl Man {
    /// Runs the command.
    pub(super) fn run(&self) -> Result<(), Failure> {
        if let Some(folder) = &self.out {
            let shown = || format!("cannot write to {}", folder.display());
            std::fs::create_dir_all(folder).with_context(shown)?;
            clap_mangen::generate_to(Cli::command(), folder).with_context(shown)?;
            return Ok(());
        }
        let mut page = Vec::new();
        clap_mangen::Man::new(Cli::command()).render(&mut page)?;
        say(String::from_utf8_lossy(&page).trim_end())
    }
}

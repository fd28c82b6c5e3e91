//! Floor 6: the command line.

mod bag;
mod build;
mod check;
mod client;
mod demo;
mod experiment;
mod health;
mod map;
mod mapper;
mod options;
mod output;
mod preflight;
mod replay;
mod secure;
mod serve;
mod shell;
mod snapshots;
mod store;
mod token;
mod transfer;

use clap::{CommandFactory, FromArgMatches, Parser, Subcommand};
use output::Failure;
use std::process::ExitCode;

/// A map server that proves free space: robots send laser scans with bounded errors, planners ask what is guaranteed
/// free.
#[derive(Debug, Parser)]
#[command(name = "ubbmap", version, max_term_width = 120, arg_required_else_help = true)]
#[command(
    after_help = "Exit codes: 0 done, 1 failed, 2 bad usage, 64 bad configuration.\n\nExample:\n  ubbmap build fr079.jsonl.gz --out fr079.ubbmap --png fr079.png"
)]
struct Cli {
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    Serve(serve::Serve),
    Demo(demo::Demo),
    Build(Box<build::Build>),
    Replay(Box<replay::Replay>),
    Map(map::Map),
    Check(check::Check),
    Store(store::Store),
    Token(token::Token),
    Experiment(Box<experiment::RunExperiment>),
    Health(health::Health),
    Completions(shell::Completions),
    Man(shell::Man),
}

/// Parses the arguments, runs the command and returns its exit code: 0 done, 1 failed, 2 bad usage, 64 bad configuration.
#[must_use]
pub fn run() -> ExitCode {
    let matches = Cli::command().get_matches();
    let cli = match Cli::from_arg_matches(&matches) {
        Ok(cli) => cli,
        Err(error) => error.exit(),
    };
    let done: Result<(), Failure> = match cli.command {
        Command::Serve(serve) => serve.run(),
        Command::Demo(demo) => demo.run(),
        Command::Build(build) => build.run(),
        Command::Replay(mut replay) => match matches.subcommand() {
            Some((_, flags)) => replay.check_flags(flags).and_then(|()| replay.run()),
            None => replay.run(),
        },
        Command::Map(map) => map.run(),
        Command::Check(check) => check.run(),
        Command::Store(store) => store.run(),
        Command::Token(token) => token.run(),
        Command::Experiment(experiment) => experiment.run(),
        Command::Health(health) => health.run(),
        Command::Completions(completions) => completions.run(),
        Command::Man(man) => man.run(),
    };
    match done {
        Ok(()) => ExitCode::SUCCESS,
        Err(failure) => failure.report(),
    }
}

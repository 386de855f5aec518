//! The command line. Progress goes to stderr, results to stdout.

mod broken_off;
mod check;
mod doctor;
mod gripper;
mod health;
mod recover;
mod replay;
mod run;
mod sense;
mod simulate;
mod teach;

use clap::{Parser, Subcommand};
use gelstereo_host::config::{Config, ConfigError};
use gelstereo_host::run::HostError;
use gelstereo_host::sense::SenseError;
use gelstereo_host::simulate::SimulateError;
use std::fmt;
use std::io::Write;
use std::path::Path;
use std::process::ExitCode;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

/// Grasp a part, find it in the hand by touch, insert it; record and replay.
#[derive(Parser)]
#[command(
    name = "gelstereo-host",
    version,
    about,
    after_help = "Examples:\n  \
        gelstereo-host run                            the whole job with simulated devices\n  \
        gelstereo-host run --config cell.toml --json  your own cell; the summary as JSON\n  \
        gelstereo-host teach --output goal.json       record the goal by touch instead of typing its pose\n  \
        gelstereo-host sense --jsonl                  contact and pose of a simulated grasp by frame\n  \
        gelstereo-host replay out/run.mcap            compute a recording again and compare every bit\n  \
        gelstereo-host recover out/run.mcap           copy a recording that was cut off, with an index\n  \
        gelstereo-host simulate scene.toml out/pairs  image pairs and truth from a scene\n  \
        gelstereo-host check --print-default          all settings to start from\n  \
        gelstereo-host doctor                         what is connected, and whether the job would start\n\n\
        Exit code: 0 when the job is done or all is well, 1 when not, 2 for an error."
)]
struct Arguments {
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    /// Do the job: open, rest frame, close, localize, align, insert, retreat.
    Run(run::Arguments),
    /// Teach the goal: grasp the part where you placed it, localize it there, write a file for
    /// `task.taught`.
    Teach(teach::Arguments),
    /// Sense without a robot until stopped: points, contact and pose to a recording, standard output or
    /// the network.
    Sense(sense::Arguments),
    /// Report whether a running `sense --health-file` is healthy.
    Health(health::Arguments),
    /// Recompute a recording from its images and compare every result.
    Replay(replay::Arguments),
    /// Copy the readable part of a truncated recording, with an index.
    Recover(recover::Arguments),
    /// Create a folder of image pairs with ground truth from a scene.
    Simulate(simulate::Arguments),
    /// Check whether a configuration would work on this computer; nothing moves.
    Check(check::Arguments),
    /// Query the configured gripper or move it, for bench work.
    Gripper(gripper::Arguments),
    /// Report connected devices, permissions, camera and disk speed, and whether `run` would start.
    Doctor(doctor::Arguments),
}

/// Errors of the command line: reported in one line, exit code 2.
enum CliError {
    Host(HostError),
    Simulate(SimulateError),
    Sense(SenseError),
    Signal(ctrlc::Error),
    Json(serde_json::Error),
    Output(std::io::Error),
    Recording(String),
}

impl fmt::Display for CliError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Host(error) => error.fmt(f),
            Self::Simulate(error) => error.fmt(f),
            Self::Sense(error) => error.fmt(f),
            Self::Signal(error) => write!(f, "cannot listen for Ctrl-C: {error}"),
            Self::Output(error) => write!(f, "standard output cannot be written: {error}"),
            Self::Recording(reason) => {
                write!(f, "the job went on to its end, but its recording ended early: {reason}")
            }
            Self::Json(error) => write!(f, "the summary cannot be written as JSON: {error}"),
        }
    }
}

impl<E: Into<HostError>> From<E> for CliError {
    fn from(error: E) -> Self {
        Self::Host(error.into())
    }
}

/// Runs the command given by the arguments.
pub fn main() -> ExitCode {
    let result = match Arguments::parse().command {
        Command::Run(arguments) => run::command(arguments),
        Command::Teach(arguments) => teach::command(arguments),
        Command::Sense(arguments) => sense::command(&arguments),
        Command::Health(arguments) => health::command(&arguments),
        Command::Replay(arguments) => replay::command(&arguments),
        Command::Recover(arguments) => recover::command(&arguments),
        Command::Simulate(arguments) => simulate::command(&arguments),
        Command::Check(arguments) => check::command(&arguments),
        Command::Gripper(arguments) => gripper::command(&arguments),
        Command::Doctor(arguments) => doctor::command(&arguments),
    };
    match result {
        Ok(true) => ExitCode::SUCCESS,
        Ok(false) => ExitCode::from(1),
        Err(error) => {
            // If stderr is closed too, only the exit code reports the error.
            let _ = writeln!(std::io::stderr(), "gelstereo-host: {error}");
            ExitCode::from(2)
        }
    }
}

fn load(path: Option<&Path>) -> Result<Config, ConfigError> {
    path.map_or_else(|| Ok(Config::default()), Config::load)
}

/// Writes a line of the result; a closed pipe is an error, not a panic.
fn say(line: impl fmt::Display) -> Result<(), CliError> {
    writeln!(std::io::stdout(), "{line}").map_err(CliError::Output)
}

/// Flag raised on Ctrl-C, SIGTERM and SIGHUP.
fn stop_flag() -> Result<Arc<AtomicBool>, CliError> {
    let stop = Arc::new(AtomicBool::new(false));
    let raised = Arc::clone(&stop);
    stop_on_signal(move || raised.store(true, Ordering::Relaxed))?;
    Ok(stop)
}

/// Calls `raise` on Ctrl-C, SIGTERM and SIGHUP.
fn stop_on_signal(raise: impl Fn() + Send + 'static) -> Result<(), CliError> {
    ctrlc::set_handler(raise).map_err(CliError::Signal)
}

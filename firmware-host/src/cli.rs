//! The command line. Progress goes to stderr, results to stdout.

use clap::{Parser, Subcommand};
use gelstereo_core::params::Params;
use gelstereo_host::config::{Config, ConfigError};
use gelstereo_host::report::{JobReport, Outcome, StageReport};
use gelstereo_host::run::HostError;
use gelstereo_host::simulate::{SimulateError, Simulated};
use gelstereo_host::{check, replay, run, simulate};
use indicatif::{ProgressBar, ProgressStyle};
use std::fmt;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

/// Grasp a part, find it in the hand by touch, insert it; record and replay.
#[derive(Parser)]
#[command(
    name = "gelstereo-host",
    version,
    about,
    after_help = "Examples:\n  \
        gelstereo-host run                               the whole job with simulated sensor, gripper and robot\n  \
        gelstereo-host run --config cell.toml --json     your own cell; the summary as JSON\n  \
        gelstereo-host replay out/run.mcap               compute a recording again and compare every bit\n  \
        gelstereo-host simulate scene.toml out/pairs     image pairs and truth from a scene\n  \
        gelstereo-host check --print-default > cell.toml all settings to start from\n\n\
        Exit code: 0 when the job is done or all is well, 1 when not, 2 for an error."
)]
struct Arguments {
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    /// Do the job: open, rest frame, close, localize, align, insert.
    Run {
        /// Configuration; without it the embedded default.
        #[arg(long, value_name = "TOML")]
        config: Option<PathBuf>,
        /// Where to record, instead of `recording.path`.
        #[arg(long, value_name = "MCAP")]
        record: Option<PathBuf>,
        /// Seed of the simulated world, instead of `simulated.seed`.
        #[arg(long)]
        seed: Option<u64>,
        /// Print the summary as JSON instead of text.
        #[arg(long)]
        json: bool,
    },
    /// Compute a recording again from its images and compare every result.
    Replay {
        /// The recording.
        recording: PathBuf,
        /// Configuration whose preset and [params] replace the recorded ones.
        #[arg(long, value_name = "TOML")]
        params: Option<PathBuf>,
        /// Print the summary as JSON instead of text.
        #[arg(long)]
        json: bool,
    },
    /// Make a folder of image pairs with truth from a scene.
    Simulate {
        /// The scene.
        scene: PathBuf,
        /// The folder, which is created.
        folder: PathBuf,
    },
    /// Say whether a configuration would work here; nothing moves.
    Check {
        /// Configuration; without it the embedded default.
        #[arg(long, value_name = "TOML")]
        config: Option<PathBuf>,
        /// Print the embedded default as TOML and stop.
        #[arg(long)]
        print_default: bool,
    },
}

/// What can go wrong at the edge: told in one line, exit code 2.
enum CliError {
    Host(HostError),
    Simulate(SimulateError),
    Signal(ctrlc::Error),
    Json(serde_json::Error),
    Output(std::io::Error),
}

impl fmt::Display for CliError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Host(error) => error.fmt(f),
            Self::Simulate(error) => error.fmt(f),
            Self::Signal(error) => write!(f, "cannot listen for Ctrl-C: {error}"),
            Self::Output(error) => write!(f, "standard output cannot be written: {error}"),
            Self::Json(error) => write!(f, "the summary cannot be written as JSON: {error}"),
        }
    }
}

impl<E: Into<HostError>> From<E> for CliError {
    fn from(error: E) -> Self {
        Self::Host(error.into())
    }
}

/// Runs the command that the arguments name.
pub fn main() -> ExitCode {
    let result = match Arguments::parse().command {
        Command::Run { config, record, seed, json } => run_job(config.as_deref(), record, seed, json),
        Command::Replay { recording, params, json } => replay_recording(&recording, params.as_deref(), json),
        Command::Simulate { scene, folder } => simulate_scene(&scene, &folder),
        Command::Check { print_default: true, .. } => print_default(),
        Command::Check { config, .. } => check_config(config.as_deref()),
    };
    match result {
        Ok(true) => ExitCode::SUCCESS,
        Ok(false) => ExitCode::from(1),
        Err(error) => {
            // When stderr is gone too, the exit code is all that is left to say.
            let _ = writeln!(std::io::stderr(), "gelstereo-host: {error}");
            ExitCode::from(2)
        }
    }
}

fn load(path: Option<&Path>) -> Result<Config, ConfigError> {
    path.map_or_else(|| Ok(Config::default()), Config::load)
}

/// Writes a line of the result; a pipe that was closed is an error, not a panic.
fn say(line: impl fmt::Display) -> Result<(), CliError> {
    writeln!(std::io::stdout(), "{line}").map_err(CliError::Output)
}

/// A flag that Ctrl-C raises, as do SIGTERM and SIGHUP.
fn stop_flag() -> Result<Arc<AtomicBool>, CliError> {
    let stop = Arc::new(AtomicBool::new(false));
    let raised = Arc::clone(&stop);
    ctrlc::set_handler(move || raised.store(true, Ordering::Relaxed)).map_err(CliError::Signal)?;
    Ok(stop)
}

fn run_job(
    config: Option<&Path>,
    record: Option<PathBuf>,
    seed: Option<u64>,
    json: bool,
) -> Result<bool, CliError> {
    let mut config = load(config)?;
    config.recording.path = record.unwrap_or(config.recording.path);
    config.simulated.seed = seed.unwrap_or(config.simulated.seed);
    let stop = stop_flag()?;
    let bar = ProgressBar::new_spinner();
    bar.enable_steady_tick(Duration::from_millis(100));
    bar.set_message("Ctrl-C stops the job and closes the recording");
    // The robot moves: that nobody reads the lines is told at the end, and does not break the job off.
    let mut said = Ok(());
    let mut progress = |report: &StageReport| {
        let line = stage_line(report);
        let write = || {
            if json { writeln!(std::io::stderr(), "{line}") } else { writeln!(std::io::stdout(), "{line}") }
        };
        said = std::mem::replace(&mut said, Ok(())).and(bar.suspend(write));
    };
    let report = run::run(&config, &config.recording.path, &stop, &mut progress);
    bar.finish_and_clear();
    let report = report?;
    said.map_err(CliError::Output)?;
    if json {
        say(serde_json::to_string_pretty(&report).map_err(CliError::Json)?)?;
    } else {
        print_summary(&report)?;
    }
    Ok(matches!(report.outcome, Outcome::Inserted { .. }))
}

fn stage_line(report: &StageReport) -> String {
    let mut line = format!(
        "{:<9} {:>6.0} ms, {:>3} frames over {:.2} s ",
        report.stage.name(),
        report.wall_s * 1e3,
        report.frames,
        report.source_s
    );
    if report.bad_frames > 0 {
        line += &format!("  {} of them bad", report.bad_frames);
    }
    for figure in &report.figures {
        line += &format!("  {} {:.3}", figure.name, figure.value);
    }
    line
}

fn print_summary(report: &JobReport) -> Result<(), CliError> {
    say(format_args!("{:<9} {}", "done", report.outcome))?;
    if let Some(localized) = &report.localized {
        let free = if localized.free.is_empty() { "nothing".to_owned() } else { localized.free.join("; ") };
        say(format_args!("  free: {free}"))?;
    }
    if let Some(truth) = &report.truth {
        say(format_args!(
            "  simulated truth: tip off by {:.3} mm and {:.2} mrad across, {:.3} mm along; inserted {:.2} mm; \
             the outcome above is {}",
            truth.tip_error_mm,
            truth.tilt_error_rad * 1e3,
            truth.axial_error_mm,
            truth.inserted_mm.max(0.0),
            if truth.outcome_is_true { "true" } else { "not true" }
        ))?;
    }
    if let Some(recording) = &report.recording {
        say(format_args!("  recording: {}", recording.display()))?;
    }
    Ok(())
}

fn replay_recording(recording: &Path, params: Option<&Path>, json: bool) -> Result<bool, CliError> {
    let params: Option<Params> = params.map(Config::load).transpose()?.map(|config| config.params);
    let bar = ProgressBar::no_length().with_style(count_style());
    let report = replay::replay(recording, params, &mut |frames| bar.set_position(frames));
    bar.finish_and_clear();
    let report = report?;
    if json {
        say(serde_json::to_string_pretty(&report).map_err(CliError::Json)?)?;
    } else {
        say(&report)?;
    }
    // With other settings other results are what was asked for.
    Ok(report.frames > 0 && (report.differing == 0 || report.changed_params))
}

fn count_style() -> ProgressStyle {
    ProgressStyle::with_template("{spinner} {human_pos} frames")
        .unwrap_or_else(|_| ProgressStyle::default_bar())
}

fn simulate_scene(scene: &Path, folder: &Path) -> Result<bool, CliError> {
    let stop = stop_flag()?;
    let bar = ProgressBar::new(0);
    let simulated = simulate::simulate(scene, folder, &stop, &mut |done, all| {
        bar.set_length(all as u64);
        bar.set_position(done as u64);
    });
    bar.finish_and_clear();
    let Simulated { frames, plan } = simulated.map_err(CliError::Simulate)?;
    say(plan.to_string().trim_end())?;
    say(format_args!("{frames} frames with truth in {}", folder.display()))?;
    Ok(!stop.load(Ordering::Relaxed))
}

fn print_default() -> Result<bool, CliError> {
    say(Config::default().to_toml()?.trim_end())?;
    Ok(true)
}

fn check_config(path: Option<&Path>) -> Result<bool, CliError> {
    let findings = check::check(&load(path)?);
    for finding in &findings {
        let (mark, text) = match &finding.result {
            Ok(text) => ("ok", text),
            Err(text) => ("WRONG", text),
        };
        say(format_args!("{mark:<6} {:<14} {text}", finding.subject))?;
    }
    Ok(findings.iter().all(|finding| finding.result.is_ok()))
}

//! `gelstereo-host teach`.

use super::broken_off::{Done, reported};
use super::run::{stage_line, tell_light_fault, tell_page_fault};
use super::{CliError, load, say, stop_flag};
use clap::Args;
use gelstereo_host::config::{Config, RobotConfig};
use gelstereo_host::report::StageReport;
use gelstereo_host::run;
use std::io::{BufRead, Write};
use std::path::PathBuf;

#[derive(Args)]
pub struct Arguments {
    /// Configuration; without it the embedded default.
    #[arg(long, value_name = "TOML")]
    config: Option<PathBuf>,
    /// Output file of the taught goal, for `task.taught`.
    #[arg(long, value_name = "JSON")]
    output: PathBuf,
    /// Record to this file, instead of `recording.path`.
    #[arg(long, value_name = "MCAP")]
    record: Option<PathBuf>,
    /// Seed of the simulated world, instead of `simulated.seed`.
    #[arg(long)]
    seed: Option<u64>,
    /// Leave the robot where it is, with the open fingers around the part, instead of moving to
    /// `task.goal_pose`.
    #[arg(long)]
    stay: bool,
    /// Start at once, without waiting for Enter.
    #[arg(long)]
    yes: bool,
    /// Print the summary as JSON instead of text.
    #[arg(long)]
    json: bool,
}

pub fn command(arguments: Arguments) -> Result<bool, CliError> {
    reported(arguments.json, |done| job(arguments, done))
}

fn job(arguments: Arguments, done: &mut Done) -> Result<bool, CliError> {
    let Arguments { config, output, record, seed, stay, yes, json } = arguments;
    let mut config = load(config.as_deref())?;
    config.recording.path = record.unwrap_or(config.recording.path);
    config.simulated.seed = seed.unwrap_or(config.simulated.seed);
    if !yes && !ready(&config, stay)? {
        return Ok(false);
    }
    let stop = stop_flag()?;
    let mut said = Ok(());
    let mut progress = |report: &StageReport| {
        let written = writeln!(std::io::stderr(), "{}", stage_line(report));
        said = std::mem::replace(&mut said, Ok(())).and(written);
        done.stages.push(report.clone());
    };
    let teaching = run::teach(&config, stay, &stop, &mut progress)?;
    said.map_err(CliError::Output)?;
    if let Some(taught) = &teaching.taught {
        taught.save(&output).map_err(run::HostError::Taught)?;
    }
    if json {
        say(serde_json::to_string_pretty(&teaching.report).map_err(CliError::Json)?)?;
    } else {
        say(&teaching.report.why)?;
    }
    tell_light_fault(&teaching.report);
    tell_page_fault(&teaching.report);
    if teaching.taught.is_some() && !json {
        say(format_args!("written to {}; use it with [task] taught = {output:?}", output.display()))?;
    }
    Ok(teaching.taught.is_some())
}

/// Prompts for the part before a real robot moves; `false` if standard input is closed.
fn ready(config: &Config, stay: bool) -> Result<bool, CliError> {
    if config.robot == RobotConfig::Simulated {
        return Ok(true);
    }
    let motion = if stay {
        "The robot stays; the gripper opens and then closes on the part."
    } else {
        "The robot comes to the goal from above, open, and the gripper closes on the part."
    };
    let question = format!("Place the part in its goal. {motion} Press Enter to begin, Ctrl-C to end.");
    writeln!(std::io::stderr(), "{question}").map_err(CliError::Output)?;
    let mut line = String::new();
    let count = std::io::stdin().lock().read_line(&mut line).map_err(CliError::Output)?;
    Ok(count > 0)
}

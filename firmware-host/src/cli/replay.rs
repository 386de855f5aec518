//! `gelstereo-host replay`.

use super::{CliError, say};
use clap::Args;
use gelstereo_core::params::Params;
use gelstereo_host::config::Config;
use gelstereo_host::replay;
use indicatif::{ProgressBar, ProgressStyle};
use std::path::PathBuf;

#[derive(Args)]
pub struct Arguments {
    /// The recording; all its parts, if it has several.
    #[arg(required = true, value_name = "MCAP")]
    recordings: Vec<PathBuf>,
    /// Configuration whose preset and [params] replace the recorded ones.
    #[arg(long, value_name = "TOML")]
    params: Option<PathBuf>,
    /// Print the summary as JSON instead of text.
    #[arg(long)]
    json: bool,
}

pub fn command(Arguments { recordings, params, json }: &Arguments) -> Result<bool, CliError> {
    let params: Option<Params> = params.as_deref().map(Config::load).transpose()?.map(|config| config.params);
    let bar = ProgressBar::no_length().with_style(count_style());
    let report = replay::replay(recordings, params, &mut |frames| bar.set_position(frames));
    bar.finish_and_clear();
    let report = report?;
    if *json {
        say(serde_json::to_string_pretty(&report).map_err(CliError::Json)?)?;
    } else {
        say(&report)?;
    }
    Ok(report.is_good())
}

fn count_style() -> ProgressStyle {
    ProgressStyle::with_template("{spinner} {human_pos} frames")
        .unwrap_or_else(|_| ProgressStyle::default_bar())
}

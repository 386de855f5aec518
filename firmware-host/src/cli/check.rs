//! `gelstereo-host check`.

use super::{CliError, load, say};
use clap::Args;
use gelstereo_host::check;
use gelstereo_host::config::Config;
use gelstereo_host::finding::all_right;
use std::path::PathBuf;

#[derive(Args)]
pub struct Arguments {
    /// Configuration; without it the embedded default.
    #[arg(long, value_name = "TOML")]
    config: Option<PathBuf>,
    /// Print the embedded default as TOML, with a comment on every setting, and exit.
    #[arg(long)]
    print_default: bool,
}

pub fn command(Arguments { config, print_default }: &Arguments) -> Result<bool, CliError> {
    if *print_default {
        say(Config::default().to_commented_toml()?.trim_end())?;
        return Ok(true);
    }
    let findings = check::check(&load(config.as_deref())?);
    for finding in &findings {
        say(finding)?;
    }
    Ok(all_right(&findings))
}

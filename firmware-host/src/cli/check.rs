//! `gelstereo-host check`.

use super::{CliError, load, say};
use clap::Args;
use gelstereo_host::check;
use gelstereo_host::config::Config;
use std::path::PathBuf;

#[derive(Args)]
pub struct Arguments {
    /// Configuration; without it the embedded default.
    #[arg(long, value_name = "TOML")]
    config: Option<PathBuf>,
    /// Print the embedded default as TOML and stop.
    #[arg(long)]
    print_default: bool,
}

pub fn command(Arguments { config, print_default }: &Arguments) -> Result<bool, CliError> {
    if *print_default {
        say(Config::default().to_toml()?.trim_end())?;
        return Ok(true);
    }
    let findings = check::check(&load(config.as_deref())?);
    for finding in &findings {
        let (mark, text) = match &finding.result {
            Ok(text) => ("ok", text),
            Err(text) => ("WRONG", text),
        };
        say(format_args!("{mark:<6} {:<14} {text}", finding.subject))?;
    }
    Ok(findings.iter().all(|finding| finding.result.is_ok()))
}

//! `gelstereo-host health`.

use super::{CliError, say};
use clap::Args;
use gelstereo_host::sense::supervisor;
use std::io::Write;
use std::path::PathBuf;

#[derive(Args)]
pub struct Arguments {
    /// The file that `sense --health-file` writes.
    file: PathBuf,
    /// Largest age of the file.
    #[arg(long, value_name = "SECONDS", default_value_t = 5.0)]
    max_age_s: f64,
}

pub fn command(Arguments { file, max_age_s }: &Arguments) -> Result<bool, CliError> {
    match supervisor::check(file, *max_age_s) {
        Ok(health) => {
            say(format_args!("well: {} frames, {:.1} Hz", health.frames, health.rate_hz))?;
            Ok(true)
        }
        Err(error) => {
            // The exit code also reports the failure.
            let _ = writeln!(std::io::stderr(), "gelstereo-host: {error}");
            Ok(false)
        }
    }
}

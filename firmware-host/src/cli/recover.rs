//! `gelstereo-host recover`.

use super::{CliError, say};
use clap::Args;
use gelstereo_host::recording::{self, RecordingError};
use std::path::{Path, PathBuf};

#[derive(Args)]
pub struct Arguments {
    /// The truncated or damaged recording. It is only read.
    broken: PathBuf,
    /// The new file. Default: `broken.recovered.mcap` beside it.
    fixed: Option<PathBuf>,
    /// Replace the broken file by the new one.
    #[arg(long, conflicts_with = "fixed")]
    in_place: bool,
    /// Print the summary as JSON instead of text.
    #[arg(long)]
    json: bool,
}

pub fn command(Arguments { broken, fixed, in_place, json }: &Arguments) -> Result<bool, CliError> {
    let fixed = fixed.clone().unwrap_or_else(|| broken.with_extension("recovered.mcap"));
    let recovered = recording::recover(broken, &fixed)?;
    if *in_place {
        replace(&fixed, broken)?;
    }
    if *json {
        say(serde_json::to_string_pretty(&recovered).map_err(CliError::Json)?)?;
    } else {
        say(recovered)?;
        say(format_args!("recording: {}", if *in_place { broken } else { &fixed }.display()))?;
    }
    Ok(recovered.messages > 0)
}

fn replace(from: &Path, to: &Path) -> Result<(), RecordingError> {
    std::fs::rename(from, to).map_err(|error| RecordingError::Io {
        path: to.to_owned(),
        doing: "replace",
        error,
    })
}

//! `gelstereo-host doctor`.

use super::{CliError, load, say};
use clap::Args;
use gelstereo_host::camera::CameraConfig;
use gelstereo_host::config::{Config, SourceConfig};
use gelstereo_host::doctor::{Roots, examine};
use gelstereo_host::finding::Level;
use std::path::PathBuf;

#[derive(Args)]
pub struct Arguments {
    /// Configuration; without it the embedded default.
    #[arg(long, value_name = "TOML")]
    config: Option<PathBuf>,
    /// Camera whose rate and latency are measured, instead of the configured one: `serial:NUMBER` or a
    /// path.
    #[arg(long, value_name = "DEVICE")]
    camera: Option<String>,
    /// Print everything as JSON instead of text.
    #[arg(long)]
    json: bool,
}

pub fn command(Arguments { config, camera, json }: &Arguments) -> Result<bool, CliError> {
    let config = load(config.as_deref())?;
    let camera = camera.as_ref().map(|device| named(&config, device));
    let diagnosis = examine(&config, camera.as_ref(), &Roots::default());
    if *json {
        say(serde_json::to_string_pretty(&diagnosis).map_err(CliError::Json)?)?;
        return Ok(diagnosis.run_would_start);
    }
    for finding in &diagnosis.findings {
        say(finding)?;
    }
    let count = |level| diagnosis.findings.iter().filter(|finding| finding.level == level).count();
    let (wrong, warnings) = (count(Level::Wrong), count(Level::Warn));
    let verdict = if diagnosis.run_would_start { "would start" } else { "would not start" };
    say(format_args!("\n`gelstereo-host run` {verdict}: {wrong} wrong, {warnings} to look at"))?;
    Ok(diagnosis.run_would_start)
}

/// Settings of the configured camera for another device.
fn named(config: &Config, device: &str) -> CameraConfig {
    let configured = match &config.source {
        SourceConfig::Camera(camera) => camera.clone(),
        _ => CameraConfig::default(),
    };
    CameraConfig { device: device.to_owned(), right_device: None, ..configured }
}

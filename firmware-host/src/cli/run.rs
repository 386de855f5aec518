//! `gelstereo-host run`.

use super::broken_off::{Done, reported};
use super::{CliError, load, say, stop_flag};
use clap::Args;
use gelstereo_host::config::RecordingConfig;
use gelstereo_host::report::{JobReport, Outcome, PageReport, StageReport, page_path};
use gelstereo_host::run::{self, HostError};
use indicatif::ProgressBar;
use std::io::Write;
use std::path::PathBuf;
use std::time::Duration;

#[derive(Args)]
pub struct Arguments {
    /// Configuration; without it the embedded default.
    #[arg(long, value_name = "TOML")]
    config: Option<PathBuf>,
    /// Record to this file, instead of `recording.path`.
    #[arg(long, value_name = "MCAP")]
    record: Option<PathBuf>,
    /// Seed of the simulated world, instead of `simulated.seed`.
    #[arg(long)]
    seed: Option<u64>,
    /// Print the summary as JSON instead of text.
    #[arg(long)]
    json: bool,
}

pub fn command(arguments: Arguments) -> Result<bool, CliError> {
    reported(arguments.json, |done| job(arguments, done))
}

fn job(Arguments { config, record, seed, json }: Arguments, done: &mut Done) -> Result<bool, CliError> {
    let mut config = load(config.as_deref())?;
    config.recording.path = record.unwrap_or(config.recording.path);
    config.simulated.seed = seed.unwrap_or(config.simulated.seed);
    let stop = stop_flag()?;
    let bar = ProgressBar::new_spinner();
    bar.enable_steady_tick(Duration::from_millis(100));
    bar.set_message("Ctrl-C stops the job and closes the recording");
    // The robot moves: a closed output must not abort the job and is reported at the end.
    let mut said = Ok(());
    let mut progress = |report: &StageReport| {
        let line = stage_line(report);
        let write = || {
            if json { writeln!(std::io::stderr(), "{line}") } else { writeln!(std::io::stdout(), "{line}") }
        };
        said = std::mem::replace(&mut said, Ok(())).and(bar.suspend(write));
        done.stages.push(report.clone());
    };
    let report = run::run(&config, &stop, &mut progress);
    bar.finish_and_clear();
    if matches!(report, Err(HostError::Task(_))) {
        done.page = name_page(&config.recording);
    }
    let report = report?;
    said.map_err(CliError::Output)?;
    if json {
        say(serde_json::to_string_pretty(&report).map_err(CliError::Json)?)?;
    } else {
        print_summary(&report)?;
    }
    tell_light_fault(&report);
    tell_page_fault(&report);
    if let Some(reason) = report.recording.and_then(|recording| recording.fault) {
        return Err(CliError::Recording(reason));
    }
    Ok(matches!(report.outcome, Outcome::Inserted { .. }))
}

pub(super) fn tell_page_fault(report: &JobReport) {
    if let Some(reason) = report.page.as_ref().and_then(|page| page.fault.as_ref()) {
        let _ = writeln!(std::io::stderr(), "gelstereo-host: the run has no page: {reason}");
    }
}

pub(super) fn tell_light_fault(report: &JobReport) {
    if let Some(reason) = &report.light_fault {
        // If stderr is closed too, the JSON report still contains it.
        let _ = writeln!(std::io::stderr(), "gelstereo-host: the light was not switched off: {reason}");
    }
}

/// Reports the path of an aborted run's page. A page that could not be written leaves no file.
fn name_page(recording: &RecordingConfig) -> Option<PageReport> {
    let path = page_path(&recording.path);
    if !(recording.report && path.is_file()) {
        return None;
    }
    // If stderr is closed too, the error that follows is lost as well.
    let _ = writeln!(std::io::stderr(), "gelstereo-host: report: {}", path.display());
    Some(PageReport { path, fault: None })
}

pub(super) fn stage_line(report: &StageReport) -> String {
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
    for warning in &report.warnings {
        line += &format!("\n  warning: {warning}");
    }
    line
}

fn print_summary(report: &JobReport) -> Result<(), CliError> {
    say(format_args!("{:<9} {}", "done", report.outcome))?;
    let latency = &report.latency;
    say(format_args!(
        "  from image to result {}; from image to the stop's last byte {} (p50 / p99)",
        latency.received_to_sensed, latency.image_to_wire
    ))?;
    if let Some(localized) = &report.localized {
        let free = if localized.free.is_empty() { "nothing".to_owned() } else { localized.free.join("; ") };
        say(format_args!("  free: {free}"))?;
    }
    if let Some(truth) = &report.truth {
        say(format_args!(
            "  simulated truth: tip off by {:.3} mm and {:.2} mrad across, {:.3} mm along; inserted {:.2} \
             mm; the outcome above is {}",
            truth.tip_error_mm,
            truth.tilt_error_rad * 1e3,
            truth.axial_error_mm,
            truth.inserted_mm.max(0.0),
            if truth.outcome_is_true { "true" } else { "not true" }
        ))?;
    }
    if let Some(recording) = &report.recording {
        for file in &recording.files {
            say(format_args!("  recording: {}", file.display()))?;
        }
        if recording.lost_messages > 0 {
            say(format_args!(
                "  the disk was too slow: {} messages were not recorded",
                recording.lost_messages
            ))?;
        }
    }
    if let Some(page) = report.page.as_ref().filter(|page| page.fault.is_none()) {
        say(format_args!("  report: {}", page.path.display()))?;
    }
    Ok(())
}

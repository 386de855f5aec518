//! `gelstereo-host sense`.

use super::{CliError, load, stop_on_signal};
use clap::{Args, ValueEnum};
use gelstereo_host::config::{Config, SourceConfig};
use gelstereo_host::light::{LightOn, set_up_camera};
use gelstereo_host::publish::Protocol;
use gelstereo_host::run::Setup;
use gelstereo_host::sense::supervisor::Supervisor;
use gelstereo_host::sense::{Control, Ended, Listeners, Parts, Report, Sense, named_source, open_outputs};
use gelstereo_host::source::FrameMode;
use gelstereo_host::source::stream::StreamConfig;
use std::io::Write;
use std::path::PathBuf;
use std::sync::Arc;
use std::time::{SystemTime, UNIX_EPOCH};

#[derive(Args)]
pub struct Arguments {
    /// Configuration; without it the embedded default.
    #[arg(long, value_name = "TOML")]
    config: Option<PathBuf>,
    /// Read frames from this FIFO or file, or from standard input with `-`, instead of `source`.
    #[arg(long, value_name = "PATH")]
    stream: Option<PathBuf>,
    /// With --stream: frames are grey bytes of this size, both views side by side, without headers.
    #[arg(long, value_name = "WxH", requires = "stream", value_parser = parse_size)]
    raw_size: Option<[u32; 2]>,
    /// With --stream: sense every frame and let the producer wait, instead of only the newest.
    #[arg(long, requires = "stream")]
    every: bool,
    /// Record to this file; if it exists, to a new one beside it.
    #[arg(long, value_name = "MCAP")]
    record: Option<PathBuf>,
    /// Write one line of JSON per frame to standard output.
    #[arg(long)]
    jsonl: bool,
    /// Add the points of all markers to these lines.
    #[arg(long, requires = "jsonl")]
    points: bool,
    /// Publish live results; may be given twice.
    #[arg(long, value_enum)]
    publish: Vec<PublishBy>,
    /// Stop after this many stereo pairs.
    #[arg(long, value_name = "N")]
    frames: Option<u64>,
    /// Format of the log on standard error.
    #[arg(long, value_enum, default_value_t)]
    log: LogFormat,
    /// Write the state to this file once a second, for `gelstereo-host health`.
    #[arg(long, value_name = "JSON")]
    health_file: Option<PathBuf>,
}

#[derive(Clone, Copy, ValueEnum)]
enum PublishBy {
    /// ROS 2 messages over zenoh.
    Zenoh,
    /// The WebSocket of Foxglove and Lichtblick.
    Foxglove,
}

#[derive(Clone, Copy, Default, ValueEnum)]
enum LogFormat {
    /// One sentence per line.
    #[default]
    Text,
    /// One JSON object per line.
    Json,
}

fn parse_size(text: &str) -> Result<[u32; 2], String> {
    let sides = text.split_once('x').and_then(|(w, h)| Some([w.parse().ok()?, h.parse().ok()?]));
    sides.ok_or_else(|| "valid is width x height in pixels, such as 1280x480".to_owned())
}

pub fn command(arguments: &Arguments) -> Result<bool, CliError> {
    let config = configuration(arguments)?;
    let control = Arc::new(Control::default());
    let stopped = Arc::clone(&control);
    stop_on_signal(move || stopped.stop.store(true, std::sync::atomic::Ordering::Relaxed))?;
    relearn_on_signal(&control)?;
    set_up_camera(&config.camera_hid)?;
    let light = LightOn::new(&config.light)?;
    let setup = Setup::without_robot(&config)?;
    let listeners = Listeners {
        recording: arguments.record.clone(),
        protocols: arguments.publish.iter().map(|by| by.protocol()).collect(),
        lines: arguments.jsonl,
        points: arguments.points,
    };
    let outputs = open_outputs(&config, &listeners, setup.attachments);
    let parts = Parts {
        config: &config,
        source: named_source(&config, setup.devices),
        sensing: setup.sensing,
        outputs: outputs.map_err(CliError::Sense)?,
        supervisor: Supervisor::new(arguments.health_file.clone()),
        max_frames: arguments.frames,
    };
    let mut say = |report: &Report| arguments.log.say(report);
    let ended = Sense::new(parts, &control, &mut say).and_then(Sense::run).map_err(CliError::Sense)?;
    let complete = tell_files(arguments.log, &ended);
    light.off()?;
    Ok(complete)
}

fn configuration(arguments: &Arguments) -> Result<Config, CliError> {
    let mut config = load(arguments.config.as_deref())?;
    if let Some(path) = &arguments.stream {
        config.source = SourceConfig::Stream(StreamConfig {
            path: path.clone(),
            mode: if arguments.every { FrameMode::Every } else { FrameMode::Latest },
            raw_size_px: arguments.raw_size,
            ..StreamConfig::default()
        });
    }
    config.validate()?;
    Ok(config)
}

/// Reports the state of the outputs; `false` if one of them lost data.
fn tell_files(log: LogFormat, ended: &Ended) -> bool {
    let recording = ended.closed.recording.as_ref();
    let faults = recording.and_then(|recording| recording.fault.clone()).into_iter();
    let faults: Vec<String> = faults.chain(ended.closed.lines.clone()).collect();
    for reason in &faults {
        log.say(&Report::OutputLost { output: "an output".to_owned(), reason: reason.clone() });
    }
    faults.is_empty() && !ended.lost_output
}

impl PublishBy {
    const fn protocol(self) -> Protocol {
        match self {
            Self::Zenoh => Protocol::Zenoh,
            Self::Foxglove => Protocol::Foxglove,
        }
    }
}

impl LogFormat {
    /// Writes a line to standard error. A closed log must not end sensing.
    fn say(self, report: &Report) {
        let line = match self {
            Self::Text => report.to_string(),
            Self::Json => {
                let mut object = serde_json::json!(report);
                let unix_s = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default().as_secs_f64();
                object["unix_s"] = unix_s.into();
                object["level"] = report.level().into();
                object["message"] = report.to_string().into();
                object.to_string()
            }
        };
        let _ = writeln!(std::io::stderr(), "{line}");
    }
}

/// SIGUSR1 makes the next good frames the rest state.
#[cfg(unix)]
fn relearn_on_signal(control: &Arc<Control>) -> Result<(), CliError> {
    use signal_hook::consts::SIGUSR1;
    use signal_hook::iterator::Signals;
    let mut signals = Signals::new([SIGUSR1]).map_err(CliError::Output)?;
    let control = Arc::clone(control);
    std::thread::spawn(move || {
        for _ in signals.forever() {
            control.relearn.store(true, std::sync::atomic::Ordering::Relaxed);
        }
    });
    Ok(())
}

#[cfg(not(unix))]
fn relearn_on_signal(_: &Arc<Control>) -> Result<(), CliError> {
    Ok(())
}

//! Builds the parts of the sensing loop from a configuration.

use super::outputs::{Lines, Outputs};
use crate::config::{Config, SourceConfig};
use crate::publish::{Outlet, Protocol, PublishError, Publisher};
use crate::recording::{Content, Recording};
use crate::run::{HostError, log_clock, recorded_config};
use crate::source::{FrameSource, SourceError};
use crate::task::Devices;
use crate::world::Rehearsal;
use gelstereo_core::frames::WidthError;
use std::io::Write;
use std::path::{Path, PathBuf};

/// Why sensing could not start or broke off.
#[derive(Debug)]
pub enum SenseError {
    /// An error shared with the robot task.
    Host(HostError),
    /// A publisher could not be opened.
    Publish(PublishError),
    /// The mount cannot reach the grasp width.
    Width(WidthError),
    /// The source failed.
    Source(SourceError),
    /// No thread could be started.
    Thread(std::io::Error),
}

impl std::fmt::Display for SenseError {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Host(error) => error.fmt(f),
            Self::Publish(error) => error.fmt(f),
            Self::Width(error) => write!(f, "sense.grasp_width_mm: {error}"),
            Self::Source(error) => error.fmt(f),
            Self::Thread(error) => write!(f, "no thread for standard output: {error}"),
        }
    }
}

impl std::error::Error for SenseError {}

impl<E: Into<HostError>> From<E> for SenseError {
    fn from(error: E) -> Self {
        Self::Host(error.into())
    }
}

/// Requested outputs.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Listeners {
    /// Path of the recording.
    pub recording: Option<PathBuf>,
    /// Publishers.
    pub protocols: Vec<Protocol>,
    /// Whether standard output receives one line per frame.
    pub lines: bool,
    /// Whether these lines include the points of all markers.
    pub points: bool,
}

/// A source with its name.
pub struct NamedSource {
    /// Stereo pairs.
    pub source: Box<dyn FrameSource>,
    /// Name for reports.
    pub name: String,
}

/// Selects the source among a configuration's devices. The simulated sensor's gripper grasps the part
/// repeatedly.
#[must_use]
pub fn named_source(config: &Config, devices: Devices) -> NamedSource {
    match &config.source {
        SourceConfig::Simulated => NamedSource {
            source: Box::new(Rehearsal::new(devices.source, devices.gripper, config)),
            name: "the simulated sensor".to_owned(),
        },
        SourceConfig::Folder { path, .. } => {
            NamedSource { source: devices.source, name: format!("the folder {}", path.display()) }
        }
        SourceConfig::Camera(camera) => {
            let right = camera.right_device.iter().map(|right| format!(" and {right}"));
            let name = format!("camera {}{}", camera.device, right.collect::<String>());
            NamedSource { source: devices.source, name }
        }
        SourceConfig::Stream(stream) => NamedSource { source: devices.source, name: stream.name() },
    }
}

/// The path itself, or, if that file exists, the first free of `name-2.mcap`, `name-3.mcap` and so on. A
/// restarted host thus keeps its earlier recordings.
#[must_use]
pub fn recording_path(path: &Path) -> PathBuf {
    if !path.is_file() {
        return path.to_owned();
    }
    let part = |text: Option<&std::ffi::OsStr>| text.unwrap_or_default().to_string_lossy().into_owned();
    let (stem, extension) = (part(path.file_stem()), part(path.extension()));
    (2_u64..)
        .map(|n| path.with_file_name(format!("{stem}-{n}")).with_extension(&extension))
        .find(|path| !path.exists())
        .unwrap_or_else(|| path.to_owned())
}

/// Opens all outputs.
///
/// # Errors
/// [`SenseError`].
pub fn open_outputs(
    config: &Config,
    listeners: &Listeners,
    attachments: Vec<(String, Vec<u8>)>,
) -> Result<Outputs, SenseError> {
    let mut outputs = Outputs::default();
    for &protocol in &listeners.protocols {
        let publisher = Publisher::open(protocol, config).map_err(SenseError::Publish)?;
        outputs.publishers.push(publisher);
    }
    if let Some(path) = &listeners.recording {
        let settings =
            crate::config::RecordingConfig { path: recording_path(path), ..config.recording.clone() };
        let content = Content { config_toml: recorded_config(config)?, attachments };
        outputs.recording = Some(Recording::create(&settings, content, log_clock(&config.source))?);
    }
    if listeners.lines {
        let outlet = Outlet::spawn("standard output", |line: String| {
            writeln!(std::io::stdout().lock(), "{line}").map_err(|error| error.to_string())
        });
        outputs.lines = Some(Lines {
            outlet: outlet.map_err(SenseError::Thread)?,
            with_points: listeners.points,
            may_drop: config.source.is_live(),
        });
    }
    Ok(outputs)
}

//! Why a configuration cannot be used.

use super::reference::Unknown;
use crate::camera::CaptureError;
use gelstereo_core::frames::MountError;
use gelstereo_core::params::{Params, ParamsError};
use gelstereo_core::rig::RigError;
use gelstereo_sim::SceneError;
use std::path::PathBuf;

/// Why a configuration cannot be used.
#[derive(Debug)]
pub enum ConfigError {
    /// A file cannot be read.
    Read {
        /// Which.
        path: PathBuf,
        /// The system's answer.
        error: std::io::Error,
    },
    /// The text is no such configuration.
    Parse {
        /// Where it came from.
        origin: String,
        /// What is wrong, with the line.
        error: toml::de::Error,
    },
    /// A key or word does not exist.
    Unknown {
        /// Where it came from.
        origin: String,
        /// Which, and what was probably meant.
        unknown: Box<Unknown>,
    },
    /// There is no such preset.
    Preset {
        /// What was found.
        found: String,
    },
    /// A setting of the pipeline is not valid.
    Params(ParamsError),
    /// A setting of the host is not valid.
    Value {
        /// Where it stands.
        name: &'static str,
        /// What was found.
        found: f64,
        /// What would be valid.
        valid: &'static str,
    },
    /// A number of a pose is not valid.
    PoseValue {
        /// The pose, for example `task.part_pose`.
        pose: &'static str,
        /// Its key.
        key: &'static str,
        /// What was found.
        found: f64,
        /// What would be valid.
        valid: &'static str,
    },
    /// A stage of the task would take longer than it may.
    TooSlow {
        /// Setting that determines the time.
        name: &'static str,
        /// Time that the stage takes.
        planned_s: f64,
        /// Time that it may take.
        limit_s: f64,
    },
    /// Two settings contradict each other.
    Contradiction {
        /// One of them, for example `params.lattice.pitch_mm`.
        name: &'static str,
        /// What was found, as text with its unit.
        found: String,
        /// The other one and its value.
        other: String,
        /// What to do.
        advice: &'static str,
    },
    /// The mount is not valid.
    Mount(MountError),
    /// The part or the simulated sensor is not valid.
    Scene {
        /// Table of the configuration, `part.shape` or `simulated`.
        table: &'static str,
        /// What is wrong.
        error: SceneError,
    },
    /// A path names no file.
    NoFile {
        /// Where it stands.
        name: &'static str,
        /// What was found.
        found: PathBuf,
        /// What to do.
        advice: &'static str,
    },
    /// A setting of the camera is not valid.
    Camera(CaptureError),
    /// There is no rig, or there are two.
    RigSource {
        /// What to do.
        message: &'static str,
    },
    /// The rig is not valid.
    Rig(RigError),
    /// The configuration cannot be written as TOML.
    Write(toml::ser::Error),
}

impl std::fmt::Display for ConfigError {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Read { path, error } => write!(f, "cannot read {}: {error}", path.display()),
            Self::Parse { origin, error } => write!(f, "{origin}: {}", error.to_string().trim_end()),
            Self::Unknown { origin, unknown } => write!(f, "{origin}, {unknown}"),
            Self::Preset { found } => {
                write!(f, "preset is \"{found}\"; valid is one of {:?}", Params::PRESETS)
            }
            Self::Params(error) => write!(f, "params.{error}"),
            Self::Value { name, found, valid } => write!(f, "{name} is {found}; valid is {valid}"),
            Self::PoseValue { pose, key, found, valid } => {
                write!(f, "{pose}.{key} is {found}; valid is {valid}")
            }
            Self::TooSlow { name, planned_s, limit_s } => write!(
                f,
                "{name} is too slow: the way takes {planned_s:.1} s, but task.stage_timeout_s is {limit_s} \
                 s; raise one of them"
            ),
            Self::Contradiction { name, found, other, advice } => {
                write!(f, "{name} is {found}, but {other}; {advice}")
            }
            Self::Mount(error) => write!(f, "mount.{error}"),
            Self::Scene { table, error } => f.write_str(&scene_text(table, error)),
            Self::NoFile { name, found, advice } => {
                write!(f, "{name} is \"{}\", which names no file; {advice}", found.display())
            }
            Self::Camera(error) => write!(f, "source.{error}"),
            Self::RigSource { message } => f.write_str(message),
            Self::Rig(error) => write!(f, "rig: {error}"),
            Self::Write(error) => write!(f, "the configuration cannot be written as TOML: {error}"),
        }
    }
}

impl ConfigError {
    /// A fault of a pose's key, from that of the pose.
    pub(super) fn within(self, key: &'static str) -> Self {
        match self {
            Self::Value { name: pose, found, valid } => Self::PoseValue { pose, key, found, valid },
            other => other,
        }
    }
}

/// The scene's error with the names that the configuration has: a scene's indenter is the part.
fn scene_text(table: &str, error: &SceneError) -> String {
    let text = error.to_string();
    match (error, text.strip_prefix("indenter.")) {
        (_, Some(rest)) => format!("{table}.{rest}"),
        (SceneError::Invalid { .. }, None) => format!("{table}.{text}"),
        _ => format!("{table}: {text}"),
    }
}

impl std::error::Error for ConfigError {}

//! Why a configuration cannot be used.

use crate::camera::CaptureError;
use gelstereo_core::params::{Params, ParamsError};
use gelstereo_core::rig::RigError;
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
    /// There is no such preset.
    Preset {
        /// What was found.
        found: String,
    },
    /// A setting of the pipeline makes no sense.
    Params(ParamsError),
    /// A setting of the host makes no sense.
    Value {
        /// Where it stands.
        name: &'static str,
        /// What was found.
        found: f64,
        /// What would be valid.
        valid: &'static str,
    },
    /// A setting of the camera makes no sense.
    Camera(CaptureError),
    /// There is no rig, or there are two.
    RigSource {
        /// What to do.
        message: &'static str,
    },
    /// The rig makes no sense.
    Rig(RigError),
    /// The configuration cannot be written as TOML.
    Write(toml::ser::Error),
}

impl std::fmt::Display for ConfigError {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Read { path, error } => write!(f, "cannot read {}: {error}", path.display()),
            Self::Parse { origin, error } => write!(f, "{origin}: {}", error.to_string().trim_end()),
            Self::Preset { found } => {
                write!(f, "preset is \"{found}\"; valid is one of {:?}", Params::PRESETS)
            }
            Self::Params(error) => write!(f, "params.{error}"),
            Self::Value { name, found, valid } => write!(f, "{name} is {found}; valid is {valid}"),
            Self::Camera(error) => write!(f, "source.{error}"),
            Self::RigSource { message } => f.write_str(message),
            Self::Rig(error) => write!(f, "rig: {error}"),
            Self::Write(error) => write!(f, "the configuration cannot be written as TOML: {error}"),
        }
    }
}

impl std::error::Error for ConfigError {}

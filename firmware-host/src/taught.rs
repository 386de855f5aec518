//! A taught goal: the gripper's pose with the part at its goal, and the part's localized pose there
//! (section V-A).
//!
//! Errors common to all localizations (the sensor's mount, the robot's base, the template's origin)
//! affect the taught pose and the pose of the next part equally. They cancel when one is brought onto the
//! other.

use crate::sensing::SensingError;
use gelstereo_core::math::Pose;
use gelstereo_core::pipeline::RestRecord;
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};

/// Version of the file.
pub const VERSION: u32 = 1;

/// File written by `gelstereo-host teach`, as JSON.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Taught {
    /// [`VERSION`].
    pub version: u32,
    /// Gripper in the base frame, with the part at its goal between the fingers.
    pub t_base_gripper: Pose,
    /// Localized pose of the part in the gripper frame.
    pub t_gripper_object: Pose,
    /// Opening width at the same time.
    pub width_mm: f64,
    /// Standard deviations of x y z, millimetres, then rotations, radians (sensor frame).
    pub sigma: [f64; 6],
    /// The sensor at rest, with its rig and settings.
    pub rest: RestRecord,
}

/// Reason why a taught goal cannot be used.
#[derive(Debug)]
pub enum TaughtError {
    /// The file cannot be read or written.
    Io {
        /// Path of the file.
        path: PathBuf,
        /// The operation: `read` or `write`.
        doing: &'static str,
        /// The system's error.
        error: std::io::Error,
    },
    /// The file is not a taught goal.
    Parse {
        /// Path of the file.
        path: PathBuf,
        /// The parse error, with the line.
        error: serde_json::Error,
    },
    /// Path of the file.
    Settings {
        /// The difference.
        path: PathBuf,
        /// What differs.
        error: SensingError,
    },
    /// The file has another version.
    Version {
        /// Path of the file.
        path: PathBuf,
        /// Version of the file.
        found: u32,
    },
}

impl std::fmt::Display for TaughtError {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Io { path, doing, error } => {
                write!(f, "cannot {doing} the taught goal {}: {error}", path.display())
            }
            Self::Parse { path, error } => {
                write!(
                    f,
                    "{} is not a taught goal: {error}; make one with `gelstereo-host teach`",
                    path.display()
                )
            }
            Self::Settings { path, error } => write!(
                f,
                "the taught goal {} does not fit this configuration: {error}; teach the goal again, or \
                 restore what it was taught with",
                path.display()
            ),
            Self::Version { path, found } => write!(
                f,
                "{} is a taught goal of version {found}; valid is {VERSION}: teach the goal again",
                path.display()
            ),
        }
    }
}

impl std::error::Error for TaughtError {}

impl Taught {
    /// The part's goal (`t_base_object`), including the errors of the localization.
    #[must_use]
    pub fn goal(&self) -> Pose {
        self.t_base_gripper * self.t_gripper_object
    }

    /// Reads a file.
    ///
    /// # Errors
    /// [`TaughtError`].
    pub fn load(path: &Path) -> Result<Self, TaughtError> {
        let fail = |error| TaughtError::Parse { path: path.to_owned(), error };
        let text = std::fs::read_to_string(path).map_err(|error| TaughtError::Io {
            path: path.to_owned(),
            doing: "read",
            error,
        })?;
        let value: serde_json::Value = serde_json::from_str(&text).map_err(fail)?;
        // The version is checked first: later versions may have other keys.
        match value.get("version").and_then(serde_json::Value::as_u64) {
            Some(found) if found != u64::from(VERSION) => {
                Err(TaughtError::Version { path: path.to_owned(), found: found as u32 })
            }
            _ => serde_json::from_value(value).map_err(fail),
        }
    }

    /// Writes a file; an existing one is replaced atomically.
    ///
    /// # Errors
    /// [`TaughtError::Io`] or [`TaughtError::Parse`].
    pub fn save(&self, path: &Path) -> Result<(), TaughtError> {
        let fail = |error| TaughtError::Io { path: path.to_owned(), doing: "write", error };
        let text = serde_json::to_string_pretty(self)
            .map_err(|error| TaughtError::Parse { path: path.to_owned(), error })?;
        let part = path.with_extension("json.part");
        std::fs::write(&part, text).map_err(fail)?;
        std::fs::rename(&part, path).map_err(fail)
    }
}

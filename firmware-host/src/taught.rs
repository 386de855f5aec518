//! A taught goal: where the gripper held the part in its goal, and how the part was localized there (section V-A).
//!
//! Errors that are the same whenever a part is localized (the sensor's mount, the robot's base, the template's origin) are
//! in the taught pose as they are in that of the next part, so that they cancel when the one is brought onto the other.

use crate::sensing::SensingError;
use gelstereo_core::math::Pose;
use gelstereo_core::pipeline::RestRecord;
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};

/// Version of the file.
pub const VERSION: u32 = 1;

/// What `gelstereo-host teach` writes, as JSON.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Taught {
    /// [`VERSION`].
    pub version: u32,
    /// Gripper in the base frame, with the part in its goal between the fingers.
    pub t_base_gripper: Pose,
    /// Part in the gripper frame, as it was localized there.
    pub t_gripper_object: Pose,
    /// Opening width then.
    pub width_mm: f64,
    /// Standard deviations of x y z, millimetres, then rotations, radians (sensor frame).
    pub sigma: [f64; 6],
    /// The sensor at rest, with its rig and settings.
    pub rest: RestRecord,
}

/// Why a taught goal cannot be used.
#[derive(Debug)]
pub enum TaughtError {
    /// The file cannot be read or written.
    Io {
        /// Which.
        path: PathBuf,
        /// What was tried: `read` or `write`.
        doing: &'static str,
        /// The system's answer.
        error: std::io::Error,
    },
    /// The file holds no taught goal.
    Parse {
        /// Which.
        path: PathBuf,
        /// What is wrong, with the line.
        error: serde_json::Error,
    },
    /// The goal was taught with another rig or other settings, whose errors are others.
    Settings {
        /// Which file.
        path: PathBuf,
        /// What differs.
        error: SensingError,
    },
    /// The file is of another version.
    Version {
        /// Which.
        path: PathBuf,
        /// What it says.
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
                    "{} is no taught goal: {error}; make one with `gelstereo-host teach`",
                    path.display()
                )
            }
            Self::Settings { path, error } => write!(
                f,
                "the taught goal {} does not fit this configuration: {error}; teach the goal again, or restore what it \
                 was taught with",
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
    /// The goal of the part (`t_base_object`), with the errors of the localization in it.
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
        // The version comes first: a later one may have other keys.
        match value.get("version").and_then(serde_json::Value::as_u64) {
            Some(found) if found != u64::from(VERSION) => {
                Err(TaughtError::Version { path: path.to_owned(), found: found as u32 })
            }
            _ => serde_json::from_value(value).map_err(fail),
        }
    }

    /// Writes a file; an older one is replaced as a whole.
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

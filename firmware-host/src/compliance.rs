//! The gel's compliance matrix, from its file or from a recording.

use crate::config::Config;
use crate::recording::ATTACHMENT_COMPLIANCE;
use gelstereo_core::force::{Compliance, ComplianceError};
use std::path::PathBuf;

/// Reason why a compliance matrix cannot be loaded.
#[derive(Debug)]
pub enum ComplianceFileError {
    /// The file cannot be read.
    Read {
        /// Path of the file.
        path: PathBuf,
        /// Error of the system.
        error: std::io::Error,
    },
    /// The file is no intact matrix.
    Content {
        /// Path of the file.
        path: PathBuf,
        /// What is wrong.
        error: ComplianceError,
    },
    /// The recording was made with a matrix, and lacks it.
    NotRecorded,
}

impl std::fmt::Display for ComplianceFileError {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Read { path, error } => {
                write!(f, "compliance_file: cannot read {}: {error}", path.display())
            }
            Self::Content { path, error } => write!(f, "compliance_file: {}: {error}", path.display()),
            Self::NotRecorded => write!(
                f,
                "the recording was made with a compliance matrix, but has no attachment \
                 {ATTACHMENT_COMPLIANCE}; give one that gelstereo-host wrote"
            ),
        }
    }
}

impl std::error::Error for ComplianceFileError {}

/// Reads the matrix of a configuration; `None` if it names none.
///
/// # Errors
/// [`ComplianceFileError::Read`] or [`ComplianceFileError::Content`].
pub fn load(config: &Config) -> Result<Option<Compliance>, ComplianceFileError> {
    let Some(path) = &config.compliance_file else { return Ok(None) };
    let bytes =
        std::fs::read(path).map_err(|error| ComplianceFileError::Read { path: path.clone(), error })?;
    parse(path.clone(), &bytes)
}

/// The matrix of a recording with this configuration, from its attachment.
///
/// # Errors
/// [`ComplianceFileError::NotRecorded`] or [`ComplianceFileError::Content`].
pub fn attached(config: &Config, bytes: Option<Vec<u8>>) -> Result<Option<Compliance>, ComplianceFileError> {
    match (&config.compliance_file, bytes) {
        (None, _) => Ok(None),
        (Some(_), None) => Err(ComplianceFileError::NotRecorded),
        (Some(path), Some(bytes)) => parse(path.clone(), &bytes),
    }
}

fn parse(path: PathBuf, bytes: &[u8]) -> Result<Option<Compliance>, ComplianceFileError> {
    Compliance::from_bytes(bytes).map(Some).map_err(|error| ComplianceFileError::Content { path, error })
}

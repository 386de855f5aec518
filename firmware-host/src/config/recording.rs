//! Where the recording goes, and what of the frames it keeps.

use super::ConfigError;
use serde::{Deserialize, Serialize};
use std::path::PathBuf;

/// Where the recording goes.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct RecordingConfig {
    /// MCAP file; it is replaced. A relative path starts at the working folder, and missing folders are made.
    /// Default: `out/run.mcap`. Change it for every run that is to be kept.
    pub path: PathBuf,
}

impl Default for RecordingConfig {
    fn default() -> Self {
        Self { path: PathBuf::from("out/run.mcap") }
    }
}

impl RecordingConfig {
    pub(super) fn validate(&self) -> Result<(), ConfigError> {
        if self.path.file_name().is_none() {
            let advice = "name a file, for example \"out/run.mcap\"";
            return Err(ConfigError::NoPath { name: "recording.path", advice });
        }
        Ok(())
    }
}

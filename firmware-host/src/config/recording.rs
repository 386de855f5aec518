//! Where the recording goes, and what of the frames it keeps.

use serde::{Deserialize, Serialize};
use std::path::PathBuf;

/// Where the recording goes.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct RecordingConfig {
    /// MCAP file; it is replaced. Default: `out/run.mcap`.
    pub path: PathBuf,
}

impl Default for RecordingConfig {
    fn default() -> Self {
        Self { path: PathBuf::from("out/run.mcap") }
    }
}

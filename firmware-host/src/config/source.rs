//! Where stereo pairs come from.

use super::ConfigError;
use super::range::RATE_HZ;
use crate::camera::CameraConfig;
use serde::{Deserialize, Serialize};
use std::path::PathBuf;

/// Where stereo pairs come from.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", tag = "kind", deny_unknown_fields)]
pub enum SourceConfig {
    /// The simulated sensor.
    #[default]
    Simulated,
    /// Image pairs in a folder.
    Folder {
        /// The folder, with images such as `left_1.png` and `right_1.png` in natural order of their names. A
        /// relative path starts at the configuration's folder. Set it to your images.
        path: PathBuf,
        /// Rate at which they were taken. Valid: 0.1 to 1000 Hz. Set it to the camera's.
        frame_rate_hz: f64,
    },
    /// A stereo camera by Video4Linux2: one device with both views, or two devices.
    Camera(CameraConfig),
}

impl SourceConfig {
    pub(super) fn validate(&self) -> Result<(), ConfigError> {
        match self {
            Self::Simulated => Ok(()),
            Self::Folder { frame_rate_hz, .. } => RATE_HZ.check("source.frame_rate_hz", *frame_rate_hz),
            Self::Camera(camera) => camera.validate().map_err(ConfigError::Camera),
        }
    }
}

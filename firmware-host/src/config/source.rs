//! Where stereo pairs come from.

use super::range::{RATE_HZ, check};
use super::{ConfigError, TaskConfig};
use crate::camera::CameraConfig;
use crate::codec::frame_stream::{MAX_PAYLOAD_BYTES, MAX_SIDE_PX};
use crate::source::FrameMode;
use crate::source::stream::StreamConfig;
use gelstereo_core::rig::Rig;
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
        /// Rate at which the images were taken. Valid: 0.1 to 1000 Hz. Set it to the camera's.
        frame_rate_hz: f64,
    },
    /// A stereo camera by Video4Linux2: one device with both views, or two devices.
    Camera(CameraConfig),
    /// Frames through a pipe, in the format of `docs/frame-stream.md`.
    Stream(StreamConfig),
}

/// Minimum number of camera periods to wait for a pair, because single frames are sometimes lost.
const MIN_WAIT_PERIODS: f64 = 2.0;

impl SourceConfig {
    /// Checks that a camera's images have the rig's size, and arrive within the task's time limit.
    pub(super) fn validate_against(&self, rig: &Rig, task: &TaskConfig) -> Result<(), ConfigError> {
        let Self::Camera(camera) = self else { return Ok(()) };
        let (width, height) = camera.view_size_px();
        for view in [&rig.left, &rig.right] {
            if (width, height) != (view.width_px, view.height_px) {
                return Err(ConfigError::Contradiction {
                    name: "source.size_px",
                    found: format!("{:?}, which gives views of {width} x {height} px", camera.size_px),
                    other: format!("the rig is of {} x {} px", view.width_px, view.height_px),
                    advice: "calibrate at this size, or take images at the rig's",
                });
            }
        }
        if task.frame_timeout_s < MIN_WAIT_PERIODS / camera.frame_rate_hz {
            return Err(ConfigError::Contradiction {
                name: "task.frame_timeout_s",
                found: format!("{} s", task.frame_timeout_s),
                other: format!("source.frame_rate_hz is {} Hz", camera.frame_rate_hz),
                advice: "wait for at least two periods",
            });
        }
        Ok(())
    }

    /// Checks that moves are slow enough that a working camera is never taken for silent.
    pub(super) fn validate_blind_travel(&self, task: &TaskConfig) -> Result<(), ConfigError> {
        let Self::Camera(camera) = self else { return Ok(()) };
        let felt = ("task.max_blind_travel_mm", task.max_blind_travel_mm);
        let free = ("task.max_blind_free_travel_mm", task.max_blind_free_travel_mm);
        let speeds = [
            (felt, "task.closing_speed_mm_s", task.closing_speed_mm_s),
            (felt, "task.insertion_speed_mm_s", task.insertion_speed_mm_s),
            (free, "task.opening_speed_mm_s", task.opening_speed_mm_s),
            (free, "task.move_speed_mm_s", task.move_speed_mm_s),
        ];
        let touches = task.edges.iter().map(|edge| (felt, "task.edges.speed_mm_s", edge.speed_mm_s));
        for ((name, travel_mm), speed, speed_mm_s) in speeds.into_iter().chain(touches) {
            let waits_s = travel_mm / speed_mm_s;
            if waits_s < MIN_WAIT_PERIODS / camera.frame_rate_hz {
                return Err(ConfigError::Contradiction {
                    name,
                    found: format!("{travel_mm} mm, {:.0} ms at {speed_mm_s} mm/s", waits_s * 1e3),
                    other: format!("{speed} allows no two periods of {} Hz within it", camera.frame_rate_hz),
                    advice: "lower the speed, or raise the travel",
                });
            }
        }
        Ok(())
    }

    pub(super) fn validate(&self) -> Result<(), ConfigError> {
        match self {
            Self::Simulated => Ok(()),
            Self::Folder { frame_rate_hz, .. } => RATE_HZ.check("source.frame_rate_hz", *frame_rate_hz),
            Self::Camera(camera) => camera.validate().map_err(ConfigError::Camera),
            Self::Stream(stream) => validate_stream(stream),
        }
    }

    /// Nominal frame rate. A stream without a rate, and the simulated sensor, have that of the simulated
    /// world.
    #[must_use]
    pub fn frame_rate_hz(&self, simulated_hz: f64) -> f64 {
        match self {
            Self::Simulated => simulated_hz,
            Self::Folder { frame_rate_hz, .. } => *frame_rate_hz,
            Self::Camera(camera) => camera.frame_rate_hz,
            Self::Stream(stream) => stream.frame_rate_hz.unwrap_or(simulated_hz),
        }
    }

    /// Whether frames arrive in real time, and are lost if they are not fetched.
    #[must_use]
    pub fn is_live(&self) -> bool {
        match self {
            Self::Simulated | Self::Folder { .. } => false,
            Self::Camera(_) => true,
            Self::Stream(stream) => stream.mode == FrameMode::Latest,
        }
    }
}

fn validate_stream(stream: &StreamConfig) -> Result<(), ConfigError> {
    if let Some(rate_hz) = stream.frame_rate_hz {
        RATE_HZ.check("source.frame_rate_hz", rate_hz)?;
    }
    if let Some(size) = stream.raw_size_px {
        let words = "an even width and 1 to 16384 pixels each";
        for side in size {
            check((1..=MAX_SIDE_PX).contains(&side), "source.raw_size_px", f64::from(side), words)?;
        }
        check(size[0] % 2 == 0, "source.raw_size_px", f64::from(size[0]), words)?;
        let bytes = size[0] * size[1];
        check(bytes <= MAX_PAYLOAD_BYTES, "source.raw_size_px", f64::from(bytes), "at most 67108864 pixels")?;
    }
    let timeout_ms = stream.stall_timeout_ms;
    check(
        (10..=3_600_000).contains(&timeout_ms),
        "source.stall_timeout_ms",
        timeout_ms as f64,
        "10 to 3600000 ms",
    )
}

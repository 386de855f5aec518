//! Camera configuration.

use super::{CaptureError, ControlSettings, PixelFormat};
use crate::source::{FrameMode, StereoLayout};
use serde::{Deserialize, Serialize};
use std::time::Duration;

/// A stereo camera: one device that holds both views, or two devices.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct CameraConfig {
    /// `serial:` and the USB serial number, or a path such as `/dev/video0` or `/dev/v4l/by-id/..`.
    /// `gelstereo-host doctor` lists what is connected. Set it always: there is no default.
    pub device: String,
    /// The right camera, named in the same way. Default: one stereo device. Set it if each view has its own
    /// device.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub right_device: Option<String>,
    /// Arrangement of both views in the frames of one stereo device. Not used with two devices. Default:
    /// `side_by_side`. Change it to your camera's; with swapped views the rig does not fit.
    pub layout: StereoLayout,
    /// Pixel format of the device. On USB 2 only `mjpg` reaches the full frame rate. Default: `mjpg`. Change
    /// it to what your camera offers.
    pub format: PixelFormat,
    /// Width and height of the device's frames as reported by the driver; side by side, this includes both
    /// views. Valid: 1 to 8192 pixels. Default: `[1280, 480]` pixels. Change it to a size that your camera
    /// offers and that the rig was calibrated at.
    pub size_px: [u32; 2],
    /// Frame rate. Valid: 0.1 to 1000 Hz. Default: `30` Hz. Change it to a rate that your camera offers at
    /// this size.
    pub frame_rate_hz: f64,
    /// Frames that are passed on. Default: `latest`. Change it to `every` where no frame may be skipped.
    pub mode: FrameMode,
    /// Largest time difference between the images of two devices that form a pair; at most half a frame
    /// period. Valid: 0.001 to 5000 ms. Default: `5` ms. Raise it for devices without a common trigger; the
    /// views of moving markers then differ.
    pub max_skew_ms: f64,
    /// Number of buffers that the driver fills ahead. More buffers bridge longer interruptions. Valid: 2 to
    /// 32 frames.
    /// Default: `4`. Raise it on a busy computer.
    pub buffers: u32,
    /// Number of frames per device queued for the reader. Valid: 1 to 256 frames. Default: `8`. Raise it with
    /// the mode `every`.
    pub queue_frames: u32,
    /// Time without data after which a device is restarted; at least two frame periods. Valid: 10 to 3600000
    /// ms. Default: `2000` ms. Raise it for cameras that pause, as triggered ones do.
    pub stall_timeout_ms: u64,
    /// First pause before reopening a lost device; each failure doubles it. Valid: 10 to 3600000 ms.
    /// Default: `100` ms. Raise it for devices that need time to start.
    pub min_retry_ms: u64,
    /// Longest such pause. Valid: 10 to 3600000 ms. Default: `5000` ms. Lower it where a camera must be
    /// available again soon.
    pub max_retry_ms: u64,
    /// Whether the camera's JPEG data is also passed on, for a recorder. Default: `true`. Set it to false to
    /// save memory where nothing is recorded.
    pub keep_encoded: bool,
    /// Exposure, gain, white balance and others. Default: the camera's own.
    pub controls: ControlSettings,
}

impl Default for CameraConfig {
    fn default() -> Self {
        Self {
            device: String::new(),
            right_device: None,
            layout: StereoLayout::default(),
            format: PixelFormat::default(),
            size_px: [1280, 480],
            frame_rate_hz: 30.0,
            mode: FrameMode::default(),
            max_skew_ms: 5.0,
            buffers: 4,
            queue_frames: 8,
            stall_timeout_ms: 2000,
            min_retry_ms: 100,
            max_retry_ms: 5000,
            keep_encoded: true,
            controls: ControlSettings::default(),
        }
    }
}

impl CameraConfig {
    /// Arrangement of the two views in a frame; `None` if each has its own device.
    #[must_use]
    pub fn joint_layout(&self) -> Option<StereoLayout> {
        self.right_device.is_none().then_some(self.layout)
    }

    /// Width and height of one view, pixels.
    #[must_use]
    pub fn view_size_px(&self) -> (usize, usize) {
        let [width, height] = self.size_px.map(|side| side as usize);
        self.format.view_size(self.joint_layout(), width, height)
    }

    pub(crate) fn max_skew_ns(&self) -> u64 {
        (self.max_skew_ms * 1e6) as u64
    }

    pub(crate) fn stall_timeout(&self) -> Duration {
        Duration::from_millis(self.stall_timeout_ms)
    }

    /// Checks every setting by itself. Opening the camera checks whether the camera supports it.
    ///
    /// # Errors
    /// [`CaptureError::Setting`].
    pub fn validate(&self) -> Result<(), CaptureError> {
        super::list::check_name("device", &self.device)?;
        if let Some(right) = &self.right_device {
            super::list::check_name("right_device", right)?;
            if *right == self.device {
                return Err(setting("right_device", right, "another device than `device`, or nothing"));
            }
        }
        let [width, height] = self.size_px;
        let sides = 1..=8192;
        if !sides.contains(&width) || !sides.contains(&height) {
            return Err(setting("size_px", format!("[{width}, {height}]"), "1 to 8192 pixels each"));
        }
        let conflict = match self.joint_layout() {
            Some(layout) => self.format.conflict(layout, width as usize),
            None if self.format == PixelFormat::Y16 => {
                Some("format y16 is two views in one device; two devices need mjpg, yuyv or grey")
            }
            None => None,
        };
        if let Some(valid) = conflict {
            let found = format!("{} with layout {:?} and width {width}", self.format, self.layout);
            return Err(setting("format", found, valid));
        }
        let rate_hz = self.frame_rate_hz;
        within("frame_rate_hz", rate_hz, (0.1, 1000.0), "0.1 to 1000 Hz")?;
        within("max_skew_ms", self.max_skew_ms, (0.001, 5000.0), "0.001 to 5000 ms")?;
        let half_period_ms = 500.0 / rate_hz;
        if self.right_device.is_some() && self.max_skew_ms > half_period_ms {
            let valid = "at most half a frame's period (500 / frame_rate_hz)";
            return Err(setting("max_skew_ms", self.max_skew_ms, valid));
        }
        within("buffers", f64::from(self.buffers), (2.0, 32.0), "2 to 32 frames")?;
        within("queue_frames", f64::from(self.queue_frames), (1.0, 256.0), "1 to 256 frames")?;
        within("stall_timeout_ms", self.stall_timeout_ms as f64, (10.0, 3.6e6), "10 to 3600000 ms")?;
        if (self.stall_timeout_ms as f64) < 2000.0 / rate_hz {
            let valid = "at least two frames' periods (2000 / frame_rate_hz)";
            return Err(setting("stall_timeout_ms", self.stall_timeout_ms, valid));
        }
        within("min_retry_ms", self.min_retry_ms as f64, (10.0, 3.6e6), "10 to 3600000 ms")?;
        within("max_retry_ms", self.max_retry_ms as f64, (10.0, 3.6e6), "10 to 3600000 ms")?;
        if self.max_retry_ms < self.min_retry_ms {
            return Err(setting("max_retry_ms", self.max_retry_ms, "at least min_retry_ms"));
        }
        self.controls.validate()
    }
}

fn within(name: &'static str, found: f64, (low, high): (f64, f64), valid: &str) -> Result<(), CaptureError> {
    if found >= low && found <= high { Ok(()) } else { Err(setting(name, found, valid)) }
}

pub(super) fn setting(name: &'static str, found: impl ToString, valid: &str) -> CaptureError {
    CaptureError::Setting { name, found: found.to_string(), valid: valid.to_owned() }
}

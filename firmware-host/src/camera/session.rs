//! One connection to a device, from opening to its first fault.

use super::abi;
use super::control_calls;
use super::device::Device;
use super::list::{find, find_again};
use super::ring::{Dequeued, Ring};
use super::{CameraConfig, CameraInfo, CaptureError, Control, ControlSettings, FrameShape};
use std::os::fd::{AsFd, BorrowedFd};
use std::time::Duration;

/// Device to open and its settings.
#[derive(Clone, Debug)]
pub(super) struct Wanted {
    /// Device name in the configuration.
    pub device: String,
    /// Format, size, rate and buffers.
    pub config: CameraConfig,
    /// Controls, including changes made since the start.
    pub controls: ControlSettings,
    /// The camera that was opened first; no other camera may replace it.
    pub before: Option<CameraInfo>,
}

/// A streaming device.
#[derive(Debug)]
pub(super) struct Session {
    ring: Ring,
    /// Description of the camera.
    pub info: CameraInfo,
    /// Shape of its frames.
    pub shape: FrameShape,
}

/// Result of waiting for a frame.
#[derive(Debug)]
pub(super) enum Wait {
    /// A frame is ready.
    Frame,
    /// The thread has commands to process.
    Woken,
    /// Timeout.
    Nothing,
}

impl Session {
    /// Finds the device, sets format, rate and controls, and starts the stream.
    pub fn open(wanted: &Wanted) -> Result<Self, CaptureError> {
        let info = match &wanted.before {
            None => find(&wanted.device)?,
            Some(before) => find_again(&wanted.device, before)?,
        };
        let device = Device::open(&info.path, &info.to_string())?;
        let shape = device.set_format(&wanted.config)?;
        device.set_rate(&wanted.config)?;
        control_calls::apply(&device, &wanted.controls)?;
        let ring = Ring::start(device, wanted.config.buffers)?;
        Ok(Self { ring, info, shape })
    }

    /// Waits for a frame or for `wake`.
    ///
    /// `poll` keeps returning at once for a faulty device. A fault without an error of the queue is
    /// therefore also returned as an error.
    pub fn wait(&mut self, wake: BorrowedFd<'_>, timeout: Duration) -> Result<Wait, CaptureError> {
        let device = self.ring.device();
        let ready =
            abi::poll(Some(device.as_fd()), wake, timeout).map_err(|error| device.failed("poll", error))?;
        if ready.woken {
            return Ok(Wait::Woken);
        }
        if let Some(name) = ready.fault {
            // The error of the queue is more specific.
            return match self.ring.dequeue(&mut Vec::new()) {
                Err(error) => Err(error),
                Ok(_) => Err(self.ring.device().failed("poll", std::io::Error::other(name))),
            };
        }
        Ok(if ready.frame { Wait::Frame } else { Wait::Nothing })
    }

    /// Copies the oldest frame, if any.
    pub fn fetch(&mut self, bytes: &mut Vec<u8>) -> Result<Option<Dequeued>, CaptureError> {
        self.ring.dequeue(bytes)
    }

    /// All controls with their values.
    pub fn controls(&self) -> Vec<Control> {
        control_calls::controls(self.ring.device())
    }

    /// Sets controls.
    pub fn apply(&self, settings: &ControlSettings) -> Result<(), CaptureError> {
        control_calls::apply(self.ring.device(), settings)
    }
}

//! Replaces the device thread on systems without Video4Linux2: nothing can be opened.

use super::{CameraConfig, CameraInfo, CaptureError, Control, ControlSettings, Mailbox, Side};
use std::sync::Arc;

#[derive(Debug)]
pub(crate) struct CameraHandle {
    /// Description of the device at opening.
    pub info: CameraInfo,
    never: std::convert::Infallible,
}

impl CameraHandle {
    pub fn open(_: Side, _: &str, _: &CameraConfig, _: &Arc<Mailbox>) -> Result<Self, CaptureError> {
        Err(CaptureError::Unsupported)
    }

    pub fn controls(&self) -> Result<Vec<Control>, CaptureError> {
        match self.never {}
    }

    pub fn set(&self, _: ControlSettings) -> Result<(), CaptureError> {
        match self.never {}
    }
}

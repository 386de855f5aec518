//! Systems without hidraw.

use super::{HidError, HidInfo, HidSelector};
use std::time::Instant;

/// An open HID device; none exists on this system.
#[derive(Debug)]
pub struct HidDevice {
    never: std::convert::Infallible,
}

#[allow(clippy::missing_errors_doc)]
impl HidDevice {
    /// Returns [`HidError::Unsupported`].
    pub fn open(_wanted: &HidSelector) -> Result<Self, HidError> {
        Err(HidError::Unsupported)
    }

    /// Returns [`HidError::Unsupported`].
    pub fn open_info(_info: HidInfo) -> Result<Self, HidError> {
        Err(HidError::Unsupported)
    }

    /// As on Linux.
    #[must_use]
    pub fn info(&self) -> &HidInfo {
        match self.never {}
    }

    /// As on Linux.
    pub fn write(&mut self, _report: &[u8]) -> Result<(), HidError> {
        match self.never {}
    }

    /// As on Linux.
    pub fn read(&mut self, _report: &mut [u8], _deadline: Instant) -> Result<Option<usize>, HidError> {
        match self.never {}
    }

    /// As on Linux.
    pub fn discard_waiting(&mut self) -> Result<(), HidError> {
        match self.never {}
    }

    /// As on Linux.
    pub fn set_feature(&mut self, _report: &[u8]) -> Result<(), HidError> {
        match self.never {}
    }

    /// As on Linux.
    pub fn get_feature(&mut self, _report: &mut [u8]) -> Result<usize, HidError> {
        match self.never {}
    }
}

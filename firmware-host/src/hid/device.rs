//! An open hidraw node: reports with timeouts, and feature reports.

use super::{HidError, HidInfo, HidSelector, report_ioctl, udev_rule};
use std::fs::{File, OpenOptions};
use std::io::{self, Read, Write};
use std::os::unix::fs::OpenOptionsExt;
use std::time::{Duration, Instant};

const READ: &str = "read";

/// An open HID device.
#[derive(Debug)]
pub struct HidDevice {
    info: HidInfo,
    file: File,
}

impl HidDevice {
    /// Opens the one matching device.
    ///
    /// # Errors
    /// [`HidError`].
    pub fn open(wanted: &HidSelector) -> Result<Self, HidError> {
        Self::open_info(wanted.find()?)
    }

    /// Opens a device listed by [`super::list`].
    ///
    /// # Errors
    /// [`HidError::PermissionDenied`] or [`HidError::Io`].
    pub fn open_info(info: HidInfo) -> Result<Self, HidError> {
        let opened =
            OpenOptions::new().read(true).write(true).custom_flags(libc::O_NONBLOCK).open(&info.path);
        match opened {
            Ok(file) => Ok(Self { info, file }),
            Err(error) if error.kind() == io::ErrorKind::PermissionDenied => {
                Err(HidError::PermissionDenied {
                    rule: udev_rule(info.vendor, info.product),
                    path: info.path,
                })
            }
            Err(error) => Err(HidError::Io { action: "open", path: info.path, error }),
        }
    }

    /// Description of the device by the kernel.
    #[must_use]
    pub fn info(&self) -> &HidInfo {
        &self.info
    }

    /// Sends an output report. Its first byte is the report number, 0 if the device does not number its
    /// reports.
    ///
    /// # Errors
    /// [`HidError::Disconnected`] or [`HidError::Io`].
    pub fn write(&mut self, report: &[u8]) -> Result<(), HidError> {
        match self.file.write(report) {
            Ok(sent) if sent == report.len() => Ok(()),
            Ok(sent) => Err(self.failed("write all of a report to", short(sent, report.len()))),
            Err(error) => Err(self.failed("write to", error)),
        }
    }

    /// Waits for an input report and returns its length, or `None` if none comes before the deadline.
    /// Bytes that do not fit the buffer are lost.
    ///
    /// # Errors
    /// [`HidError::Disconnected`] or [`HidError::Io`].
    pub fn read(&mut self, report: &mut [u8], deadline: Instant) -> Result<Option<usize>, HidError> {
        loop {
            let left = deadline.saturating_duration_since(Instant::now());
            if !report_ioctl::wait_readable(&self.file, left)
                .map_err(|error| self.failed("wait for", error))?
            {
                // A signal, or the time limit of one poll, may have ended the wait early.
                if Instant::now() >= deadline {
                    return Ok(None);
                }
                continue;
            }
            match self.file.read(report) {
                Ok(length) => return Ok(Some(length)),
                Err(error) if error.kind() == io::ErrorKind::WouldBlock => {}
                Err(error) => return Err(self.failed(READ, error)),
            }
        }
    }

    /// Discards waiting input reports, so that they are not taken for the answer to a later command.
    ///
    /// # Errors
    /// As [`Self::read`].
    pub fn discard_waiting(&mut self) -> Result<(), HidError> {
        // The kernel queues at most this many reports. The bound keeps a device that sends continuously
        // from blocking the host.
        const KERNEL_QUEUE: usize = 64;
        for _ in 0..KERNEL_QUEUE {
            if self.read(&mut [0; 64], Instant::now())?.is_none() {
                break;
            }
        }
        Ok(())
    }

    /// Sends a feature report; its first byte is the report number.
    ///
    /// # Errors
    /// [`HidError::Disconnected`] or [`HidError::Io`].
    pub fn set_feature(&mut self, report: &[u8]) -> Result<(), HidError> {
        report_ioctl::set_feature(&self.file, report)
            .map_err(|error| self.failed("send a feature report to", error))
    }

    /// Fetches the feature report whose number is in the buffer's first byte, and returns its length.
    ///
    /// # Errors
    /// [`HidError::Disconnected`] or [`HidError::Io`].
    pub fn get_feature(&mut self, report: &mut [u8]) -> Result<usize, HidError> {
        report_ioctl::get_feature(&self.file, report)
            .map_err(|error| self.failed("fetch a feature report from", error))
    }

    fn failed(&self, action: &'static str, error: io::Error) -> HidError {
        let path = self.info.path.clone();
        match error.raw_os_error() {
            Some(libc::ENODEV | libc::ESHUTDOWN) => HidError::Disconnected { path },
            // hidraw's read returns this error only for an unplugged device. The node disappears
            // slightly later.
            Some(libc::EIO) if action == READ => HidError::Disconnected { path },
            _ => HidError::Io { action, path, error },
        }
    }
}

fn short(sent: usize, length: usize) -> io::Error {
    io::Error::new(io::ErrorKind::WriteZero, format!("{sent} of {length} bytes were taken"))
}

/// Longest wait of one poll; the caller's deadline is checked again afterwards.
pub(super) const MAX_POLL: Duration = Duration::from_secs(60);

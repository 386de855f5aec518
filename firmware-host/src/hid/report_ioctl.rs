//! System calls of hidraw that Rust's standard library lacks.
#![allow(unsafe_code)]

use super::device::MAX_POLL;
use std::fs::File;
use std::io;
use std::os::fd::AsRawFd;
use std::time::Duration;

const MAGIC: u32 = b'H' as u32;
const SET_FEATURE: u32 = 0x06;
const GET_FEATURE: u32 = 0x07;
/// An ioctl number has 14 bits for the length of its argument.
const MAX_REPORT_BYTES: usize = (1 << 14) - 1;

/// `_IOC(_IOC_WRITE | _IOC_READ, 'H', function, length)` of the kernel's headers.
fn request(function: u32, length: usize) -> io::Result<libc::Ioctl> {
    if length > MAX_REPORT_BYTES {
        return Err(io::Error::new(
            io::ErrorKind::InvalidInput,
            format!("a report of {length} bytes is too long"),
        ));
    }
    let number = (3 << 30) | ((length as u32) << 16) | (MAGIC << 8) | function;
    Ok(number as libc::Ioctl)
}

fn outcome(result: libc::c_int) -> io::Result<usize> {
    usize::try_from(result).map_err(|_| io::Error::last_os_error())
}

/// `HIDIOCSFEATURE`.
pub(super) fn set_feature(file: &File, report: &[u8]) -> io::Result<()> {
    let request = request(SET_FEATURE, report.len())?;
    // SAFETY: the descriptor is open as long as `file`. The kernel reads `report.len()` bytes, the
    // length encoded in the request number, from a buffer of that length. It does not write to this
    // buffer.
    outcome(unsafe { libc::ioctl(file.as_raw_fd(), request, report.as_ptr()) }).map(drop)
}

/// `HIDIOCGFEATURE`.
pub(super) fn get_feature(file: &File, report: &mut [u8]) -> io::Result<usize> {
    let request = request(GET_FEATURE, report.len())?;
    // SAFETY: the descriptor is open as long as `file`. The kernel writes at most `report.len()` bytes,
    // the length encoded in the request number, to a buffer of that length that is borrowed for this
    // call only.
    let length = outcome(unsafe { libc::ioctl(file.as_raw_fd(), request, report.as_mut_ptr()) })?;
    Ok(length.min(report.len()))
}

/// Waits up to `limit` until a report can be read; false if none came.
pub(super) fn wait_readable(file: &File, limit: Duration) -> io::Result<bool> {
    let mut poll = libc::pollfd { fd: file.as_raw_fd(), events: libc::POLLIN, revents: 0 };
    // Rounded up, so that a wait of less than a millisecond does not become a busy loop.
    let limit_ms = limit.min(MAX_POLL).as_micros().div_ceil(1000) as libc::c_int;
    // SAFETY: `poll` is one valid pollfd that outlives the call.
    match outcome(unsafe { libc::poll(&mut poll, 1, limit_ms) }) {
        // A hang-up counts as readable: the following read returns the reason.
        Ok(ready) => Ok(ready > 0),
        Err(error) if error.kind() == io::ErrorKind::Interrupted => Ok(false),
        Err(error) => Err(error),
    }
}

//! The driver's buffers mapped into memory. Each is queued again as soon as its bytes are copied, so
//! that the driver can fill all but one at any time.

use super::CaptureError;
use super::abi::{self, BUF_TYPE_VIDEO_CAPTURE, Buffer, MEMORY_MMAP, Plain, RequestBuffers};
use super::device::Device;
use std::io;
use std::os::fd::{AsFd, AsRawFd, BorrowedFd};
use std::ptr::NonNull;

/// One mapped buffer of the driver.
#[derive(Debug)]
struct Mapping {
    start: NonNull<u8>,
    length: usize,
}

// SAFETY: the mapping belongs to the process, not to a thread, and is accessed through `&mut Ring` only.
unsafe impl Send for Mapping {}

impl Mapping {
    fn new(device: BorrowedFd<'_>, offset: u32, length: usize) -> io::Result<Self> {
        // SAFETY: a new shared mapping of the device at the offset given by its driver for this buffer.
        // The kernel chooses the address and checks offset and length.
        let start = unsafe {
            libc::mmap(
                std::ptr::null_mut(),
                length,
                libc::PROT_READ | libc::PROT_WRITE,
                libc::MAP_SHARED,
                device.as_raw_fd(),
                offset as libc::off_t,
            )
        };
        if start == libc::MAP_FAILED {
            return Err(io::Error::last_os_error());
        }
        match NonNull::new(start.cast()) {
            Some(start) => Ok(Self { start, length }),
            None => Err(io::Error::other("the kernel mapped a buffer at address 0")),
        }
    }

    /// Copies the first `length` bytes. The buffer must be dequeued, so that the driver does not write
    /// to it.
    fn copy_to(&self, length: usize, bytes: &mut Vec<u8>) {
        bytes.clear();
        let length = length.min(self.length);
        bytes.reserve(length);
        // SAFETY: the mapping holds at least `length` bytes and lives until `drop`. The driver does not
        // write to a dequeued buffer. `bytes` has a separate capacity of `length` bytes, all of which
        // are written.
        unsafe {
            std::ptr::copy_nonoverlapping(self.start.as_ptr(), bytes.as_mut_ptr(), length);
            bytes.set_len(length);
        }
    }
}

impl Drop for Mapping {
    fn drop(&mut self) {
        // SAFETY: the mapping is owned by this value and nothing borrows from it.
        unsafe { libc::munmap(self.start.as_ptr().cast(), self.length) };
    }
}

/// A dequeued frame.
#[derive(Clone, Copy, Debug)]
pub(super) struct Dequeued {
    /// Frame number of the driver.
    pub number: u32,
    /// The driver's timestamp, if its flags state `CLOCK_MONOTONIC`.
    pub driver_ns: Option<u64>,
    /// Whether the driver marks the frame as corrupt.
    pub damaged: bool,
}

/// Buffers of a streaming device. Dropping the ring stops the stream.
#[derive(Debug)]
pub(super) struct Ring {
    // Declared first, so that it is unmapped before the device is closed.
    mappings: Vec<Mapping>,
    device: Device,
}

impl Ring {
    /// Maps and queues buffers, and starts the stream.
    pub fn start(device: Device, count: u32) -> Result<Self, CaptureError> {
        let mut request = RequestBuffers {
            count,
            buf_type: BUF_TYPE_VIDEO_CAPTURE,
            memory: MEMORY_MMAP,
            ..RequestBuffers::zeroed()
        };
        device.must(&abi::REQBUFS, &mut request)?;
        let mut ring = Self { mappings: Vec::new(), device };
        // The driver may allocate fewer or more buffers than requested.
        for index in 0..request.count {
            let mut buffer = buffer(index);
            ring.device.must(&abi::QUERYBUF, &mut buffer)?;
            // SAFETY: with `MEMORY_MMAP` the union holds the offset, and any bytes are a valid number.
            let offset = unsafe { buffer.offset.offset };
            let mapping = Mapping::new(ring.device.as_fd(), offset, buffer.length as usize);
            ring.mappings.push(mapping.map_err(|error| ring.device.failed("mmap", error))?);
            ring.device.must(&abi::QBUF, &mut self::buffer(index))?;
        }
        if ring.mappings.len() < 2 {
            let error =
                io::Error::other(format!("the driver gives {} buffers of {count}", ring.mappings.len()));
            return Err(ring.device.failed(abi::REQBUFS.name, error));
        }
        let mut which = BUF_TYPE_VIDEO_CAPTURE;
        ring.device.must(&abi::STREAMON, &mut which)?;
        Ok(ring)
    }

    /// The streaming device.
    pub fn device(&self) -> &Device {
        &self.device
    }

    /// Copies the oldest filled buffer to `bytes` and queues it again; `None` if no buffer is filled.
    pub fn dequeue(&mut self, bytes: &mut Vec<u8>) -> Result<Option<Dequeued>, CaptureError> {
        let mut filled = buffer(0);
        match self.device.call(&abi::DQBUF, &mut filled) {
            Ok(()) => {}
            Err(error) if error.kind() == io::ErrorKind::WouldBlock => return Ok(None),
            Err(error) => return Err(self.device.failed(abi::DQBUF.name, error)),
        }
        let Some(mapping) = self.mappings.get(filled.index as usize) else {
            let error =
                io::Error::other(format!("the driver gave buffer {}, which there is not", filled.index));
            return Err(self.device.failed(abi::DQBUF.name, error));
        };
        mapping.copy_to(filled.bytesused as usize, bytes);
        self.device.must(&abi::QBUF, &mut buffer(filled.index))?;
        let monotonic = filled.flags & abi::BUF_FLAG_TIMESTAMP_MASK == abi::BUF_FLAG_TIMESTAMP_MONOTONIC;
        Ok(Some(Dequeued {
            number: filled.sequence,
            driver_ns: monotonic.then(|| nanoseconds(filled.timestamp)),
            damaged: filled.flags & abi::BUF_FLAG_ERROR != 0,
        }))
    }
}

impl Drop for Ring {
    fn drop(&mut self) {
        // STREAMOFF fails on a disconnected device; closing it is enough.
        let _ = self.device.call(&abi::STREAMOFF, &mut { BUF_TYPE_VIDEO_CAPTURE });
    }
}

fn buffer(index: u32) -> Buffer {
    Buffer { index, buf_type: BUF_TYPE_VIDEO_CAPTURE, memory: MEMORY_MMAP, ..Buffer::zeroed() }
}

/// A negative time, impossible on this clock, wraps to a value that the timestamp check rejects.
fn nanoseconds(time: libc::timeval) -> u64 {
    (time.tv_sec as u64).wrapping_mul(1_000_000_000).wrapping_add((time.tv_usec as u64).wrapping_mul(1000))
}

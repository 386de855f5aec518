//! Kernel interface `linux/videodev2.h` and the system calls that use it.
//!
//! Unsafe code is confined to this file and `ring.rs`; the rest uses safe wrappers.

use std::io;
use std::os::fd::{AsRawFd, BorrowedFd};
use std::time::Duration;

pub(super) const BUF_TYPE_VIDEO_CAPTURE: u32 = 1;
pub(super) const MEMORY_MMAP: u32 = 1;

pub(super) const FIELD_ANY: u32 = 0;
pub(super) const FIELD_NONE: u32 = 1;

pub(super) const CAP_VIDEO_CAPTURE: u32 = 0x0000_0001;
pub(super) const CAP_VIDEO_CAPTURE_MPLANE: u32 = 0x0000_1000;
pub(super) const CAP_META_CAPTURE: u32 = 0x0080_0000;
pub(super) const CAP_STREAMING: u32 = 0x0400_0000;
pub(super) const CAP_DEVICE_CAPS: u32 = 0x8000_0000;
pub(super) const CAP_TIMEPERFRAME: u32 = 0x1000;

pub(super) const BUF_FLAG_ERROR: u32 = 0x40;
pub(super) const BUF_FLAG_TIMESTAMP_MASK: u32 = 0xe000;
pub(super) const BUF_FLAG_TIMESTAMP_MONOTONIC: u32 = 0x2000;

pub(super) const TYPE_DISCRETE: u32 = 1;

pub(super) const CTRL_FLAG_DISABLED: u32 = 0x0001;
pub(super) const CTRL_FLAG_READ_ONLY: u32 = 0x0004;
pub(super) const CTRL_FLAG_INACTIVE: u32 = 0x0010;
pub(super) const CTRL_FLAG_WRITE_ONLY: u32 = 0x0040;
pub(super) const CTRL_FLAG_NEXT_CTRL: u32 = 0x8000_0000;

#[repr(C)]
#[derive(Clone, Copy)]
pub(super) struct Capability {
    pub driver: [u8; 16],
    pub card: [u8; 32],
    pub bus_info: [u8; 32],
    pub version: u32,
    pub capabilities: u32,
    pub device_caps: u32,
    pub reserved: [u32; 3],
}

#[repr(C)]
#[derive(Clone, Copy)]
pub(super) struct FormatDescription {
    pub index: u32,
    pub buf_type: u32,
    pub flags: u32,
    pub description: [u8; 32],
    pub pixelformat: u32,
    pub mbus_code: u32,
    pub reserved: [u32; 3],
}

#[repr(C)]
#[derive(Clone, Copy)]
pub(super) struct PixFormat {
    pub width: u32,
    pub height: u32,
    pub pixelformat: u32,
    pub field: u32,
    pub bytesperline: u32,
    pub sizeimage: u32,
    pub colorspace: u32,
    pub private: u32,
    pub flags: u32,
    pub encoding: u32,
    pub quantization: u32,
    pub transfer_function: u32,
}

/// The kernel's union of 200 bytes. Its other members hold pointers, hence the alignment.
#[repr(C)]
#[derive(Clone, Copy)]
pub(super) struct FormatUnion {
    pub pix: PixFormat,
    pub rest: [u8; 152],
    pub align: [usize; 0],
}

#[repr(C)]
#[derive(Clone, Copy)]
pub(super) struct Format {
    pub buf_type: u32,
    pub fmt: FormatUnion,
}

#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Fraction {
    pub numerator: u32,
    pub denominator: u32,
}

#[repr(C)]
#[derive(Clone, Copy)]
pub(super) struct StreamParameters {
    pub buf_type: u32,
    pub capability: u32,
    pub capture_mode: u32,
    pub time_per_frame: Fraction,
    pub extended_mode: u32,
    pub read_buffers: u32,
    pub reserved: [u32; 4],
    pub rest: [u8; 160],
}

/// `discrete` uses the first two numbers, `stepwise` all: smallest, largest and step of the width, then
/// of the height.
#[repr(C)]
#[derive(Clone, Copy)]
pub(super) struct FrameSize {
    pub index: u32,
    pub pixel_format: u32,
    pub kind: u32,
    pub values: [u32; 6],
    pub reserved: [u32; 2],
}

/// `discrete` uses the first fraction, `stepwise` all: shortest, longest, step.
#[repr(C)]
#[derive(Clone, Copy)]
pub(super) struct FrameInterval {
    pub index: u32,
    pub pixel_format: u32,
    pub width: u32,
    pub height: u32,
    pub kind: u32,
    pub values: [Fraction; 3],
    pub reserved: [u32; 2],
}

#[repr(C)]
#[derive(Clone, Copy)]
pub(super) struct RequestBuffers {
    pub count: u32,
    pub buf_type: u32,
    pub memory: u32,
    pub capabilities: u32,
    pub flags: u8,
    pub reserved: [u8; 3],
}

#[repr(C)]
#[derive(Clone, Copy)]
pub(super) struct Timecode {
    pub kind: u32,
    pub flags: u32,
    pub fields: [u8; 8],
}

#[repr(C)]
#[derive(Clone, Copy)]
pub(super) struct Buffer {
    pub index: u32,
    pub buf_type: u32,
    pub bytesused: u32,
    pub flags: u32,
    pub field: u32,
    pub timestamp: libc::timeval,
    pub timecode: Timecode,
    pub sequence: u32,
    pub memory: u32,
    /// The kernel's union of offset, pointer and file handle; with `MEMORY_MMAP` it is the offset.
    pub offset: Offset,
    pub length: u32,
    pub reserved2: u32,
    pub request: u32,
}

#[repr(C)]
#[derive(Clone, Copy)]
pub(super) union Offset {
    pub offset: u32,
    pub pointer: usize,
}

#[repr(C)]
#[derive(Clone, Copy)]
pub(super) struct QueryExtCtrl {
    pub id: u32,
    pub kind: u32,
    pub name: [u8; 32],
    pub minimum: i64,
    pub maximum: i64,
    pub step: u64,
    pub default: i64,
    pub flags: u32,
    pub elem_size: u32,
    pub elems: u32,
    pub dimensions: u32,
    pub dims: [u32; 4],
    pub reserved: [u32; 32],
}

/// The kernel's union of a name and a number; the number occupies the name's first eight bytes.
#[repr(C, packed)]
#[derive(Clone, Copy)]
pub(super) struct QueryMenu {
    pub id: u32,
    pub index: u32,
    pub name: [u8; 32],
    pub reserved: u32,
}

/// The kernel's union also holds pointers; here it is always a number of 32 or 64 bits in native byte
/// order.
#[repr(C, packed)]
#[derive(Clone, Copy)]
pub(super) struct ExtControl {
    pub id: u32,
    pub size: u32,
    pub reserved2: u32,
    pub value: [u8; 8],
}

#[repr(C)]
#[derive(Clone, Copy)]
pub(super) struct ExtControls {
    which: u32,
    count: u32,
    error_idx: u32,
    request_fd: i32,
    reserved: u32,
    controls: *mut ExtControl,
}

/// Structure of the kernel interface for which any byte pattern is a valid value.
///
/// # Safety
/// All zeros, and any bytes that the kernel writes, must be a valid value.
pub(super) unsafe trait Plain: Copy {
    /// All zeros.
    fn zeroed() -> Self {
        // SAFETY: guaranteed by the trait.
        unsafe { std::mem::zeroed() }
    }
}

macro_rules! plain {
    ($($name:ty),+ $(,)?) => {
        $(
            // SAFETY: contains only numbers and arrays of numbers, or a raw pointer.
            unsafe impl Plain for $name {}
        )+
    };
}
plain!(
    Capability,
    FormatDescription,
    Format,
    StreamParameters,
    FrameSize,
    FrameInterval,
    RequestBuffers,
    Buffer,
    QueryExtCtrl,
    QueryMenu,
    ExtControl,
    ExtControls,
    u32
);

/// A system call on a device with its structure. The name is that of the kernel's headers, `VIDIOC_` ..
pub(super) struct Call<T> {
    pub name: &'static str,
    number: u32,
    structure: std::marker::PhantomData<T>,
}

impl<T: Plain> Call<T> {
    const fn new(name: &'static str, number: u32) -> Self {
        Self { name, number, structure: std::marker::PhantomData }
    }
}

const V: u32 = b'V' as u32;

macro_rules! calls {
    ($($constant:ident = $direction:ident $number:literal $structure:ty),+ $(,)?) => {
        $(
            pub(super) const $constant: Call<$structure> = Call::new(
                concat!("VIDIOC_", stringify!($constant)),
                libc::$direction::<$structure>(V, $number) as u32,
            );
        )+
        /// Name and number of every call.
        #[cfg(test)]
        const NUMBERS: &[(&str, u32)] = &[$(($constant.name, $constant.number)),+];
    };
}
calls! {
    QUERYCAP = _IOR 0 Capability,
    ENUM_FMT = _IOWR 2 FormatDescription,
    S_FMT = _IOWR 5 Format,
    REQBUFS = _IOWR 8 RequestBuffers,
    QUERYBUF = _IOWR 9 Buffer,
    QBUF = _IOWR 15 Buffer,
    DQBUF = _IOWR 17 Buffer,
    STREAMON = _IOW 18 u32,
    STREAMOFF = _IOW 19 u32,
    S_PARM = _IOWR 22 StreamParameters,
    QUERYMENU = _IOWR 37 QueryMenu,
    G_EXT_CTRLS = _IOWR 71 ExtControls,
    S_EXT_CTRLS = _IOWR 72 ExtControls,
    ENUM_FRAMESIZES = _IOWR 74 FrameSize,
    ENUM_FRAMEINTERVALS = _IOWR 75 FrameInterval,
    QUERY_EXT_CTRL = _IOWR 103 QueryExtCtrl,
}

/// Makes a call and repeats it if a signal interrupts it.
pub(super) fn call<T: Plain>(device: BorrowedFd<'_>, call: &Call<T>, argument: &mut T) -> io::Result<()> {
    loop {
        // SAFETY: the file is open, the number encodes the size of `T`, and `argument` is valid for
        // reads and writes of that size. Pointers within it are null or set by `one_control`, which
        // keeps their targets alive.
        let answer =
            unsafe { libc::ioctl(device.as_raw_fd(), call.number as _, std::ptr::from_mut(argument)) };
        if answer >= 0 {
            return Ok(());
        }
        let error = io::Error::last_os_error();
        if error.kind() != io::ErrorKind::Interrupted {
            return Err(error);
        }
    }
}

/// Reads the number of a control.
pub(super) fn get_control(device: BorrowedFd<'_>, control: &mut ExtControl) -> io::Result<()> {
    one_control(device, &G_EXT_CTRLS, control)
}

/// Writes the number of a control; the driver may replace it by a valid one.
pub(super) fn set_control(device: BorrowedFd<'_>, control: &mut ExtControl) -> io::Result<()> {
    one_control(device, &S_EXT_CTRLS, control)
}

fn one_control(
    device: BorrowedFd<'_>,
    which: &Call<ExtControls>,
    control: &mut ExtControl,
) -> io::Result<()> {
    let mut controls =
        ExtControls { count: 1, controls: std::ptr::from_mut(control), ..ExtControls::zeroed() };
    call(device, which, &mut controls)
}

/// Result of `poll` on two files.
#[derive(Clone, Copy, Debug)]
pub(super) struct Readiness {
    /// A frame can be dequeued.
    pub frame: bool,
    /// `POLLERR`, `POLLHUP` or `POLLNVAL` on the camera.
    pub fault: Option<&'static str>,
    /// The other file can be read, or its writer has closed it.
    pub woken: bool,
}

/// Waits for a camera's next frame, or for the other file to become readable.
pub(super) fn poll(
    camera: Option<BorrowedFd<'_>>,
    wake: BorrowedFd<'_>,
    timeout: Duration,
) -> io::Result<Readiness> {
    let watch = |fd: i32| libc::pollfd { fd, events: libc::POLLIN, revents: 0 };
    // `poll` skips a negative descriptor.
    let mut files = [watch(camera.map_or(-1, |file| file.as_raw_fd())), watch(wake.as_raw_fd())];
    let timeout_ms = i32::try_from(timeout.as_millis()).unwrap_or(i32::MAX);
    // SAFETY: the array is valid for the call and its length is given.
    let answer = unsafe { libc::poll(files.as_mut_ptr(), files.len() as libc::nfds_t, timeout_ms) };
    if answer < 0 {
        let error = io::Error::last_os_error();
        if error.kind() != io::ErrorKind::Interrupted {
            return Err(error);
        }
        return Ok(Readiness { frame: false, fault: None, woken: false });
    }
    let [camera, wake] = files;
    let faults = [(libc::POLLHUP, "POLLHUP"), (libc::POLLNVAL, "POLLNVAL"), (libc::POLLERR, "POLLERR")];
    Ok(Readiness {
        frame: camera.revents & libc::POLLIN != 0,
        fault: faults.iter().find(|(bit, _)| camera.revents & bit != 0).map(|(_, name)| *name),
        woken: wake.revents != 0,
    })
}

/// Text of a field padded with zeros by the kernel.
pub(super) fn text(field: &[u8]) -> String {
    let end = field.iter().position(|&byte| byte == 0).unwrap_or(field.len());
    String::from_utf8_lossy(&field[..end]).into_owned()
}

#[cfg(test)]
mod tests;

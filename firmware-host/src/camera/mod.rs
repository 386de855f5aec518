//! Cameras through Video4Linux2: capture, decoding to luma, controls.
//!
//! [`crate::source::CameraSource`] combines these parts into a source of stereo pairs. [`list`] names
//! the connected devices, [`CameraConfig`] holds the settings, and each device has a thread that keeps
//! it streaming. Code with system calls is compiled for Linux only; elsewhere opening a camera returns a
//! typed error.

// Elsewhere no camera can be opened, so most of the code is unused.
#![cfg_attr(not(target_os = "linux"), allow(dead_code, unused_mut))]

mod backoff;
mod clock;
mod config;
mod controls;
mod error;
mod format;
mod list;
mod mailbox;
mod sequence;
mod statistics;

#[cfg(target_os = "linux")]
mod abi;
#[cfg(target_os = "linux")]
mod control_calls;
#[cfg(target_os = "linux")]
mod device;
#[cfg(target_os = "linux")]
mod ring;
#[cfg(target_os = "linux")]
mod session;
#[cfg(target_os = "linux")]
mod worker;
#[cfg(not(target_os = "linux"))]
#[path = "unsupported.rs"]
mod worker;

pub use backoff::Backoff;
pub use clock::{Timestamp, TimestampCheck};
pub use config::CameraConfig;
pub use controls::{Control, ControlKind, ControlSettings, MenuItem};
pub use error::CaptureError;
pub(crate) use format::trim_jpeg;
pub use format::{FrameDecoder, FrameFault, FrameShape, PixelFormat};
pub use list::{CameraInfo, NodeKind, list, offers, select};
pub use mailbox::Side;
pub(crate) use mailbox::{Mailbox, Message, RawFrame};
pub use sequence::{SequenceCheck, Step};
pub use statistics::{CameraStatistics, Statistics};
pub(crate) use worker::CameraHandle;

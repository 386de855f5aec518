//! Sources of stereo pairs.

mod camera;
mod clock;
#[cfg(feature = "host")]
mod folder;
mod huffman;
pub mod jpeg;
mod layout;
mod mode;
#[cfg(feature = "host")]
mod natural;
pub mod pairing;
#[cfg(feature = "host")]
pub mod stream;
#[cfg(feature = "host")]
mod stream_reader;

pub use camera::CameraSource;
pub(crate) use clock::{epoch_ns, monotonic_ns};
#[cfg(feature = "host")]
pub use folder::FolderSource;
pub use layout::OddWidth;
pub use mode::FrameMode;
#[cfg(feature = "host")]
pub(crate) use natural::compare as compare_names;
#[cfg(feature = "host")]
pub use stream::StreamSource;

use crate::camera::CaptureError;
use gelstereo_core::image::{GrayView, ImageError};
use serde::{Deserialize, Serialize};
use std::path::PathBuf;
use std::time::Duration;

/// A grey image without padding. Its buffer is reused from frame to frame.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Gray {
    /// Pixels per row.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Pixels row by row, `width * height` bytes.
    pub pixels: Vec<u8>,
}

impl Gray {
    /// View for the pipeline.
    ///
    /// # Errors
    /// [`ImageError`] if the shape is empty or does not match the pixels.
    pub fn view(&self) -> Result<GrayView<'_>, ImageError> {
        GrayView::new(&self.pixels, self.width, self.height, self.width)
    }
}

/// Two simultaneous images.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct StereoPair {
    /// Time of exposure, nanoseconds: since the epoch for a camera, since the start for a simulated
    /// sensor or a folder.
    pub time_ns: u64,
    /// Left image.
    pub left: Gray,
    /// Right image.
    pub right: Gray,
    /// Capture data.
    pub capture: Capture,
    /// Compressed images of the camera, if it sends them and the source is set to keep them.
    pub encoded: Encoded,
    /// Whether the images are from an earlier call because no newer ones came.
    pub stale: bool,
}

/// Capture data of a pair. Times are `CLOCK_MONOTONIC` of this computer.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Capture {
    /// The driver's sequence number, or the pair's number in a folder or stream.
    pub sequence: u64,
    /// Time at which the driver had the later of both images. `None` if the source has no driver.
    pub driver_ns: Option<u64>,
    /// Time at which both images were decoded. `None` if the source has no driver.
    pub received_ns: Option<u64>,
    /// Pairs lost or skipped since the previous one.
    pub dropped: u64,
    /// Time of the right image minus that of the left one; 0 for one stereo device.
    pub skew_ns: i64,
}

/// Compressed images from the camera.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub enum Encoded {
    /// The camera sends uncompressed pixels, or the source does not keep compressed images.
    #[default]
    None,
    /// One JPEG image that holds both views.
    Joint {
        /// Arrangement of the views.
        layout: StereoLayout,
        /// The JPEG file from its start to its end marker.
        jpeg: Vec<u8>,
    },
    /// Two JPEG images.
    Separate {
        /// Left image.
        left_jpeg: Vec<u8>,
        /// Right image.
        right_jpeg: Vec<u8>,
    },
}

/// Where both views stand in the frames of one stereo device.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum StereoLayout {
    /// The left half is the left view.
    #[default]
    SideBySide,
    /// The left half is the right view.
    SideBySideSwapped,
    /// Even bytes are the left view, odd bytes the right one.
    Interleaved,
    /// Even bytes are the right view, odd bytes the left one.
    InterleavedSwapped,
}

/// Result of waiting for a pair.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Next {
    /// A pair.
    Pair,
    /// No new pair, but an event. The pair passed in is unchanged and marked stale; the next call may
    /// return a pair.
    Event(SourceEvent),
    /// No more pairs.
    End,
}

/// Event of a source that continues.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", tag = "event")]
pub enum SourceEvent {
    /// A device was opened or reopened.
    Connected {
        /// Name, path and serial number.
        device: String,
    },
    /// A device was disconnected: it was unplugged or its bus was reset.
    Disconnected {
        /// Name, path and serial number.
        device: String,
        /// Error of the system.
        reason: String,
        /// Time until the next attempt.
        retry_in_ms: u64,
    },
    /// A device is present but sends nothing.
    Stalled {
        /// Name, path and serial number.
        device: String,
        /// Duration of the silence.
        silent_ms: u64,
    },
    /// A frame is unusable.
    Corrupt {
        /// The driver's sequence number.
        sequence: u64,
        /// Reason.
        reason: String,
    },
    /// Sequence numbers go back, or jump farther than frames can have been lost.
    Sequence {
        /// Expected number.
        expected: u64,
        /// Received number.
        found: u64,
    },
    /// A driver's timestamp goes back or is not of `CLOCK_MONOTONIC`. The time of reading replaces it.
    Timestamp {
        /// The driver's sequence number.
        sequence: u64,
        /// Reason.
        reason: String,
    },
    /// Images of two devices are too far apart in time for a pair.
    Skewed {
        /// Time of the right image minus that of the left one.
        skew_ns: i64,
        /// Largest valid difference in either direction.
        max_skew_ns: u64,
    },
}

impl std::fmt::Display for SourceEvent {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Connected { device } => write!(f, "camera {device} is connected"),
            Self::Disconnected { device, reason, retry_in_ms } => {
                write!(f, "camera {device} is gone ({reason}); trying again in {retry_in_ms} ms")
            }
            Self::Stalled { device, silent_ms } => {
                write!(f, "camera {device} has sent nothing for {silent_ms} ms")
            }
            Self::Corrupt { sequence, reason } => write!(f, "frame {sequence} cannot be used: {reason}"),
            Self::Sequence { expected, found } => {
                write!(f, "frame {found} came where {expected} was expected")
            }
            Self::Timestamp { sequence, reason } => write!(f, "frame {sequence}: {reason}"),
            Self::Skewed { skew_ns, max_skew_ns } => write!(
                f,
                "the right image is {:.3} ms {} than the left one; at most {:.3} ms apart they are a pair",
                skew_ns.unsigned_abs() as f64 * 1e-6,
                if *skew_ns < 0 { "earlier" } else { "later" },
                *max_skew_ns as f64 * 1e-6
            ),
        }
    }
}

/// Reason why there is no pair.
#[derive(Debug)]
pub enum SourceError {
    /// No pair came in time.
    Timeout {
        /// Time waited.
        waited: Duration,
    },
    /// A folder or file cannot be read.
    Io {
        /// Path of the folder or file.
        path: PathBuf,
        /// Error of the system.
        error: std::io::Error,
    },
    /// A folder has no image with left or right in its name.
    NoPairs {
        /// The folder.
        folder: PathBuf,
        /// Number of images found in it.
        images: usize,
    },
    /// An image has no partner.
    NoPartner {
        /// The image.
        path: PathBuf,
        /// Name of the missing view.
        missing: &'static str,
    },
    /// Two images of one view have the same number.
    Ambiguous {
        /// First image.
        first: PathBuf,
        /// Second image.
        second: PathBuf,
    },
    /// A file is not a valid image.
    Decode {
        /// Path of the file.
        path: PathBuf,
        /// Reason.
        message: String,
    },
    /// The size of an image differs from the first one.
    SizeChange {
        /// Path of the image.
        path: PathBuf,
        /// Width and height found, pixels.
        found: (usize, usize),
        /// Width and height of the first image, pixels.
        expected: (usize, usize),
    },
    /// A camera cannot be opened or configured.
    Camera(CaptureError),
    /// A device was unplugged or reports a fault.
    Device {
        /// Message of the device.
        message: String,
    },
}

impl std::fmt::Display for SourceError {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Timeout { waited } => write!(
                f,
                "no stereo pair came within {:.1} s; is the camera still connected and streaming?",
                waited.as_secs_f64()
            ),
            Self::Io { path, error } => write!(f, "cannot read {}: {error}", path.display()),
            Self::NoPairs { folder, images } => write!(
                f,
                "{} holds {images} images but none whose name says left or right; wanted are pairs such as \
                 left_0001.png and right_0001.png, or the subfolders left and right",
                folder.display()
            ),
            Self::NoPartner { path, missing } => write!(
                f,
                "{} has no partner: there is no {missing} image of the same number; add it or remove this \
                one",
                path.display()
            ),
            Self::Ambiguous { first, second } => write!(
                f,
                "{} and {} are images of the same view and number; keep one of them",
                first.display(),
                second.display()
            ),
            Self::Decode { path, message } => {
                write!(f, "{} cannot be read as a PNG, PGM or JPEG image: {message}", path.display())
            }
            Self::SizeChange { path, found, expected } => write!(
                f,
                "{} is {} x {} pixels but the first image {} x {}; all images of a folder must have one size",
                path.display(),
                found.0,
                found.1,
                expected.0,
                expected.1
            ),
            Self::Camera(error) => error.fmt(f),
            Self::Device { message } => write!(f, "camera: {message}"),
        }
    }
}

impl std::error::Error for SourceError {}

impl From<CaptureError> for SourceError {
    fn from(error: CaptureError) -> Self {
        Self::Camera(error)
    }
}

/// A stereo camera or a substitute.
pub trait FrameSource {
    /// Waits for the next pair and writes it to `pair`, reusing its buffers. Returns within `timeout`
    /// plus the decoding time of one pair.
    ///
    /// # Errors
    /// [`SourceError::Timeout`] if nothing comes in time; the next call may succeed. Any other
    /// [`SourceError`] means that the source has failed.
    fn next_pair(&mut self, timeout: Duration, pair: &mut StereoPair) -> Result<Next, SourceError>;

    /// Total number of pairs, if known.
    fn len_hint(&self) -> Option<usize> {
        None
    }
}

//! Where stereo pairs come from.

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

/// A grey image without padding, whose buffer is used again from frame to frame.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Gray {
    /// Pixels per row.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Row after row, `width * height` bytes.
    pub pixels: Vec<u8>,
}

impl Gray {
    /// What the pipeline reads.
    ///
    /// # Errors
    /// [`ImageError`] when the shape is empty or does not fit the pixels.
    pub fn view(&self) -> Result<GrayView<'_>, ImageError> {
        GrayView::new(&self.pixels, self.width, self.height, self.width)
    }
}

/// Two images of one moment.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct StereoPair {
    /// Moment of exposure, nanoseconds: from the epoch for a camera, from its start for a simulated sensor or a folder.
    pub time_ns: u64,
    /// Left image.
    pub left: Gray,
    /// Right image.
    pub right: Gray,
    /// How it was captured.
    pub capture: Capture,
    /// The camera's compressed images, where it sends such and the source was asked to keep them.
    pub encoded: Encoded,
    /// Whether the images are those of an earlier call, because no newer ones came.
    pub stale: bool,
}

/// How a pair was captured. Clocks are `CLOCK_MONOTONIC` of this computer.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Capture {
    /// The driver's sequence number, or the pair's number in a folder or stream.
    pub sequence: u64,
    /// When the driver had the later of both images. Absent where the source has no driver.
    pub driver_ns: Option<u64>,
    /// When both images were decoded. Absent where the source has no driver.
    pub received_ns: Option<u64>,
    /// Pairs that were lost or passed over since the pair before.
    pub dropped: u64,
    /// Right image's time minus the left one's; 0 for one stereo device.
    pub skew_ns: i64,
}

/// Compressed images as the camera sent them.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub enum Encoded {
    /// The camera sends plain pixels, or the source does not keep them.
    #[default]
    None,
    /// One JPEG image that holds both views.
    Joint {
        /// Where the views stand in it.
        layout: StereoLayout,
        /// The file, from its start to its end marker.
        jpeg: Vec<u8>,
    },
    /// Two JPEG images.
    Separate {
        /// The left one.
        left_jpeg: Vec<u8>,
        /// The right one.
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

/// What came of waiting for a pair.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Next {
    /// A pair.
    Pair,
    /// No new pair, but something to know. The pair handed over is left as it was and marked stale; the next call may
    /// give a pair.
    Event(SourceEvent),
    /// There will be no more.
    End,
}

/// What happened to a source that goes on.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", tag = "event")]
pub enum SourceEvent {
    /// A device was opened, at the start or again.
    Connected {
        /// Its name, path and serial number.
        device: String,
    },
    /// A device went away: it was unplugged or its bus was reset.
    Disconnected {
        /// Its name, path and serial number.
        device: String,
        /// The system's answer.
        reason: String,
        /// When it is tried again.
        retry_in_ms: u64,
    },
    /// A device is there but sends nothing.
    Stalled {
        /// Its name, path and serial number.
        device: String,
        /// For how long.
        silent_ms: u64,
    },
    /// A frame cannot be used.
    Corrupt {
        /// The driver's sequence number.
        sequence: u64,
        /// What is wrong with it.
        reason: String,
    },
    /// Sequence numbers go back, or jump farther than frames can have been lost.
    Sequence {
        /// Number that was expected.
        expected: u64,
        /// Number that came.
        found: u64,
    },
    /// A driver's timestamp goes back or is of another clock than `CLOCK_MONOTONIC`. The moment of reading takes its
    /// place.
    Timestamp {
        /// The driver's sequence number.
        sequence: u64,
        /// What is wrong with it.
        reason: String,
    },
    /// Two devices' images are too far apart in time to be a pair.
    Skewed {
        /// Right image's time minus the left one's.
        skew_ns: i64,
        /// Largest valid, in either direction.
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

/// Why there is no pair.
#[derive(Debug)]
pub enum SourceError {
    /// Nothing came in time.
    Timeout {
        /// How long it was waited for.
        waited: Duration,
    },
    /// A folder or file cannot be read.
    Io {
        /// Which.
        path: PathBuf,
        /// The system's answer.
        error: std::io::Error,
    },
    /// A folder holds no image whose name says left or right.
    NoPairs {
        /// The folder.
        folder: PathBuf,
        /// Images found in it.
        images: usize,
    },
    /// An image has no partner.
    NoPartner {
        /// The image.
        path: PathBuf,
        /// The other view.
        missing: &'static str,
    },
    /// Two images of one view have the same number.
    Ambiguous {
        /// The one.
        first: PathBuf,
        /// The other.
        second: PathBuf,
    },
    /// A file is no image.
    Decode {
        /// Which.
        path: PathBuf,
        /// Why.
        message: String,
    },
    /// An image differs in size from the first one.
    SizeChange {
        /// Which.
        path: PathBuf,
        /// Width and height found, pixels.
        found: (usize, usize),
        /// Width and height of the first image, pixels.
        expected: (usize, usize),
    },
    /// A camera cannot be opened or set.
    Camera(CaptureError),
    /// A device was unplugged or reports a fault.
    Device {
        /// What it said.
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
                "{} has no partner: there is no {missing} image of the same number; add it or remove this one",
                path.display()
            ),
            Self::Ambiguous { first, second } => write!(
                f,
                "{} and {} are images of the same view and number; keep one of them",
                first.display(),
                second.display()
            ),
            Self::Decode { path, message } => {
                write!(f, "{} is no PNG, PGM or JPEG image that can be read: {message}", path.display())
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

/// A stereo camera, or what stands in for one.
pub trait FrameSource {
    /// Waits for the next pair and writes it to `pair`, whose buffers it uses again. Returns within `timeout`, with
    /// an allowance for the decoding of one pair.
    ///
    /// # Errors
    /// [`SourceError::Timeout`] when nothing comes in time, after which the next call may succeed; any other
    /// [`SourceError`] when the source is broken.
    fn next_pair(&mut self, timeout: Duration, pair: &mut StereoPair) -> Result<Next, SourceError>;

    /// How many pairs there are in all, where that is known.
    fn len_hint(&self) -> Option<usize> {
        None
    }
}

//! Where stereo pairs come from.

mod folder;

pub use folder::FolderSource;

use gelstereo_core::image::{GrayView, ImageError};
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
    /// Moment of exposure on the source's own clock, nanoseconds from its start or from the epoch.
    pub time_ns: u64,
    /// Left image.
    pub left: Gray,
    /// Right image.
    pub right: Gray,
}

/// What came of waiting for a pair.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Next {
    /// A pair.
    Pair,
    /// There will be no more.
    End,
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
        error: image::ImageError,
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
            Self::Decode { path, error } => {
                write!(f, "{} is no PNG, PGM or JPEG image that can be read: {error}", path.display())
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
            Self::Device { message } => write!(f, "camera: {message}"),
        }
    }
}

impl std::error::Error for SourceError {}

/// A stereo camera, or what stands in for one.
pub trait FrameSource {
    /// Waits for the next pair and writes it to `pair`, whose buffers it uses again.
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

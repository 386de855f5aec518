//! How a pair was captured, as a recording keeps it.

use crate::source::{Capture, Gray, StereoPair};
use serde::{Deserialize, Serialize};

/// What `/gelstereo/capture` says of a pair. An event of the source stands there as [`crate::source::SourceEvent`].
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct CaptureNote {
    /// Sequence number, the driver's clock, losses.
    #[serde(flatten)]
    pub capture: Capture,
    /// Whether the images are those of an earlier pair.
    pub stale: bool,
    /// [`pixel_crc`] of the decoded left image.
    pub left_crc32: String,
    /// [`pixel_crc`] of the decoded right image.
    pub right_crc32: String,
}

impl CaptureNote {
    /// Of this pair.
    #[must_use]
    pub fn new(pair: &StereoPair) -> Self {
        Self {
            capture: pair.capture,
            stale: pair.stale,
            left_crc32: pixel_crc(&pair.left),
            right_crc32: pixel_crc(&pair.right),
        }
    }
}

/// CRC-32 of an image's pixels, row after row, as 8 hexadecimal digits. A replay compares it with what its decoder
/// gives.
#[must_use]
pub fn pixel_crc(image: &Gray) -> String {
    format!("{:08x}", crc32fast::hash(&image.pixels))
}

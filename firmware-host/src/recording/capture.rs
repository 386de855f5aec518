//! Capture data of a pair in a recording.

use crate::source::{Capture, Encoded, Gray, StereoLayout, StereoPair};
use serde::{Deserialize, Serialize};

/// Content of `/gelstereo/capture` for a pair. Events of the source are stored there as
/// [`crate::source::SourceEvent`].
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct CaptureNote {
    /// Sequence number, the driver's timestamp and losses.
    #[serde(flatten)]
    pub capture: Capture,
    /// Whether the images are those of an earlier pair.
    pub stale: bool,
    /// Whether the recording contains the pair's images.
    pub images: bool,
    /// Position of the views in the camera's image, if it sends both in one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub layout: Option<StereoLayout>,
    /// [`pixel_crc`] of the decoded left image.
    pub left_crc32: String,
    /// [`pixel_crc`] of the decoded right image.
    pub right_crc32: String,
}

impl CaptureNote {
    /// Note for this pair; `images` states whether its images are recorded.
    #[must_use]
    pub fn new(pair: &StereoPair, images: bool) -> Self {
        let layout = match pair.encoded {
            Encoded::Joint { layout, .. } => Some(layout),
            _ => None,
        };
        Self {
            capture: pair.capture,
            stale: pair.stale,
            images,
            layout,
            left_crc32: pixel_crc(&pair.left),
            right_crc32: pixel_crc(&pair.right),
        }
    }
}

/// CRC-32 of an image's pixels, row by row, as 8 hexadecimal digits. A replay compares it with the output
/// of its decoder.
#[must_use]
pub fn pixel_crc(image: &Gray) -> String {
    format!("{:08x}", crc32fast::hash(&image.pixels))
}

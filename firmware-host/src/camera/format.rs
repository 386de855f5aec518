//! Decodes driver frames to grey images.

use crate::source::jpeg::{JpegDecoder, JpegError, trimmed};
use crate::source::{Gray, OddWidth, StereoLayout};
use gelstereo_core::image::{GrayView, ImageError};
use serde::{Deserialize, Serialize};

/// How a camera sends its pixels.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum PixelFormat {
    /// JPEG images one by one, `MJPG` or `JPEG` to the driver.
    #[default]
    Mjpg,
    /// Luma and chroma byte by byte, `YUYV`; or, interleaved, the left and the right pixel.
    Yuyv,
    /// One byte of luma per pixel, `GREY`.
    Grey,
    /// 16 bits per pixel, `Y16 `, whose two bytes are the left and the right pixel.
    Y16,
}

impl PixelFormat {
    /// FourCC codes of the driver; drivers use either if there are two.
    #[must_use]
    pub const fn fourccs(self) -> &'static [[u8; 4]] {
        match self {
            Self::Mjpg => const { &[*b"MJPG", *b"JPEG"] },
            Self::Yuyv => const { &[*b"YUYV"] },
            Self::Grey => const { &[*b"GREY"] },
            Self::Y16 => const { &[*b"Y16 "] },
        }
    }

    /// Bytes of one row, if rows have a fixed length.
    #[must_use]
    pub const fn row_bytes(self, width: usize) -> Option<usize> {
        match self {
            Self::Mjpg => None,
            Self::Yuyv | Self::Y16 => Some(2 * width),
            Self::Grey => Some(width),
        }
    }

    /// Reason why frames of this format cannot hold two views in this layout, if any.
    #[must_use]
    pub fn conflict(self, layout: StereoLayout, width: usize) -> Option<&'static str> {
        let interleaved = matches!(layout, StereoLayout::Interleaved | StereoLayout::InterleavedSwapped);
        match (self, interleaved) {
            (Self::Mjpg, true) => {
                Some("an interleaved layout needs format yuyv, y16 or grey: JPEG mixes neighbours")
            }
            (Self::Y16, false) => Some("format y16 is two views byte by byte: layout must be interleaved"),
            (Self::Yuyv | Self::Y16, true) => None,
            _ if !width.is_multiple_of(2) => Some("two views in one frame need an even width"),
            _ => None,
        }
    }

    /// Width and height of one view in frames of this size.
    #[must_use]
    pub fn view_size(self, layout: Option<StereoLayout>, width: usize, height: usize) -> (usize, usize) {
        match (self, layout) {
            (_, None) => (width, height),
            (Self::Yuyv | Self::Y16, Some(StereoLayout::Interleaved | StereoLayout::InterleavedSwapped)) => {
                (width, height)
            }
            _ => (width / 2, height),
        }
    }
}

impl std::fmt::Display for PixelFormat {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            Self::Mjpg => "mjpg",
            Self::Yuyv => "yuyv",
            Self::Grey => "grey",
            Self::Y16 => "y16",
        })
    }
}

/// Shape of a device's frames.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct FrameShape {
    /// Format.
    pub format: PixelFormat,
    /// Pixels per row, as counted by the driver.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Bytes from row to row; unused for JPEG.
    pub stride: usize,
}

/// Reason why a frame cannot be used.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum FrameFault {
    /// The driver delivered fewer bytes than a frame has, or the shape is invalid.
    Shape(ImageError),
    /// The data are not a valid JPEG image.
    Jpeg(JpegError),
    /// The size of the JPEG image differs from the one announced by the driver.
    Size {
        /// Width and height found, pixels.
        found: (usize, usize),
        /// Width and height of the driver's format, pixels.
        expected: (usize, usize),
    },
    /// The frame cannot be split into two views.
    Layout(OddWidth),
}

impl std::fmt::Display for FrameFault {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Shape(error) => error.fmt(f),
            Self::Jpeg(error) => error.fmt(f),
            Self::Size { found, expected } => write!(
                f,
                "the JPEG image is {} x {} pixels, but the camera's format is {} x {}",
                found.0, found.1, expected.0, expected.1
            ),
            Self::Layout(error) => error.fmt(f),
        }
    }
}

impl std::error::Error for FrameFault {}

impl From<ImageError> for FrameFault {
    fn from(error: ImageError) -> Self {
        Self::Shape(error)
    }
}

impl From<JpegError> for FrameFault {
    fn from(error: JpegError) -> Self {
        Self::Jpeg(error)
    }
}

/// Decodes frames to luma. Buffers are reused from frame to frame.
#[derive(Clone, Debug, Default)]
pub struct FrameDecoder {
    jpeg: JpegDecoder,
    frame: Gray,
}

impl FrameDecoder {
    /// Decodes both views of a frame from one stereo device.
    ///
    /// # Errors
    /// [`FrameFault`]; the content of `left` and `right` is then undefined.
    pub fn stereo(
        &mut self,
        bytes: &[u8],
        shape: FrameShape,
        layout: StereoLayout,
        left: &mut Gray,
        right: &mut Gray,
    ) -> Result<(), FrameFault> {
        let interleaved = matches!(layout, StereoLayout::Interleaved | StereoLayout::InterleavedSwapped);
        let FrameShape { format, width, height, stride } = shape;
        let direct = match format.row_bytes(width) {
            Some(row_bytes) if interleaved || format == PixelFormat::Grey => Some(row_bytes),
            _ => None,
        };
        match direct {
            Some(row_bytes) => layout.split(GrayView::new(bytes, row_bytes, height, stride)?, left, right),
            None => {
                luma(&mut self.jpeg, bytes, shape, &mut self.frame)?;
                layout.split(self.frame.view()?, left, right)
            }
        }
        .map_err(FrameFault::Layout)
    }

    /// Decodes the image of a device with one view.
    ///
    /// # Errors
    /// [`FrameFault`]; the content of `image` is then undefined.
    pub fn single(&mut self, bytes: &[u8], shape: FrameShape, image: &mut Gray) -> Result<(), FrameFault> {
        luma(&mut self.jpeg, bytes, shape, image)
    }
}

fn luma(jpeg: &mut JpegDecoder, bytes: &[u8], shape: FrameShape, image: &mut Gray) -> Result<(), FrameFault> {
    let FrameShape { format, width, height, stride } = shape;
    let Some(row_bytes) = format.row_bytes(width) else {
        jpeg.decode(bytes, image)?;
        let found = (image.width, image.height);
        let expected = (width, height);
        return if found == expected { Ok(()) } else { Err(FrameFault::Size { found, expected }) };
    };
    let rows = GrayView::new(bytes, row_bytes, height, stride)?;
    image.pixels.clear();
    image.pixels.reserve(width * height);
    for y in 0..height {
        let row = rows.row(y);
        if row_bytes == width {
            image.pixels.extend_from_slice(row);
        } else {
            // Luma is the first byte of each pair.
            image.pixels.extend(row.chunks_exact(2).map(|pixel| pixel[0]));
        }
    }
    (image.width, image.height) = (width, height);
    Ok(())
}

/// Removes padding after the end of a JPEG image, so that the buffer holds the file as the camera made it.
pub(crate) fn trim_jpeg(mut bytes: Vec<u8>) -> Vec<u8> {
    if let Ok(jpeg) = trimmed(&bytes) {
        let length = jpeg.len();
        bytes.truncate(length);
    }
    bytes
}

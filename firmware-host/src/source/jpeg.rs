//! Decodes JPEG images of cameras to grey with one pinned decoder.

use super::{Gray, huffman};
use zune_jpeg::zune_core::bytestream::ZCursor;
use zune_jpeg::zune_core::colorspace::ColorSpace;
use zune_jpeg::zune_core::options::DecoderOptions;

/// Decoder and version. Another decoder may give other pixels, so recordings store this name.
pub const DECODER: &str = "zune-jpeg 0.5.15";

/// Largest side of an image. It exceeds cameras of this kind and bounds a corrupt header.
const MAX_SIDE_PX: usize = 8192;

const START: [u8; 2] = [0xff, 0xd8];
const END: [u8; 2] = [0xff, 0xd9];
/// Markers: baseline frame, Huffman table, start of the coded data.
const BASELINE: u8 = 0xc0;
const HUFFMAN_TABLE: u8 = 0xc4;
const START_OF_SCAN: u8 = 0xda;

/// From this width on, a row of blocks exceeds the decoder's 8-byte read-ahead: 32 blocks of at least 2
/// bits.
const MIN_LONG_ROW_PX: u16 = 256;

/// Reason why bytes are not a usable JPEG image.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum JpegError {
    /// The JPEG start marker is missing.
    NoStart,
    /// The end marker is missing: the image is truncated.
    NoEnd {
        /// Length of the data.
        bytes: usize,
    },
    /// The coded data is corrupt, or of a kind that cameras do not send.
    Corrupt {
        /// Error of the decoder.
        reason: String,
    },
}

impl std::fmt::Display for JpegError {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::NoStart => write!(f, "the JPEG image does not start with the bytes ff d8"),
            Self::NoEnd { bytes } => {
                write!(f, "the JPEG image is truncated: its {bytes} bytes have no end marker, ff d9")
            }
            Self::Corrupt { reason } => write!(f, "the JPEG image is damaged: {reason}"),
        }
    }
}

impl std::error::Error for JpegError {}

/// The image from its start to its end marker, without the padding that some cameras append.
///
/// # Errors
/// [`JpegError::NoStart`] and [`JpegError::NoEnd`].
pub fn trimmed(bytes: &[u8]) -> Result<&[u8], JpegError> {
    if !bytes.starts_with(&START) {
        return Err(JpegError::NoStart);
    }
    let end = bytes.windows(END.len()).rposition(|window| window == END);
    end.map(|end| &bytes[..end + END.len()]).ok_or(JpegError::NoEnd { bytes: bytes.len() })
}

/// Decodes Motion JPEG. Buffers are reused from image to image.
#[derive(Clone, Debug, Default)]
pub struct JpegDecoder {
    /// Image completed with Huffman tables.
    completed: Vec<u8>,
}

impl JpegDecoder {
    /// Decodes the luma of one image, grey or YCbCr, to `gray`.
    ///
    /// SIMD code is disabled, so that every machine gives the same pixels.
    ///
    /// # Errors
    /// [`JpegError`]; `gray` is then empty.
    pub fn decode(&mut self, bytes: &[u8], gray: &mut Gray) -> Result<(), JpegError> {
        (gray.width, gray.height) = (0, 0);
        let mut jpeg = trimmed(bytes)?;
        let header = Header::find(jpeg);
        if header.long_rows {
            // With an end marker the decoder fills in a truncated last row; without it, it reports the
            // loss.
            jpeg = &jpeg[..jpeg.len() - END.len()];
        }
        if let Some(scan) = header.scan_without_tables {
            self.completed.clear();
            for part in [&jpeg[..scan], &huffman::SEGMENT, &jpeg[scan..]] {
                self.completed.extend_from_slice(part);
            }
            jpeg = &self.completed;
        }
        let corrupt =
            |error: zune_jpeg::errors::DecodeErrors| JpegError::Corrupt { reason: error.to_string() };
        let options = DecoderOptions::default()
            .set_strict_mode(true)
            .set_use_unsafe(false)
            .set_max_width(MAX_SIDE_PX)
            .set_max_height(MAX_SIDE_PX)
            .jpeg_set_out_colorspace(ColorSpace::Luma);
        let mut decoder = zune_jpeg::JpegDecoder::new_with_options(ZCursor::new(jpeg), options);
        decoder.decode_headers().map_err(corrupt)?;
        let colours = decoder.input_colorspace();
        if !matches!(colours, Some(ColorSpace::Luma | ColorSpace::YCbCr)) {
            let reason = format!("its colours are {colours:?}; valid is grey or YCbCr");
            return Err(JpegError::Corrupt { reason });
        }
        let (width, height) = decoder.dimensions().unwrap_or_default();
        gray.pixels.resize(width * height, 0);
        decoder.decode_into(&mut gray.pixels).map_err(corrupt)?;
        (gray.width, gray.height) = (width, height);
        Ok(())
    }
}

/// Information from the segments before the coded data.
#[derive(Default)]
struct Header {
    /// Start of the coded data, if no earlier segment defines Huffman tables.
    scan_without_tables: Option<usize>,
    /// Whether the image is baseline and at least [`MIN_LONG_ROW_PX`] wide.
    long_rows: bool,
}

impl Header {
    fn find(jpeg: &[u8]) -> Self {
        let (mut header, mut at, mut tables) = (Self::default(), START.len(), false);
        while let Some(&[0xff, marker, high, low]) = jpeg.get(at..).and_then(<[u8]>::first_chunk) {
            match marker {
                // Length, bits per sample, height, width.
                BASELINE => {
                    let width = jpeg.get(at + 7..).and_then(<[u8]>::first_chunk).copied().unwrap_or_default();
                    header.long_rows = u16::from_be_bytes(width) >= MIN_LONG_ROW_PX;
                }
                HUFFMAN_TABLE => tables = true,
                START_OF_SCAN => {
                    header.scan_without_tables = (!tables).then_some(at);
                    break;
                }
                _ => {}
            }
            at += 2 + usize::from(u16::from_be_bytes([high, low]));
        }
        header
    }
}

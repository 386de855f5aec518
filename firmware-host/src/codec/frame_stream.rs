//! Frame stream: passes stereo frames from a vendor's SDK, GStreamer or a script to the host through a
//! pipe.
//!
//! A stream is a sequence of frames, each a header of [`HEADER_BYTES`] bytes and its payload.
//! `docs/frame-stream.md` has the byte table. [`FrameDecoder`] accepts chunks of any size and
//! resynchronises after bytes that belong to no frame.

use crate::source::StereoLayout;

/// First bytes of every header. The first byte is invalid in ASCII and at the start of UTF-8 text, so
/// text is never mistaken for a frame.
pub const MAGIC: [u8; 4] = [0x89, b'G', b'S', b'F'];
/// Format version written and read.
pub const VERSION: u8 = 1;
/// Length of a header.
pub const HEADER_BYTES: usize = 44;
/// Largest valid width and height of a frame, both views together.
pub const MAX_SIDE_PX: u32 = 16_384;
/// Longest valid payload: four times a pair of 8 megapixels. It bounds the decoder's memory.
pub const MAX_PAYLOAD_BYTES: u32 = 1 << 26;

/// Bytes that belong to no frame are reported at the next frame, or once this many have come, so that a
/// stream of another kind is noticed. It is less than two pairs of 640 x 480.
const MAX_SKIPPED_BYTES: u64 = 1 << 20;

/// Flag bit: the payload has a checksum.
const HAS_PAYLOAD_CRC: u8 = 1;
/// Offset of the header's checksum, which covers everything before it.
const HEADER_CRC_AT: usize = 40;

/// Pixel storage of a frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PayloadFormat {
    /// One byte per pixel, row by row without padding.
    Grey8,
    /// One JPEG file that holds both views.
    Jpeg,
}

/// Header before a payload.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct FrameHeader {
    /// Frame number; it grows by 1. A gap is counted as lost frames.
    pub sequence: u64,
    /// Time of exposure, `CLOCK_MONOTONIC` of the host, nanoseconds; `None` if unknown to the producer.
    pub captured_ns: Option<u64>,
    /// Pixels per row, both views together.
    pub width_px: u32,
    /// Rows, both views together.
    pub height_px: u32,
    /// Pixel storage.
    pub format: PayloadFormat,
    /// Arrangement of the two views in the frame.
    pub layout: StereoLayout,
    /// Length of the payload, bytes.
    pub payload_bytes: u32,
    /// CRC-32 of the payload, if the producer computes one.
    pub payload_crc: Option<u32>,
}

/// Reason why bytes are not a frame. The decoder continues after each.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FrameStreamError {
    /// Bytes that belong to no frame.
    Skipped {
        /// Number of bytes.
        bytes: u64,
    },
    /// The header has another version.
    Version {
        /// Version found.
        found: u8,
    },
    /// The payload's format is unknown.
    Format {
        /// Format found.
        found: u8,
    },
    /// The layout of the views is unknown.
    Layout {
        /// Layout found.
        found: u8,
    },
    /// A flag is unknown.
    Flags {
        /// Flags found.
        found: u8,
    },
    /// The frame is empty, odd in width, or too large.
    Size {
        /// Pixels per row.
        width_px: u32,
        /// Rows.
        height_px: u32,
    },
    /// The payload is longer than any valid one, empty, or does not match the size of a grey frame.
    Length {
        /// Length found, bytes.
        found: u32,
        /// Length of a grey frame of that size; `None` for a JPEG file.
        expected: Option<u32>,
    },
    /// The payload does not match its checksum: bytes were lost in transit.
    Payload {
        /// Frame number.
        sequence: u64,
    },
    /// The stream ended within a frame.
    Cut {
        /// Bytes of the frame that were received.
        found: usize,
        /// Length of the frame, or of its header while that is incomplete.
        expected: usize,
    },
}

impl std::fmt::Display for FrameStreamError {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Skipped { bytes } => write!(f, "{bytes} bytes belong to no frame"),
            Self::Version { found } => write!(f, "header of version {found}; valid is {VERSION}"),
            Self::Format { found } => write!(f, "payload format {found}; valid is 0 (grey8) or 1 (JPEG)"),
            Self::Layout { found } => write!(f, "stereo layout {found}; valid is 0 to 3"),
            Self::Flags { found } => write!(f, "flags {found:#04x}; valid is 0x00 or 0x01"),
            Self::Size { width_px, height_px } => write!(
                f,
                "frame of {width_px} x {height_px} pixels; valid is an even width and at most \
                 {MAX_SIDE_PX} x {MAX_SIDE_PX}"
            ),
            Self::Length { found, expected: Some(expected) } => {
                write!(f, "payload of {found} bytes; a grey frame of that size has {expected}")
            }
            Self::Length { found, expected: None } => {
                write!(f, "payload of {found} bytes; valid is 1 to {MAX_PAYLOAD_BYTES}")
            }
            Self::Payload { sequence } => {
                write!(f, "the payload of frame {sequence} differs from its checksum: bytes were lost")
            }
            Self::Cut { found, expected } => {
                write!(f, "the stream ended after {found} of a frame's {expected} bytes")
            }
        }
    }
}

impl std::error::Error for FrameStreamError {}

const fn layout_code(layout: StereoLayout) -> u8 {
    match layout {
        StereoLayout::SideBySide => 0,
        StereoLayout::SideBySideSwapped => 1,
        StereoLayout::Interleaved => 2,
        StereoLayout::InterleavedSwapped => 3,
    }
}

impl FrameHeader {
    /// Encodes the header.
    #[must_use]
    pub fn encode(&self) -> [u8; HEADER_BYTES] {
        let format = match self.format {
            PayloadFormat::Grey8 => 0,
            PayloadFormat::Jpeg => 1,
        };
        let flags = if self.payload_crc.is_some() { HAS_PAYLOAD_CRC } else { 0 };
        let mut bytes = [0; HEADER_BYTES];
        bytes[..4].copy_from_slice(&MAGIC);
        bytes[4..8].copy_from_slice(&[VERSION, format, layout_code(self.layout), flags]);
        bytes[8..16].copy_from_slice(&self.sequence.to_le_bytes());
        bytes[16..24].copy_from_slice(&self.captured_ns.unwrap_or(0).to_le_bytes());
        let words = [self.width_px, self.height_px, self.payload_bytes, self.payload_crc.unwrap_or(0)]
            .map(u32::to_le_bytes);
        bytes[24..HEADER_CRC_AT].copy_from_slice(words.as_flattened());
        let crc = crc32fast::hash(&bytes[..HEADER_CRC_AT]);
        bytes[HEADER_CRC_AT..].copy_from_slice(&crc.to_le_bytes());
        bytes
    }

    /// Decodes a header; `None` if the bytes are not one.
    fn decode(bytes: &[u8; HEADER_BYTES]) -> Option<Result<Self, FrameStreamError>> {
        let is_header =
            bytes[..4] == MAGIC && u32_at(bytes, HEADER_CRC_AT) == crc32fast::hash(&bytes[..HEADER_CRC_AT]);
        is_header.then(|| Self::checked(bytes))
    }

    fn checked(bytes: &[u8; HEADER_BYTES]) -> Result<Self, FrameStreamError> {
        let [version, format, layout, flags] = [bytes[4], bytes[5], bytes[6], bytes[7]];
        if version != VERSION {
            return Err(FrameStreamError::Version { found: version });
        }
        let format = match format {
            0 => PayloadFormat::Grey8,
            1 => PayloadFormat::Jpeg,
            found => return Err(FrameStreamError::Format { found }),
        };
        let layout = match layout {
            0 => StereoLayout::SideBySide,
            1 => StereoLayout::SideBySideSwapped,
            2 => StereoLayout::Interleaved,
            3 => StereoLayout::InterleavedSwapped,
            found => return Err(FrameStreamError::Layout { found }),
        };
        if flags & !HAS_PAYLOAD_CRC != 0 {
            return Err(FrameStreamError::Flags { found: flags });
        }
        let captured_ns = u64_at(bytes, 16);
        let header = Self {
            sequence: u64_at(bytes, 8),
            captured_ns: (captured_ns != 0).then_some(captured_ns),
            width_px: u32_at(bytes, 24),
            height_px: u32_at(bytes, 28),
            format,
            layout,
            payload_bytes: u32_at(bytes, 32),
            payload_crc: (flags & HAS_PAYLOAD_CRC != 0).then_some(u32_at(bytes, 36)),
        };
        header.validate()?;
        Ok(header)
    }

    /// Checks the size of the frame and of its payload.
    ///
    /// # Errors
    /// [`FrameStreamError::Size`] or [`FrameStreamError::Length`].
    pub fn validate(&self) -> Result<(), FrameStreamError> {
        let Self { width_px, height_px, payload_bytes: found, .. } = *self;
        let valid = 1..=MAX_SIDE_PX;
        if !valid.contains(&width_px) || !valid.contains(&height_px) || width_px % 2 != 0 {
            return Err(FrameStreamError::Size { width_px, height_px });
        }
        let expected = match self.format {
            PayloadFormat::Grey8 => Some(width_px * height_px),
            PayloadFormat::Jpeg => None,
        };
        let fits = expected.is_none_or(|expected| expected == found);
        if !fits || found == 0 || found > MAX_PAYLOAD_BYTES {
            return Err(FrameStreamError::Length { found, expected: expected.filter(|_| !fits) });
        }
        Ok(())
    }
}

fn u32_at(bytes: &[u8; HEADER_BYTES], at: usize) -> u32 {
    u32::from_le_bytes(core::array::from_fn(|i| bytes[at + i]))
}

fn u64_at(bytes: &[u8; HEADER_BYTES], at: usize) -> u64 {
    u64::from_le_bytes(core::array::from_fn(|i| bytes[at + i]))
}

/// Decodes a stream. It holds one header and the longest payload received.
#[derive(Clone, Debug, Default)]
pub struct FrameDecoder {
    /// Header bytes so far; they start with a prefix of the magic bytes.
    head: Vec<u8>,
    /// The header whose payload is being read.
    header: Option<FrameHeader>,
    payload: Vec<u8>,
    /// Bytes skipped since the last frame.
    skipped: u64,
}

impl FrameDecoder {
    /// Consumes bytes from the front of `bytes` until a frame or an error is complete; `None` once all
    /// are consumed. The frame's payload is in [`Self::payload`] until the next call.
    ///
    /// # Errors
    /// [`FrameStreamError`]; the next call continues after it.
    pub fn next_frame(&mut self, bytes: &mut &[u8]) -> Option<Result<FrameHeader, FrameStreamError>> {
        loop {
            if let Some(header) = self.header {
                return self.fill_payload(&header, bytes);
            }
            match self.fill_head(bytes)? {
                Ok(header) => {
                    self.payload.clear();
                    self.header = Some(header);
                }
                Err(error) => return Some(Err(error)),
            }
            if let Some(skipped) = self.take_skipped() {
                return Some(Err(skipped));
            }
        }
    }

    /// Payload of the last frame.
    #[must_use]
    pub fn payload(&self) -> &[u8] {
        &self.payload
    }

    /// Swaps the last frame's payload for a buffer that the next frame may use.
    pub fn swap_payload(&mut self, buffer: &mut Vec<u8>) {
        core::mem::swap(&mut self.payload, buffer);
    }

    /// Reports a truncated frame or trailing bytes that belong to no frame, and resets the decoder.
    ///
    /// # Errors
    /// [`FrameStreamError::Cut`] or [`FrameStreamError::Skipped`].
    pub fn finish(&mut self) -> Result<(), FrameStreamError> {
        let head = core::mem::take(&mut self.head).len();
        if let Some(header) = self.header.take() {
            let expected = HEADER_BYTES + header.payload_bytes as usize;
            return Err(FrameStreamError::Cut { found: HEADER_BYTES + self.payload.len(), expected });
        }
        match self.take_skipped() {
            Some(FrameStreamError::Skipped { bytes }) => {
                Err(FrameStreamError::Skipped { bytes: bytes + head as u64 })
            }
            _ if head > 0 => Err(FrameStreamError::Cut { found: head, expected: HEADER_BYTES }),
            _ => Ok(()),
        }
    }

    fn take_skipped(&mut self) -> Option<FrameStreamError> {
        let bytes = core::mem::take(&mut self.skipped);
        (bytes > 0).then_some(FrameStreamError::Skipped { bytes })
    }

    fn fill_payload(
        &mut self,
        header: &FrameHeader,
        bytes: &mut &[u8],
    ) -> Option<Result<FrameHeader, FrameStreamError>> {
        // A random header with a valid checksum may state a large length: memory grows with the bytes
        // received only.
        let missing = header.payload_bytes as usize - self.payload.len();
        let (taken, rest) = bytes.split_at(missing.min(bytes.len()));
        self.payload.extend_from_slice(taken);
        *bytes = rest;
        if taken.len() < missing {
            return None;
        }
        self.header = None;
        let is_whole = header.payload_crc.is_none_or(|crc| crc == crc32fast::hash(&self.payload));
        Some(if is_whole {
            Ok(*header)
        } else {
            Err(FrameStreamError::Payload { sequence: header.sequence })
        })
    }

    fn fill_head(&mut self, bytes: &mut &[u8]) -> Option<Result<FrameHeader, FrameStreamError>> {
        loop {
            if self.skipped >= MAX_SKIPPED_BYTES {
                return self.take_skipped().map(Err);
            }
            if self.head.is_empty() {
                let start = bytes.iter().position(|&byte| byte == MAGIC[0]).unwrap_or(bytes.len());
                self.skipped += start as u64;
                *bytes = &bytes[start..];
            }
            let missing = HEADER_BYTES - self.head.len();
            let (taken, rest) = bytes.split_at(missing.min(bytes.len()));
            self.head.extend_from_slice(taken);
            *bytes = rest;
            let complete: Option<&[u8; HEADER_BYTES]> = self.head.as_slice().try_into().ok();
            if let Some(found) = complete.and_then(FrameHeader::decode) {
                self.head.clear();
                return Some(found);
            }
            if self.head.len() < HEADER_BYTES && begins_like_magic(&self.head) {
                return None;
            }
            self.next_start();
        }
    }

    /// Drops the first byte, and the bytes after it that cannot start a header.
    fn next_start(&mut self) {
        let start = (1..self.head.len()).find(|&i| begins_like_magic(&self.head[i..]));
        let dropped = start.unwrap_or(self.head.len());
        self.head.drain(..dropped);
        self.skipped += dropped as u64;
    }
}

fn begins_like_magic(bytes: &[u8]) -> bool {
    bytes.iter().zip(&MAGIC).all(|(byte, magic)| byte == magic)
}

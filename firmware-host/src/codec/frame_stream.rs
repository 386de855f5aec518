//! The frame stream: how a vendor's SDK, GStreamer or a script hands stereo frames to the host through a
//! pipe.
//!
//! A stream is a sequence of frames, each a header of [`HEADER_BYTES`] bytes and its payload;
//! `docs/frame-stream.md` has the table of bytes. [`FrameDecoder`] takes the bytes in chunks of any size, and
//! finds the next frame again after bytes that are none.

use crate::source::StereoLayout;

/// First bytes of every header. The first one is no ASCII and no UTF-8, so that text is never taken for a
/// frame.
pub const MAGIC: [u8; 4] = [0x89, b'G', b'S', b'F'];
/// Version of the format that is written and read.
pub const VERSION: u8 = 1;
/// Length of a header.
pub const HEADER_BYTES: usize = 44;
/// Widest and highest valid frame, both views together.
pub const MAX_SIDE_PX: u32 = 16_384;
/// Longest valid payload: four times a pair of 8 megapixels. It bounds the decoder's memory.
pub const MAX_PAYLOAD_BYTES: u32 = 1 << 26;

/// Bytes that belong to no frame are reported at the next frame, or when there are so many, so that a stream
/// of another kind is noticed: less than two pairs of 640 x 480.
const MAX_SKIPPED_BYTES: u64 = 1 << 20;

/// Bit of the flags that says that the payload has a checksum.
const HAS_PAYLOAD_CRC: u8 = 1;
/// The header's own checksum stands here, over everything before it.
const HEADER_CRC_AT: usize = 40;

/// How the pixels of a frame are stored.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PayloadFormat {
    /// One byte a pixel, row after row without padding.
    Grey8,
    /// One JPEG file that holds both views.
    Jpeg,
}

/// What stands before a payload.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct FrameHeader {
    /// Number of the frame; it grows by 1. A gap is counted as lost frames.
    pub sequence: u64,
    /// Moment of exposure, `CLOCK_MONOTONIC` of the host, nanoseconds; `None` where the producer cannot say.
    pub captured_ns: Option<u64>,
    /// Pixels per row, both views together.
    pub width_px: u32,
    /// Rows, both views together.
    pub height_px: u32,
    /// How the pixels are stored.
    pub format: PayloadFormat,
    /// Where both views stand in the frame.
    pub layout: StereoLayout,
    /// Length of the payload, bytes.
    pub payload_bytes: u32,
    /// CRC-32 of the payload, where the producer computes one.
    pub payload_crc: Option<u32>,
}

/// Why bytes of a stream make no frame. The decoder goes on after each of them.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FrameStreamError {
    /// Bytes that belong to no frame.
    Skipped {
        /// How many.
        bytes: u64,
    },
    /// The header is of another version.
    Version {
        /// What was found.
        found: u8,
    },
    /// The payload's format is unknown.
    Format {
        /// What was found.
        found: u8,
    },
    /// The layout of the views is unknown.
    Layout {
        /// What was found.
        found: u8,
    },
    /// A flag is unknown.
    Flags {
        /// What was found.
        found: u8,
    },
    /// The frame is empty, odd in width, or too large.
    Size {
        /// Pixels per row.
        width_px: u32,
        /// Rows.
        height_px: u32,
    },
    /// The payload is longer than any valid one, empty, or does not fit the size of a grey frame.
    Length {
        /// Length found, bytes.
        found: u32,
        /// Length of a grey frame of that size; `None` for a JPEG file.
        expected: Option<u32>,
    },
    /// The payload differs from its checksum: bytes were lost on the way.
    Payload {
        /// The frame's number.
        sequence: u64,
    },
    /// The stream ended within a frame.
    Cut {
        /// Bytes of the frame that came.
        found: usize,
        /// Bytes of the frame, or of its header where that is not complete.
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
    /// Its bytes.
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

    /// The header that these bytes are; `None` when they are none.
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

/// Takes a stream apart. Its memory is that of one header and of the longest payload that came.
#[derive(Clone, Debug, Default)]
pub struct FrameDecoder {
    /// The header so far; it begins like one.
    head: Vec<u8>,
    /// The header whose payload is being read.
    header: Option<FrameHeader>,
    payload: Vec<u8>,
    /// Bytes passed over since the last frame.
    skipped: u64,
}

impl FrameDecoder {
    /// Takes bytes off the front of `bytes` until a frame or an error is complete; `None` once all are taken.
    /// The payload of the frame stands in [`Self::payload`] until the next call.
    ///
    /// # Errors
    /// [`FrameStreamError`]; the next call goes on after it.
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

    /// The last frame's payload.
    #[must_use]
    pub fn payload(&self) -> &[u8] {
        &self.payload
    }

    /// Hands the last frame's payload over for a buffer that the next one may use.
    pub fn swap_payload(&mut self, buffer: &mut Vec<u8>) {
        core::mem::swap(&mut self.payload, buffer);
    }

    /// Says what the end of the stream cut off, or which last bytes belonged to no frame, and starts anew.
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
        // A valid header of garbage may claim much: memory grows with what comes, not with what is said.
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

    /// Drops the first byte, and those after it that begin no header either.
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

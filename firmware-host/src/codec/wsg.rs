//! Binary protocol of Weiss Robotics' WSG 50 (command set reference manual): frames, commands and
//! replies.
//!
//! A frame is a preamble, a command number, a length, the payload and a checksum; numbers are little-endian.

use std::fmt;

/// Start of every frame.
const PREAMBLE: [u8; 3] = [0xAA; 3];
/// Preamble, command number, length.
const HEADER: usize = 6;
/// Longest accepted payload; the gripper's replies are far shorter.
const MAX_PAYLOAD: usize = 1024;

/// `E_SUCCESS`.
pub const SUCCESS: u16 = 0;
/// `E_CMD_PENDING`: another reply follows when the command is complete.
pub const PENDING: u16 = 0x001A;

/// CRC of a frame up to its payload, initial value 0xFFFF.
///
/// The table is CCITT's (polynomial 0x1021, most significant bit first), but the register is shifted to
/// the right. No standard CRC gives these values.
#[must_use]
pub fn crc(bytes: &[u8]) -> u16 {
    bytes.iter().fold(0xFFFF, |crc, &byte| table_entry(crc as u8 ^ byte) ^ crc >> 8)
}

fn table_entry(index: u8) -> u16 {
    (0..8).fold(
        u16::from(index) << 8,
        |value, _| {
            if value & 0x8000 == 0 { value << 1 } else { value << 1 ^ 0x1021 }
        },
    )
}

/// A command to the gripper.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Command {
    /// Reference the fingers.
    Home,
    /// Move the fingers.
    PrePosition {
        /// Opening.
        width_mm: f32,
        /// Speed.
        speed_mm_s: f32,
        /// On an obstacle, stop instead of reporting a fault.
        stop_on_block: bool,
    },
    /// Stop at the present position.
    Stop,
    /// Stop immediately; [`Command::AcknowledgeFault`] is required before the next move.
    FastStop,
    /// Leave the fault state.
    AcknowledgeFault,
    /// Grasp a part.
    Grasp {
        /// Width of the part.
        width_mm: f32,
        /// Speed.
        speed_mm_s: f32,
    },
    /// Release the part.
    Release {
        /// Opening after the release.
        width_mm: f32,
        /// Speed.
        speed_mm_s: f32,
    },
    /// Limit the grasping force.
    SetForceLimit {
        /// The limit.
        force_n: f32,
    },
    /// Read the opening once.
    GetOpening,
    /// Read the grasping force once.
    GetForce,
    /// Read the grasping state once.
    GetGraspState,
    /// Read the system flags once.
    GetSystemState,
}

impl Command {
    /// Command number.
    #[must_use]
    pub const fn id(&self) -> u8 {
        match self {
            Self::Home => 0x20,
            Self::PrePosition { .. } => 0x21,
            Self::Stop => 0x22,
            Self::FastStop => 0x23,
            Self::AcknowledgeFault => 0x24,
            Self::Grasp { .. } => 0x25,
            Self::Release { .. } => 0x26,
            Self::SetForceLimit { .. } => 0x32,
            Self::GetSystemState => 0x40,
            Self::GetGraspState => 0x41,
            Self::GetOpening => 0x43,
            Self::GetForce => 0x45,
        }
    }

    /// Encodes the frame of the command.
    #[must_use]
    pub fn encode(&self) -> Vec<u8> {
        // No automatic updates: a flag, and a period that is then ignored.
        const ONCE: [u8; 3] = [0; 3];
        let floats =
            |values: &[f32]| values.iter().flat_map(|value| value.to_le_bytes()).collect::<Vec<u8>>();
        let payload = match *self {
            Self::Home => vec![0],
            Self::PrePosition { width_mm, speed_mm_s, stop_on_block } => {
                [vec![u8::from(stop_on_block) << 1], floats(&[width_mm, speed_mm_s])].concat()
            }
            Self::Stop | Self::FastStop => Vec::new(),
            Self::AcknowledgeFault => b"ack".to_vec(),
            Self::Grasp { width_mm, speed_mm_s } | Self::Release { width_mm, speed_mm_s } => {
                floats(&[width_mm, speed_mm_s])
            }
            Self::SetForceLimit { force_n } => floats(&[force_n]),
            Self::GetOpening | Self::GetForce | Self::GetGraspState | Self::GetSystemState => ONCE.to_vec(),
        };
        frame(self.id(), &payload)
    }
}

/// Encodes a frame with any command number and payload.
#[must_use]
pub fn frame(id: u8, payload: &[u8]) -> Vec<u8> {
    let mut bytes = PREAMBLE.to_vec();
    bytes.push(id);
    bytes.extend_from_slice(&(payload.len() as u16).to_le_bytes());
    bytes.extend_from_slice(payload);
    bytes.extend_from_slice(&crc(&bytes).to_le_bytes());
    bytes
}

/// A frame from the gripper.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Reply {
    /// Number of the answered command.
    pub id: u8,
    /// [`SUCCESS`], [`PENDING`] or a fault.
    pub status: u16,
    /// Data after the status.
    pub data: Vec<u8>,
}

impl Reply {
    /// The only value of a reply, as a float.
    #[must_use]
    pub fn float(&self) -> Option<f32> {
        Some(f32::from_le_bytes(self.data.as_slice().try_into().ok()?))
    }

    /// Whether the command is complete.
    ///
    /// # Errors
    /// [`WsgError::Refused`] if the status is a fault.
    pub const fn is_done(&self) -> Result<bool, WsgError> {
        match self.status {
            SUCCESS => Ok(true),
            PENDING => Ok(false),
            status => Err(WsgError::Refused { id: self.id, status }),
        }
    }
}

/// Reason for a missing reply.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum WsgError {
    /// The gripper refused the command.
    Refused {
        /// Command number.
        id: u8,
        /// Status of the gripper.
        status: u16,
    },
    /// A frame has the wrong checksum.
    Checksum {
        /// CRC in the frame.
        found: u16,
        /// CRC computed from its bytes.
        expected: u16,
    },
    /// A frame is too short for a status, or too long.
    Length {
        /// Length of its payload, bytes.
        found: usize,
    },
}

impl fmt::Display for WsgError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Refused { id, status } => {
                write!(f, "the gripper refused command {id:#04x}: {}", status_in_words(*status))
            }
            Self::Checksum { found, expected } => {
                write!(f, "a frame has the checksum {found:#06x}, its bytes give {expected:#06x}")
            }
            Self::Length { found } => {
                write!(f, "a frame has a payload of {found} bytes; valid is 2 to {MAX_PAYLOAD}")
            }
        }
    }
}

impl std::error::Error for WsgError {}

/// Status code in words (appendix of the manual).
fn status_in_words(status: u16) -> String {
    let words = match status {
        1 => "the device is not available",
        2 => "no sensor is connected",
        3 => "it is not initialised; home the gripper first",
        4 => "it runs already",
        5 => "the feature is not supported",
        6 => "the values do not fit together",
        7 => "it took too long",
        8 => "reading failed",
        9 => "writing failed",
        10 => "resources are short",
        11 => "the checksum was wrong",
        12 => "no parameter was expected",
        13 => "a parameter is missing",
        14 => "the command is unknown",
        15 => "the format is wrong",
        16 => "access is denied; acknowledge the fault first",
        17 => "it is open already",
        18 => "the command failed",
        19 => "the command was aborted",
        20 => "the handle is not valid",
        21 => "it was not found",
        22 => "it is not open",
        23 => "input or output failed",
        24 => "a parameter is not valid",
        25 => "an index is out of bounds",
        27 => "there was too much data",
        28 => "a parameter is out of range",
        29 => "the fingers are blocked",
        30 => "the file exists",
        _ => return format!("status {status:#06x}"),
    };
    format!("{words} (status {status:#06x})")
}

/// Assembles replies from received bytes.
#[derive(Clone, Debug, Default)]
pub struct ReplyReader {
    bytes: Vec<u8>,
}

impl ReplyReader {
    /// Adds received bytes and returns the next complete reply, if any. Call again with an empty slice
    /// for more. Bytes that start no frame are skipped.
    ///
    /// # Errors
    /// [`WsgError::Checksum`] or [`WsgError::Length`]; the frame is dropped.
    pub fn push(&mut self, bytes: &[u8]) -> Option<Result<Reply, WsgError>> {
        self.bytes.extend_from_slice(bytes);
        let start = self.bytes.windows(PREAMBLE.len()).position(|window| window == PREAMBLE);
        self.bytes.drain(..start.unwrap_or(self.bytes.len().saturating_sub(PREAMBLE.len() - 1)));
        let &[_, _, _, id, low, high] = self.bytes.first_chunk::<HEADER>()?;
        let length = usize::from(u16::from_le_bytes([low, high]));
        if !(2..=MAX_PAYLOAD).contains(&length) {
            self.bytes.drain(..1);
            return Some(Err(WsgError::Length { found: length }));
        }
        let end = HEADER + length;
        if self.bytes.len() < end + 2 {
            return None;
        }
        let found = u16::from_le_bytes([self.bytes[end], self.bytes[end + 1]]);
        let expected = crc(&self.bytes[..end]);
        if found != expected {
            self.bytes.drain(..1);
            return Some(Err(WsgError::Checksum { found, expected }));
        }
        let payload: Vec<u8> = self.bytes.drain(..end + 2).skip(HEADER).take(length).collect();
        let status = u16::from_le_bytes([payload[0], payload[1]]);
        Some(Ok(Reply { id, status, data: payload[2..].to_vec() }))
    }
}

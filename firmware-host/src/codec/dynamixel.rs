//! Dynamixel protocol 2.0 (ROBOTIS e-Manual): instruction packets and status packets.
//!
//! A packet is a header, an identifier, a length, an instruction, parameters and a CRC; numbers are
//! little-endian. Header bytes that occur in parameters are escaped by a stuffed fourth byte.

use std::fmt;

const HEADER: [u8; 4] = [0xFF, 0xFF, 0xFD, 0x00];
/// Header bytes that must not occur unescaped in parameters.
const FORBIDDEN: [u8; 3] = [0xFF, 0xFF, 0xFD];
/// Header, identifier, length.
const PREFIX: usize = 7;
const STATUS: u8 = 0x55;
/// Error bit of a status: the servo has a hardware fault.
const ALERT: u8 = 0x80;
/// Longest accepted length. Packets of a servo are far shorter; a longer one is corrupt.
const MAX_LENGTH: usize = 1024;

/// Instruction to a servo.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Instruction<'a> {
    /// Check whether the servo is present.
    Ping,
    /// Read bytes of the control table.
    Read {
        /// First address.
        address: u16,
        /// Number of bytes.
        count: u16,
    },
    /// Write bytes of the control table.
    Write {
        /// First address.
        address: u16,
        /// Bytes to write.
        data: &'a [u8],
    },
    /// Restart; clears a hardware fault.
    Reboot,
}

impl Instruction<'_> {
    const fn number(&self) -> u8 {
        match self {
            Self::Ping => 0x01,
            Self::Read { .. } => 0x02,
            Self::Write { .. } => 0x03,
            Self::Reboot => 0x08,
        }
    }

    /// Encodes the packet for servo `id`.
    #[must_use]
    pub fn encode(&self, id: u8) -> Vec<u8> {
        let mut body = vec![self.number()];
        match *self {
            Self::Ping | Self::Reboot => {}
            Self::Read { address, count } => {
                body.extend_from_slice(&address.to_le_bytes());
                body.extend_from_slice(&count.to_le_bytes());
            }
            Self::Write { address, data } => {
                body.extend_from_slice(&address.to_le_bytes());
                body.extend_from_slice(data);
            }
        }
        packet(id, &body)
    }
}

/// Wraps an instruction and its parameters into a packet.
fn packet(id: u8, body: &[u8]) -> Vec<u8> {
    let body = stuff(body);
    let mut bytes = HEADER.to_vec();
    bytes.push(id);
    bytes.extend_from_slice(&(body.len() as u16 + 2).to_le_bytes());
    bytes.extend_from_slice(&body);
    bytes.extend_from_slice(&crc(&bytes).to_le_bytes());
    bytes
}

/// CRC-16 with polynomial 0x8005, most significant bit first, initial value 0.
#[must_use]
pub fn crc(bytes: &[u8]) -> u16 {
    bytes.iter().fold(0, |crc, &byte| {
        (0..8).fold(
            crc ^ u16::from(byte) << 8,
            |crc, _| {
                if crc & 0x8000 == 0 { crc << 1 } else { crc << 1 ^ 0x8005 }
            },
        )
    })
}

fn stuff(body: &[u8]) -> Vec<u8> {
    let mut stuffed = Vec::with_capacity(body.len());
    for &byte in body {
        stuffed.push(byte);
        if stuffed.ends_with(&FORBIDDEN) {
            stuffed.push(FORBIDDEN[2]);
        }
    }
    stuffed
}

fn unstuff(stuffed: &[u8]) -> Vec<u8> {
    let mut body = Vec::with_capacity(stuffed.len());
    let mut position = 0;
    while let Some(&byte) = stuffed.get(position) {
        body.push(byte);
        position += 1;
        if stuffed[..position].ends_with(&FORBIDDEN) && stuffed.get(position) == Some(&FORBIDDEN[2]) {
            position += 1;
        }
    }
    body
}

/// A status packet.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Status {
    /// Identifier of the sender.
    pub id: u8,
    /// Whether the servo has a hardware fault; its control table states which.
    pub alert: bool,
    /// Bytes read.
    pub data: Vec<u8>,
}

/// Reason for a missing status.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum DynamixelError {
    /// The servo refused the instruction.
    Refused {
        /// Identifier of the servo.
        id: u8,
        /// Its error number.
        number: u8,
    },
    /// A packet has the wrong CRC.
    Checksum {
        /// CRC in the packet.
        found: u16,
        /// CRC computed from its bytes.
        expected: u16,
    },
}

impl fmt::Display for DynamixelError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Refused { id, number } => {
                let words = match number {
                    1 => "it could not process the packet",
                    2 => "it does not have this instruction",
                    3 => "the CRC was wrong",
                    4 => "a value is out of range",
                    5 => "the data are too short",
                    6 => "a value is beyond a limit that is set",
                    7 => "this address cannot be read or written now; writing to EEPROM needs torque off",
                    _ => "the number is not standard",
                };
                write!(f, "servo {id} refused the instruction: {words} (error {number})")
            }
            Self::Checksum { found, expected } => {
                write!(f, "a packet has the CRC {found:#06x}, its bytes give {expected:#06x}")
            }
        }
    }
}

impl std::error::Error for DynamixelError {}

/// Assembles status packets from received bytes. The echo of a sent instruction on a one-wire bus is
/// skipped.
#[derive(Clone, Debug, Default)]
pub struct StatusReader {
    bytes: Vec<u8>,
}

impl StatusReader {
    /// Adds received bytes and returns the next complete status, if any. Call again with an empty slice
    /// for more.
    ///
    /// # Errors
    /// [`DynamixelError`].
    pub fn push(&mut self, bytes: &[u8]) -> Option<Result<Status, DynamixelError>> {
        self.bytes.extend_from_slice(bytes);
        loop {
            let start = self.bytes.windows(HEADER.len()).position(|window| window == HEADER);
            self.bytes.drain(..start.unwrap_or(self.bytes.len().saturating_sub(HEADER.len() - 1)));
            let &[_, _, _, _, id, low, high] = self.bytes.first_chunk::<PREFIX>()?;
            let length = usize::from(u16::from_le_bytes([low, high]));
            // The shortest packet has an instruction and a CRC.
            if !(3..=MAX_LENGTH).contains(&length) {
                self.bytes.drain(..1);
                continue;
            }
            let end = PREFIX + length;
            if self.bytes.len() < end {
                return None;
            }
            let found = u16::from_le_bytes([self.bytes[end - 2], self.bytes[end - 1]]);
            let expected = crc(&self.bytes[..end - 2]);
            if found != expected {
                self.bytes.drain(..1);
                return Some(Err(DynamixelError::Checksum { found, expected }));
            }
            let body = unstuff(&self.bytes[PREFIX..end - 2]);
            self.bytes.drain(..end);
            let [STATUS, error, data @ ..] = body.as_slice() else {
                continue;
            };
            return Some(match error & !ALERT {
                0 => Ok(Status { id, alert: error & ALERT != 0, data: data.to_vec() }),
                number => Err(DynamixelError::Refused { id, number }),
            });
        }
    }
}

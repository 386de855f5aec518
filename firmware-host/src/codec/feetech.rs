//! Protocol of Feetech's STS and SMS bus servos: instruction packets and replies.
//!
//! A packet is two bytes 0xFF, an identifier, a length, an instruction, parameters and a checksum, as in
//! Dynamixel protocol 1.0. Numbers in the control table are little-endian; some are sign-magnitude
//! rather than two's complement.

use std::fmt;

const HEADER: [u8; 2] = [0xFF; 2];
/// Header, identifier, length.
const PREFIX: usize = 4;
/// Broadcast identifier; no servo has it.
pub const BROADCAST: u8 = 0xFE;

/// Instruction to a servo.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Instruction<'a> {
    /// Check whether the servo is present.
    Ping,
    /// Read bytes of the control table.
    Read {
        /// First address.
        address: u8,
        /// Number of bytes.
        count: u8,
    },
    /// Write bytes of the control table.
    Write {
        /// First address.
        address: u8,
        /// Bytes to write, at most 251.
        data: &'a [u8],
    },
}

/// Reason for a missing packet or reply.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FeetechError {
    /// The data exceed 251 bytes.
    TooLong {
        /// Number of data bytes.
        found: usize,
    },
    /// A packet has the wrong checksum.
    Checksum {
        /// Checksum in the packet.
        found: u8,
        /// Checksum computed from its bytes.
        expected: u8,
    },
}

impl fmt::Display for FeetechError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::TooLong { found } => write!(f, "the packet would carry {found} bytes; valid is up to 251"),
            Self::Checksum { found, expected } => {
                write!(f, "a packet has the checksum {found:#04x}, its bytes give {expected:#04x}")
            }
        }
    }
}

impl std::error::Error for FeetechError {}

impl Instruction<'_> {
    /// Encodes the packet for servo `id`.
    ///
    /// # Errors
    /// [`FeetechError::TooLong`].
    pub fn encode(&self, id: u8) -> Result<Vec<u8>, FeetechError> {
        let body = match *self {
            Self::Ping => vec![0x01],
            Self::Read { address, count } => vec![0x02, address, count],
            Self::Write { address, data } => [&[0x03, address], data].concat(),
        };
        // The length counts the body and the checksum; 255 would look like a header byte.
        let length = match u8::try_from(body.len() + 1) {
            Ok(length) if length < 0xFF => length,
            _ => return Err(FeetechError::TooLong { found: body.len().saturating_sub(2) }),
        };
        let mut bytes = HEADER.to_vec();
        bytes.extend_from_slice(&[id, length]);
        bytes.extend_from_slice(&body);
        bytes.push(checksum(&bytes));
        Ok(bytes)
    }
}

/// Complement of the sum of all bytes after the header.
fn checksum(packet: &[u8]) -> u8 {
    !packet[HEADER.len()..].iter().fold(0_u8, |sum, &byte| sum.wrapping_add(byte))
}

/// A reply.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Status {
    /// Identifier of the sender.
    pub id: u8,
    /// Present faults of the servo.
    pub faults: Faults,
    /// Bytes read.
    pub data: Vec<u8>,
}

/// Faults of a servo, one bit each. They describe its state; they do not mean that the instruction was
/// refused.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Faults(pub u8);

impl fmt::Display for Faults {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        const WORDS: [(u8, &str); 5] = [
            (0x01, "the supply voltage is out of range"),
            (0x02, "the angle sensor has a fault"),
            (0x04, "the motor is too hot"),
            (0x08, "the motor current is too high"),
            (0x20, "the load is too high"),
        ];
        let known: Vec<&str> =
            WORDS.iter().filter(|(bit, _)| self.0 & bit != 0).map(|&(_, word)| word).collect();
        let rest = WORDS.iter().fold(self.0, |bits, (bit, _)| bits & !bit);
        match (known.is_empty(), rest) {
            (true, 0) => f.write_str("no fault"),
            (false, 0) => f.write_str(&known.join("; ")),
            (true, rest) => write!(f, "fault bits {rest:#04x}"),
            (false, rest) => write!(f, "{}; fault bits {rest:#04x}", known.join("; ")),
        }
    }
}

/// Assembles replies from received bytes.
///
/// A reply has the format of an instruction, and a one-wire bus first returns the echo of the
/// instruction. A packet identical to the sent one is skipped as its echo.
#[derive(Clone, Debug, Default)]
pub struct StatusReader {
    bytes: Vec<u8>,
    echo: Vec<u8>,
}

impl StatusReader {
    /// Reader for replies to `packet`, whose echo is skipped.
    #[must_use]
    pub fn after(packet: &[u8]) -> Self {
        Self { bytes: Vec::new(), echo: packet.to_vec() }
    }

    /// Adds received bytes and returns the next complete reply, if any. Call again with an empty slice
    /// for more.
    ///
    /// # Errors
    /// [`FeetechError::Checksum`].
    pub fn push(&mut self, bytes: &[u8]) -> Option<Result<Status, FeetechError>> {
        self.bytes.extend_from_slice(bytes);
        loop {
            let start = self.bytes.windows(HEADER.len()).position(|window| window == HEADER);
            self.bytes.drain(..start.unwrap_or(self.bytes.len().saturating_sub(HEADER.len() - 1)));
            let &[_, _, id, length] = self.bytes.first_chunk::<PREFIX>()?;
            // A third 0xFF shifts the header by one. The shortest reply has an error byte and a
            // checksum.
            if id == 0xFF || length < 2 {
                self.bytes.drain(..1);
                continue;
            }
            let end = PREFIX + usize::from(length);
            if self.bytes.len() < end {
                return None;
            }
            let (found, expected) = (self.bytes[end - 1], checksum(&self.bytes[..end - 1]));
            if found != expected {
                self.bytes.drain(..1);
                return Some(Err(FeetechError::Checksum { found, expected }));
            }
            let packet: Vec<u8> = self.bytes.drain(..end).collect();
            if packet == self.echo {
                self.echo.clear();
                continue;
            }
            let faults = Faults(packet[PREFIX]);
            return Some(Ok(Status { id, faults, data: packet[PREFIX + 1..end - 1].to_vec() }));
        }
    }
}

/// Decodes a sign-magnitude number of the control table with its sign in bit `sign_bit`.
#[must_use]
pub const fn signed(value: u16, sign_bit: u32) -> i32 {
    let magnitude = (value & ((1 << sign_bit) - 1)) as i32;
    if value >> sign_bit & 1 == 1 { -magnitude } else { magnitude }
}

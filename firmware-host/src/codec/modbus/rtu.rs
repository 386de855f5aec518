//! Modbus RTU: unit address, protocol data unit, CRC-16 (Modbus over Serial Line V1.02, section 2.5).

use super::{EXCEPTION, ModbusError, Reply, Request};

/// Address, function, exception code, CRC.
const EXCEPTION_LENGTH: usize = 5;
/// Address before and CRC after the protocol data unit.
const ENVELOPE: usize = 3;
/// Longest frame (section 2.5.1).
pub const MAX_FRAME: usize = 256;

/// CRC-16 with reflected polynomial 0xA001, initial value 0xFFFF.
#[must_use]
pub fn crc(bytes: &[u8]) -> u16 {
    bytes.iter().fold(0xFFFF, |crc, &byte| {
        (0..8).fold(crc ^ u16::from(byte), |crc, _| if crc & 1 == 1 { crc >> 1 ^ 0xA001 } else { crc >> 1 })
    })
}

/// Encodes the frame of a request to a unit.
///
/// # Errors
/// [`ModbusError::Count`].
pub fn encode(unit: u8, request: &Request<'_>) -> Result<Vec<u8>, ModbusError> {
    let mut frame = vec![unit];
    request.encode(&mut frame)?;
    frame.extend_from_slice(&crc(&frame).to_le_bytes());
    Ok(frame)
}

/// Assembles one reply from received bytes.
///
/// A reply does not contain its length; the request determines it. Bytes that cannot start the reply are
/// skipped, so that line noise and replies to other units do not hide it.
#[derive(Clone, Debug)]
pub struct ReplyReader<'a> {
    unit: u8,
    request: Request<'a>,
    bytes: Vec<u8>,
    skipped: usize,
}

impl<'a> ReplyReader<'a> {
    /// Reader for the reply of `unit` to `request`.
    #[must_use]
    pub const fn new(unit: u8, request: Request<'a>) -> Self {
        Self { unit, request, bytes: Vec::new(), skipped: 0 }
    }

    /// Number of skipped bytes.
    #[must_use]
    pub const fn skipped(&self) -> usize {
        self.skipped
    }

    /// Adds received bytes. Returns `None` until the reply is complete.
    ///
    /// # Errors
    /// [`ModbusError::Exception`] if the device refused; [`ModbusError::Foreign`] or
    /// [`ModbusError::Frame`] if a frame with a correct CRC does not match the request.
    pub fn push(&mut self, bytes: &[u8]) -> Option<Result<Reply, ModbusError>> {
        self.bytes.extend_from_slice(bytes);
        while self.bytes.len() >= EXCEPTION_LENGTH {
            let Some(length) = self.candidate_length() else {
                self.skip();
                continue;
            };
            if self.bytes.len() < length {
                return None;
            }
            let (body, check) = self.bytes[..length].split_at(length - 2);
            if crc(body).to_le_bytes() != check {
                self.skip();
                continue;
            }
            let reply = self.request.decode(&body[1..]);
            self.bytes.drain(..length);
            return Some(reply);
        }
        None
    }

    /// Length of the frame that may start at the first byte.
    fn candidate_length(&self) -> Option<usize> {
        let [unit, function] = *self.bytes.first_chunk()?;
        match (unit == self.unit, function) {
            (false, _) => None,
            (true, f) if f == self.request.function() => Some(self.request.reply_length() + ENVELOPE),
            (true, f) if f == self.request.function() | EXCEPTION => Some(EXCEPTION_LENGTH),
            (true, _) => None,
        }
    }

    fn skip(&mut self) {
        self.bytes.remove(0);
        self.skipped += 1;
    }
}

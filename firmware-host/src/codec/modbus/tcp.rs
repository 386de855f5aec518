//! Modbus TCP: a header with transaction number and length before the protocol data unit (MODBUS
//! Messaging on TCP/IP V1.0b, section 3.1.3).

use super::{ModbusError, Reply, Request};

/// Transaction, protocol, length, unit.
const HEADER: usize = 7;
/// Longest protocol data unit including its unit address.
const MAX_LENGTH: usize = 254;

/// Encodes the frame of a request to a unit. The reply repeats `transaction`.
///
/// # Errors
/// [`ModbusError::Count`].
pub fn encode(transaction: u16, unit: u8, request: &Request<'_>) -> Result<Vec<u8>, ModbusError> {
    let mut body = vec![unit];
    request.encode(&mut body)?;
    let mut frame = Vec::with_capacity(HEADER + body.len());
    frame.extend_from_slice(&transaction.to_be_bytes());
    frame.extend_from_slice(&0_u16.to_be_bytes());
    frame.extend_from_slice(&(body.len() as u16).to_be_bytes());
    frame.extend_from_slice(&body);
    Ok(frame)
}

/// Assembles one reply from received bytes. Replies with another transaction number are late and are
/// skipped.
#[derive(Clone, Debug)]
pub struct ReplyReader<'a> {
    transaction: u16,
    unit: u8,
    request: Request<'a>,
    bytes: Vec<u8>,
    late: usize,
}

impl<'a> ReplyReader<'a> {
    /// Reader for the reply to `request`, sent to `unit` as `transaction`.
    #[must_use]
    pub const fn new(transaction: u16, unit: u8, request: Request<'a>) -> Self {
        Self { transaction, unit, request, bytes: Vec::new(), late: 0 }
    }

    /// Number of skipped replies to earlier requests.
    #[must_use]
    pub const fn late(&self) -> usize {
        self.late
    }

    /// Adds received bytes. Returns `None` until the reply is complete.
    ///
    /// # Errors
    /// [`ModbusError`]; after [`ModbusError::Frame`] the connection is out of sync and must be closed.
    pub fn push(&mut self, bytes: &[u8]) -> Option<Result<Reply, ModbusError>> {
        self.bytes.extend_from_slice(bytes);
        loop {
            let header: [u8; HEADER] = *self.bytes.first_chunk()?;
            let word = |at: usize| u16::from_be_bytes([header[at], header[at + 1]]);
            let (transaction, protocol, length) = (word(0), word(2), usize::from(word(4)));
            if protocol != 0 {
                return Some(Err(ModbusError::Frame { message: "its protocol number is not 0" }));
            }
            if !(2..=MAX_LENGTH).contains(&length) {
                return Some(Err(ModbusError::Frame { message: "its length is not 2 to 254" }));
            }
            let end = HEADER - 1 + length;
            if self.bytes.len() < end {
                return None;
            }
            let unit = header[HEADER - 1];
            let body: Vec<u8> = self.bytes.drain(..end).skip(HEADER).collect();
            if transaction != self.transaction {
                self.late += 1;
                continue;
            }
            if unit != self.unit {
                let (found, expected) = (unit.into(), self.unit.into());
                return Some(Err(ModbusError::Foreign { field: "unit", found, expected }));
            }
            return Some(self.request.decode(&body));
        }
    }
}

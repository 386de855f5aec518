//! Modbus without transport: encodes requests and decodes replies (Modbus Application Protocol V1.1b3).
//!
//! [`rtu`] frames requests for serial lines, [`tcp`] for Modbus TCP. Only the five functions that
//! grippers use are implemented. Registers are big-endian.

pub mod rtu;
pub mod tcp;

use std::fmt;

/// Most registers in one read (section 6.3: the reply's byte count is one byte, 0x7D registers).
pub const MAX_READ: u16 = 0x7D;
/// Most registers in one write (section 6.12).
pub const MAX_WRITE: usize = 0x7B;
/// Most registers in the write half of a read-and-write (section 6.17).
pub const MAX_READ_WRITE: usize = 0x79;
/// Bit of the function code that marks an exception.
const EXCEPTION: u8 = 0x80;

/// Request of a master to a device.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Request<'a> {
    /// Function 0x03.
    ReadHolding {
        /// First register.
        address: u16,
        /// Number of registers, 1 to [`MAX_READ`].
        count: u16,
    },
    /// Function 0x04.
    ReadInput {
        /// First register.
        address: u16,
        /// Number of registers, 1 to [`MAX_READ`].
        count: u16,
    },
    /// Function 0x06.
    WriteSingle {
        /// The register.
        address: u16,
        /// Value to write.
        value: u16,
    },
    /// Function 0x10.
    WriteMultiple {
        /// First register.
        address: u16,
        /// 1 to [`MAX_WRITE`] values.
        values: &'a [u16],
    },
    /// Function 0x17: the device writes first, then reads.
    ReadWrite {
        /// First register to read.
        read_address: u16,
        /// Number of registers to read, 1 to [`MAX_READ`].
        read_count: u16,
        /// First register to write.
        write_address: u16,
        /// 1 to [`MAX_READ_WRITE`] values.
        values: &'a [u16],
    },
}

/// Reply of a device.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Reply {
    /// Values read.
    Registers(Vec<u16>),
    /// The write was done.
    Written,
}

/// Reason for a missing or mismatched reply.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum ModbusError {
    /// The request has too few or too many registers.
    Count {
        /// Number requested.
        found: usize,
        /// Largest valid number.
        max: usize,
    },
    /// The device refused the request.
    Exception {
        /// Refused function.
        function: u8,
        /// Exception code of the device.
        code: u8,
    },
    /// The reply belongs to another request: it is late, or from another device.
    Foreign {
        /// Field that differs.
        field: &'static str,
        /// Value in the reply.
        found: u16,
        /// Value expected for the request.
        expected: u16,
    },
    /// The bytes are not a valid reply.
    Frame {
        /// What is wrong with them.
        message: &'static str,
    },
}

impl fmt::Display for ModbusError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Count { found, max } => {
                write!(f, "the request is for {found} registers; valid is 1 to {max}")
            }
            Self::Exception { function, code } => write!(
                f,
                "the device refused function {function:#04x}: {} (exception {code})",
                exception_in_words(*code)
            ),
            Self::Foreign { field, found, expected } => {
                write!(f, "the reply is to another request: its {field} is {found}, expected {expected}")
            }
            Self::Frame { message } => write!(f, "the reply is damaged: {message}"),
        }
    }
}

impl std::error::Error for ModbusError {}

/// Exception code in words (section 7 of the specification).
const fn exception_in_words(code: u8) -> &'static str {
    match code {
        1 => "it does not have this function",
        2 => "it does not have this register",
        3 => "the value is not valid",
        4 => "it failed while it worked on the request",
        5 => "it accepted the request and needs more time",
        6 => "it is busy; try again",
        8 => "its memory is damaged",
        10 => "the gateway has no path to the device",
        11 => "the device behind the gateway does not answer",
        _ => "the code is not standard",
    }
}

impl Request<'_> {
    /// Function code.
    #[must_use]
    pub const fn function(&self) -> u8 {
        match self {
            Self::ReadHolding { .. } => 0x03,
            Self::ReadInput { .. } => 0x04,
            Self::WriteSingle { .. } => 0x06,
            Self::WriteMultiple { .. } => 0x10,
            Self::ReadWrite { .. } => 0x17,
        }
    }

    fn check(&self) -> Result<(), ModbusError> {
        let within = |found: usize, max: usize| {
            if (1..=max).contains(&found) { Ok(()) } else { Err(ModbusError::Count { found, max }) }
        };
        match *self {
            Self::ReadHolding { count, .. } | Self::ReadInput { count, .. } => {
                within(count.into(), MAX_READ.into())
            }
            Self::WriteSingle { .. } => Ok(()),
            Self::WriteMultiple { values, .. } => within(values.len(), MAX_WRITE),
            Self::ReadWrite { read_count, values, .. } => {
                within(read_count.into(), MAX_READ.into())?;
                within(values.len(), MAX_READ_WRITE)
            }
        }
    }

    /// Appends the protocol data unit: function code and data.
    fn encode(&self, out: &mut Vec<u8>) -> Result<(), ModbusError> {
        self.check()?;
        out.push(self.function());
        let mut word = |value: u16| out.extend_from_slice(&value.to_be_bytes());
        match *self {
            Self::ReadHolding { address, count } | Self::ReadInput { address, count } => {
                word(address);
                word(count);
            }
            Self::WriteSingle { address, value } => {
                word(address);
                word(value);
            }
            Self::WriteMultiple { address, values } => {
                word(address);
                append_values(out, values);
            }
            Self::ReadWrite { read_address, read_count, write_address, values } => {
                word(read_address);
                word(read_count);
                word(write_address);
                append_values(out, values);
            }
        }
        Ok(())
    }

    /// Length of the protocol data unit of the reply.
    const fn reply_length(&self) -> usize {
        match *self {
            Self::ReadHolding { count, .. }
            | Self::ReadInput { count, .. }
            | Self::ReadWrite { read_count: count, .. } => 2 + 2 * count as usize,
            Self::WriteSingle { .. } | Self::WriteMultiple { .. } => 5,
        }
    }

    /// Decodes the protocol data unit of a reply.
    fn decode(&self, unit: &[u8]) -> Result<Reply, ModbusError> {
        let (&function, data) =
            unit.split_first().ok_or(ModbusError::Frame { message: "it has no function code" })?;
        if function == self.function() | EXCEPTION {
            let &[code] = data else {
                return Err(ModbusError::Frame { message: "an exception has one byte of data" });
            };
            return Err(ModbusError::Exception { function: self.function(), code });
        }
        let same = |field, found: u16, expected: u16| {
            if found == expected { Ok(()) } else { Err(ModbusError::Foreign { field, found, expected }) }
        };
        same("function code", function.into(), self.function().into())?;
        if unit.len() != self.reply_length() {
            return Err(ModbusError::Frame { message: "its length does not fit the request" });
        }
        let word = |at: usize| u16::from_be_bytes([data[at], data[at + 1]]);
        match *self {
            Self::ReadHolding { count, .. }
            | Self::ReadInput { count, .. }
            | Self::ReadWrite { read_count: count, .. } => {
                same("byte count", data[0].into(), 2 * count)?;
                Ok(Reply::Registers((0..count as usize).map(|i| word(1 + 2 * i)).collect()))
            }
            Self::WriteSingle { address, value } => {
                same("address", word(0), address)?;
                same("value", word(2), value)?;
                Ok(Reply::Written)
            }
            Self::WriteMultiple { address, values } => {
                same("address", word(0), address)?;
                same("count", word(2), values.len() as u16)?;
                Ok(Reply::Written)
            }
        }
    }
}

/// Appends the register count, the byte count and the registers.
fn append_values(out: &mut Vec<u8>, values: &[u16]) {
    out.extend_from_slice(&(values.len() as u16).to_be_bytes());
    out.push(2 * values.len() as u8);
    for value in values {
        out.extend_from_slice(&value.to_be_bytes());
    }
}

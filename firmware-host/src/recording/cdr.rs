//! Plain CDR, little endian: the serialisation of ROS 2 messages (OMG CDR, XCDR version 1).
//!
//! Every primitive is aligned to its own size, counted from the byte after the 4-byte encapsulation.

/// Encapsulation: little-endian CDR, no options.
const ENCAPSULATION: [u8; 4] = [0, 1, 0, 0];

/// Serialises one message.
#[derive(Clone, Debug)]
pub struct Encoder {
    bytes: Vec<u8>,
}

impl Default for Encoder {
    fn default() -> Self {
        Self { bytes: ENCAPSULATION.to_vec() }
    }
}

impl Encoder {
    /// Returns the message.
    #[must_use]
    pub fn finish(self) -> Vec<u8> {
        self.bytes
    }

    fn aligned(mut self, bytes: &[u8]) -> Self {
        let offset = self.bytes.len() - ENCAPSULATION.len();
        self.bytes.resize(self.bytes.len() + offset.next_multiple_of(bytes.len()) - offset, 0);
        self.bytes.extend_from_slice(bytes);
        self
    }

    /// One byte; also ROS's bool.
    #[must_use]
    pub fn u8(self, value: u8) -> Self {
        self.aligned(&[value])
    }

    /// Four bytes.
    #[must_use]
    pub fn u32(self, value: u32) -> Self {
        self.aligned(&value.to_le_bytes())
    }

    /// Four bytes.
    #[must_use]
    pub fn i32(self, value: i32) -> Self {
        self.aligned(&value.to_le_bytes())
    }

    /// A fixed-size array of float64.
    #[must_use]
    pub fn f64s(self, values: &[f64]) -> Self {
        values.iter().fold(self, |encoder, value| encoder.aligned(&value.to_le_bytes()))
    }

    /// A sequence of float64.
    #[must_use]
    pub fn f64_sequence(self, values: &[f64]) -> Self {
        self.u32(values.len() as u32).f64s(values)
    }

    /// A sequence of bytes.
    #[must_use]
    pub fn byte_sequence(self, values: &[u8]) -> Self {
        let mut encoder = self.u32(values.len() as u32);
        encoder.bytes.extend_from_slice(values);
        encoder
    }

    /// A string; CDR counts and writes the terminating zero.
    #[must_use]
    pub fn string(self, value: &str) -> Self {
        let mut encoder = self.u32(value.len() as u32 + 1);
        encoder.bytes.extend_from_slice(value.as_bytes());
        encoder.bytes.push(0);
        encoder
    }
}

/// A message that does not match its schema.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum CdrError {
    /// The encapsulation is not plain little-endian CDR.
    Encapsulation {
        /// First four bytes.
        found: [u8; 4],
    },
    /// The message ends within a field.
    TooShort {
        /// Bytes needed up to the end of the field, from the start of the message.
        needed: usize,
        /// Length of the message in bytes.
        found: usize,
    },
    /// A string is not UTF-8 or lacks its terminating zero.
    String,
}

impl std::fmt::Display for CdrError {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Encapsulation { found } => {
                write!(f, "the message starts with {found:?}; valid is little-endian CDR, [0, 1, 0, 0]")
            }
            Self::TooShort { needed, found } => {
                write!(f, "the message has {found} bytes, but a field ends at byte {needed}")
            }
            Self::String => write!(f, "a string of the message is not UTF-8 with a final zero"),
        }
    }
}

impl std::error::Error for CdrError {}

/// Reads one message, field by field.
#[derive(Clone, Debug)]
pub struct Decoder<'a> {
    bytes: &'a [u8],
    position: usize,
}

impl<'a> Decoder<'a> {
    /// Starts after the encapsulation.
    ///
    /// # Errors
    /// [`CdrError::Encapsulation`] or [`CdrError::TooShort`].
    pub fn new(bytes: &'a [u8]) -> Result<Self, CdrError> {
        match bytes.first_chunk() {
            Some(&ENCAPSULATION) => Ok(Self { bytes, position: ENCAPSULATION.len() }),
            Some(&found) => Err(CdrError::Encapsulation { found }),
            None => Err(CdrError::TooShort { needed: ENCAPSULATION.len(), found: bytes.len() }),
        }
    }

    fn take(&mut self, count: usize) -> Result<&'a [u8], CdrError> {
        let needed = self.position.saturating_add(count);
        let field = self
            .bytes
            .get(self.position..needed)
            .ok_or(CdrError::TooShort { needed, found: self.bytes.len() })?;
        self.position = needed;
        Ok(field)
    }

    /// One byte.
    ///
    /// # Errors
    /// [`CdrError::TooShort`].
    pub fn u8(&mut self) -> Result<u8, CdrError> {
        Ok(self.take(1)?[0])
    }

    /// Four bytes.
    ///
    /// # Errors
    /// [`CdrError::TooShort`].
    pub fn u32(&mut self) -> Result<u32, CdrError> {
        let offset = self.position - ENCAPSULATION.len();
        self.take(offset.next_multiple_of(4) - offset)?;
        let field = self.take(4)?;
        Ok(u32::from_le_bytes([field[0], field[1], field[2], field[3]]))
    }

    /// A sequence of bytes.
    ///
    /// # Errors
    /// [`CdrError::TooShort`].
    pub fn byte_sequence(&mut self) -> Result<&'a [u8], CdrError> {
        let count = self.u32()? as usize;
        self.take(count)
    }

    /// A string.
    ///
    /// # Errors
    /// [`CdrError`].
    pub fn string(&mut self) -> Result<&'a str, CdrError> {
        let field = self.byte_sequence()?;
        let (&last, text) = field.split_last().ok_or(CdrError::String)?;
        if last != 0 {
            return Err(CdrError::String);
        }
        std::str::from_utf8(text).map_err(|_| CdrError::String)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Expected bytes derived by hand from the rules: 4 bytes of encapsulation, a byte, padding to 4, a
    /// string of length 3 including its zero, padding to 8, a double.
    #[test]
    fn alignment_is_counted_after_the_encapsulation() {
        let bytes = Encoder::default().u8(7).string("ab").f64s(&[1.0]).finish();
        let expected =
            [0, 1, 0, 0, 7, 0, 0, 0, 3, 0, 0, 0, b'a', b'b', 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0xF0, 0x3F];
        assert_eq!(bytes[..15], expected[..15]);
        // The field ends at offset 11, so the double starts at offset 16 (byte 20).
        assert_eq!(bytes.len(), 28);
        assert_eq!(bytes[20..], 1.0_f64.to_le_bytes());
    }

    #[test]
    fn what_was_written_is_read_back_and_every_cut_is_an_error() {
        let bytes = Encoder::default().u8(9).u32(77).string("left").byte_sequence(&[1, 2, 3]).finish();
        let read = |bytes: &[u8]| -> Result<(u8, u32, String, Vec<u8>), CdrError> {
            let mut d = Decoder::new(bytes)?;
            Ok((d.u8()?, d.u32()?, d.string()?.to_owned(), d.byte_sequence()?.to_vec()))
        };
        assert_eq!(read(&bytes), Ok((9, 77, "left".to_owned(), vec![1, 2, 3])));
        for cut in 0..bytes.len() {
            assert!(matches!(read(&bytes[..cut]), Err(CdrError::TooShort { .. })), "cut at {cut}");
        }
    }
}

//! Digest of results, to compare two runs bit for bit.

/// 64-bit FNV-1a over the input bits, in order. It detects differences; it is not collision-resistant.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Digest(u64);

impl Default for Digest {
    fn default() -> Self {
        Self::new()
    }
}

impl Digest {
    /// The digest of no input.
    #[must_use]
    pub const fn new() -> Self {
        Self(0xCBF2_9CE4_8422_2325)
    }

    /// Adds these bytes.
    #[must_use]
    pub fn bytes(mut self, bytes: &[u8]) -> Self {
        for &byte in bytes {
            self.0 = (self.0 ^ u64::from(byte)).wrapping_mul(0x0000_0100_0000_01B3);
        }
        self
    }

    /// Adds this integer.
    #[must_use]
    pub fn u64(self, value: u64) -> Self {
        self.bytes(&value.to_le_bytes())
    }

    /// Adds these numbers, bit for bit (0.0 and -0.0 differ).
    #[must_use]
    pub fn f64s(mut self, values: impl IntoIterator<Item = f64>) -> Self {
        for value in values {
            self = self.u64(value.to_bits());
        }
        self
    }

    /// The digest.
    #[must_use]
    pub const fn value(self) -> u64 {
        self.0
    }
}

//! Random streams keyed by (seed, name): a stream's numbers are independent of other streams.

use super::{cos, exp, ln, sin, sqrt};
use crate::digest::Digest;

/// xoshiro256++ (Blackman and Vigna 2021), seeded through SplitMix64 from a seed and a name.
#[derive(Clone, Debug)]
pub struct Stream {
    state: [u64; 4],
}

impl Stream {
    /// The stream of this seed and name.
    #[must_use]
    pub fn new(seed: u64, name: &str) -> Self {
        let mut key = seed ^ Digest::new().bytes(name.as_bytes()).value();
        Self { state: core::array::from_fn(|_| split_mix(&mut key)) }
    }

    /// The next 64 uniform bits.
    pub fn next_u64(&mut self) -> u64 {
        let s = &mut self.state;
        let result = s[0].wrapping_add(s[3]).rotate_left(23).wrapping_add(s[0]);
        let t = s[1] << 17;
        s[2] ^= s[0];
        s[3] ^= s[1];
        s[1] ^= s[2];
        s[0] ^= s[3];
        s[2] ^= t;
        s[3] = s[3].rotate_left(45);
        result
    }

    /// Uniform in [0, 1), 53 bits.
    pub fn uniform(&mut self) -> f64 {
        (self.next_u64() >> 11) as f64 / (1_u64 << 53) as f64
    }

    /// A number from `low` to `high`, both above 0, whose logarithm is uniform.
    pub fn log_uniform(&mut self, low: f64, high: f64) -> f64 {
        let (from, to) = (ln(low), ln(high));
        exp(from + (to - from) * self.uniform()).clamp(low, high)
    }

    /// Uniform index below `n`, by Lemire's multiplication; the bias is below n / 2^64. `n` must not be 0.
    pub fn below(&mut self, n: usize) -> usize {
        ((u128::from(self.next_u64()) * n as u128) >> 64) as usize
    }

    /// Two independent standard normal numbers (Box and Muller 1958).
    pub fn normal_pair(&mut self) -> (f64, f64) {
        let radius = sqrt(-2.0 * ln(1.0 - self.uniform()));
        let angle = core::f64::consts::TAU * self.uniform();
        (radius * cos(angle), radius * sin(angle))
    }

    /// A standard normal number.
    pub fn normal(&mut self) -> f64 {
        self.normal_pair().0
    }
}

/// 64 uniform bits that depend only on key and index: the index-th output of SplitMix64 from that key.
#[must_use]
pub const fn keyed(key: u64, index: usize) -> u64 {
    split_mix(&mut key.wrapping_add((index as u64).wrapping_mul(GOLDEN)))
}

/// 2^64 over the golden ratio, made odd: the increment of SplitMix64 (Steele, Lea and Flood 2014).
const GOLDEN: u64 = 0x9E37_79B9_7F4A_7C15;

const fn split_mix(key: &mut u64) -> u64 {
    *key = key.wrapping_add(GOLDEN);
    let mut z = *key;
    z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
    z ^ (z >> 31)
}

//! The Bessel function J1 from a table.

use crate::math::{abs, bessel_j1, round_even};
use alloc::vec::Vec;

/// Nodes per unit. Linear interpolation of J1 is accurate to 1 / 16² / 8 · 0.5 = 2.4e-4; such weight
/// errors cost 1e-7 of precision.
const PER_UNIT: f64 = 16.0;
/// Integer steps per unit of J1, which is at most 0.582; 16-bit values keep the table small.
const STEPS: f64 = 50_000.0;

/// J1 up to a largest argument.
#[derive(Clone, Debug)]
pub(super) struct Bessel(Vec<i16>);

impl Bessel {
    /// Table for arguments up to this magnitude.
    pub fn up_to(max: f64) -> Self {
        let last = (max * PER_UNIT) as usize + 2;
        Self((0..=last).map(|n| round_even(STEPS * bessel_j1(n as f64 / PER_UNIT)) as i16).collect())
    }

    /// J1, an odd function; the last value beyond the table.
    pub fn j1(&self, x: f64) -> f64 {
        let at = (abs(x) * PER_UNIT).min((self.0.len() - 2) as f64);
        let (first, part) = (at as usize, at - at as usize as f64);
        let (a, b) = (f64::from(self.0[first]), f64::from(self.0[first + 1]));
        let value = (a + (b - a) * part) / STEPS;
        if x < 0.0 { -value } else { value }
    }
}

//! Four numbers at once. Written so that the compiler turns each operation into one vector instruction; single precision
//! suffices, for sums over a window keep 1e-6 of the contrast.

use core::array::from_fn;
use core::ops::{Add, Mul, Sub};

/// Numbers in a [`Lanes`].
pub(super) const WIDTH: usize = 4;

#[derive(Clone, Copy, Debug, Default)]
#[repr(align(16))]
pub(super) struct Lanes(pub [f32; WIDTH]);

impl Lanes {
    #[inline]
    pub const fn all(value: f32) -> Self {
        Self([value; WIDTH])
    }

    /// The lanes, kept within -limit to limit.
    #[inline]
    pub fn limited(self, limit: f32) -> Self {
        let low = self.0.map(|x| if x > -limit { x } else { -limit });
        Self(low.map(|x| if x < limit { x } else { limit }))
    }

    /// Sum of the lanes, always in the same order.
    #[inline]
    pub fn sum(self) -> f64 {
        let [a, b, c, d] = self.0.map(f64::from);
        (a + b) + (c + d)
    }

    /// 1 / sqrt(x) for normal x > 0, to 5e-6: a first guess by halving the exponent, then Newton's method, which unlike
    /// the square root is vectorised without unsafe code.
    #[inline]
    pub fn inverse_root(self) -> Self {
        let mut y = Self(self.0.map(|x| f32::from_bits(0x5f37_59df - (x.to_bits() >> 1))));
        let half = self * Self::all(0.5);
        for _ in 0..2 {
            y = y * (Self::all(1.5) - half * y * y);
        }
        y
    }
}

impl Add for Lanes {
    type Output = Self;
    #[inline]
    fn add(self, other: Self) -> Self {
        Self(from_fn(|k| self.0[k] + other.0[k]))
    }
}

impl Sub for Lanes {
    type Output = Self;
    #[inline]
    fn sub(self, other: Self) -> Self {
        Self(from_fn(|k| self.0[k] - other.0[k]))
    }
}

impl Mul for Lanes {
    type Output = Self;
    #[inline]
    fn mul(self, other: Self) -> Self {
        Self(from_fn(|k| self.0[k] * other.0[k]))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn inverse_roots_are_right_to_five_digits() {
        for k in 0..4000 {
            let x = 1e-12_f32 * 1.02_f32.powi(k % 2000) * (1.0 + k as f32 * 1e-4);
            let exact = 1.0 / f64::from(x).sqrt();
            let found = f64::from(Lanes::all(x).inverse_root().0[0]);
            assert!((found / exact - 1.0).abs() < 5e-6, "{x:e}: {found:e}");
        }
    }
}

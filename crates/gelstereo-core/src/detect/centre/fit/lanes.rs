//! Groups of 32 pixels. Loops over them are plain, and long enough that the compiler vectorises each instead
//! of unrolling it first. Single precision suffices: sums over a window keep 1e-6 of the contrast.

use core::ops::{Index, IndexMut};

/// Numbers in a [`Lanes`].
pub(super) const WIDTH: usize = 32;
/// Running sums of a [`Sum`].
const SUMS: usize = 8;

/// One number for each of 32 pixels.
#[derive(Clone, Copy, Debug)]
#[repr(align(32))]
pub(super) struct Lanes(pub [f32; WIDTH]);

impl Default for Lanes {
    fn default() -> Self {
        Self([0.0; WIDTH])
    }
}

impl Index<usize> for Lanes {
    type Output = f32;
    #[inline]
    fn index(&self, lane: usize) -> &f32 {
        &self.0[lane]
    }
}

impl IndexMut<usize> for Lanes {
    #[inline]
    fn index_mut(&mut self, lane: usize) -> &mut f32 {
        &mut self.0[lane]
    }
}

/// A sum of products, always in the same order.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Sum([f32; SUMS]);

impl Sum {
    #[inline]
    pub fn add(&mut self, a: &Lanes, b: &Lanes) {
        for (a, b) in a.0.chunks_exact(SUMS).zip(b.0.chunks_exact(SUMS)) {
            for k in 0..SUMS {
                self.0[k] += a[k] * b[k];
            }
        }
    }

    /// Total of the running sums. Not inlined: otherwise the compiler vectorises across several totals
    /// and shuffles every product.
    #[inline(never)]
    pub fn total(&self) -> f64 {
        let [a, b, c, d, e, f, g, h] = self.0.map(f64::from);
        ((a + b) + (c + d)) + ((e + f) + (g + h))
    }
}

/// 1 / sqrt(x) for normal x > 0, to 5e-6: initial guess by halving the exponent, then Newton's method.
/// Unlike the square root, it is vectorised without unsafe code.
#[inline]
pub(super) fn inverse_root(x: f32) -> f32 {
    let half = x * 0.5;
    let y = f32::from_bits(0x5f37_59df - (x.to_bits() >> 1));
    let y = y * (1.5 - half * y * y);
    y * (1.5 - half * y * y)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn inverse_roots_are_right_to_five_digits() {
        for k in 0..4000 {
            let x = 1e-12_f32 * 1.02_f32.powi(k % 2000) * (1.0 + k as f32 * 1e-4);
            let exact = 1.0 / f64::from(x).sqrt();
            let found = f64::from(inverse_root(x));
            assert!((found / exact - 1.0).abs() < 5e-6, "{x:e}: {found:e}");
        }
    }
}

//! Symmetric positive definite systems of any size.

use super::sqrt;
use alloc::vec::Vec;

/// Inverse V of the Cholesky factor U of a matrix A = Uᵀ U (Golub and Van Loan, section 4.2), so that A⁻¹ =
/// V Vᵀ. Memory is kept between matrices.
#[derive(Clone, Debug, Default)]
pub(crate) struct InverseFactor {
    size: usize,
    /// U, row by row; its lower triangle is not used.
    upper: Vec<f64>,
    /// V, row by row; its lower triangle is not used.
    inverse: Vec<f64>,
}

impl InverseFactor {
    /// Reserves memory for matrices of this size.
    pub fn reserve(&mut self, size: usize) {
        for list in [&mut self.upper, &mut self.inverse] {
            list.clear();
            list.reserve(size * size);
        }
    }

    /// Factors a matrix given by rows, of which only the upper triangle is read. Returns whether it is
    /// positive definite; otherwise the factor must not be used.
    pub fn factor(&mut self, size: usize, matrix: &[f64]) -> bool {
        self.size = size;
        self.upper.clear();
        self.upper.extend_from_slice(&matrix[..size * size]);
        for i in 0..size {
            let (above, below) = self.upper.split_at_mut((i + 1) * size);
            let row = &mut above[i * size..];
            if !(row[i] > 0.0) {
                return false;
            }
            let scale = 1.0 / sqrt(row[i]);
            row[i..].iter_mut().for_each(|entry| *entry *= scale);
            for (k, other) in below.chunks_exact_mut(size).enumerate() {
                let j = i + 1 + k;
                let factor = row[j];
                for (entry, &own) in other[j..].iter_mut().zip(&row[j..]) {
                    *entry -= factor * own;
                }
            }
        }
        self.invert();
        true
    }

    /// Solves U V = 1 from the last row up.
    fn invert(&mut self) {
        let Self { size, upper, inverse } = self;
        let size = *size;
        inverse.clear();
        inverse.resize(size * size, 0.0);
        for i in (0..size).rev() {
            let (above, below) = inverse.split_at_mut((i + 1) * size);
            let (row, own) = (&mut above[i * size..], &upper[i * size..][..size]);
            row[i] = 1.0;
            for (k, other) in below.chunks_exact(size).enumerate() {
                let j = i + 1 + k;
                for (entry, &of_other) in row[j..].iter_mut().zip(&other[j..]) {
                    *entry -= own[j] * of_other;
                }
            }
            let scale = 1.0 / own[i];
            row[i..].iter_mut().for_each(|entry| *entry *= scale);
        }
    }

    /// Diagonal entry of A⁻¹.
    pub fn variance(&self, i: usize) -> f64 {
        self.inverse[i * self.size..][i..self.size].iter().map(|entry| entry * entry).sum()
    }

    /// Vᵀ b, by which A⁻¹ b = V Vᵀ b and c A⁻¹ b = (Vᵀ c) (Vᵀ b).
    pub fn half(&self, right: &[f64], out: &mut Vec<f64>) {
        out.clear();
        out.resize(self.size, 0.0);
        for (i, row) in self.inverse.chunks_exact(self.size).enumerate() {
            for (sum, &entry) in out[i..].iter_mut().zip(&row[i..]) {
                *sum += entry * right[i];
            }
        }
    }

    /// V h, which completes a solution from [`Self::half`].
    pub fn whole(&self, half: &[f64], out: &mut Vec<f64>) {
        out.clear();
        out.extend(
            (self.inverse.chunks_exact(self.size).enumerate())
                .map(|(i, row)| row[i..].iter().zip(&half[i..]).map(|(entry, h)| entry * h).sum::<f64>()),
        );
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        /// A A⁻¹ b is b, to the rounding of some 100 operations on a matrix of condition below 1e4.
        #[test]
        fn a_solution_solves(
            size in 1_usize..12, seeds in prop::collection::vec(-1.0..1.0_f64, 12 * 12 + 12),
        ) {
            let root = |i: usize, k: usize| seeds[i * 12 + k];
            let entry = |i: usize, j: usize| {
                (0..size).map(|k| root(i, k) * root(j, k)).sum::<f64>() + if i == j { 0.1 } else { 0.0 }
            };
            let matrix: Vec<f64> = (0..size * size).map(|n| entry(n / size, n % size)).collect();
            let right = &seeds[144..][..size];
            let (mut factor, mut half, mut solved) = (InverseFactor::default(), Vec::new(), Vec::new());
            prop_assert!(factor.factor(size, &matrix));
            factor.half(right, &mut half);
            factor.whole(&half, &mut solved);
            for i in 0..size {
                let back: f64 = (0..size).map(|j| entry(i, j) * solved[j]).sum();
                prop_assert!((back - right[i]).abs() < 1e-9, "{} {}", back, right[i]);
            }
            // A column of the inverse has its variance on the diagonal.
            let unit: Vec<f64> = (0..size).map(|i| f64::from(u8::from(i == 0))).collect();
            factor.half(&unit, &mut half);
            factor.whole(&half, &mut solved);
            prop_assert!((solved[0] - factor.variance(0)).abs() < 1e-9 * solved[0]);
        }
    }

    #[test]
    fn an_indefinite_matrix_is_refused() {
        let mut factor = InverseFactor::default();
        assert!(!factor.factor(2, &[1.0, 2.0, 2.0, 1.0]));
        assert!(!factor.factor(1, &[f64::NAN]));
        assert!(factor.factor(1, &[4.0]));
        assert!((factor.variance(0) - 0.25).abs() < 1e-15);
    }
}

//! Symmetric systems for several right-hand sides at once.

use crate::math::sqrt;
use alloc::vec::Vec;

/// Products summed at a time.
const LANES: usize = 4;

/// C = L Lᵀ with a lower triangle L (Golub and Van Loan, section 4.2).
#[derive(Clone, Debug, Default)]
pub(super) struct Cholesky {
    /// Rows of L in sequence; the last entry of each is the reciprocal of the diagonal.
    rows: Vec<f64>,
}

impl Cholesky {
    /// Reserves memory for this many unknowns.
    pub fn reserve(&mut self, unknowns: usize) {
        self.rows.clear();
        self.rows.reserve(unknowns * (unknowns + 1) / 2);
    }

    /// Factors a positive definite matrix; only its lower triangle (row, column) is read.
    pub fn factor(&mut self, unknowns: usize, entry: impl Fn(usize, usize) -> f64) {
        let rows = &mut self.rows;
        rows.clear();
        for i in 0..unknowns {
            let (start, mut above) = (rows.len(), 0);
            for j in 0..i {
                let left = entry(i, j) - dot(&rows[above..above + j], &rows[start..]);
                rows.push(left * rows[above + j]);
                above += j + 1;
            }
            let own = entry(i, i) - dot(&rows[start..], &rows[start..]);
            rows.push(1.0 / sqrt(own));
        }
    }

    /// L⁻¹ b for several b at once, in place: one row of numbers per unknown.
    pub fn forward<const N: usize>(&self, right: &mut [[f64; N]]) {
        let mut start = 0;
        for i in 0..right.len() {
            let row = &self.rows[start..=start + i];
            let (solved, rest) = right.split_at_mut(i);
            let mut own = rest[0];
            for (entry, solved) in row.iter().zip(solved) {
                for k in 0..N {
                    own[k] -= entry * solved[k];
                }
            }
            rest[0] = own.map(|own| own * row[i]);
            start += i + 1;
        }
    }

    /// L⁻ᵀ b, as [`Self::forward`].
    pub fn backward<const N: usize>(&self, right: &mut [[f64; N]]) {
        let mut start = right.len() * (right.len() + 1) / 2;
        for i in (0..right.len()).rev() {
            start -= i + 1;
            let row = &self.rows[start..=start + i];
            let (before, rest) = right.split_at_mut(i);
            let own = rest[0].map(|own| own * row[i]);
            rest[0] = own;
            for (entry, before) in row.iter().zip(before) {
                for k in 0..N {
                    before[k] -= entry * own[k];
                }
            }
        }
    }
}

/// Sum of products in lanes, in a fixed order that vectorises well.
fn dot(a: &[f64], b: &[f64]) -> f64 {
    let ((a, a_rest), (b, b_rest)) = (a.as_chunks::<LANES>(), b.as_chunks::<LANES>());
    let mut sums = [0.0; LANES];
    for (a, b) in a.iter().zip(b) {
        for k in 0..LANES {
            sums[k] += a[k] * b[k];
        }
    }
    let rest: f64 = a_rest.iter().zip(b_rest).map(|(a, b)| a * b).sum();
    sums.iter().sum::<f64>() + rest
}

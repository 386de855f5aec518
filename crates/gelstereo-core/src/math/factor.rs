//! Small symmetric systems.

use super::linalg::Symmetric;

/// L D Lᵀ factorisation of a clearly positive definite matrix (Golub and Van Loan, section 4.1).
#[derive(Clone, Copy, Debug)]
pub(crate) struct Factor<const N: usize> {
    lower: Symmetric<N>,
    diagonal: [f64; N],
}

impl<const N: usize> Factor<N> {
    /// From the lower triangle of `matrix`. `None` if a pivot falls below 1e-9 of its diagonal entry:
    /// that direction is not determined.
    pub fn new(matrix: &Symmetric<N>) -> Option<Self> {
        let (mut lower, mut diagonal) = ([[0.0; N]; N], [0.0; N]);
        for j in 0..N {
            let mut pivot = matrix[j][j];
            for k in 0..j {
                pivot -= lower[j][k] * lower[j][k] * diagonal[k];
            }
            if !(pivot > 1e-9 * matrix[j][j]) {
                return None;
            }
            diagonal[j] = pivot;
            for i in j + 1..N {
                let mut entry = matrix[i][j];
                for k in 0..j {
                    entry -= lower[i][k] * lower[j][k] * diagonal[k];
                }
                lower[i][j] = entry / pivot;
            }
        }
        Some(Self { lower, diagonal })
    }

    pub fn solve(&self, right: &[f64; N]) -> [f64; N] {
        let mut x = *right;
        for i in 0..N {
            for k in 0..i {
                x[i] -= self.lower[i][k] * x[k];
            }
        }
        for i in (0..N).rev() {
            x[i] /= self.diagonal[i];
            for k in i + 1..N {
                x[i] -= self.lower[k][i] * x[k];
            }
        }
        x
    }
}

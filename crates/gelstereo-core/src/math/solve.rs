//! Symmetric positive definite systems.

use super::linalg::Symmetric;
use super::sqrt;

/// Cholesky factor U of a matrix H = Uᵀ U (Golub and Van Loan, section 4.2).
#[derive(Clone, Copy, Debug)]
pub(crate) struct Factor<const N: usize> {
    upper: Symmetric<N>,
    /// Reciprocals of its diagonal.
    inverses: [f64; N],
}

impl<const N: usize> Factor<N> {
    /// From the lower triangle of a clearly positive definite matrix. `None` if a pivot falls below 1e-9 of
    /// its diagonal entry: that direction is not determined.
    pub fn new(matrix: &Symmetric<N>) -> Option<Self> {
        Self::of_upper(core::array::from_fn(|i| core::array::from_fn(|k| matrix[k][i])), 1e-9)
    }

    /// From the upper triangle of a matrix. `None` unless every pivot exceeds this share of its diagonal
    /// entry; 0 refuses only what is not positive definite.
    fn of_upper(mut upper: Symmetric<N>, min_pivot: f64) -> Option<Self> {
        let mut inverses = [0.0; N];
        let limits: [f64; N] = core::array::from_fn(|i| min_pivot * upper[i][i]);
        for i in 0..N {
            if !(upper[i][i] > limits[i]) {
                return None;
            }
            inverses[i] = 1.0 / sqrt(upper[i][i]);
            for k in i..N {
                upper[i][k] *= inverses[i];
            }
            for j in i + 1..N {
                let factor = upper[i][j];
                for k in j..N {
                    upper[j][k] -= factor * upper[i][k];
                }
            }
        }
        Some(Self { upper, inverses })
    }

    /// Solves H z = `right`.
    pub fn solve(&self, right: &[f64; N]) -> [f64; N] {
        let (u, mut z) = (&self.upper, *right);
        for i in 0..N {
            z[i] *= self.inverses[i];
            for j in i + 1..N {
                z[j] -= u[i][j] * z[i];
            }
        }
        for i in (0..N).rev() {
            for k in i + 1..N {
                z[i] -= u[i][k] * z[k];
            }
            z[i] /= u[i][i];
        }
        z
    }
}

/// Solves H z = `right` from the upper triangle of H; `None` unless H is positive definite.
pub(crate) fn solve_definite<const N: usize>(upper: &Symmetric<N>, right: &[f64; N]) -> Option<[f64; N]> {
    Some(Factor::of_upper(*upper, 0.0)?.solve(right))
}

#[cfg(test)]
mod tests {
    use super::{Factor, solve_definite};
    use crate::math::abs;
    use proptest::prelude::*;

    proptest! {
        /// H z is `right` again, to the rounding of five sums of terms up to 20 times the pivots' least
        /// share.
        #[test]
        fn a_solution_solves(
            root in prop::array::uniform5(prop::array::uniform5(-1.0..1.0_f64)),
            right in prop::array::uniform5(-1.0..1.0_f64),
        ) {
            let entry = |i: usize, j: usize| {
                (0..5).map(|k| root[k][i] * root[k][j]).sum::<f64>() + if i == j { 0.1 } else { 0.0 }
            };
            let matrix: [[f64; 5]; 5] = core::array::from_fn(|i| core::array::from_fn(|j| entry(i, j)));
            let solved = Factor::new(&matrix).unwrap().solve(&right);
            for i in 0..5 {
                let back: f64 = (0..5).map(|j| matrix[i][j] * solved[j]).sum();
                prop_assert!(abs(back - right[i]) < 1e-11, "{} {}", back, right[i]);
            }
        }
    }

    #[test]
    fn a_direction_that_is_not_determined_is_refused() {
        let singular = [[1.0, 1.0], [1.0, 1.0]];
        assert!(Factor::new(&singular).is_none() && solve_definite(&singular, &[1.0; 2]).is_none());
        assert!(Factor::new(&[[1.0, 1.0], [1.0, 1.0 + 1e-10]]).is_none());
        assert!(solve_definite(&[[1.0, 1.0], [1.0, 1.0 + 1e-10]], &[1.0; 2]).is_some());
    }
}

//! Polynomials in three variables of bounded total degree, in products of Chebyshev polynomials over [-1, 1]³.

use crate::math::{DVec3, cos};
use alloc::vec::Vec;
use core::f64::consts::PI;

/// Highest degree.
const DEGREE: usize = 7;

/// Sums of N polynomials of one degree.
#[derive(Clone, Debug)]
pub(super) struct Series<const N: usize> {
    degree: usize,
    /// The first variable's degree runs fastest.
    coefficients: Vec<[f64; N]>,
}

impl<const N: usize> Series<N> {
    /// Of the values at [`nodes`], M along each variable: there the products are orthogonal, so that each coefficient is one
    /// sum, and a lower degree a truncation. The degree must be below M.
    pub fn fit<const M: usize>(degree: usize, values: &[[f64; N]]) -> Self {
        let basis = roots::<M>().map(chebyshev);
        let mut coefficients = Vec::with_capacity((degree + 1) * (degree + 2) * (degree + 3) / 6);
        for_exponents(degree, |[a, b, c]| {
            let mut total = [0.0; N];
            let by_xy: [[f64; M]; M] =
                core::array::from_fn(|y| core::array::from_fn(|x| basis[x][a] * basis[y][b]));
            for (plane, z) in values.chunks_exact(M * M).zip(&basis) {
                for (line, by_x) in plane.chunks_exact(M).zip(&by_xy) {
                    for (value, by_x) in line.iter().zip(by_x) {
                        let at = by_x * z[c];
                        total.iter_mut().zip(value).for_each(|(total, value)| *total += at * value);
                    }
                }
            }
            let twos = [a, b, c].into_iter().filter(|&k| k > 0).count();
            let norm = f64::from(1 << twos) / (M * M * M) as f64;
            coefficients.push(total.map(|total| total * norm));
        });
        Self { degree, coefficients }
    }

    /// The values at a point of the cube.
    pub fn at(&self, x: DVec3) -> [f64; N] {
        let basis = [chebyshev(x.x), chebyshev(x.y), chebyshev(x.z)];
        let (mut total, mut coefficients) = ([0.0; N], self.coefficients.iter());
        for_exponents(self.degree, |[a, b, c]| {
            let Some(coefficient) = coefficients.next() else { return };
            let at = basis[0][a] * basis[1][b] * basis[2][c];
            total.iter_mut().zip(coefficient).for_each(|(total, value)| *total += at * value);
        });
        total
    }

    /// The same polynomials in powers: exponents and coefficients, for degrees up to 3, where this loses no digits.
    pub fn powers(&self) -> impl Iterator<Item = ([usize; 3], [f64; N])> + '_ {
        // Coefficients of T_0 to T_3.
        const POWERS: [[f64; 4]; 4] =
            [[1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [-1.0, 0.0, 2.0, 0.0], [0.0, -3.0, 0.0, 4.0]];
        exponents(self.degree).map(|[i, j, k]| {
            let (mut total, mut coefficients) = ([0.0; N], self.coefficients.iter());
            for_exponents(self.degree, |[a, b, c]| {
                let Some(coefficient) = coefficients.next() else { return };
                let share = POWERS[a][i] * POWERS[b][j] * POWERS[c][k];
                total.iter_mut().zip(coefficient).for_each(|(total, value)| *total += share * value);
            });
            ([i, j, k], total)
        })
    }
}

/// As [`exponents`]: plain loops take a fraction of the time.
#[inline]
fn for_exponents(degree: usize, mut see: impl FnMut([usize; 3])) {
    for c in 0..=degree {
        for b in 0..=degree - c {
            for a in 0..=degree - c - b {
                see([a, b, c]);
            }
        }
    }
}

/// All exponents of a total degree up to this one; the first runs fastest.
fn exponents(degree: usize) -> impl Iterator<Item = [usize; 3]> {
    (0..=degree)
        .flat_map(move |c| (0..=degree - c).flat_map(move |b| (0..=degree - c - b).map(move |a| [a, b, c])))
}

/// T_0 to T_7.
fn chebyshev(x: f64) -> [f64; DEGREE + 1] {
    let mut t = [1.0; DEGREE + 1];
    t[1] = x;
    for k in 2..=DEGREE {
        t[k] = 2.0 * x * t[k - 1] - t[k - 2];
    }
    t
}

fn roots<const M: usize>() -> [f64; M] {
    core::array::from_fn(|i| cos(PI * (i as f64 + 0.5) / M as f64))
}

/// Points at which the values must be known for [`Series::fit`], in this order.
pub(super) fn nodes<const M: usize>() -> impl Iterator<Item = DVec3> {
    grid(roots::<M>())
}

/// Points at which to check what was fitted, borders and corners among them.
pub(super) fn checks<const M: usize>() -> impl Iterator<Item = DVec3> {
    grid(core::array::from_fn::<f64, M, _>(|i| cos(PI * i as f64 / (M - 1) as f64)))
}

/// All points with coordinates of `axis`; the first coordinate runs fastest.
fn grid<const M: usize>(axis: [f64; M]) -> impl Iterator<Item = DVec3> {
    (0..M * M * M).map(move |n| DVec3::new(axis[n % M], axis[n / M % M], axis[n / M / M]))
}

//! Polynomials in three variables of bounded total degree, as products of Chebyshev polynomials over [-1,
//! 1]³.

use crate::math::{DVec3, cos};
use core::f64::consts::PI;

/// Highest degree, and the number of coefficients of a polynomial of that degree.
const DEGREE: usize = 7;
const MAX_TERMS: usize = (DEGREE + 1) * (DEGREE + 2) * (DEGREE + 3) / 6;

/// Coefficients by the degrees of two variables.
type Plane<const N: usize> = [[[f64; N]; DEGREE + 1]; DEGREE + 1];

/// N polynomials of one degree.
#[derive(Clone, Debug)]
pub(super) struct Series<const N: usize> {
    degree: usize,
    /// The first variable's degree runs fastest.
    coefficients: [[f64; N]; MAX_TERMS],
}

impl<const N: usize> Series<N> {
    /// Zero polynomials.
    pub const fn zero() -> Self {
        Self { degree: 0, coefficients: [[0.0; N]; MAX_TERMS] }
    }

    /// Fits the values at [`nodes`], M along each variable. The products are orthogonal there, so each
    /// coefficient is one sum, and a lower degree a truncation. The degree must be below M.
    ///
    /// Summing over one variable after the other takes M times fewer products than one sum over all
    /// three.
    pub fn fit<'v, const M: usize, V>(degree: usize, mut values: V) -> Self
    where
        V: Iterator<Item = &'v [f64; N]>,
    {
        let basis = roots::<M>().map(chebyshev);
        let mut coefficients = [[0.0; N]; MAX_TERMS];
        for z in &basis {
            let mut by_xy: Plane<N> = [[[0.0; N]; DEGREE + 1]; DEGREE + 1];
            for y in &basis {
                let mut by_x = [[0.0; N]; DEGREE + 1];
                for (x, value) in basis.iter().zip(&mut values) {
                    by_x[..=degree].iter_mut().zip(x).for_each(|(sum, &t)| add(sum, value, t));
                }
                for (b, by_xy) in by_xy[..=degree].iter_mut().enumerate() {
                    by_xy[..=degree - b].iter_mut().zip(&by_x).for_each(|(sum, by_x)| add(sum, by_x, y[b]));
                }
            }
            let mut all = coefficients.iter_mut();
            for_exponents(degree, |[a, b, c]| {
                if let Some(sum) = all.next() {
                    add(sum, &by_xy[b][a], z[c]);
                }
            });
        }
        let mut all = coefficients.iter_mut();
        for_exponents(degree, |exponents| {
            let twos = exponents.into_iter().filter(|&k| k > 0).count();
            let norm = f64::from(1 << twos) / (M * M * M) as f64;
            if let Some(coefficient) = all.next() {
                coefficient.iter_mut().for_each(|sum| *sum *= norm);
            }
        });
        Self { degree, coefficients }
    }

    /// Calls `each` with the values at all points of the grid of these axes, within [-1, 1]; the first
    /// runs fastest.
    pub fn on_grid<const M: usize>(&self, axes: &[[f64; M]; 3], mut each: impl FnMut([f64; N])) {
        let [xs, ys, zs] = axes.map(|axis| axis.map(chebyshev));
        for z in &zs {
            let mut by_xy: Plane<N> = [[[0.0; N]; DEGREE + 1]; DEGREE + 1];
            let mut all = self.coefficients.iter();
            for_exponents(self.degree, |[a, b, c]| {
                if let Some(coefficient) = all.next() {
                    add(&mut by_xy[b][a], coefficient, z[c]);
                }
            });
            for y in &ys {
                let mut by_x = [[0.0; N]; DEGREE + 1];
                for (b, by_xy) in by_xy[..=self.degree].iter().enumerate() {
                    by_x[..=self.degree - b].iter_mut().zip(by_xy).for_each(|(sum, c)| add(sum, c, y[b]));
                }
                for x in &xs {
                    let mut sum = [0.0; N];
                    by_x[..=self.degree].iter().zip(x).for_each(|(by_x, &t)| add(&mut sum, by_x, t));
                    each(sum);
                }
            }
        }
    }

    /// The same polynomials in powers: exponents and coefficients, for degrees up to 3, where this loses
    /// no precision.
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

#[inline]
fn add<const N: usize>(sum: &mut [f64; N], value: &[f64; N], share: f64) {
    sum.iter_mut().zip(value).for_each(|(sum, value)| *sum += share * value);
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

/// Coordinates of the values for [`Series::fit`].
pub(super) fn roots<const M: usize>() -> [f64; M] {
    core::array::from_fn(|i| cos(PI * (i as f64 + 0.5) / M as f64))
}

/// Coordinates at which a fit is checked, including the ends.
pub(super) fn extremes<const M: usize>() -> [f64; M] {
    core::array::from_fn(|i| cos(PI * i as f64 / (M - 1) as f64))
}

/// All points with coordinates of [`roots`].
pub(super) fn nodes<const M: usize>() -> impl Iterator<Item = DVec3> {
    grid(roots::<M>())
}

/// All points with coordinates of [`extremes`].
pub(super) fn checks<const M: usize>() -> impl Iterator<Item = DVec3> {
    grid(extremes::<M>())
}

/// All points with coordinates of `axis`; the first coordinate runs fastest.
fn grid<const M: usize>(axis: [f64; M]) -> impl Iterator<Item = DVec3> {
    (0..M * M * M).map(move |n| DVec3::new(axis[n % M], axis[n / M % M], axis[n / M / M]))
}

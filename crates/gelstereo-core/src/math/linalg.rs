//! Small dense symmetric linear algebra.

/// A symmetric N x N matrix, stored whole, row by row.
pub type Symmetric<const N: usize> = [[f64; N]; N];

/// Eigenvalues in ascending order and their unit eigenvectors (`vectors[k]` belongs to `values[k]`).
#[derive(Clone, Copy, Debug)]
pub struct Eigen<const N: usize> {
    /// Eigenvalues, ascending.
    pub values: [f64; N],
    /// Unit eigenvectors, one a row.
    pub vectors: [[f64; N]; N],
}

/// Eigen-decomposition of a symmetric matrix by cyclic Jacobi rotations (Golub and Van Loan, section 8.5).
///
/// Only finite input is meaningful; the sweeps are bounded, so it always returns. Eigenvalues are accurate to a few
/// ulp of the largest. The sign of a vector makes its largest component positive.
#[must_use]
pub fn eigen<const N: usize>(matrix: &Symmetric<N>) -> Eigen<N> {
    let mut a = *matrix;
    let mut v: [[f64; N]; N] =
        core::array::from_fn(|i| core::array::from_fn(|j| f64::from(u8::from(i == j))));
    for _sweep in 0..32 {
        let mut rotated = false;
        for p in 0..N {
            for q in p + 1..N {
                // Below half an ulp of both diagonal entries the rotation changes nothing.
                if a[p][q].abs() <= f64::EPSILON * 0.25 * libm::sqrt((a[p][p] * a[q][q]).abs())
                    && a[p][q].abs() <= f64::EPSILON * (a[p][p].abs() + a[q][q].abs())
                    || a[p][q] == 0.0
                {
                    continue;
                }
                rotated = true;
                rotate(&mut a, &mut v, p, q);
            }
        }
        if !rotated {
            break;
        }
    }
    let mut order: [usize; N] = core::array::from_fn(|i| i);
    order.sort_by(|&i, &j| a[i][i].total_cmp(&a[j][j]));
    Eigen {
        values: order.map(|k| a[k][k]),
        vectors: order.map(|k| oriented(core::array::from_fn(|row| v[row][k]))),
    }
}

/// One Jacobi rotation that zeroes a[p][q]; `v` collects the rotations in its columns.
fn rotate<const N: usize>(a: &mut Symmetric<N>, v: &mut [[f64; N]; N], p: usize, q: usize) {
    let tau = (a[q][q] - a[p][p]) / (2.0 * a[p][q]);
    let root = libm::hypot(1.0, tau);
    let t = if tau >= 0.0 { 1.0 / (tau + root) } else { 1.0 / (tau - root) };
    let c = 1.0 / libm::hypot(1.0, t);
    let s = t * c;
    for row in a.iter_mut() {
        let (x, y) = (row[p], row[q]);
        row[p] = c * x - s * y;
        row[q] = s * x + c * y;
    }
    for col in 0..N {
        let (x, y) = (a[p][col], a[q][col]);
        a[p][col] = c * x - s * y;
        a[q][col] = s * x + c * y;
    }
    a[p][q] = 0.0;
    a[q][p] = 0.0;
    for row in v.iter_mut() {
        let (x, y) = (row[p], row[q]);
        row[p] = c * x - s * y;
        row[q] = s * x + c * y;
    }
}

/// The vector or its opposite, whichever has a positive largest component.
fn oriented<const N: usize>(vector: [f64; N]) -> [f64; N] {
    let largest = vector.iter().fold(0.0_f64, |best, &x| if x.abs() > best.abs() { x } else { best });
    if largest < 0.0 { vector.map(|x| -x) } else { vector }
}

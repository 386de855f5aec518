//! Small dense symmetric linear algebra.

/// A symmetric N x N matrix, stored in full, row by row.
pub type Symmetric<const N: usize> = [[f64; N]; N];

/// Adds w u uᵀ.
pub(crate) fn add_outer<const N: usize>(matrix: &mut Symmetric<N>, weight: f64, u: [f64; N]) {
    for (row, along) in matrix.iter_mut().zip(u) {
        for (entry, across) in row.iter_mut().zip(u) {
            *entry += weight * (along * across);
        }
    }
}

/// The upper triangle of a symmetric matrix; entries below the diagonal stay zero.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Triangle<const N: usize>(pub Symmetric<N>);

impl<const N: usize> Triangle<N> {
    pub const ZERO: Self = Self([[0.0; N]; N]);

    /// Adds w u uᵀ.
    pub fn add_outer(&mut self, u: &[f64; N], weight: f64) {
        for (i, row) in self.0.iter_mut().enumerate() {
            let wu = weight * u[i];
            (i..N).for_each(|k| row[k] += wu * u[k]);
        }
    }

    pub fn whole(&self) -> Symmetric<N> {
        core::array::from_fn(|i| core::array::from_fn(|k| self.0[i.min(k)][i.max(k)]))
    }
}

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
/// Only meaningful for finite input; the number of sweeps is bounded, so it always returns. Eigenvalues
/// are accurate to a few ulp of the largest. Each vector's largest component is positive.
#[must_use]
pub fn eigen<const N: usize>(matrix: &Symmetric<N>) -> Eigen<N> {
    let mut a = *matrix;
    let mut v: [[f64; N]; N] =
        core::array::from_fn(|i| core::array::from_fn(|j| f64::from(u8::from(i == j))));
    for _sweep in 0..32 {
        let mut rotated = false;
        for p in 0..N {
            for q in p + 1..N {
                if !is_zero(a[p][q], [a[p][p], a[q][q]]) {
                    rotated = true;
                    rotate(&mut a, &mut v, p, q);
                }
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

/// Whether this off-diagonal entry is zero up to rounding. The test is relative to both diagonal entries,
/// so that small eigenvalues of a graded matrix stay accurate (Demmel and Veselić 1992).
fn is_zero(off: f64, diagonal: [f64; 2]) -> bool {
    let rounding = 0.25 * f64::EPSILON;
    let [a, d] = diagonal.map(f64::abs);
    // The larger one usually decides. Two roots, as the product may underflow.
    off == 0.0
        || (off.abs() <= rounding * a.max(d) && off.abs() <= rounding * (libm::sqrt(a) * libm::sqrt(d)))
}

/// One Jacobi rotation that zeroes a[p][q]; `v` collects the rotations in its columns.
fn rotate<const N: usize>(a: &mut Symmetric<N>, v: &mut [[f64; N]; N], p: usize, q: usize) {
    let off = a[p][q];
    let tau = (a[q][q] - a[p][p]) / (2.0 * off);
    // If the square overflows, the rotation is negligible.
    let root = libm::sqrt(1.0 + tau * tau);
    let t = if tau >= 0.0 { 1.0 / (tau + root) } else { 1.0 / (tau - root) };
    let c = 1.0 / libm::sqrt(1.0 + t * t);
    let s = t * c;
    // As corrections: c² a - 2 c s b + s² d would cancel for a small eigenvalue next to a large one.
    let (low, high) = (a[p][p] - t * off, a[q][q] + t * off);
    let (row_p, row_q) = (a[p], a[q]);
    a[p] = core::array::from_fn(|i| c * row_p[i] - s * row_q[i]);
    a[q] = core::array::from_fn(|i| s * row_p[i] + c * row_q[i]);
    for i in (0..N).filter(|&i| i != p && i != q) {
        (a[i][p], a[i][q]) = (a[p][i], a[q][i]);
    }
    (a[p][p], a[q][q], a[p][q], a[q][p]) = (low, high, 0.0, 0.0);
    for row in v.iter_mut() {
        let (x, y) = (row[p], row[q]);
        row[p] = c * x - s * y;
        row[q] = s * x + c * y;
    }
}

/// The vector, negated if needed so that its largest component is positive.
fn oriented<const N: usize>(vector: [f64; N]) -> [f64; N] {
    let largest = vector.iter().fold(0.0_f64, |best, &x| if x.abs() > best.abs() { x } else { best });
    if largest < 0.0 { vector.map(|x| -x) } else { vector }
}

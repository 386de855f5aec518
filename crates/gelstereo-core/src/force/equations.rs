//! Normal equations of the tractions.

use super::cells::{Cell, Cells};
use super::compliance::Compliance;
use crate::layer::{FreeSides, Influence};
use crate::math::linalg::Symmetric;
use crate::math::sqrt;
use alloc::vec::Vec;

/// Motion of a gel under unit tractions on the cells around its markers.
#[derive(Clone, Copy, Debug)]
pub(super) enum Gel<'a> {
    Layer { influence: &'a Influence, sides: Option<&'a FreeSides> },
    Matrix(&'a Compliance),
}

impl<'a> Gel<'a> {
    /// With a matrix, the influence is not used.
    pub fn new(
        influence: &'a Influence,
        sides: Option<&'a FreeSides>,
        compliance: Option<&'a Compliance>,
    ) -> Self {
        compliance.map_or(Self::Layer { influence, sides }, Self::Matrix)
    }

    /// Motion of the marker in this row and column into the layer, along rows and along columns, under a
    /// pressure and tractions along rows and columns of a cell.
    fn effect(&self, (row, col): (usize, usize), cell: &Cell) -> [[f64; 3]; 3] {
        let (influence, sides) = match *self {
            Gel::Matrix(compliance) => return compliance.effect((row, col), (cell.row, cell.col)),
            Gel::Layer { influence, sides } => (influence, sides),
        };
        let effect =
            |at_col: isize, at_row: isize| influence.effect(col as isize - at_col, row as isize - at_row);
        let mut effects = effect(cell.col as isize, cell.row as isize);
        for image in sides.iter().flat_map(|sides| sides.images([cell.col, cell.row])) {
            for (sum, of_image) in effects.iter_mut().zip(effect(image.col, image.row)) {
                (0..3).for_each(|k| sum[k] += image.factors[k] * of_image[k]);
            }
        }
        effects
    }
}

/// Least squares K x = u, weighted by the covariances of the motions u. The unknowns x are, for each block,
/// the pressure and the tractions along rows and columns, in units of Young's modulus.
#[derive(Clone, Debug, Default)]
pub(super) struct Equations {
    /// Number of unknowns.
    pub size: usize,
    /// Kᵀ W K, by rows.
    pub matrix: Vec<f64>,
    /// Kᵀ W u.
    pub right: Vec<f64>,
    /// uᵀ W u.
    pub square: f64,
    /// Number of equations.
    pub count: usize,
    /// Influence of the unknowns on one marker: into the layer, along rows and along columns.
    rows: [Vec<f64>; 3],
    /// Its derivative.
    changes: [Vec<f64>; 3],
}

impl Equations {
    pub fn reserve(&mut self, size: usize) {
        self.matrix.reserve(size * size);
        self.right.reserve(size);
        self.rows.iter_mut().chain(&mut self.changes).for_each(|row| row.reserve(size));
    }

    /// Begins anew.
    pub fn clear(&mut self, size: usize) {
        (self.size, self.square, self.count) = (size, 0.0, 0);
        for (list, length) in [(&mut self.matrix, size * size), (&mut self.right, size)] {
            list.clear();
            list.resize(length, 0.0);
        }
    }

    /// Adds the motion of the marker in this row and column, mm, if its covariance is positive definite.
    pub fn add(
        &mut self,
        gel: Gel<'_>,
        cells: &Cells,
        place: (usize, usize),
        motion_mm: [f64; 3],
        covariance_mm2: &Symmetric<3>,
    ) {
        let Some(root) = whitening(covariance_mm2) else { return };
        fill(&mut self.rows, self.size, gel, cells, place);
        let [into, along, across] = &mut self.rows;
        for ((a, b), c) in into.iter_mut().zip(along.iter_mut()).zip(across.iter_mut()) {
            [*a, *b, *c] = times(&root, [*a, *b, *c]);
        }
        let u = times(&root, motion_mm);
        self.square += u.iter().map(|u| u * u).sum::<f64>();
        self.count += 3;
        for i in 0..self.size {
            let (a, b, c) = (into[i], along[i], across[i]);
            self.right[i] += a * u[0] + b * u[1] + c * u[2];
            let entries = self.matrix[i * self.size..][i..self.size].iter_mut();
            let others = into[i..].iter().zip(&along[i..]).zip(&across[i..]);
            for (entry, ((into, along), across)) in entries.zip(others) {
                *entry += a * into + b * along + c * across;
            }
        }
    }

    /// Adds to `out` what [`Self::add`] would add to Kᵀ W (u - K x), differentiated by a number of the gel by
    /// which the influence has this derivative.
    pub fn differentiate(
        &mut self,
        (gel, derivative): (Gel<'_>, Gel<'_>),
        cells: &Cells,
        place: (usize, usize),
        (motion_mm, covariance_mm2): ([f64; 3], &Symmetric<3>),
        x: &[f64],
        out: &mut [f64],
    ) {
        let Some(root) = whitening(covariance_mm2) else { return };
        fill(&mut self.rows, self.size, gel, cells, place);
        fill(&mut self.changes, self.size, derivative, cells, place);
        let product = |row: &Vec<f64>| row.iter().zip(x).map(|(entry, x)| entry * x).sum::<f64>();
        let predicted_mm = [0, 1, 2].map(|i| product(&self.rows[i]));
        let left = weighed(&root, core::array::from_fn(|i| motion_mm[i] - predicted_mm[i]));
        let change = weighed(&root, [0, 1, 2].map(|i| product(&self.changes[i])));
        for i in 0..3 {
            for ((out, row), changed) in out.iter_mut().zip(&self.rows[i]).zip(&self.changes[i]) {
                *out += changed * left[i] - row * change[i];
            }
        }
    }

    /// Derivatives of sums by the motion of one marker, from those by Kᵀ W u; `None` for a marker that is not
    /// used.
    pub fn by_motion<const N: usize>(
        &mut self,
        gel: Gel<'_>,
        cells: &Cells,
        place: (usize, usize),
        covariance_mm2: &Symmetric<3>,
        sums: &[Vec<f64>; N],
    ) -> Option<[[f64; 3]; N]> {
        let root = whitening(covariance_mm2)?;
        fill(&mut self.rows, self.size, gel, cells, place);
        let product = |row: &Vec<f64>, sum: &Vec<f64>| row.iter().zip(sum).map(|(a, b)| a * b).sum::<f64>();
        Some(core::array::from_fn(|k| weighed(&root, [0, 1, 2].map(|i| product(&self.rows[i], &sums[k])))))
    }

    /// Completes the lower triangle.
    pub fn mirror(&mut self) {
        for i in 0..self.size {
            for k in 0..i {
                self.matrix[i * self.size + k] = self.matrix[k * self.size + i];
            }
        }
    }

    /// Weighted sum of squares that these tractions leave.
    pub fn residual(&self, x: &[f64]) -> f64 {
        let mut left = self.square;
        for ((row, &right), &own) in self.matrix.chunks_exact(self.size).zip(&self.right).zip(x) {
            let product: f64 = row.iter().zip(x).map(|(entry, x)| entry * x).sum();
            left += own * (product - 2.0 * right);
        }
        left.max(0.0)
    }
}

/// Influence of all unknowns on the marker in this row and column.
fn fill(rows: &mut [Vec<f64>; 3], size: usize, gel: Gel<'_>, cells: &Cells, place: (usize, usize)) {
    for row in rows.iter_mut() {
        row.clear();
        row.resize(size, 0.0);
    }
    for cell in &cells.cells {
        for (list, effect) in rows.iter_mut().zip(gel.effect(place, cell)) {
            list[3 * cell.block..][..3].iter_mut().zip(effect).for_each(|(sum, effect)| *sum += effect);
        }
    }
}

/// Lower triangle R with R C Rᵀ = 1; `None` if C is not positive definite.
fn whitening(c: &Symmetric<3>) -> Option<[[f64; 3]; 3]> {
    let positive = |x: f64| (x > 0.0 && x.is_finite()).then(|| sqrt(x));
    let l00 = positive(c[0][0])?;
    let (l10, l20) = (c[1][0] / l00, c[2][0] / l00);
    let l11 = positive(c[1][1] - l10 * l10)?;
    let l21 = (c[2][1] - l20 * l10) / l11;
    let l22 = positive(c[2][2] - l20 * l20 - l21 * l21)?;
    let (r00, r11, r22) = (1.0 / l00, 1.0 / l11, 1.0 / l22);
    let r10 = -l10 * r00 * r11;
    Some([[r00, 0.0, 0.0], [r10, r11, 0.0], [-(l20 * r00 + l21 * r10) * r22, -l21 * r11 * r22, r22]])
}

fn times(root: &[[f64; 3]; 3], v: [f64; 3]) -> [f64; 3] {
    [root[0][0] * v[0], root[1][0] * v[0] + root[1][1] * v[1], {
        root[2][0] * v[0] + root[2][1] * v[1] + root[2][2] * v[2]
    }]
}

/// Rᵀ R v, which is C⁻¹ v.
fn weighed(root: &[[f64; 3]; 3], v: [f64; 3]) -> [f64; 3] {
    let u = times(root, v);
    [0, 1, 2].map(|k| (0..3).map(|i| root[i][k] * u[i]).sum())
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        /// R C Rᵀ is 1.
        #[test]
        fn whitened_motion_has_unit_covariance(
            root in prop::array::uniform3(prop::array::uniform3(-1.0..1.0_f64)),
        ) {
            let entry = |i: usize, k: usize| {
                (0..3).map(|j| root[i][j] * root[k][j]).sum::<f64>() + if i == k { 0.05 } else { 0.0 }
            };
            let c: Symmetric<3> = core::array::from_fn(|i| core::array::from_fn(|k| entry(i, k)));
            let r = whitening(&c).unwrap();
            for i in 0..3 {
                for k in 0..3 {
                    let product: f64 = (0..3)
                        .flat_map(|a| (0..3).map(move |b| (a, b)))
                        .map(|(a, b)| r[i][a] * c[a][b] * r[k][b])
                        .sum();
                    prop_assert!((product - f64::from(u8::from(i == k))).abs() < 1e-11);
                }
            }
        }
    }

    #[test]
    fn a_singular_covariance_is_left_out() {
        assert!(whitening(&[[1.0, 1.0, 0.0], [1.0, 1.0, 0.0], [0.0, 0.0, 1.0]]).is_none());
        assert!(whitening(&[[f64::NAN; 3]; 3]).is_none());
    }
}

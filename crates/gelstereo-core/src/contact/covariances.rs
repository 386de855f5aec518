//! Covariances of the pressures of neighbouring markers, and prediction of one marker's noise from them.

use super::stencils::Stencils;
use crate::math::sqrt;
use alloc::vec::Vec;

/// Number of markers whose stencils share a height with that of a marker.
pub(super) const COUNT: usize = 12;
/// Their offsets in rows down and columns across, row by row.
pub(super) const AROUND: [(isize, isize); COUNT] =
    [(-2, 0), (-1, -1), (-1, 0), (-1, 1), (0, -2), (0, -1), (0, 1), (0, 2), (1, -1), (1, 0), (1, 1), (2, 0)];
/// Offsets at which two stencils share heights, up to mirror images.
const SHARED: [(isize, isize); 7] = [(0, 0), (0, 1), (0, 2), (1, -1), (1, 0), (1, 1), (2, 0)];
/// Index in `SHARED` of the offset between two places of a marker's cross, in row-by-row order.
const CROSS: [[usize; 5]; 5] =
    [[0, 3, 4, 5, 6], [0, 0, 1, 2, 5], [0, 0, 0, 1, 4], [0, 0, 0, 0, 3], [0, 0, 0, 0, 0]];
/// Index in `SHARED` of the offset between two places of `AROUND`, the later one first; `SHARED.len()` for
/// places that share no height.
const PAIRS: [[usize; COUNT]; COUNT] = {
    let (mut pairs, mut a) = ([[SHARED.len(); COUNT]; COUNT], 0);
    while a < COUNT {
        let mut b = 0;
        while b <= a {
            pairs[a][b] = offset(AROUND[a].0 - AROUND[b].0, AROUND[a].1 - AROUND[b].1);
            b += 1;
        }
        a += 1;
    }
    pairs
};

/// Index of an offset in `SHARED`.
const fn offset(row: isize, col: isize) -> usize {
    let mut k = 0;
    while k < SHARED.len() && !(SHARED[k].0 == row && SHARED[k].1 == col) {
        k += 1;
    }
    k
}

/// Covariances of the pressures of a lattice, row by row.
#[derive(Clone, Debug, Default)]
pub(super) struct Covariances {
    /// With the markers at the offsets `SHARED`.
    shared: Vec<[f64; SHARED.len()]>,
}

impl Covariances {
    pub fn reserve(&mut self, markers: usize) {
        self.shared.reserve(markers);
    }

    /// Computes them for heights of these variances.
    pub fn measure(&mut self, lattice: &Stencils, variance_mm2: &[f64]) {
        let (cols, stencils) = (lattice.cols, &lattice.weights);
        self.shared.clear();
        self.shared.resize(stencils.len(), [0.0; SHARED.len()]);
        for (k, &variance) in variance_mm2.iter().enumerate() {
            let [_, left, right, up, down] = stencils[k].map(|weight| weight != 0.0);
            // Markers whose stencils include this one, and its weight there: above, left, itself, right,
            // below.
            let whose = [k.wrapping_sub(cols), k.wrapping_sub(1), k, k + 1, k + cols];
            let taps = [(up, 4), (left, 2), (true, 0), (right, 1), (down, 3)];
            let mut weights = [0.0; 5];
            for ((weight, (exists, tap)), i) in weights.iter_mut().zip(taps).zip(whose) {
                *weight = if exists { stencils[i][tap] } else { 0.0 };
            }
            for (a, &i) in whose.iter().enumerate().filter(|&(a, _)| weights[a] != 0.0) {
                let scaled = weights[a] * variance;
                for b in a..5 {
                    self.shared[i][CROSS[a][b]] += scaled * weights[b];
                }
            }
        }
    }

    /// Predicts a marker's pressure from those of free markers at these places of [`AROUND`], which all
    /// exist. Returns the prediction and the remaining variance.
    pub fn predict(
        &self,
        lattice: &Stencils,
        i: usize,
        places: &[usize],
        pressure_mm: &[f64; COUNT],
    ) -> (f64, f64) {
        let mut noise = Noise { own: self.shared[i][0], cross: [0.0; COUNT], among: [[0.0; COUNT]; COUNT] };
        for (k, &place) in places.iter().enumerate() {
            let (row, col) = AROUND[place];
            let j = lattice.beside(i, row, col);
            noise.cross[place] = if (row, col) < (0, 0) {
                self.shared[j][offset(-row, -col)]
            } else {
                self.shared[i][offset(row, col)]
            };
            for &other in &places[..=k] {
                let (row, col) = AROUND[other];
                let shared = &self.shared[lattice.beside(i, row, col)];
                noise.among[place][other] = shared.get(PAIRS[place][other]).copied().unwrap_or(0.0);
            }
        }
        noise.predict(places, pressure_mm)
    }
}

/// Variance of a marker's pressure, and its covariances with, and among, those around it.
struct Noise {
    own: f64,
    cross: [f64; COUNT],
    /// Lower triangle.
    among: [[f64; COUNT]; COUNT],
}

impl Noise {
    /// Simple kriging, by a Cholesky factor of the covariance matrix.
    fn predict(&self, places: &[usize], pressure_mm: &[f64; COUNT]) -> (f64, f64) {
        let (mut factor, mut half, mut values) = ([[0.0; COUNT]; COUNT], [0.0; COUNT], [0.0; COUNT]);
        let (mut predicted, mut left) = (0.0, self.own);
        for (i, &place) in places.iter().enumerate() {
            let mut row = [0.0; COUNT];
            let among = &self.among[place];
            for j in 0..i {
                let sum: f64 = row[..j].iter().zip(&factor[j][..j]).map(|(a, b)| a * b).sum();
                row[j] = (among[places[j]] - sum) * factor[j][j];
            }
            let before = |list: &[f64; COUNT]| row[..i].iter().zip(list).map(|(a, b)| a * b).sum::<f64>();
            let pivot = (among[place] - before(&row)).max(1e-9 * among[place]);
            // The inverse of the diagonal.
            let inverse = 1.0 / sqrt(pivot);
            (half[i], values[i]) =
                ((self.cross[place] - before(&half)) * inverse, (pressure_mm[i] - before(&values)) * inverse);
            row[i] = inverse;
            factor[i] = row;
            predicted += half[i] * values[i];
            left -= half[i] * half[i];
        }
        (predicted, left.max(1e-9 * self.own))
    }
}

/// Weights of the markers around one in the prediction of its pressure, in a regular lattice of heights of
/// equal variance, and the share of the variance that remains.
#[derive(Clone, Debug, Default)]
pub(super) struct Even {
    pub weights: [f64; COUNT],
    pub left: f64,
}

impl Even {
    /// Where no prediction is made.
    pub const fn none() -> Self {
        Self { weights: [0.0; COUNT], left: 1.0 }
    }

    /// For the weights of the neighbours along a row and down a column.
    pub fn new(along: f64, down: f64) -> Self {
        let stencil = |(row, col): (isize, isize)| match (row.abs(), col.abs()) {
            (0, 0) => 1.0 - 2.0 * (along + down),
            (0, 1) => along,
            (1, 0) => down,
            _ => 0.0,
        };
        let taps = [(0, 0), (0, 1), (0, -1), (1, 0), (-1, 0)];
        let alike = |(row, col): (isize, isize)| -> f64 {
            taps.iter().map(|&(r, c)| stencil((r, c)) * stencil((r - row, c - col))).sum()
        };
        let noise = Noise {
            own: alike((0, 0)),
            cross: AROUND.map(alike),
            among: AROUND.map(|(a, b)| AROUND.map(|(row, col)| alike((row - a, col - b)))),
        };
        let (all, mut even): ([usize; COUNT], _) = (core::array::from_fn(|k| k), Self::default());
        for k in 0..COUNT {
            // The prediction is linear: the response to a unit pressure is its weight.
            let mut unit = [0.0; COUNT];
            unit[k] = 1.0;
            (even.weights[k], even.left) = noise.predict(&all, &unit);
        }
        even.left /= noise.own;
        even
    }
}

//! Noise of one marker's pressure as the free markers around it predict it (simple kriging).

use alloc::vec::Vec;

/// Markers on either side of the one that is judged whose noise is used to predict its own; stencils share none beyond.
pub(super) const REACH: usize = 2;
pub(super) const SIDE: usize = 2 * REACH + 1;
pub(super) const WINDOW: usize = SIDE * SIDE;
/// Offsets (rows down, columns across) at which two stencils share markers; their mirror images do too.
const SHARED: [(usize, isize); 7] = [(0, 0), (0, 1), (0, 2), (1, -1), (1, 0), (1, 1), (2, 0)];
/// Place in `SHARED` of the offset between two of a marker's cross, its places in row-by-row order.
const CROSS: [[usize; 5]; 5] =
    [[0, 3, 4, 5, 6], [0, 0, 1, 2, 5], [0, 0, 0, 1, 4], [0, 0, 0, 0, 3], [0, 0, 0, 0, 0]];

/// Covariances of the pressures of a lattice, row by row.
#[derive(Clone, Debug, Default)]
pub(super) struct Covariances {
    cols: usize,
    /// With those at the offsets `SHARED`.
    shared: Vec<[f64; SHARED.len()]>,
}

impl Covariances {
    /// For stencils with weights (marker, left, right, up, down) and heights of these variances.
    pub(super) fn measure(&mut self, cols: usize, stencils: &[[f64; 5]], variance_mm2: &[f64]) {
        self.cols = cols;
        self.shared.clear();
        self.shared.resize(stencils.len(), [0.0; SHARED.len()]);
        for (k, &variance) in variance_mm2.iter().enumerate() {
            let [_, left, right, up, down] = stencils[k].map(|weight| weight != 0.0);
            // Those whose stencils take this marker in, and with what weight: above, left, itself, right, below.
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

    pub(super) fn variance(&self, i: usize) -> f64 {
        self.shared[i][0]
    }
}

/// The free markers of a window and the one that is judged, in that order, and the covariances of their pressures.
pub(super) struct Kriging {
    count: usize,
    index: [usize; WINDOW],
    /// Upper triangle.
    matrix: [[f64; WINDOW]; WINDOW],
}

impl Kriging {
    /// About marker `i`, of the `free` ones among the `window`, which goes row by row.
    pub(super) fn new(
        covariances: &Covariances,
        i: usize,
        window: impl Iterator<Item = usize>,
        free: impl Fn(usize) -> bool,
    ) -> Self {
        let mut kriging = Self { count: 0, index: [0; WINDOW], matrix: [[0.0; WINDOW]; WINDOW] };
        let cols = covariances.cols;
        let slot = |j: usize| (j / cols + REACH - i / cols) * SIDE + j % cols + REACH - i % cols;
        let (mut slots, mut place) = ([0; WINDOW], [WINDOW; WINDOW]);
        let mut add = |j: usize, kriging: &mut Self| {
            let s = slot(j);
            (slots[kriging.count], place[s], kriging.index[kriging.count]) = (s, kriging.count, j);
            kriging.count += 1;
        };
        window.filter(|&j| j != i && free(j)).for_each(|j| add(j, &mut kriging));
        add(i, &mut kriging);
        for (a, &s) in slots[..kriging.count].iter().enumerate() {
            let (row, col) = (s / SIDE, s % SIDE);
            for (&(down, across), &value) in SHARED.iter().zip(&covariances.shared[kriging.index[a]]) {
                let col = col.wrapping_add_signed(across);
                if row + down < SIDE && col < SIDE {
                    let b = place[(row + down) * SIDE + col];
                    if b < WINDOW {
                        kriging.matrix[a.min(b)][a.max(b)] = value;
                    }
                }
            }
        }
        kriging
    }

    /// The judged marker's pressure less what the free ones, which carry none, say of its noise; and its variance.
    pub(super) fn predict(&mut self, pressure_mm: &[f64]) -> (f64, f64) {
        let n = self.count;
        let mut right = [0.0; WINDOW];
        for (value, &i) in right.iter_mut().zip(&self.index[..n]) {
            *value = pressure_mm[i];
        }
        self.eliminate(&mut right);
        (right[n - 1], self.matrix[n - 1][n - 1])
    }

    /// Gives each free marker's weight in the prediction, and returns its variance.
    pub(super) fn weights(&mut self, mut give: impl FnMut(usize, f64)) -> f64 {
        let last = self.count - 1;
        self.eliminate(&mut [0.0; WINDOW]);
        let mut weights = [0.0; WINDOW];
        for k in (0..last).rev() {
            let sum: f64 = (k + 1..last).map(|c| self.matrix[k][c] * weights[c]).sum();
            weights[k] = (self.matrix[k][last] - sum) / self.matrix[k][k];
            give(self.index[k], weights[k]);
        }
        self.matrix[last][last]
    }

    /// Gauss elimination of the free markers from the judged one.
    fn eliminate(&mut self, right: &mut [f64; WINDOW]) {
        let n = self.count;
        // Pivots are variances; where some are unknown, round-off must not take others to 0.
        let least: [f64; WINDOW] = core::array::from_fn(|k| 1e-12 * self.matrix[k][k]);
        for k in 0..n - 1 {
            let (above, below) = self.matrix.split_at_mut(k + 1);
            let pivot = &above[k];
            let inverse = 1.0 / pivot[k].max(least[k]);
            let value = right[k];
            for r in k + 1..n {
                let factor = pivot[r] * inverse;
                if factor != 0.0 {
                    right[r] -= factor * value;
                    for (x, &p) in below[r - k - 1][r..n].iter_mut().zip(&pivot[r..n]) {
                        *x -= factor * p;
                    }
                }
            }
        }
    }
}

//! Prediction of the noise of one marker's pressure from the free markers around it (simple kriging).

use alloc::vec::Vec;

/// Radius of the window of free markers used in the prediction; stencils farther apart share no marker.
pub(super) const REACH: usize = 2;
pub(super) const SIDE: usize = 2 * REACH + 1;
pub(super) const WINDOW: usize = SIDE * SIDE;
/// Offsets (rows down, columns across) at which two stencils share markers, up to mirror images.
const SHARED: [(usize, isize); 7] = [(0, 0), (0, 1), (0, 2), (1, -1), (1, 0), (1, 1), (2, 0)];
/// Index in `SHARED` of the offset between two places of a marker's cross, in row-by-row order.
const CROSS: [[usize; 5]; 5] =
    [[0, 3, 4, 5, 6], [0, 0, 1, 2, 5], [0, 0, 0, 1, 4], [0, 0, 0, 0, 3], [0, 0, 0, 0, 0]];

/// Covariances of the pressures of a lattice, row by row.
#[derive(Clone, Debug, Default)]
pub(super) struct Covariances {
    cols: usize,
    /// Covariances with the markers at the offsets `SHARED`.
    shared: Vec<[f64; SHARED.len()]>,
}

impl Covariances {
    /// Computes the covariances for stencils with weights (marker, left, right, up, down) and heights of
    /// these variances.
    pub(super) fn measure(&mut self, cols: usize, stencils: &[[f64; 5]], variance_mm2: &[f64]) {
        self.cols = cols;
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

    pub(super) fn variance(&self, i: usize) -> f64 {
        self.shared[i][0]
    }
}

/// Bandwidth: two markers of a window whose stencils overlap are no farther apart than this, counted row
/// by row.
const BAND: usize = REACH * SIDE + 1;
/// Size of a window plus the zeros that its last rows access.
const PADDED: usize = WINDOW + BAND;

/// The free markers of a window, with the covariances of their pressures among each other and with the
/// centre marker's.
pub(super) struct Kriging {
    count: usize,
    index: [usize; WINDOW],
    /// Upper band of the covariance matrix; each row starts at the diagonal.
    band: [[f64; BAND]; PADDED],
    cross: [f64; PADDED],
    /// Variance of the centre marker's pressure.
    own: f64,
}

impl Kriging {
    /// For marker `i` and the `free` markers of the `window`, which is in row-by-row order.
    pub(super) fn new(
        covariances: &Covariances,
        i: usize,
        window: impl Iterator<Item = usize>,
        free: impl Fn(usize) -> bool,
    ) -> Self {
        let mut kriging = Self {
            count: 0,
            index: [0; WINDOW],
            band: [[0.0; BAND]; PADDED],
            cross: [0.0; PADDED],
            own: covariances.variance(i),
        };
        let cols = covariances.cols;
        let slot = |j: usize| (j / cols + REACH - i / cols) * SIDE + j % cols + REACH - i % cols;
        let (mut slots, mut place) = ([0; WINDOW], [WINDOW; WINDOW]);
        for j in window.filter(|&j| j != i && free(j)) {
            let (s, n) = (slot(j), kriging.count);
            (slots[n], place[s], kriging.index[n]) = (s, n, j);
            kriging.count += 1;
        }
        kriging.fill(covariances, i, &slots, &place);
        kriging
    }

    fn fill(&mut self, covariances: &Covariances, i: usize, slots: &[usize], place: &[usize]) {
        let judged = WINDOW / 2;
        let markers = self.index[..self.count].iter().copied().zip(slots.iter().copied());
        for (j, s) in markers.chain([(i, judged)]) {
            let (row, col) = (s / SIDE, s % SIDE);
            for (&(down, across), &value) in SHARED.iter().zip(&covariances.shared[j]) {
                let col = col.wrapping_add_signed(across);
                if row + down >= SIDE || col >= SIDE {
                    continue;
                }
                let other = (row + down) * SIDE + col;
                match (place[s], place[other]) {
                    (WINDOW, WINDOW) => {}
                    (a, WINDOW) if other == judged => self.cross[a] = value,
                    (WINDOW, b) => self.cross[b] = value,
                    (_, WINDOW) => {}
                    (a, b) => self.band[a][b - a] = value,
                }
            }
        }
    }

    /// Residual of the centre marker's pressure after subtracting its noise as predicted from the free
    /// markers, which carry no pressure; and its variance.
    pub(super) fn predict(&mut self, i: usize, pressure_mm: &[f64]) -> (f64, f64) {
        let mut values = [0.0; PADDED];
        for (value, &j) in values.iter_mut().zip(&self.index[..self.count]) {
            *value = pressure_mm[j];
        }
        self.eliminate(&mut values);
        let (mut pressure, mut variance) = (pressure_mm[i], self.own);
        for k in 0..self.count {
            let share = self.cross[k] / self.band[k][0];
            pressure -= share * values[k];
            variance -= share * self.cross[k];
        }
        (pressure, variance)
    }

    /// Passes each free marker's weight in the prediction to `give`; returns the variance.
    pub(super) fn weights(&mut self, mut give: impl FnMut(usize, f64)) -> f64 {
        self.eliminate(&mut [0.0; PADDED]);
        let (mut weights, mut variance) = ([0.0; PADDED], self.own);
        for k in (0..self.count).rev() {
            let row = &self.band[k];
            let sum: f64 = row[1..].iter().zip(&weights[k + 1..]).map(|(x, w)| x * w).sum();
            weights[k] = (self.cross[k] - sum) / row[0];
            variance -= self.cross[k] * self.cross[k] / row[0];
            give(self.index[k], weights[k]);
        }
        variance
    }

    /// Gaussian forward elimination of the band and of both right-hand sides.
    fn eliminate(&mut self, values: &mut [f64; PADDED]) {
        // Pivots are variances; with some of them unknown (large), rounding must not make others 0.
        let least: [f64; WINDOW] = core::array::from_fn(|k| 1e-12 * self.band[k][0]);
        for (k, &least) in least.iter().enumerate().take(self.count) {
            self.band[k][0] = self.band[k][0].max(least);
            let pivot = self.band[k];
            let inverse = 1.0 / pivot[0];
            let (cross, value) = (self.cross[k], values[k]);
            for d in 1..BAND {
                let factor = pivot[d] * inverse;
                for (x, p) in self.band[k + d].iter_mut().zip(&pivot[d..]) {
                    *x -= factor * p;
                }
                self.cross[k + d] -= factor * cross;
                values[k + d] -= factor * value;
            }
        }
    }
}

/// Markers whose weights are computed together.
pub(super) const LANES: usize = 4;

/// One number per marker.
type Lane = [f64; LANES];

/// Weights of complete windows of free markers, for several adjacent markers at once: bit-identical to
/// [`Kriging`].
pub(super) struct Windows {
    /// As those of [`Kriging`].
    band: [[Lane; BAND]; PADDED],
    cross: [Lane; PADDED],
}

impl Windows {
    pub(super) const fn new() -> Self {
        Self { band: [[[0.0; LANES]; BAND]; PADDED], cross: [[0.0; LANES]; PADDED] }
    }

    /// Passes the weights of all window places except the centre to `give`, for marker `first` and those
    /// right of it, whose windows all lie inside the lattice. Returns their variances.
    pub(super) fn weights(
        &mut self,
        covariances: &Covariances,
        first: usize,
        mut give: impl FnMut(usize, Lane),
    ) -> Lane {
        self.fill(covariances, first);
        self.eliminate();
        let mut weights = [[0.0; LANES]; PADDED];
        let mut variance = core::array::from_fn(|lane| covariances.variance(first + lane));
        for k in (0..WINDOW - 1).rev() {
            let (row, cross) = (&self.band[k], &self.cross[k]);
            let mut sum = [0.0; LANES];
            for (x, w) in row[1..].iter().zip(&weights[k + 1..]) {
                for lane in 0..LANES {
                    sum[lane] += x[lane] * w[lane];
                }
            }
            for lane in 0..LANES {
                weights[k][lane] = (cross[lane] - sum[lane]) / row[0][lane];
                variance[lane] -= cross[lane] * cross[lane] / row[0][lane];
            }
            give(k + usize::from(k >= WINDOW / 2), weights[k]);
        }
        variance
    }

    fn fill(&mut self, covariances: &Covariances, first: usize) {
        // Elimination keeps the zeros of the padding.
        self.band.iter_mut().take(WINDOW - 1).for_each(|row| *row = [[0.0; LANES]; BAND]);
        self.cross = [[0.0; LANES]; PADDED];
        let judged = WINDOW / 2;
        // Index of a place among those other than the centre.
        let number = |slot: usize| slot - usize::from(slot > judged);
        for (row, col) in (0..SIDE).flat_map(|row| (0..SIDE).map(move |col| (row, col))) {
            let slot = row * SIDE + col;
            let marker = first + row * covariances.cols + col - REACH * covariances.cols - REACH;
            let shared = &covariances.shared[marker..marker + LANES];
            for (q, &(down, across)) in SHARED.iter().enumerate() {
                let col = col.wrapping_add_signed(across);
                if row + down >= SIDE || col >= SIDE {
                    continue;
                }
                let other = (row + down) * SIDE + col;
                let value = core::array::from_fn(|lane| shared[lane][q]);
                match (slot == judged, other == judged) {
                    (true, true) => {}
                    (true, false) => self.cross[number(other)] = value,
                    (false, true) => self.cross[number(slot)] = value,
                    (false, false) => self.band[number(slot)][number(other) - number(slot)] = value,
                }
            }
        }
    }

    /// As [`Kriging::eliminate`].
    fn eliminate(&mut self) {
        let least: [Lane; WINDOW] = core::array::from_fn(|k| self.band[k][0].map(|own| 1e-12 * own));
        for (k, least) in least.iter().enumerate().take(WINDOW - 1) {
            for lane in 0..LANES {
                self.band[k][0][lane] = self.band[k][0][lane].max(least[lane]);
            }
            let (pivot, cross) = (self.band[k], self.cross[k]);
            let inverse = pivot[0].map(|own| 1.0 / own);
            for d in 1..BAND {
                let factor: Lane = core::array::from_fn(|lane| pivot[d][lane] * inverse[lane]);
                for (x, p) in self.band[k + d].iter_mut().zip(&pivot[d..]) {
                    for lane in 0..LANES {
                        x[lane] -= factor[lane] * p[lane];
                    }
                }
                for lane in 0..LANES {
                    self.cross[k + d][lane] -= factor[lane] * cross[lane];
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::{Covariances, Kriging, LANES, REACH, SIDE, WINDOW, Windows};
    use crate::math::random::Stream;
    use alloc::vec::Vec;

    /// Bit for bit, on a lattice with varying stencils and variances.
    #[test]
    fn windows_give_the_weights_of_kriging() {
        let (rows, cols) = (7, 11);
        let mut stream = Stream::new(5, "stencils");
        let mut near = |exists: bool| if exists { -4.0 - stream.uniform() } else { 0.0 };
        let stencils: Vec<[f64; 5]> = (0..rows * cols)
            .map(|i| {
                let (row, col) = (i / cols, i % cols);
                let around = [near(col > 0), near(col + 1 < cols), near(row > 0), near(row + 1 < rows)];
                let [left, right, up, down] = around;
                [1.0 - left - right - up - down, left, right, up, down]
            })
            .collect();
        let variances: Vec<f64> = (0..rows * cols).map(|_| 0.5 + stream.uniform()).collect();
        let mut covariances = Covariances::default();
        covariances.measure(cols, &stencils, &variances);
        let mut windows = Windows::new();
        for first in [2 * cols + 2, 4 * cols + 5] {
            let mut found = [[0.0; LANES]; WINDOW];
            let variance = windows.weights(&covariances, first, |slot, weights| found[slot] = weights);
            for lane in 0..LANES {
                let i = first + lane;
                let corner = i - REACH * cols - REACH;
                let window = (0..WINDOW).map(|slot| corner + slot / SIDE * cols + slot % SIDE);
                let mut expected = [0.0; WINDOW];
                let least = Kriging::new(&covariances, i, window, |_| true).weights(|j, weight| {
                    expected[(j - corner) / cols * SIDE + (j - corner) % cols] = weight;
                });
                assert_eq!(found.map(|weights| weights[lane].to_bits()), expected.map(f64::to_bits));
                assert_eq!(variance[lane].to_bits(), least.to_bits());
            }
        }
    }
}

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

/// Two markers of a window that share some are no farther apart than this, counted row by row.
const BAND: usize = REACH * SIDE + 1;
/// Room for a window and the zeros that its last rows reach into.
const PADDED: usize = WINDOW + BAND;

/// The free markers of a window, and the covariances of their pressures among each other and with the judged one.
pub(super) struct Kriging {
    count: usize,
    index: [usize; WINDOW],
    /// Upper band of the covariance matrix; each row starts at the diagonal.
    band: [[f64; BAND]; PADDED],
    cross: [f64; PADDED],
    /// Variance of the judged marker's pressure.
    own: f64,
}

impl Kriging {
    /// About marker `i`, of the `free` ones among the `window`, which goes row by row.
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

    /// The judged marker's pressure less what the free ones, which carry none, say of its noise; and its variance.
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

    /// Gives each free marker's weight in the prediction, and returns its variance.
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

    /// Gauss elimination, downwards, of the band and of both right sides.
    fn eliminate(&mut self, values: &mut [f64; PADDED]) {
        // Pivots are variances; where some are unknown, round-off must not take others to 0.
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

//! Fields over the marker lattice: differences between neighbours, and the screened membrane.

use crate::scene::Gel;
use gelstereo_core::math::{DVec2, cos, sin, sqrt};

/// The lattice on its layer of gel.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Lattice {
    pub(crate) rows: usize,
    pub(crate) cols: usize,
    pub(crate) pitch_mm: f64,
    pub(crate) thickness_mm: f64,
    /// Unit vectors along a row and along a column, sensor x and y.
    pub(crate) axes: [DVec2; 2],
}

/// A sweep that moves nothing by more than this has converged: a tenth of a nanometre is 2e-6 px on the default
/// rig.
const STEP_MM: f64 = 1e-8;
/// About 13 sweeps are needed for every pitch of decay length: enough for 300 pitches.
const MAX_SWEEPS: usize = 4000;

impl Lattice {
    pub(crate) fn new(gel: &Gel) -> Self {
        let (s, c) = (sin(gel.rotation_rad), cos(gel.rotation_rad));
        let axes = [DVec2::new(c, s), DVec2::new(-s, c)];
        Self { rows: gel.rows, cols: gel.cols, pitch_mm: gel.pitch_mm, thickness_mm: gel.thickness_mm, axes }
    }

    /// Rest position of a marker, sensor x and y.
    pub(crate) fn marker_mm(&self, centre_mm: DVec2, row: usize, col: usize) -> DVec2 {
        let from_middle = |i: usize, n: usize| (i as f64 - 0.5 * (n as f64 - 1.0)) * self.pitch_mm;
        centre_mm + self.axes[0] * from_middle(col, self.cols) + self.axes[1] * from_middle(row, self.rows)
    }

    /// Rest positions of all markers, sensor x and y.
    pub(crate) fn rest_mm(&self, centre_mm: DVec2) -> impl Iterator<Item = DVec2> {
        let row_of = move |row| (0..self.cols).map(move |col| self.marker_mm(centre_mm, row, col));
        (0..self.rows).flat_map(row_of)
    }

    /// The two neighbours along a row and along a column that a difference is taken over, with their distance
    /// in pitches: 2, or 1 at the border.
    pub(crate) fn neighbours(&self, index: usize) -> [(usize, usize, f64); 2] {
        let (row, col) = (index / self.cols, index % self.cols);
        let pair = |i: usize, n: usize, stride: usize| {
            let (before, after) = (usize::from(i > 0), usize::from(i + 1 < n));
            (index - before * stride, index + after * stride, (before + after) as f64)
        };
        [pair(col, self.cols, 1), pair(row, self.rows, self.cols)]
    }

    /// Gradient of a field in sensor x and y, by central differences (one-sided at the border).
    pub(crate) fn gradient(&self, field: &[f64], index: usize) -> DVec2 {
        let [(left, right, across), (up, down, along)] = self.neighbours(index);
        let per_mm = 1.0 / self.pitch_mm;
        self.axes[0] * ((field[right] - field[left]) * per_mm / across)
            + self.axes[1] * ((field[down] - field[up]) * per_mm / along)
    }

    /// Solves u - l² Δu = `source` with free borders by successive over-relaxation, starting from `field`,
    /// where after each step `hold(index, value)` gives the value that is allowed: an obstacle's, a prescribed
    /// one, or the value itself.
    ///
    /// With an obstacle this is projected over-relaxation (Cryer 1971), which converges for this operator.
    pub(crate) fn relax(
        &self,
        length_mm: f64,
        field: &mut [f64],
        source: impl Fn(usize) -> f64,
        hold: impl Fn(usize, f64) -> f64,
    ) {
        let reach = length_mm / self.pitch_mm;
        let l2 = reach * reach;
        let jacobi = 4.0 * l2 / (1.0 + 4.0 * l2);
        let omega = 2.0 / (1.0 + sqrt(1.0 - jacobi * jacobi));
        let share = [0.0, 1.0, 2.0, 3.0, 4.0].map(|count| 1.0 / (1.0 + l2 * count));
        for _sweep in 0..MAX_SWEEPS {
            let mut largest = 0.0_f64;
            // Chequered order: the steps of one colour do not wait for each other.
            for colour in 0..2 {
                for row in 0..self.rows {
                    for col in ((row + colour) % 2..self.cols).step_by(2) {
                        let i = row * self.cols + col;
                        let (sum, count) = self.ring(field, row, col);
                        let old = field[i];
                        let balanced = (source(i) + l2 * sum) * share[count];
                        let new = hold(i, old + omega * (balanced - old));
                        field[i] = new;
                        largest = largest.max((new - old).abs());
                    }
                }
            }
            if largest <= STEP_MM {
                return;
            }
        }
    }

    /// Sum over the up to four neighbours, and their number.
    fn ring(&self, field: &[f64], row: usize, col: usize) -> (f64, usize) {
        let i = row * self.cols + col;
        let (mut sum, mut count) = (0.0, 0);
        let mut add = |exists: bool, j: usize| {
            if exists {
                sum += field[j];
                count += 1;
            }
        };
        add(col > 0, i.wrapping_sub(1));
        add(col + 1 < self.cols, i + 1);
        add(row > 0, i.wrapping_sub(self.cols));
        add(row + 1 < self.rows, i + self.cols);
        (sum, count)
    }
}

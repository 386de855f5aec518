//! Fields over the marker lattice: differences between neighbours, and the screened membrane.

use crate::scene::Gel;
use core::ops::{Add, Mul, Sub};
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
    pub(crate) fn relax<T: Relaxed>(
        &self,
        length_mm: f64,
        field: &mut [T],
        source: impl Fn(usize) -> T,
        hold: impl Fn(usize, T) -> T,
    ) {
        let (rows, cols, reach) = (self.rows, self.cols, length_mm / self.pitch_mm);
        let l2 = reach * reach;
        let jacobi = 4.0 * l2 / (1.0 + 4.0 * l2);
        let omega = 2.0 / (1.0 + sqrt(1.0 - jacobi * jacobi));
        let share = [0.0, 1.0, 2.0, 3.0, 4.0].map(|count| 1.0 / (1.0 + l2 * count));
        for _sweep in 0..MAX_SWEEPS {
            let mut largest = 0.0;
            let mut step = |i: usize, here: &mut T, (sum, count): (T, usize)| {
                let old = *here;
                let balanced = (source(i) + sum * l2) * share[count];
                *here = hold(i, old + (balanced - old) * omega);
                let moved = (*here - old).size();
                largest = if moved > largest { moved } else { largest };
            };
            // Chequered order: the steps of one colour do not wait for each other.
            for colour in 0..2 {
                for row in 0..rows {
                    let (first, from) = ((row + colour) % 2, row * cols);
                    if row == 0 || row + 1 == rows {
                        for col in (first..cols).step_by(2) {
                            let ring = self.ring(field, row, col);
                            step(from + col, &mut field[from + col], ring);
                        }
                        continue;
                    }
                    let (above, rest) = field.split_at_mut(from);
                    let (here, below) = rest.split_at_mut(cols);
                    let (above, below) = (&above[from - cols..], &below[..cols]);
                    each_inside(first, here, above, below, |col, here, ring| step(from + col, here, ring));
                }
            }
            if largest <= STEP_MM {
                return;
            }
        }
    }

    /// Sum over the up to four neighbours, and their number.
    fn ring<T: Relaxed>(&self, field: &[T], row: usize, col: usize) -> (T, usize) {
        let i = row * self.cols + col;
        let (mut sum, mut count) = (T::default(), 0);
        let mut add = |exists: bool, j: usize| {
            if exists {
                sum = sum + field[j];
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

/// What is relaxed: numbers, or vectors whose components share the places that hold them.
pub(crate) trait Relaxed:
    Copy + Default + Add<Output = Self> + Sub<Output = Self> + Mul<f64, Output = Self>
{
    /// Its largest component.
    fn size(self) -> f64;
}

impl Relaxed for f64 {
    #[inline(always)]
    fn size(self) -> f64 {
        self.abs()
    }
}

impl Relaxed for DVec2 {
    #[inline(always)]
    fn size(self) -> f64 {
        let (x, y) = (self.x.abs(), self.y.abs());
        if x > y { x } else { y }
    }
}

/// Every other marker of a row that has two neighbours beside it in its column, with [`Lattice::ring`] about it.
#[inline(always)]
fn each_inside<T: Relaxed>(
    first: usize,
    here: &mut [T],
    above: &[T],
    below: &[T],
    mut step: impl FnMut(usize, &mut T, (T, usize)),
) {
    let last = here.len() - 1;
    let (above, below) = (&above[..=last], &below[..=last]);
    if first == 0 {
        let sum = here[1] + above[0] + below[0];
        step(0, &mut here[0], (sum, 3));
    }
    for col in (2 - first..last).step_by(2) {
        let sum = here[col - 1] + here[col + 1] + above[col] + below[col];
        step(col, &mut here[col], (sum, 4));
    }
    if last % 2 == first {
        let sum = here[last - 1] + above[last] + below[last];
        step(last, &mut here[last], (sum, 3));
    }
}

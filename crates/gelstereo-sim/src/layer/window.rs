//! Window of grid cells that a solve covers.

use super::fft::Plane;
use super::{Grid, MIN_SIDE};
use alloc::vec::Vec;

/// A rectangle of cells.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Window {
    row: usize,
    col: usize,
    rows: usize,
    cols: usize,
    grid_cols: usize,
}

impl Window {
    /// The whole grid.
    pub(crate) fn whole(grid: Grid) -> Self {
        Self { row: 0, col: 0, rows: grid.rows, cols: grid.cols, grid_cols: grid.cols }
    }

    /// Bounding window of the cells whose height exceeds `-rise` times the greatest height; empty if no
    /// height is positive.
    pub(crate) fn around(heights_mm: &[f64], grid: Grid, rise: f64) -> Self {
        let deepest = heights_mm.iter().fold(0.0_f64, |deepest, &height| deepest.max(height));
        let threshold = -rise * deepest;
        let (mut low, mut high) = ([usize::MAX; 2], [0; 2]);
        for (row, heights_mm) in heights_mm.chunks_exact(grid.cols).enumerate() {
            let near = |height: &f64| *height > threshold;
            let (Some(first), Some(last)) =
                (heights_mm.iter().position(near), heights_mm.iter().rposition(near))
            else {
                continue;
            };
            low = [low[0].min(row), low[1].min(first)];
            high = [row + 1, high[1].max(last + 1)];
        }
        if high[0] == 0 || deepest == 0.0 {
            return Self { grid_cols: grid.cols, ..Self::default() };
        }
        let [row, col] = low;
        Self { row, col, rows: high[0] - row, cols: high[1] - col, grid_cols: grid.cols }
    }

    /// Index of the operator that holds the window; operators are sorted by the logarithms of their
    /// sides.
    pub(crate) fn operator(&self, sizes: [usize; 2]) -> usize {
        let log = |cells: usize| (cells.max(MIN_SIDE).next_power_of_two() / MIN_SIDE).ilog2() as usize;
        log(self.rows) * sizes[1] + log(self.cols)
    }

    /// Copies the window of a grid field onto an operator's cells. `beside` fills the remaining cells,
    /// and all cells if the field is empty.
    pub(crate) fn cut(&self, field: &[f64], beside: f64, plane: &Plane, out: &mut Vec<f64>) {
        out.clear();
        out.resize(plane.rows * plane.cols, beside);
        if field.is_empty() {
            return;
        }
        for row in 0..self.rows {
            let from = (self.row + row) * self.grid_cols + self.col;
            out[row * plane.cols..][..self.cols].copy_from_slice(&field[from..][..self.cols]);
        }
    }

    /// Inverse of [`Self::cut`].
    pub(crate) fn paste(&self, cut: &[f64], plane: &Plane, field: &mut [f64]) {
        for row in 0..self.rows {
            let to = (self.row + row) * self.grid_cols + self.col;
            field[to..][..self.cols].copy_from_slice(&cut[row * plane.cols..][..self.cols]);
        }
    }

    /// [`Self::paste`] onto a field of its own.
    pub(crate) fn put(&self, cut: &[f64], plane: &Plane, field: &mut Vec<f64>) {
        field.clear();
        field.resize(self.rows * self.cols, 0.0);
        self.paste(cut, plane, field);
    }

    /// Adds the values that [`Self::paste`] would write.
    pub(crate) fn add(&self, cut: &[f64], plane: &Plane, field: &mut [f64]) {
        for row in 0..self.rows {
            let to = (self.row + row) * self.grid_cols + self.col;
            let from = &cut[row * plane.cols..][..self.cols];
            field[to..][..self.cols].iter_mut().zip(from).for_each(|(sum, x)| *sum += x);
        }
    }
}

//! The marker lattice: rest positions, and differences between neighbours.

use crate::scene::Gel;
use gelstereo_core::math::{DVec2, cos, sin};

/// Place of a node from the middle of a grid, along a row and along a column.
pub(crate) fn from_middle([row, col]: [usize; 2], [rows, cols]: [usize; 2], step_mm: [f64; 2]) -> DVec2 {
    let along = |i: usize, n: usize, step_mm: f64| (i as f64 - 0.5 * (n as f64 - 1.0)) * step_mm;
    DVec2::new(along(col, cols, step_mm[0]), along(row, rows, step_mm[1]))
}

/// The marker lattice with its gel thickness.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Lattice {
    pub(crate) rows: usize,
    pub(crate) cols: usize,
    /// Distance of neighbours along a row and along a column.
    pub(crate) pitch_mm: [f64; 2],
    pub(crate) thickness_mm: f64,
    /// Unit vectors along a row and along a column, sensor x and y.
    pub(crate) axes: [DVec2; 2],
}

impl Lattice {
    pub(crate) fn new(gel: &Gel) -> Self {
        let (s, c) = (sin(gel.rotation_rad), cos(gel.rotation_rad));
        let axes = [DVec2::new(c, s), DVec2::new(-s, c)];
        let Gel { rows, cols, thickness_mm, .. } = *gel;
        Self { rows, cols, pitch_mm: gel.pitch_mm.axes_mm(), thickness_mm, axes }
    }

    /// Rest position of a marker, sensor x and y.
    pub(crate) fn marker_mm(&self, centre_mm: DVec2, row: usize, col: usize) -> DVec2 {
        let at = self.printed_mm(row, col);
        centre_mm + self.axes[0] * at.x + self.axes[1] * at.y
    }

    /// Place of a marker in the lattice's frame.
    pub(crate) fn printed_mm(&self, row: usize, col: usize) -> DVec2 {
        from_middle([row, col], [self.rows, self.cols], self.pitch_mm)
    }

    /// Rest positions of all markers, sensor x and y.
    pub(crate) fn rest_mm(&self, centre_mm: DVec2) -> impl Iterator<Item = DVec2> {
        let row_of = move |row| (0..self.cols).map(move |col| self.marker_mm(centre_mm, row, col));
        (0..self.rows).flat_map(row_of)
    }

    /// The two neighbours along the row and along the column for a difference, with their distance in
    /// pitches: 2, or 1 at the border.
    pub(crate) fn neighbours(&self, index: usize) -> [(usize, usize, f64); 2] {
        let (row, col) = (index / self.cols, index % self.cols);
        let pair = |i: usize, n: usize, stride: usize| {
            let (before, after) = (usize::from(i > 0), usize::from(i + 1 < n));
            (index - before * stride, index + after * stride, (before + after) as f64)
        };
        [pair(col, self.cols, 1), pair(row, self.rows, self.cols)]
    }

    /// Squares of a length in pitches along a row and along a column.
    pub(crate) fn squared_pitches(&self, length_mm: f64) -> [f64; 2] {
        self.pitch_mm.map(|mm| (length_mm / mm) * (length_mm / mm))
    }

    /// Gradient of a field in sensor x and y, by central differences (one-sided at the border).
    pub(crate) fn gradient(&self, field: &[f64], index: usize) -> DVec2 {
        let [(left, right, across), (up, down, along)] = self.neighbours(index);
        let per_mm = self.pitch_mm.map(|mm| 1.0 / mm);
        self.axes[0] * ((field[right] - field[left]) * per_mm[0] / across)
            + self.axes[1] * ((field[down] - field[up]) * per_mm[1] / along)
    }
}

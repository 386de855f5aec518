//! The marker lattice: rest positions, and differences between neighbours.

use crate::scene::Gel;
use gelstereo_core::math::{DVec2, cos, sin};
use gelstereo_core::params::PrintLayout;

/// Place of a node from the middle of a grid, along a row and along a column.
pub(crate) fn from_middle([row, col]: [usize; 2], [rows, cols]: [usize; 2], step_mm: [f64; 2]) -> DVec2 {
    let along = |i: usize, n: usize, step_mm: f64| (i as f64 - 0.5 * (n as f64 - 1.0)) * step_mm;
    DVec2::new(along(col, cols, step_mm[0]), along(row, rows, step_mm[1]))
}

/// The lattice's nodes with the gel's thickness. Markers stand on all nodes or, in a hexagonal print, on
/// every second one of each row.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Lattice {
    /// Nodes from top to bottom and from left to right.
    pub(crate) rows: usize,
    pub(crate) cols: usize,
    /// Distance of neighbouring nodes along a row and along a column.
    pub(crate) pitch_mm: [f64; 2],
    pub(crate) thickness_mm: f64,
    /// Unit vectors along a row and along a column, sensor x and y.
    pub(crate) axes: [DVec2; 2],
    /// Nodes from a marker to the next one of its row.
    pub(crate) apart: usize,
    /// Node column of the first marker of even and of odd rows.
    first: [usize; 2],
}

impl Lattice {
    pub(crate) fn new(gel: &Gel) -> Self {
        let (s, c) = (sin(gel.rotation_rad), cos(gel.rotation_rad));
        let axes = [DVec2::new(c, s), DVec2::new(-s, c)];
        let (apart, first) = match gel.layout {
            PrintLayout::Square => (1, [0, 0]),
            PrintLayout::Hexagonal if gel.odd_rows_forward => (2, [0, 1]),
            PrintLayout::Hexagonal => (2, [1, 0]),
        };
        let [x_mm, y_mm] = gel.spacing_mm();
        let Gel { rows, cols, thickness_mm, .. } = *gel;
        let pitch_mm = [x_mm / apart as f64, y_mm];
        Self { rows, cols: cols * apart, pitch_mm, thickness_mm, axes, apart, first }
    }

    /// Number of nodes.
    pub(crate) const fn nodes(&self) -> usize {
        self.rows * self.cols
    }

    /// Number of markers.
    pub(crate) const fn markers(&self) -> usize {
        self.nodes() / self.apart
    }

    /// The node that a marker stands on.
    pub(crate) const fn node(&self, marker: usize) -> usize {
        let per_row = self.cols / self.apart;
        let row = marker / per_row;
        row * self.cols + marker % per_row * self.apart + self.first[row % 2]
    }

    /// The marker on a node.
    pub(crate) fn marker_on(&self, node: usize) -> Option<usize> {
        let (row, col) = (node / self.cols, node % self.cols);
        let is_marker = col % self.apart == self.first[row % 2];
        is_marker.then_some(node / self.apart)
    }

    /// The markers' values of a field over the nodes.
    pub(crate) fn of_markers<'a, T: Copy>(&self, field: &'a [T]) -> impl Iterator<Item = T> + use<'a, T> {
        let lattice = *self;
        (0..lattice.markers()).map(move |marker| field[lattice.node(marker)])
    }

    /// Rest position of a marker, sensor x and y.
    pub(crate) fn marker_mm(&self, centre_mm: DVec2, row: usize, col: usize) -> DVec2 {
        self.node_mm(centre_mm, row, col * self.apart + self.first[row % 2])
    }

    /// Rest position of a node, sensor x and y.
    fn node_mm(&self, centre_mm: DVec2, row: usize, col: usize) -> DVec2 {
        let at = self.printed_mm(row, col);
        centre_mm + self.axes[0] * at.x + self.axes[1] * at.y
    }

    /// Place of a node in the lattice's frame.
    pub(crate) fn printed_mm(&self, row: usize, col: usize) -> DVec2 {
        from_middle([row, col], [self.rows, self.cols], self.pitch_mm)
    }

    /// Rest positions of all nodes, sensor x and y.
    pub(crate) fn rest_mm(&self, centre_mm: DVec2) -> impl Iterator<Item = DVec2> {
        let row_of = move |row| (0..self.cols).map(move |col| self.node_mm(centre_mm, row, col));
        (0..self.rows).flat_map(row_of)
    }

    /// The two markers along the row and along the column for a difference, with their printed difference in
    /// the lattice's frame.
    pub(crate) fn marker_pairs(&self, marker: usize) -> [(usize, usize, DVec2); 2] {
        let per_row = self.cols / self.apart;
        let (row, col) = (marker / per_row, marker % per_row);
        let place = |marker: usize| {
            let node = self.node(marker);
            DVec2::new(
                (node % self.cols) as f64 * self.pitch_mm[0],
                (marker / per_row) as f64 * self.pitch_mm[1],
            )
        };
        let pair = |i: usize, n: usize, stride: usize| {
            let (before, after) = (usize::from(i > 0) * stride, usize::from(i + 1 < n) * stride);
            let (before, after) = (marker - before, marker + after);
            (before, after, place(after) - place(before))
        };
        [pair(col, per_row, 1), pair(row, self.rows, per_row)]
    }

    /// The two nodes along the row and along the column for a difference, with their distance in
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

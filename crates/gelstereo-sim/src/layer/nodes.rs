//! Motion of markers under the tractions of a contact.
//!
//! Markers stand on every n-th cell, so the influence of a cell on a row of markers is a contiguous
//! slice of a table. A contact has far fewer loaded cells than the grid, so sums over them are cheaper
//! than transforms of all cells.

use super::LayerContact;
use alloc::vec::Vec;
use gelstereo_core::layer::Influence;

/// Nodes of the lattice on a grid of cells.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Places {
    pub(crate) rows: usize,
    pub(crate) cols: usize,
    /// Cells between neighbouring nodes along a column and along a row.
    pub(crate) step: [usize; 2],
    /// Cells above and beside the first node, each a multiple of its `step`.
    pub(crate) border: [usize; 2],
}

/// Influence of cells on markers.
#[derive(Debug)]
pub(crate) struct Nodes {
    places: Places,
    grid_cols: usize,
    /// Index of offset zero in a table row.
    origin: usize,
    /// Length of a table row.
    width: usize,
    /// Indexed by offset down (absolute value), offset across modulo `step`, and offset across.
    normal: Vec<f64>,
    cross: [Vec<f64>; 2],
    /// Along x, along y, and the coupling between them.
    shear: [Vec<f64>; 3],
}

/// Motion of every marker, mm: into the layer, and along the cells' x and y.
#[derive(Clone, Debug, Default)]
pub(crate) struct Motion {
    pub(crate) into: Vec<f64>,
    pub(crate) aside: [Vec<f64>; 2],
}

impl Places {
    /// Cells along y and x.
    pub(crate) fn cells(&self) -> [usize; 2] {
        let count = |nodes: usize, axis: usize| (nodes - 1) * self.step[axis] + 1 + 2 * self.border[axis];
        [count(self.rows, 0), count(self.cols, 1)]
    }

    /// The cell under a node.
    pub(crate) fn cell(&self, node: usize) -> usize {
        let (row, col) = (node / self.cols, node % self.cols);
        let [down, across] = [0, 1].map(|axis| [row, col][axis] * self.step[axis] + self.border[axis]);
        down * self.cells()[1] + across
    }
}

impl Nodes {
    pub(crate) fn new(contact: &LayerContact, places: Places) -> Self {
        let [grid_rows, grid_cols] = places.cells();
        let [_, step] = places.step;
        let origin = (grid_cols - 1).div_ceil(step);
        let width = origin + places.cols + places.border[1] / step;
        let influence = contact.influence();
        let side = influence.side;
        let table = |field: &[f64], odd: bool| {
            let mut list = Vec::with_capacity(grid_rows * step * width);
            for row in 0..grid_rows {
                for phase in 0..step {
                    for t in 0..width {
                        let col = ((t as isize - origin as isize) * step as isize) + phase as isize;
                        let sign = if odd && col < 0 { -1.0 } else { 1.0 };
                        // No cell has a marker beyond the table.
                        let col = col.unsigned_abs();
                        list.push(if col < side { sign * field[row * side + col] } else { 0.0 });
                    }
                }
            }
            list
        };
        let Influence { normal, cross, along, across, .. } = influence;
        Self {
            places,
            grid_cols,
            origin,
            width,
            normal: table(normal, false),
            cross: [table(&cross[0], true), table(&cross[1], false)],
            shear: [table(&along[0], false), table(&along[1], false), table(across, true)],
        }
    }

    /// Motion of the markers under the contact's tractions.
    pub(crate) fn motion(&self, contact: &LayerContact, out: &mut Motion) {
        let markers = self.places.rows * self.places.cols;
        let Motion { into, aside: [along, across] } = out;
        for field in [&mut *into, &mut *along, &mut *across] {
            field.clear();
            field.resize(markers, 0.0);
        }
        let [qx, qy] = contact.traction();
        for (cell, &p) in contact.pressure().iter().enumerate() {
            let (qx, qy) = (qx[cell], qy[cell]);
            if p == 0.0 && qx == 0.0 && qy == 0.0 {
                continue;
            }
            for row in 0..self.places.rows {
                let (at, sign) = self.stretch(cell, row);
                let cols = row * self.places.cols..(row + 1) * self.places.cols;
                let out = [&mut into[cols.clone()], &mut along[cols.clone()], &mut across[cols]];
                let normal = &self.normal[at..at + self.places.cols];
                let [vx, vy] = [0, 1].map(|n| &self.cross[n][at..at + self.places.cols]);
                let [into, along, across] = out;
                add([into, along, across], [normal, vx, vy], [p, p, sign * p]);
                if qx != 0.0 || qy != 0.0 {
                    let [xx, yy, xy] = [0, 1, 2].map(|n| &self.shear[n][at..at + self.places.cols]);
                    add([into, along, across], [vx, xx, xy], [-qx, qx, sign * qx]);
                    add([into, along, across], [vy, xy, yy], [-sign * qy, sign * qy, qy]);
                }
            }
        }
    }

    /// Start of the table slice for the influence of a cell on a row of markers, and the sign of kernels
    /// that are odd down.
    fn stretch(&self, cell: usize, row: usize) -> (usize, f64) {
        let Places { step: [row_step, step], border: [above, border], .. } = self.places;
        let (cell_row, cell_col) = (cell / self.grid_cols, cell % self.grid_cols);
        let down = (row * row_step + above) as isize - cell_row as isize;
        let back = cell_col.div_ceil(step);
        let phase = back * step - cell_col;
        let start = self.origin + border / step - back;
        let line = down.unsigned_abs() * step + phase;
        (line * self.width + start, if down < 0 { -1.0 } else { 1.0 })
    }
}

fn add(out: [&mut [f64]; 3], tables: [&[f64]; 3], loads: [f64; 3]) {
    for ((out, table), load) in out.into_iter().zip(tables).zip(loads) {
        out.iter_mut().zip(table).for_each(|(sum, k)| *sum += load * k);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::layer::{Grid, Layer};
    use gelstereo_core::math::random::Stream;

    /// The transforms over all cells are the reference.
    #[test]
    fn markers_move_as_the_cells_that_they_stand_on() {
        let steps =
            [([1, 1], [0, 0]), ([2, 2], [4, 4]), ([3, 3], [3, 3]), ([4, 4], [0, 0]), ([3, 2], [3, 4])];
        for (step, border) in steps {
            let places = Places { rows: 5, cols: 7, step, border };
            let [rows, cols] = places.cells();
            let layer = Layer { thickness_mm: 3.0, poisson_ratio: 0.45 };
            let mut contact =
                LayerContact::new(layer, Grid { rows, cols, cell_mm: [0.4, 0.3] }, 1.0).unwrap();
            let mut random = Stream::new(1, "loads");
            let [p, qx, qy] =
                [0, 1, 2].map(|_| (0..rows * cols).map(|_| random.uniform() - 0.5).collect::<Vec<_>>());
            contact.load(&p, [&qx, &qy]).unwrap();
            let mut found = Motion::default();
            Nodes::new(&contact, places).motion(&contact, &mut found);
            let (mut into, mut aside) = (Vec::new(), [Vec::new(), Vec::new()]);
            contact.surface_mm(&mut into, &mut aside);
            for marker in 0..35 {
                let cell = places.cell(marker);
                let off = (found.into[marker] - into[cell]).abs()
                    + (found.aside[0][marker] - aside[0][cell]).abs()
                    + (found.aside[1][marker] - aside[1][cell]).abs();
                assert!(off < 1e-11, "step {step:?}: marker {marker} is off by {off}");
            }
        }
    }
}

//! Motion of a gel's surface by its free sides ([`FreeSides`]).

use super::{LayerContact, Motion, Places};
use alloc::vec::Vec;
use core::ops::Range;
use gelstereo_core::layer::{FreeSides, Influence};
use gelstereo_core::math::{ceil, floor};

/// Free sides about a grid of cells, and the images of its loads.
#[derive(Clone, Debug)]
pub(crate) struct Sides {
    sides: FreeSides,
    influence: Influence,
    /// Columns and rows of cells on the gel.
    inside: [Range<usize>; 2],
    cols: usize,
    images: Vec<Load>,
}

/// Load of an image: pressure and tractions along x and y.
#[derive(Clone, Copy, Debug)]
struct Load {
    col: isize,
    row: isize,
    loads: [f64; 3],
}

impl Sides {
    /// Sides beyond the outermost markers by `rim_mm`, rounded to half a cell.
    pub(crate) fn new(contact: &LayerContact, places: Places, rim_mm: f64) -> Self {
        let grid = contact.grid();
        let counts = [grid.cols, grid.rows];
        let [above, beside] = places.border;
        let [x_mm, y_mm] = grid.cell_mm;
        let beyond_mm = [rim_mm - beside as f64 * x_mm, rim_mm - above as f64 * y_mm];
        let sides = FreeSides::new(counts, grid.cell_mm, beyond_mm);
        // A cell belongs to the gel if its middle does.
        let [x, y] = sides.places();
        let within = |[low, high]: [f64; 2], count: usize| {
            ceil(low).max(0.0) as usize..(floor(high) as usize + 1).min(count)
        };
        let inside = [within(x, counts[0]), within(y, counts[1])];
        let influence = Influence::new(&contact.layer(), grid.cell_mm, sides.reach());
        Self { sides, influence, inside, cols: grid.cols, images: Vec::new() }
    }

    /// Whether a cell is gel.
    pub(crate) fn holds(&self, cell: usize) -> bool {
        self.inside[0].contains(&(cell % self.cols)) && self.inside[1].contains(&(cell / self.cols))
    }

    /// Takes the images of a contact's loads.
    pub(crate) fn take(&mut self, contact: &LayerContact) {
        self.images.clear();
        let [qx, qy] = contact.traction();
        for (cell, &p) in contact.pressure().iter().enumerate() {
            let own = [p, qx[cell], qy[cell]];
            if own == [0.0; 3] {
                continue;
            }
            self.images.extend(self.sides.images([cell % self.cols, cell / self.cols]).map(|image| Load {
                col: image.col,
                row: image.row,
                loads: [0, 1, 2].map(|k| image.factors[k] * own[k]),
            }));
        }
    }

    /// Motion of a cell by the images: into the layer, along x and along y.
    pub(crate) fn motion(&self, cell: usize) -> [f64; 3] {
        let (col, row) = ((cell % self.cols) as isize, (cell / self.cols) as isize);
        let mut sum = [0.0; 3];
        for image in &self.images {
            let effect = self.influence.effect(col - image.col, row - image.row);
            for (sum, effect) in sum.iter_mut().zip(effect) {
                let [p, qx, qy] = image.loads;
                *sum += effect[0] * p + effect[1] * qx + effect[2] * qy;
            }
        }
        sum
    }

    /// Adds the motion of the markers.
    pub(crate) fn add(&self, places: Places, out: &mut Motion) {
        let Motion { into, aside: [along, across] } = out;
        for marker in 0..into.len() {
            let [u, v, w] = self.motion(places.cell(marker));
            into[marker] += u;
            along[marker] += v;
            across[marker] += w;
        }
    }
}

//! Free sides of a gel, by mirror images of its loads.
//!
//! A side carries no load. A load and its mirror image beyond the side, with the opposite sign, cancel the
//! normal stress there by symmetry, as images do for point forces (Mindlin 1936); the shear stress on the side
//! remains. Pressures and tractions along the side change sign, and tractions across it keep theirs.
//!
//! The shear stress that remains moves the gel beside it, too, and images that are larger by a fifth account for
//! most of that. The table has what images leave of the change by free sides, for a gel whose half width is 2.7
//! times its thickness (balls, solids) and 5.5 times (balls, solids), under the loads of the finite-element
//! contacts of bench/outside, half `w`. The reference is a block of linear elements with these sides:
//!
//! | images times | 2.7, balls | 2.7, solids | 5.5, balls | 5.5, solids |
//! |---|---|---|---|---|
//! | 1 | 29 % | 31 % | 14 % | 23 % |
//! | 1, with images of images at the corners | 38 % | 35 % | 15 % | 62 % |
//! | 1.1 | 22 % | 25 % | 11 % | 21 % |
//! | 1.2 | 17 % | 20 % | 14 % | 23 % |
//! | 1.35 | 14 % | 17 % | 25 % | 31 % |

use super::{LayerContact, Motion, Places};
use alloc::vec::Vec;
use core::ops::Range;
use gelstereo_core::layer::Influence;
use gelstereo_core::math::{ceil, floor, round};

/// Loads of an image over those of the cell.
const OF_IMAGE: f64 = 1.2;

/// Free sides about a grid of cells.
#[derive(Clone, Debug)]
pub(crate) struct Sides {
    influence: Influence,
    /// Sum of the columns, and of the rows, of a cell and its image: of both sides of each axis.
    sums: [[isize; 2]; 2],
    /// Columns and rows of cells on the gel.
    inside: [Range<usize>; 2],
    cols: usize,
    images: Vec<Image>,
}

/// Load of an image: pressure and tractions along x and y.
#[derive(Clone, Copy, Debug)]
struct Image {
    col: isize,
    row: isize,
    loads: [f64; 3],
}

impl Sides {
    /// Sides beyond the outermost markers by `rim_mm`, rounded to half a cell.
    pub(crate) fn new(contact: &LayerContact, places: Places, rim_mm: f64) -> Self {
        let grid = contact.grid();
        let counts = [grid.cols, grid.rows];
        let sums = [0, 1].map(|axis| {
            let half_cells = round(2.0 * rim_mm / grid.cell_mm[axis]) as isize;
            let low = 2 * places.border as isize - half_cells;
            [low, 2 * (counts[axis] as isize - 1) - low]
        });
        // A cell belongs to the gel if its middle does.
        let inside = [0, 1].map(|axis| {
            let [low, high] = sums[axis].map(|sum| 0.5 * sum as f64);
            ceil(low).max(0.0) as usize..(floor(high) as usize + 1).min(counts[axis])
        });
        // From one end of the grid to the image of the other.
        let side = sums[0][1].max(sums[1][1]).unsigned_abs() + 1;
        let influence = Influence::new(&contact.layer(), grid.cell_mm, side);
        Self { influence, sums, inside, cols: grid.cols, images: Vec::new() }
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
            let [p, qx, qy] = [p, qx[cell], qy[cell]].map(|load| OF_IMAGE * load);
            if p == 0.0 && qx == 0.0 && qy == 0.0 {
                continue;
            }
            let (col, row) = ((cell % self.cols) as isize, (cell / self.cols) as isize);
            for side in 0..2 {
                let across = Image { col: self.sums[0][side] - col, row, loads: [-p, qx, -qy] };
                let down = Image { col, row: self.sums[1][side] - row, loads: [-p, -qx, qy] };
                self.images.extend([across, down]);
            }
        }
    }

    /// Motion of a cell by the images: into the layer, along x and along y.
    pub(crate) fn motion(&self, cell: usize) -> [f64; 3] {
        let (col, row) = ((cell % self.cols) as isize, (cell / self.cols) as isize);
        let Influence { side, normal, cross, along, across } = &self.influence;
        let mut sum = [0.0; 3];
        for image in &self.images {
            let (right, down) = (col - image.col, row - image.row);
            let i = down.unsigned_abs() * side + right.unsigned_abs();
            let sign = |offset: isize| if offset < 0 { -1.0 } else { 1.0 };
            let (x, y) = (sign(right), sign(down));
            let [p, qx, qy] = image.loads;
            let (aside_x, aside_y, mixed) = (x * cross[0][i], y * cross[1][i], x * y * across[i]);
            sum[0] += p * normal[i] - qx * aside_x - qy * aside_y;
            sum[1] += p * aside_x + qx * along[0][i] + qy * mixed;
            sum[2] += p * aside_y + qx * mixed + qy * along[1][i];
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

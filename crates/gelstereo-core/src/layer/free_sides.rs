//! Free sides of a gel, by mirror images of its loads.
//!
//! A side carries no load. A load and its mirror image beyond the side, with the opposite sign, cancel the
//! normal stress there by symmetry, as images do for point forces (Mindlin 1936); the shear stress on the
//! side remains. Pressures and tractions along the side change sign, and tractions across it keep theirs.
//!
//! The shear stress that remains moves the gel beside it, too, and images that are larger by a fifth account
//! for most of that. The table has what images leave of the change by free sides, for a gel whose half width
//! is 2.7 times its thickness (balls, solids) and 5.5 times (balls, solids), under the loads of the
//! finite-element contacts of bench/outside, half `w`. The reference is a block of linear elements with
//! these sides:
//!
//! | images times | 2.7, balls | 2.7, solids | 5.5, balls | 5.5, solids |
//! |---|---|---|---|---|
//! | 1 | 29 % | 31 % | 14 % | 23 % |
//! | 1, with images of images at the corners | 38 % | 35 % | 15 % | 62 % |
//! | 1.1 | 22 % | 25 % | 11 % | 21 % |
//! | 1.2 | 17 % | 20 % | 14 % | 23 % |
//! | 1.35 | 14 % | 17 % | 25 % | 31 % |

use super::Influence;
use crate::math::round;

/// Loads of an image over those of the cell.
const OF_IMAGE: f64 = 1.2;

/// Sides about a grid of cells.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct FreeSides {
    /// Sum of the columns, and of the rows, of a cell and its image: of both sides of each axis.
    sums: [[isize; 2]; 2],
}

/// Mirror image of a loaded cell.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Image {
    /// Its column, also beyond the grid.
    pub col: isize,
    /// Its row.
    pub row: isize,
    /// Its pressure and tractions along x and y over those of the cell.
    pub factors: [f64; 3],
}

impl FreeSides {
    /// Sides beyond the outermost of `counts` columns and rows by `beyond_mm`, rounded to half a cell; it may
    /// be negative.
    #[must_use]
    pub fn new(counts: [usize; 2], cell_mm: [f64; 2], beyond_mm: [f64; 2]) -> Self {
        let sums = [0, 1].map(|axis| {
            let half_cells = round(2.0 * beyond_mm[axis] / cell_mm[axis]) as isize;
            [-half_cells, 2 * (counts[axis] as isize - 1) + half_cells]
        });
        Self { sums }
    }

    /// Columns of both sides, and rows of both; halves lie between cells.
    #[must_use]
    pub fn places(&self) -> [[f64; 2]; 2] {
        self.sums.map(|sums| sums.map(|sum| 0.5 * sum as f64))
    }

    /// Side of an [`Influence`] that reaches from one end of the grid to the image of the other.
    #[must_use]
    pub fn reach(&self) -> usize {
        self.sums.iter().flatten().max().map_or(0, |sum| sum.unsigned_abs() + 1)
    }

    /// Images of a cell in a column and row.
    #[must_use]
    pub fn images(&self, [col, row]: [usize; 2]) -> [Image; 4] {
        let (col, row) = (col as isize, row as isize);
        let [x, y] = self.sums;
        let across = |sum| Image { col: sum - col, row, factors: [-OF_IMAGE, OF_IMAGE, -OF_IMAGE] };
        let down = |sum| Image { col, row: sum - row, factors: [-OF_IMAGE, -OF_IMAGE, OF_IMAGE] };
        [across(x[0]), across(x[1]), down(y[0]), down(y[1])]
    }
}

impl Influence {
    /// Motion into the layer, along x and along y (rows), at an offset in cells from a cell under a pressure,
    /// or under a traction along x or y (columns).
    #[must_use]
    pub fn effect(&self, right: isize, down: isize) -> [[f64; 3]; 3] {
        let i = down.unsigned_abs() * self.side + right.unsigned_abs();
        let sign = |offset: isize| if offset < 0 { -1.0 } else { 1.0 };
        let (x, y) = (sign(right), sign(down));
        let (aside_x, aside_y) = (x * self.cross[0][i], y * self.cross[1][i]);
        let across = x * y * self.across[i];
        [
            // The two cross terms are transposes (Betti), and odd: hence the sign.
            [self.normal[i], -aside_x, -aside_y],
            [aside_x, self.along[0][i], across],
            [aside_y, across, self.along[1][i]],
        ]
    }
}

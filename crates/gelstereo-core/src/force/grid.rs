//! The places between which the gel's motion is tabulated.

use super::error::ForceError;
use crate::lattice::Topology;
use crate::layer::{Influence, Layer};
use crate::math::{DVec3, abs, sqrt};

/// Largest relative difference of the pitches along rows and along columns. With 0, 2 and 4.9 %, the rms
/// error of the pressing force is 6.9, 6.9 and 7.0 % on square lattices (development half of the FEM contacts
/// of bench/outside).
const SQUARE: f64 = 0.05;

/// A grid with a place at every marker. In a hexagonal print there is one between any two markers of a row,
/// too, so that rows that are shifted by half a pitch share its columns.
#[derive(Clone, Copy, Debug)]
pub(super) struct Grid {
    pub topology: Topology,
    /// Distance of nearest markers.
    pub pitch_mm: f64,
    /// Sides of the rectangle that belongs to a marker, along rows and along columns.
    pub sides_mm: [f64; 2],
    /// Places from a marker to the next one of its row.
    apart: usize,
    /// Parity of the hexagonal print's rows that are not shifted to the right.
    left: usize,
}

impl Grid {
    /// Of a square lattice.
    pub const fn square(rows: usize, cols: usize, pitch_mm: f64) -> Self {
        let topology = Topology::square(rows, cols);
        Self { topology, pitch_mm, sides_mm: [pitch_mm; 2], apart: 1, left: 0 }
    }

    /// Of a hexagonal lattice.
    pub fn hexagonal(topology: Topology, pitch_mm: f64) -> Self {
        let is_back = topology.along(topology.cols()) < 0.0;
        let sides_mm = [pitch_mm, sqrt(0.75) * pitch_mm];
        Self { topology, pitch_mm, sides_mm, apart: 2, left: usize::from(is_back) }
    }

    /// Of markers at rest, with the axes into the layer, along rows and along columns.
    pub fn of(
        rest_mm: &[DVec3],
        normal: DVec3,
        topology: Topology,
    ) -> Result<([DVec3; 3], Self), ForceError> {
        let [x, y] = mean_steps(rest_mm, normal, topology.cols())?;
        let right = x.normalize_or_zero();
        let y = y - right * y.dot(right);
        // Rows of a hexagonal print are half of the root of 3 apart, in pitches.
        let apart = if topology.is_hexagonal() { sqrt(0.75) } else { 1.0 };
        let found_mm = [x.length(), y.length() / apart];
        let pitch_mm = 0.5 * (found_mm[0] + found_mm[1]);
        if !(abs(found_mm[0] - found_mm[1]) < SQUARE * pitch_mm) {
            return Err(ForceError::Pitch { found_mm });
        }
        let grid = if topology.is_hexagonal() {
            Self::hexagonal(topology, pitch_mm)
        } else {
            Self::square(topology.rows(), topology.cols(), pitch_mm)
        };
        Ok(([normal, right, y / y.length()], grid))
    }

    /// Columns and rows of places.
    pub const fn counts(&self) -> [usize; 2] {
        [self.apart * self.topology.cols(), self.topology.rows()]
    }

    /// From one place to the next, along rows and along columns.
    pub const fn step_mm(&self) -> [f64; 2] {
        [self.sides_mm[0] / self.apart as f64, self.sides_mm[1]]
    }

    /// Row and column of the place of a marker.
    pub fn place(&self, marker: usize) -> (usize, usize) {
        let cols = self.topology.cols();
        let (row, col) = (marker / cols, marker % cols);
        let half = if self.apart == 2 && row % 2 != self.left { 1 } else { 0 };
        (row, self.apart * col + half)
    }

    /// Motion at the places around a marker under a traction on its rectangle.
    pub fn influence(&self, layer: &Layer, side: usize) -> Influence {
        Influence::overlapping(layer, self.step_mm(), [self.apart, 1], side)
    }

    /// Squared distance of two places, in pitches.
    pub fn distance2(&self, one: (usize, usize), other: (usize, usize)) -> f64 {
        let (down, along) = (one.0.abs_diff(other.0), one.1.abs_diff(other.1));
        match self.apart {
            1 => (down * down + along * along) as f64,
            _ => 0.75 * (down * down) as f64 + 0.25 * (along * along) as f64,
        }
    }
}

/// Mean steps in the plane, along rows and from row to row.
fn mean_steps(rest_mm: &[DVec3], normal: DVec3, cols: usize) -> Result<[DVec3; 2], ForceError> {
    let markers = rest_mm.len();
    if cols < 2 || markers < 2 * cols || !markers.is_multiple_of(cols) {
        return Err(ForceError::Lattice { markers, cols });
    }
    let rows = markers / cols;
    let in_plane = |v: DVec3| v - normal * v.dot(normal);
    // The mean of the steps between neighbours is that between the ends.
    let along: DVec3 = (0..rows).map(|row| rest_mm[row * cols + cols - 1] - rest_mm[row * cols]).sum();
    let down: DVec3 = (0..cols).map(|col| rest_mm[markers - cols + col] - rest_mm[col]).sum();
    Ok([in_plane(along) / (rows * (cols - 1)) as f64, in_plane(down) / (cols * (rows - 1)) as f64])
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        /// Places lie where the print's topology has the markers.
        #[test]
        fn places_are_those_of_the_markers(
            (rows, cols) in (2_usize..9, 2_usize..9), forward in any::<bool>(),
        ) {
            let topology = Topology::hexagonal(rows, cols, forward);
            let (grid, height) = (Grid::hexagonal(topology, 0.8), sqrt(0.75));
            let at = |i: usize| DVec3::new(topology.along(i), height * (i / cols) as f64, 0.0) * 0.8;
            let rest_mm: alloc::vec::Vec<DVec3> = (0..rows * cols).map(at).collect();
            let (_, found) = Grid::of(&rest_mm, DVec3::NEG_Z, topology).unwrap();
            prop_assert!(abs(found.pitch_mm - 0.8) < 1e-12);
            let [x_mm, y_mm] = grid.step_mm();
            for i in 0..rows * cols {
                let ((top, left), (row, col)) = (grid.place(0), grid.place(i));
                let x = (col as f64 - left as f64) * x_mm;
                let step = DVec3::new(x, (row as f64 - top as f64) * y_mm, 0.0);
                prop_assert!((at(i) - at(0) - step).length() < 1e-12);
                prop_assert!(col < grid.counts()[0] && row < grid.counts()[1]);
                let pitches2 = grid.distance2((row, col), (top, left));
                prop_assert!(abs(sqrt(pitches2) * 0.8 - step.length()) < 1e-12);
            }
        }
    }
}

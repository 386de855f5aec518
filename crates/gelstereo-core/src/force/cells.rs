//! Cells of a contact, and the markers around them.

use super::grid::Grid;
use alloc::vec::Vec;

/// Largest number of blocks, which have three unknown tractions each. Larger contacts have the same traction
/// on blocks of cells. With 25, 64 and 100, the rms error of the pressing force is 7.8, 6.9 and 6.8 % on the
/// development half of the FEM contacts of bench/outside, and the largest of them takes 0.6, 2.1 and 3.2 ms.
pub(super) const MAX_BLOCKS: usize = 64;

/// The square around a marker, or the rectangle of a hexagonal print.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Cell {
    pub marker: usize,
    /// Its place on the grid.
    pub row: usize,
    pub col: usize,
    /// Which traction it has.
    pub block: usize,
}

const NONE: u32 = u32::MAX;

/// Cells that a contact may load: those of its markers and their eight neighbours, or six of a hexagonal
/// print, since the part touches gel between the markers too.
#[derive(Clone, Debug, Default)]
pub(super) struct Cells {
    pub cells: Vec<Cell>,
    /// Number of tractions.
    pub blocks: usize,
    /// Whether a cell lies on the lattice's border.
    pub is_cut: bool,
    /// Indices of the markers within reach.
    pub near: Vec<usize>,
    is_loaded: Vec<bool>,
    block_of: Vec<u32>,
}

impl Cells {
    /// Reserves memory for a lattice.
    pub fn reserve(&mut self, markers: usize) {
        self.cells.reserve(markers);
        self.near.reserve(markers);
        self.is_loaded.reserve(markers);
        self.block_of.reserve(markers);
    }

    /// Whether there are more cells than blocks.
    pub const fn are_merged(&self) -> bool {
        self.blocks != self.cells.len()
    }

    /// Selects the cells of a patch. Returns whether there are any.
    pub fn choose(&mut self, patch: &[bool], grid: &Grid) -> bool {
        let (rows, cols) = (grid.topology.rows(), grid.topology.cols());
        self.is_loaded.clear();
        self.is_loaded.resize(patch.len(), false);
        self.is_cut = false;
        for (n, _) in patch.iter().enumerate().filter(|&(_, &in_patch)| in_patch) {
            let (row, col) = (n / cols, n % cols);
            self.is_cut |= row == 0 || col == 0 || row + 1 == rows || col + 1 == cols;
            self.is_loaded[n] = true;
            grid.topology.around(n).for_each(|beside| self.is_loaded[beside] = true);
        }
        let mut side = 1;
        while self.divide(grid, side) > MAX_BLOCKS {
            side += 1;
        }
        self.blocks > 0
    }

    /// Divides the loaded cells into blocks of this many rows and columns; returns their number.
    fn divide(&mut self, grid: &Grid, side: usize) -> usize {
        let cols = grid.topology.cols();
        let Self { cells, blocks, is_loaded, block_of, .. } = self;
        cells.clear();
        block_of.clear();
        block_of.resize(is_loaded.len(), NONE);
        *blocks = 0;
        for (n, _) in is_loaded.iter().enumerate().filter(|&(_, &is_loaded)| is_loaded) {
            let block = &mut block_of[n / cols / side * cols + n % cols / side];
            if *block == NONE {
                *block = *blocks as u32;
                *blocks += 1;
            }
            let (row, col) = grid.place(n);
            cells.push(Cell { marker: n, row, col, block: *block as usize });
        }
        *blocks
    }

    /// Lists the markers of which the nearest cell is within this distance.
    pub fn surround(&mut self, grid: &Grid, reach_pitches: f64) {
        let Self { cells, near, is_loaded, .. } = self;
        let reach2 = reach_pitches * reach_pitches;
        let is_near = |n: &usize| {
            let place = grid.place(*n);
            cells.iter().any(|cell| grid.distance2((cell.row, cell.col), place) <= reach2)
        };
        near.clear();
        near.extend((0..is_loaded.len()).filter(is_near));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        /// Every marker of the patch and its neighbours have a cell, no other has, and there are never too
        /// many tractions.
        #[test]
        fn cells_are_those_of_the_patch_and_beside_it(
            (rows, cols) in (2_usize..30, 2_usize..30), seed in any::<u64>(), share in 0.0..1.0_f64,
        ) {
            let mut random = crate::math::random::Stream::new(seed, "patch");
            let patch: Vec<bool> = (0..rows * cols).map(|_| random.uniform() < share).collect();
            let mut cells = Cells::default();
            let any = cells.choose(&patch, &Grid::square(rows, cols, 1.0));
            prop_assert_eq!(any, patch.contains(&true));
            prop_assert!(cells.blocks <= MAX_BLOCKS);
            for (row, col) in (0..rows).flat_map(|row| (0..cols).map(move |col| (row, col))) {
                let touches = |n: usize| {
                    patch[n] && (n / cols).abs_diff(row) <= 1 && (n % cols).abs_diff(col) <= 1
                };
                let expected = (0..rows * cols).any(touches);
                let found = cells.cells.iter().filter(|cell| (cell.row, cell.col) == (row, col)).count();
                prop_assert_eq!(found, usize::from(expected));
            }
            let used: Vec<bool> =
                (0..cells.blocks).map(|b| cells.cells.iter().any(|cell| cell.block == b)).collect();
            prop_assert!(!used.contains(&false));
        }
    }
}

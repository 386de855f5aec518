//! Row and column of every marker: foresight sort (Algorithm 1) and the rest lattice.

use crate::math::DVec2;
use crate::params::LatticeParams;
use alloc::vec::Vec;

/// Why markers could not be labelled.
#[derive(Clone, Debug, PartialEq)]
pub enum LabelError {
    /// Count off.
    Count { found: usize, expected: usize, max_missing: usize },
    /// A row of the foresight sort did not fill.
    RowNotFilled { row: usize, found: usize, expected: usize },
    // room owner: extend as needed
}

impl core::fmt::Display for LabelError {
    fn fmt(&self, _f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        unimplemented!()
    }
}

impl core::error::Error for LabelError {}

/// The rest lattice, complete.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct RestLattice {
    /// Position of marker `row * cols + col`, pixels.
    pub positions_px: Vec<DVec2>,
    /// Whether it was filled in from its neighbours (never printed or not detected).
    pub filled: Vec<bool>,
    /// Median distance of neighbours, pixels.
    pub pitch_px: f64,
}

/// Algorithm 1: writes into `order` the permutation that sorts `positions_px` row by row, left to right.
///
/// # Errors
/// [`LabelError`] when a row does not fill.
pub fn foresight_sort(
    positions_px: &[DVec2],
    lattice: &LatticeParams,
    tolerance_px: f64,
    order: &mut Vec<usize>,
) -> Result<(), LabelError> {
    let _ = (positions_px, lattice, tolerance_px, order);
    unimplemented!()
}

/// Labels an undisturbed frame and fills in up to `lattice.max_missing` markers that were not detected.
///
/// # Errors
/// [`LabelError`] naming what was found.
pub fn rest_lattice(
    detected_px: &[DVec2],
    lattice: &LatticeParams,
    tolerance_pitches: f64,
) -> Result<RestLattice, LabelError> {
    let _ = (detected_px, lattice, tolerance_pitches);
    unimplemented!()
}

//! Common displacements of scattered markers, by votes.

use super::hypothesis::Scene;
use crate::math::DVec2;
use crate::spatial::Grid;
use alloc::vec::Vec;

/// Largest displacement per axis, in spacings.
const REACH: f64 = 3.0;

/// Cells per spacing and axis, and cells per axis. Two cells are half a spacing: wider ones hold votes for
/// two displacements of a regular print.
const PER_SPACING: f64 = 4.0;
const SIDE: usize = (2.0 * REACH * PER_SPACING) as usize;

/// Displacements that are tried: a regular print has four about as likely as the true one.
pub(super) const PEAKS: usize = 40;

/// Number and sum of displacements.
#[derive(Clone, Copy, Debug, Default)]
struct Cell {
    count: u32,
    sum_px: DVec2,
}

/// Votes of all pairs of a marker and a detection for their displacement, in square cells.
#[derive(Clone, Debug, Default)]
pub(super) struct Votes {
    cells: Vec<Cell>,
    peaks_px: Vec<DVec2>,
    /// Votes in two by two cells, and the first of them.
    sums: Vec<(u32, u32)>,
}

impl Votes {
    pub fn reserve(&mut self) {
        self.cells.reserve(SIDE * SIDE);
        self.sums.reserve(SIDE * SIDE);
        self.peaks_px.reserve(PEAKS);
    }

    /// The `n`th most likely displacement, pixels.
    pub fn peak_px(&self, n: usize) -> Option<DVec2> {
        self.peaks_px.get(n).copied()
    }

    /// Counts the votes; `grid` holds the detections.
    pub fn count(&mut self, scene: &Scene<'_>, grid: &Grid) {
        self.cells.clear();
        self.cells.resize(SIDE * SIDE, Cell::default());
        let (reach_px, per_px) = (REACH * scene.spacing_px, PER_SPACING / scene.spacing_px);
        for &expected_px in scene.expected_px {
            grid.visit(expected_px, reach_px, |m| {
                let apart_px = scene.detected_px[m] - expected_px;
                let at = (apart_px + reach_px) * per_px;
                if at.min_element() >= 0.0 && at.max_element() < SIDE as f64 {
                    let cell = &mut self.cells[at.y as usize * SIDE + at.x as usize];
                    cell.count += 1;
                    cell.sum_px += apart_px;
                }
            });
        }
        self.find_peaks();
    }

    /// The fullest blocks of two by two cells that share no cell, most votes first.
    fn find_peaks(&mut self) {
        let Self { cells, peaks_px, sums } = self;
        let block = |first: usize| [first, first + 1, first + SIDE, first + SIDE + 1];
        let firsts = || (0..SIDE - 1).flat_map(|y| (0..SIDE - 1).map(move |x| y * SIDE + x));
        sums.clear();
        sums.extend(firsts().map(|f| (block(f).iter().map(|&c| cells[c].count).sum(), f as u32)));
        peaks_px.clear();
        while peaks_px.len() < PEAKS {
            let Some(&(votes, first)) = sums.iter().max_by_key(|&&(votes, f)| (votes, u32::MAX - f)) else {
                return;
            };
            if votes == 0 {
                return;
            }
            let sum_px: DVec2 = block(first as usize).iter().map(|&c| cells[c].sum_px).sum();
            peaks_px.push(sum_px / f64::from(votes));
            let (x, y) = (first as usize % SIDE, first as usize / SIDE);
            sums.retain(|&(_, f)| (f as usize % SIDE).abs_diff(x) > 1 || (f as usize / SIDE).abs_diff(y) > 1);
        }
    }
}

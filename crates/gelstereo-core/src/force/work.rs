//! Work of an estimate of forces.
//!
//! The constants are instructions of a baseline x86-64 processor, fitted to counts by callgrind on ten
//! contacts of 9 to 193 cells. Residuals are -23 to +7 %.

/// For any contact.
const BASE: f64 = 1e6;
/// For each marker and cell of an assembly.
const PER_CELL: f64 = 306.0;
/// For each marker and pair of unknowns.
const PER_PAIR: f64 = 2.6;
/// For each round of the search and triple of unknowns.
const PER_TRIPLE: f64 = 2.7;
/// A search that begins where the last one ended takes one to six rounds.
const USUAL_ROUNDS: usize = 4;

/// What the work grows with.
pub(super) struct Size {
    pub markers: f64,
    pub cells: usize,
    pub unknowns: usize,
    /// Of the influences of all cells on all markers.
    pub assemblies: usize,
    /// Of the last search.
    pub rounds: usize,
}

impl Size {
    /// In units of 1000 instructions.
    pub fn work(&self) -> u64 {
        let unknowns = self.unknowns as f64;
        let of_cells = self.assemblies as f64 * PER_CELL * self.cells as f64;
        let assembly = self.markers * (of_cells + PER_PAIR * unknowns * unknowns);
        let rounds = self.rounds.min(USUAL_ROUNDS) as f64 * PER_TRIPLE * unknowns * unknowns * unknowns;
        (1e-3 * (BASE + assembly + rounds)) as u64
    }
}

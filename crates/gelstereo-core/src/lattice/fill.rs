//! Fills in missing markers from their neighbours.

use crate::math::DVec2;
use alloc::vec::Vec;

/// Positions of a lattice, row by row, some of them unknown.
pub(super) struct Partial {
    pub rows: usize,
    pub cols: usize,
    pub at: Vec<Option<DVec2>>,
}

impl Partial {
    /// Position at that place, if it lies in the lattice and is known.
    pub fn get(&self, row: isize, col: isize) -> Option<DVec2> {
        let (r, c) = (usize::try_from(row).ok()?, usize::try_from(col).ok()?);
        if r < self.rows && c < self.cols { self.at[r * self.cols + c] } else { None }
    }

    /// Fills every gap, starting with those that have known neighbours; `None` when too little is known.
    pub fn filled(mut self) -> Option<Vec<DVec2>> {
        while self.at.iter().any(Option::is_none) {
            // Each round uses only positions known before it, so that the result is independent of the
            // visiting order.
            let round: Vec<(usize, DVec2)> = (0..self.at.len())
                .filter(|&n| self.at[n].is_none())
                .filter_map(|n| Some((n, self.predict((n / self.cols) as isize, (n % self.cols) as isize)?)))
                .collect();
            if round.is_empty() {
                return None;
            }
            for (n, position) in round {
                self.at[n] = Some(position);
            }
        }
        self.at.into_iter().collect()
    }

    /// Midpoint of opposite neighbours where available, otherwise extrapolation along rows, columns and
    /// cells.
    fn predict(&self, row: isize, col: isize) -> Option<DVec2> {
        let near = |dr: isize, dc: isize| self.get(row + dr, col + dc);
        let between =
            [(0, 1), (1, 0)].iter().filter_map(|&(dr, dc)| Some((near(-dr, -dc)? + near(dr, dc)?) * 0.5));
        let beyond = [(0, 1), (0, -1), (1, 0), (-1, 0)]
            .iter()
            .filter_map(|&(dr, dc)| Some(near(dr, dc)? * 2.0 - near(2 * dr, 2 * dc)?));
        let across = [(1, 1), (1, -1), (-1, 1), (-1, -1)]
            .iter()
            .filter_map(|&(dr, dc)| Some(near(dr, 0)? + near(0, dc)? - near(dr, dc)?));
        mean(between).or_else(|| mean(beyond.chain(across)))
    }
}

/// Mean of the points, if there are any.
pub(super) fn mean(points: impl Iterator<Item = DVec2>) -> Option<DVec2> {
    let (sum, count) = points.fold((DVec2::ZERO, 0.0), |(sum, count), p| (sum + p, count + 1.0));
    (count > 0.0).then(|| sum / count)
}

//! Which places of a print are neighbours.

use crate::math::{DVec2, DVec3};
use crate::params::PrintLayout;

/// Steps down and to the right.
pub(crate) type Offset = (isize, isize);

/// One step along each axis: along the row, down, and, in hexagonal prints, down to the left.
pub(crate) const STEPS: [Offset; 3] = [(0, 1), (1, 0), (1, -1)];

/// Rows and columns of a print, and how its rows stand beside each other. Place `i` is in row `i / cols` and
/// column `i % cols`.
///
/// In a hexagonal print, every second row is shifted by half a pitch. Column `col` of row `row` then stands
/// `col + s (row mod 2) / 2` pitches along the row, where `s` is 1 or -1.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Topology {
    rows: usize,
    cols: usize,
    shifted: Shifted,
}

/// How odd rows stand to even ones.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
enum Shifted {
    #[default]
    None,
    Forward,
    Backward,
}

impl Topology {
    /// Rows and columns at right angles.
    #[must_use]
    pub const fn square(rows: usize, cols: usize) -> Self {
        Self { rows, cols, shifted: Shifted::None }
    }

    /// A hexagonal print, whose odd rows are shifted half a pitch along the row, or half a pitch back.
    #[must_use]
    pub const fn hexagonal(rows: usize, cols: usize, odd_rows_forward: bool) -> Self {
        Self { rows, cols, shifted: if odd_rows_forward { Shifted::Forward } else { Shifted::Backward } }
    }

    /// Of a print of this layout, whose markers stand here at rest, row by row.
    #[must_use]
    pub fn of(layout: PrintLayout, cols: usize, rest_mm: &[DVec3]) -> Self {
        let rows = rest_mm.len() / cols.max(1);
        match layout {
            PrintLayout::Square => Self::square(rows, cols),
            PrintLayout::Hexagonal => Self::hexagonal(rows, cols, odd_rows_forward(cols, rest_mm)),
        }
    }

    /// As [`Self::of`], of positions in an image.
    #[must_use]
    pub fn in_image(layout: PrintLayout, cols: usize, rest_px: &[DVec2]) -> Self {
        let flat: alloc::vec::Vec<DVec3> = rest_px.iter().map(|at| at.extend(0.0)).collect();
        Self::of(layout, cols, &flat)
    }

    /// Number of rows.
    #[must_use]
    pub const fn rows(&self) -> usize {
        self.rows
    }

    /// Number of columns: places of a row.
    #[must_use]
    pub const fn cols(&self) -> usize {
        self.cols
    }

    /// Number of places.
    #[must_use]
    pub const fn places(&self) -> usize {
        self.rows * self.cols
    }

    /// Whether every second row is shifted.
    #[must_use]
    pub const fn is_hexagonal(&self) -> bool {
        !matches!(self.shifted, Shifted::None)
    }

    /// Number of directions in which a place has neighbours, each with one before and one after: along the
    /// row and down the column, or along the row, down to the right and down to the left.
    #[must_use]
    pub const fn axes(&self) -> usize {
        if self.is_hexagonal() { 3 } else { 2 }
    }

    /// The place so many steps from another one along an axis, if it exists.
    #[must_use]
    pub fn step(&self, place: usize, axis: usize, count: isize) -> Option<usize> {
        self.step_from(self.row_and_col(place), axis, count)
    }

    /// As [`Self::step`], from a row and column.
    #[must_use]
    #[inline]
    pub fn step_from(&self, from: (usize, usize), axis: usize, count: isize) -> Option<usize> {
        let (down, right) = STEPS[axis.min(STEPS.len() - 1)];
        self.offset_from(from, (count * down, count * right))
    }

    /// The place so many steps down and to the right of a row and column, if it exists. In a hexagonal print,
    /// the steps down are along the line of nearest neighbours that leans to the right ([`Self::axes`]).
    #[must_use]
    #[inline]
    pub fn offset_from(&self, (row, col): (usize, usize), (down, right): Offset) -> Option<usize> {
        let from = row as isize;
        let right = right + self.shift(from + down) - self.shift(from);
        let row = row.checked_add_signed(down).filter(|&row| row < self.rows)?;
        let col = col.checked_add_signed(right).filter(|&col| col < self.cols)?;
        Some(row * self.cols + col)
    }

    /// Places around one, row by row: the eight of a square print, with those across corners, or the six
    /// neighbours in a hexagonal one.
    pub fn around(&self, place: usize) -> impl Iterator<Item = usize> + use<> {
        let (topology, from) = (*self, self.row_and_col(place));
        let square = (-1..2).flat_map(|down| (-1..2).map(move |right| (down, right)));
        // In a hexagonal print, the places at (-1, -1) and (1, 1) are farther away.
        let is_around = move |&(down, right): &Offset| match topology.is_hexagonal() {
            true => down != right,
            false => (down, right) != (0, 0),
        };
        square.filter(is_around).filter_map(move |offset| topology.offset_from(from, offset))
    }

    /// Row and column of a place.
    #[must_use]
    pub const fn row_and_col(&self, place: usize) -> (usize, usize) {
        (place / self.cols, place % self.cols)
    }

    /// Neighbours of a place: before and after it along each axis.
    pub fn neighbours(&self, place: usize) -> impl Iterator<Item = usize> {
        let topology = *self;
        (0..self.axes())
            .flat_map(move |axis| [-1, 1].into_iter().map(move |count| (axis, count)))
            .filter_map(move |(axis, count)| topology.step(place, axis, count))
    }

    /// Where a place stands along its row, in pitches.
    #[must_use]
    pub const fn along(&self, place: usize) -> f64 {
        let (row, col) = (place / self.cols, (place % self.cols) as f64);
        match self.shifted {
            Shifted::Forward if row % 2 == 1 => col + 0.5,
            Shifted::Backward if row % 2 == 1 => col - 0.5,
            _ => col,
        }
    }

    /// Columns between a row's first place and the line down to the right through place 0.
    const fn shift(&self, row: isize) -> isize {
        match self.shifted {
            Shifted::None => 0,
            Shifted::Forward => row.div_euclid(2),
            Shifted::Backward => (row + 1).div_euclid(2),
        }
    }
}

/// Whether odd rows are shifted along the row, by the mean step from even rows to odd ones.
fn odd_rows_forward(cols: usize, rest_mm: &[DVec3]) -> bool {
    let cols = cols.max(1);
    let mut along = DVec3::ZERO;
    for row in rest_mm.chunks_exact(cols) {
        along += row[cols - 1] - row[0];
    }
    // From an even row to the odd ones above and below, so that a slanted view does not count.
    let row = |row: usize| rest_mm.get(row * cols..(row + 1) * cols);
    let mut shift = 0.0;
    for even in (0..rest_mm.len() / cols).step_by(2) {
        for odd in [even.checked_sub(1), Some(even + 1)].into_iter().flatten() {
            if let (Some(even), Some(odd)) = (row(even), row(odd)) {
                shift += even.iter().zip(odd).map(|(even, odd)| (*odd - *even).dot(along)).sum::<f64>();
            }
        }
    }
    shift > 0.0
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::{abs, sqrt};
    use proptest::prelude::*;

    proptest! {
        /// Places around one, and steps along an axis, are those at their distances.
        #[test]
        fn neighbours_are_the_nearest_places(
            (rows, cols) in (2_usize..9, 2_usize..9), hexagonal in any::<bool>(), forward in any::<bool>(),
            place in any::<prop::sample::Index>(),
        ) {
            let square = Topology::square(rows, cols);
            let topology = if hexagonal { Topology::hexagonal(rows, cols, forward) } else { square };
            let row_pitches = if hexagonal { sqrt(0.75) } else { 1.0 };
            let at = |i: usize| DVec2::new(topology.along(i), row_pitches * (i / cols) as f64);
            let i = place.index(rows * cols);
            let within = |pitches: f64| -> alloc::vec::Vec<usize> {
                let near = |k: &usize| *k != i && at(*k).distance(at(i)) < pitches;
                (0..rows * cols).filter(near).collect()
            };
            let around: alloc::vec::Vec<usize> = topology.around(i).collect();
            prop_assert_eq!(around, within(if hexagonal { 1.01 } else { 1.42 }));
            let mut neighbours: alloc::vec::Vec<usize> = topology.neighbours(i).collect();
            neighbours.sort_unstable();
            prop_assert_eq!(neighbours, within(1.01));
            for axis in 0..topology.axes() {
                if let (Some(one), Some(two)) = (topology.step(i, axis, 1), topology.step(i, axis, 2)) {
                    prop_assert!((at(two) - at(i) - 2.0 * (at(one) - at(i))).length() < 1e-12);
                    prop_assert!(abs(at(one).distance(at(i)) - 1.0) < 1e-12);
                }
            }
        }
    }
}

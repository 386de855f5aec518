//! Detection at each place while a lattice grows.

use super::found::Place;
use crate::math::{DVec2, sqrt};
use alloc::vec::Vec;

/// Most rows or columns on either side of the seed.
const MAX_HALF: usize = 240;

/// Empty cells around the square, so that the neighbourhood of any cell is read without bounds checks.
const MARGIN: i32 = 3;

/// The four neighbours: right, down, left, up, as (rows, columns).
pub(super) const STEPS: [(i32, i32); 4] = [(0, 1), (1, 0), (0, -1), (-1, 0)];

/// A square of places around the seed, and the place of each detection. Clearing costs time in proportion
/// to the placed detections, not to the area.
#[derive(Clone, Debug)]
pub(super) struct DetectionGrid {
    half: i32,
    most_half: usize,
    /// Detection index plus one at each place; zero where there is none.
    cells: Vec<u32>,
    pub places: Vec<Option<Place>>,
    /// Steps to the next marker of the row and of the column, as estimated when each detection was
    /// placed.
    steps: Vec<[DVec2; 2]>,
    /// Detections in the order of placement, including those dropped since.
    pub order: Vec<u32>,
}

impl Default for DetectionGrid {
    fn default() -> Self {
        let (cells, places, steps, order) = (Vec::new(), Vec::new(), Vec::new(), Vec::new());
        Self { half: 0, most_half: MAX_HALF, cells, places, steps, order }
    }
}

impl DetectionGrid {
    /// Reserves memory for `most` detections, in lattices with rows and columns of up to `longest`.
    pub fn reserve(&mut self, most: usize, longest: usize) {
        self.clear();
        self.most_half = longest.min(MAX_HALF);
        self.make_room(self.half_side(most));
        self.places.reserve(most);
        self.steps.reserve(most);
        self.order.reserve(2 * most);
    }

    /// Clears the grid and sizes it for this number of detections, in rows and columns of up to
    /// `longest`.
    pub fn start(&mut self, detections: usize, longest: usize) {
        self.clear();
        let half = self.half_side(detections).min(longest);
        self.make_room(half);
        self.half = half as i32;
        self.places.resize(detections, None);
        self.steps.resize(detections, [DVec2::ZERO; 2]);
    }

    fn make_room(&mut self, half: usize) {
        let side = 2 * (half + MARGIN as usize) + 1;
        if self.cells.len() < side * side {
            // Zeroed by the allocator: untouched pages cost no memory.
            self.cells = alloc::vec![0; side * side];
        }
    }

    pub fn clear(&mut self) {
        for n in 0..self.places.len() {
            self.drop(n);
        }
        self.places.clear();
        self.steps.clear();
        self.order.clear();
    }

    /// Places a detection. `steps` are used where its neighbours give no estimate.
    pub fn put(&mut self, place: Place, detection: usize, steps: [DVec2; 2]) {
        let Some(cell) = self.cell(place) else { return };
        self.cells[cell] = detection as u32 + 1;
        self.places[detection] = Some(place);
        self.steps[detection] = steps;
        self.order.push(detection as u32);
    }

    /// Steps to the next marker of the row and of the column at a placed detection, estimated from its
    /// current neighbours.
    pub fn steps_at(&self, points: &[DVec2], detection: usize, place: Place) -> [DVec2; 2] {
        let here = points[detection];
        let steps = self.steps[detection];
        let Some(cell) = self.cell(place) else { return steps };
        let axis = |(rows, cols): (i32, i32), else_step: DVec2| {
            let before = self.seen_from(points, cell, -rows, -cols);
            match (before, self.seen_from(points, cell, rows, cols)) {
                (Some(before), Some(after)) => (after - before) * 0.5,
                (Some(before), None) => here - before,
                (None, Some(after)) => after - here,
                (None, None) => else_step,
            }
        };
        [axis(STEPS[0], steps[0]), axis(STEPS[1], steps[1])]
    }

    pub fn drop(&mut self, detection: usize) {
        if let Some(place) = self.places[detection].take()
            && let Some(cell) = self.cell(place)
        {
            self.cells[cell] = 0;
        }
    }

    pub fn at(&self, place: Place) -> Option<usize> {
        (self.cells[self.cell(place)?] as usize).checked_sub(1)
    }

    pub fn position(&self, points: &[DVec2], place: Place) -> Option<DVec2> {
        self.at(place).map(|m| points[m])
    }

    /// Position of the detection at this row and column offset, up to three each, from a cell.
    #[inline]
    pub fn seen_from(&self, points: &[DVec2], cell: usize, rows: i32, cols: i32) -> Option<DVec2> {
        self.at_offset(cell, rows, cols).map(|m| points[m])
    }

    /// Detection at this row and column offset, up to three each, from a cell.
    #[inline]
    pub fn at_offset(&self, cell: usize, rows: i32, cols: i32) -> Option<usize> {
        let there = cell.wrapping_add_signed((rows * self.side() + cols) as isize);
        (self.cells[there] as usize).checked_sub(1)
    }

    /// Cell of a place, unless it lies outside the square.
    #[inline]
    pub fn cell(&self, place: Place) -> Option<usize> {
        let (row, col) = (place.row + self.half, place.col + self.half);
        let inside = (0..=2 * self.half).contains(&row) && (0..=2 * self.half).contains(&col);
        inside.then(|| ((row + MARGIN) * self.side() + col + MARGIN) as usize)
    }

    const fn side(&self) -> i32 {
        2 * (self.half + MARGIN) + 1
    }

    /// Enough for a lattice 64 times as long as it is wide, grown from its end.
    fn half_side(&self, detections: usize) -> usize {
        ((8.0 * sqrt(detections as f64)) as usize + 8).min(self.most_half)
    }
}

//! Extent of a lattice, and where the print ends.

use super::consistency::placed;
use super::detection_grid::DetectionGrid;
use super::extrapolate::predict;
use super::found::{FoundLattice, Place, Side};
use super::seed::rows_to_the_right;
use crate::math::{DVec2, median, sqrt};
use crate::spatial::Grid;
use alloc::vec::Vec;

/// One to three markers that all lie nearer to the image border than this, in pitches, are not a row:
/// they are not whole.
const WHOLE: f64 = 0.2;

/// Rectangle of places from `low` to `high`, both inclusive.
#[derive(Clone, Copy, Debug)]
struct LatticeBounds {
    low: Place,
    high: Place,
}

/// Inputs of the decision on each side.
pub(super) struct View<'a> {
    pub points: &'a [DVec2],
    pub grid: &'a Grid,
    /// Width and height of the image; `None` if unknown.
    pub size_px: Option<DVec2>,
    pub pitch_px: f64,
    /// Whether outer rows and columns with a single marker are kept.
    pub with_specks: bool,
}

/// Mean steps along rows and along columns, and the median length of a step.
pub(super) fn mean_steps(
    points: &[DVec2],
    detection_grid: &DetectionGrid,
    lengths: &mut Vec<f64>,
) -> Option<(DVec2, DVec2, f64)> {
    // The root of the median square is the median.
    lengths.clear();
    let mut sums = [(DVec2::ZERO, 0.0); 2];
    for (m, place) in placed(detection_grid) {
        for (sum, step) in sums.iter_mut().zip([(0, 1), (1, 0)]) {
            if let Some(next) = detection_grid.position(points, place.step(step)) {
                let step = next - points[m];
                *sum = (sum.0 + step, sum.1 + 1.0);
                lengths.push(step.length_squared());
            }
        }
    }
    let pitch_px = sqrt(median(lengths)?);
    let [row, col] = sums.map(|(sum, count): (DVec2, f64)| sum / count);
    (row.is_finite() && col.is_finite()).then_some((row, col, pitch_px))
}

/// Quarter turns of the places after which rows run most nearly from left to right.
pub(super) fn upright_turns(row_step: DVec2, col_step: DVec2) -> u8 {
    let (row, _) = rows_to_the_right(row_step, col_step);
    [row_step, col_step, -row_step, -col_step].iter().position(|&r| r == row).unwrap_or(0) as u8
}

impl View<'_> {
    /// Writes places, counts and sides.
    pub fn write(&self, detection_grid: &DetectionGrid, out: &mut FoundLattice) {
        let mut extent = LatticeBounds::of(detection_grid);
        while let Some(smaller) = self.without_specks(detection_grid, extent) {
            extent = smaller;
        }
        (out.rows, out.cols) = extent.size();
        out.places.clear();
        out.places.extend(detection_grid.places.iter().map(|place| {
            let place = place.filter(|&place| extent.contains(place))?;
            Some(Place::new(place.row - extent.low.row, place.col - extent.low.col))
        }));
        out.placed = out.places.iter().flatten().count();
        out.sides = [0, 1, 2, 3].map(|side| self.side(detection_grid, extent, side));
    }

    /// Removes an outer row or column that may consist of false detections. It has one marker, or fewer
    /// than a quarter of the markers expected inside the image, or up to three at the image border.
    fn without_specks(&self, detection_grid: &DetectionGrid, extent: LatticeBounds) -> Option<LatticeBounds> {
        let (rows, cols) = extent.size();
        if self.with_specks || rows == 0 || cols == 0 {
            return None;
        }
        let few = |side: usize| {
            let (seen, expected) = self.count(detection_grid, extent.line(side, 0));
            let mut placed =
                extent.line(side, 0).filter_map(|place| detection_grid.position(self.points, place));
            seen <= 1 || 4 * seen < expected || (seen <= 3 && !placed.any(|at| self.is_within(at, WHOLE)))
        };
        (0..4).find(|&side| few(side)).map(|side| extent.without(side))
    }

    fn side(&self, detection_grid: &DetectionGrid, extent: LatticeBounds, side: usize) -> Side {
        let (placed, expected) = self.count(detection_grid, extent.line(side, 0));
        let empty_beyond = extent
            .line(side, 1)
            .filter(|&place| {
                detection_grid.at(place).is_none()
                    && predict(detection_grid, self.points, place).is_some_and(|p| self.is_empty(p.at))
            })
            .count();
        let length = extent.line(side, 0).count();
        let ends = 2 * placed >= expected
            && 2 * placed >= length
            && empty_beyond >= 3
            && 5 * empty_beyond >= 2 * length;
        Side { placed, empty_beyond, ends }
    }

    /// Markers detected in a line of places, and how many are expected if none is missing.
    fn count(&self, detection_grid: &DetectionGrid, line: impl Iterator<Item = Place>) -> (usize, usize) {
        let (mut seen, mut expected) = (0, 0);
        for place in line {
            if detection_grid.at(place).is_some() {
                (seen, expected) = (seen + 1, expected + 1);
            } else if predict(detection_grid, self.points, place)
                .map_or(self.size_px.is_none(), |p| self.is_inside(p.at))
            {
                expected += 1;
            }
        }
        (seen, expected)
    }

    /// Whether a marker there would be seen whole; true if the image size is unknown.
    fn is_inside(&self, at: DVec2) -> bool {
        self.is_within(at, 0.5)
    }

    fn is_within(&self, at: DVec2, margin_pitches: f64) -> bool {
        let margin = margin_pitches * self.pitch_px;
        self.size_px.is_none_or(|size| {
            (at - margin).min_element() >= 0.0 && (size - at - margin).min_element() >= 0.0
        })
    }

    fn is_empty(&self, at: DVec2) -> bool {
        let near = || self.grid.nearest(self.points, at, 0.4 * self.pitch_px, |_| true);
        self.size_px.is_some() && self.is_inside(at) && near().is_none()
    }
}

impl LatticeBounds {
    fn of(detection_grid: &DetectionGrid) -> Self {
        let (low, high) = (Place::new(i32::MAX, i32::MAX), Place::new(i32::MIN, i32::MIN));
        placed(detection_grid).fold(Self { low, high }, |e, (_, p)| Self {
            low: Place::new(e.low.row.min(p.row), e.low.col.min(p.col)),
            high: Place::new(e.high.row.max(p.row), e.high.col.max(p.col)),
        })
    }

    const fn contains(&self, p: Place) -> bool {
        p.row >= self.low.row && p.row <= self.high.row && p.col >= self.low.col && p.col <= self.high.col
    }

    fn size(&self) -> (usize, usize) {
        let count = |low: i32, high: i32| if low <= high { (high - low + 1) as usize } else { 0 };
        (count(self.low.row, self.high.row), count(self.low.col, self.high.col))
    }

    /// Upper, right, lower or left line of places, `outside` steps further out.
    fn line(self, side: usize, outside: i32) -> impl Iterator<Item = Place> {
        let along_row = side.is_multiple_of(2);
        let fixed = match side {
            0 => self.low.row - outside,
            1 => self.high.col + outside,
            2 => self.high.row + outside,
            _ => self.low.col - outside,
        };
        let (from, to) =
            if along_row { (self.low.col, self.high.col) } else { (self.low.row, self.high.row) };
        (from..=to).map(move |n| if along_row { Place::new(fixed, n) } else { Place::new(n, fixed) })
    }

    const fn without(mut self, side: usize) -> Self {
        match side {
            0 => self.low.row += 1,
            1 => self.high.col -= 1,
            2 => self.high.row -= 1,
            _ => self.low.col += 1,
        }
        self
    }
}

//! Predicted position of a marker, from the markers placed around it.

use super::detection_grid::{DetectionGrid, STEPS};
use super::found::Place;
use crate::math::DVec2;

/// Predicted position of a place.
#[derive(Clone, Copy, Debug)]
pub(super) struct Extrapolation {
    pub at: DVec2,
    /// Number of independent estimates averaged.
    pub sources: u32,
    /// Mean squared distance of the estimates from their mean, square pixels.
    pub spread2: f64,
}

/// Running mean and spread.
#[derive(Default)]
struct Mean {
    sum: DVec2,
    sum2: f64,
    count: u32,
}

impl Mean {
    fn add(&mut self, p: DVec2, origin: DVec2) {
        // Relative to a nearby point, so that the squares lose no precision.
        let p = p - origin;
        self.sum += p;
        self.sum2 += p.length_squared();
        self.count += 1;
    }

    fn prediction(&self, origin: DVec2) -> Option<Extrapolation> {
        let count = f64::from(self.count);
        let mean = self.sum / count;
        let spread2 = (self.sum2 / count - mean.length_squared()).max(0.0);
        (self.count > 0).then(|| Extrapolation { at: origin + mean, sources: self.count, spread2 })
    }
}

/// Predicts a place from its four nearest places and the four corners of the adjacent cells. Midpoints of
/// opposite neighbours are preferred, as they follow curved rows best; otherwise it extrapolates along
/// rows and columns and across cells.
pub(super) fn predict(
    detection_grid: &DetectionGrid,
    points: &[DVec2],
    place: Place,
) -> Option<Extrapolation> {
    predict_at(detection_grid, points, detection_grid.cell(place)?)
}

/// As [`predict`], for the cell of a place.
#[inline(never)]
pub(super) fn predict_at(
    detection_grid: &DetectionGrid,
    points: &[DVec2],
    cell: usize,
) -> Option<Extrapolation> {
    predict_amid(detection_grid, points, cell, neighbours(detection_grid, points, cell))
}

/// Positions right of, below, left of and above a cell.
#[inline(always)]
pub(super) fn neighbours(
    detection_grid: &DetectionGrid,
    points: &[DVec2],
    cell: usize,
) -> [Option<DVec2>; 4] {
    let at = |rows: i32, cols: i32| detection_grid.seen_from(points, cell, rows, cols);
    [at(0, 1), at(1, 0), at(0, -1), at(-1, 0)]
}

/// As [`predict_at`], with the cell's [`neighbours`].
#[inline(always)]
pub(super) fn predict_amid(
    detection_grid: &DetectionGrid,
    points: &[DVec2],
    cell: usize,
    [right, down, left, up]: [Option<DVec2>; 4],
) -> Option<Extrapolation> {
    let origin = right.or(down).or(left).or(up)?;
    let mut between = Mean::default();
    for (one, other) in [(right, left), (down, up)] {
        if let (Some(one), Some(other)) = (one, other) {
            between.add((one + other) * 0.5, origin);
        }
    }
    if between.count > 0 {
        return between.prediction(origin);
    }
    let at = |rows: i32, cols: i32| detection_grid.seen_from(points, cell, rows, cols);
    let near = [right, down, left, up, right];
    let mut beyond = Mean::default();
    for k in 0..4 {
        let Some(here) = near[k] else { continue };
        let ((dr, dc), (er, ec)) = (STEPS[k], STEPS[(k + 1) % 4]);
        if let Some(before) = at(2 * dr, 2 * dc) {
            beyond.add(here * 2.0 - before, origin);
        }
        if let (Some(next), Some(corner)) = (near[k + 1], at(dr + er, dc + ec)) {
            beyond.add(here + next - corner, origin);
        }
    }
    beyond.prediction(origin)
}

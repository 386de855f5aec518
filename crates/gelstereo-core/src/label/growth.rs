//! The rest lattice, grown from a seed by predicted steps.

use super::fill::{Partial, mean};
use super::{LabelError, RestLattice, check_regular};
use crate::math::{DVec2, atan2, median, sqrt};
use crate::params::LatticeParams;
use crate::track::grid::Grid;
use alloc::vec;
use alloc::vec::Vec;

/// A square lattice turned by 45 degrees looks the same turned either way: beyond this angle it is refused.
const MOST_ROTATION_DEG: f64 = 40.0;

/// Most rows and columns, as in the settings.
const MOST_MARKERS: usize = 1000;

/// Right, down, left, up as (row, column).
const STEPS: [(isize, isize); 4] = [(0, 1), (1, 0), (0, -1), (-1, 0)];

/// Counts rows and columns of an undisturbed frame, labels it, and fills in up to `lattice.max_missing_share` of its
/// markers where none was detected.
///
/// From the marker whose four neighbours are the most regular, the lattice grows along rows and columns. Each step is
/// predicted from the steps already known around it, so that curved rows are followed, and taken when a detection lies within
/// `tolerance_pitches` of the prediction. Detections off the lattice are ignored. The labels are right for any
/// rotation up to 40 degrees: row 0 is the upper one, column 0 the left one.
///
/// The frame must be undisturbed if markers may be missing: where a press makes dots merge, one that slipped into the
/// place of a missing one cannot be told from it.
///
/// # Errors
/// [`LabelError`] naming what was found: a lattice with other rows or columns than the settings say, if they do, with too
/// many gaps, or with fewer than 3 x 3 markers.
pub fn rest_lattice(
    detected_px: &[DVec2],
    lattice: &LatticeParams,
    tolerance_pitches: f64,
) -> Result<RestLattice, LabelError> {
    let found = detected_px.len();
    if let Some(index) = detected_px.iter().position(|p| !p.is_finite()) {
        return Err(LabelError::NotFinite { index });
    }
    let mut grid = Grid::default();
    let near_px = neighbour_distance(detected_px, &mut grid).ok_or(LabelError::NoLattice { found })?;
    let seed = find_seed(detected_px, &grid, near_px).ok_or(LabelError::NoLattice { found })?;
    check_rotation(detected_px, &seed)?;
    let mut growth = Growth::new(detected_px, &grid, near_px, tolerance_pitches);
    growth.grow(&seed);
    let partial = growth.place(lattice)?;
    let pitch_px = pitch(&partial);
    let (rows, cols) = (partial.rows, partial.cols);
    check_regular(rows, cols, tolerance_pitches * pitch_px, |r, c| partial.get(r as isize, c as isize))?;
    let detection = partial.detection.clone();
    let positions_px = partial.filled().ok_or(LabelError::NoLattice { found })?;
    growth.check_gaps(&positions_px, &detection, pitch_px, cols)?;
    Ok(RestLattice { rows, cols, positions_px, detection, pitch_px })
}

/// A detection and its right, lower, left and upper neighbour.
struct Seed {
    centre: usize,
    around: [usize; 4],
}

/// Median distance to the nearest neighbour; leaves the detections in the grid.
fn neighbour_distance(points: &[DVec2], grid: &mut Grid) -> Option<f64> {
    let first = *points.first()?;
    let (low, high) = points.iter().fold((first, first), |(low, high), &p| (low.min(p), high.max(p)));
    let spread = high - low;
    let side = sqrt(spread.x.max(1.0) * spread.y.max(1.0) / points.len() as f64);
    grid.build(points, side);
    let nearest = |(n, &p): (usize, &DVec2)| {
        grid.nearest(points, p, 3.0 * side, |m| m != n).map(|m| p.distance(points[m]))
    };
    let mut distances: Vec<f64> = points.iter().enumerate().filter_map(nearest).collect();
    median(&mut distances).filter(|&d| d > 0.0)
}

/// The detection whose neighbours to the right and left, and above and below, are the most symmetric and square.
fn find_seed(points: &[DVec2], grid: &Grid, near_px: f64) -> Option<Seed> {
    let mut best: Option<(f64, Seed)> = None;
    for centre in 0..points.len() {
        let Some(around) = nearest_in_quadrants(points, grid, centre, 2.0 * near_px) else { continue };
        let [right, down, left, up] = around.map(|m| points[m] - points[centre]);
        let size = right.length_squared() + down.length_squared();
        let asymmetry = ((right + left).length_squared() + (down + up).length_squared()) / size;
        // The middle of two merged dots can be symmetric as well, but its rows and columns are oblique.
        let slant = right.dot(down) / (0.5 * size);
        let score = asymmetry + slant * slant;
        if asymmetry < 0.1 && best.as_ref().is_none_or(|(least, _)| score < *least) {
            best = Some((score, Seed { centre, around }));
        }
    }
    best.map(|(_, seed)| seed)
}

/// The nearest detection within 45 degrees of each image axis: right, down, left, up.
fn nearest_in_quadrants(points: &[DVec2], grid: &Grid, centre: usize, radius_px: f64) -> Option<[usize; 4]> {
    let mut nearest = [(f64::INFINITY, usize::MAX); 4];
    grid.visit(points[centre], radius_px, |m| {
        let step = points[m] - points[centre];
        if m == centre {
            return;
        }
        let quadrant = match (step.x.abs() >= step.y.abs(), step.x > 0.0, step.y > 0.0) {
            (true, true, _) => 0,
            (false, _, true) => 1,
            (true, false, _) => 2,
            (false, _, false) => 3,
        };
        let key = (step.length_squared(), m);
        if key < nearest[quadrant] {
            nearest[quadrant] = key;
        }
    });
    nearest.iter().all(|&(_, m)| m != usize::MAX).then(|| nearest.map(|(_, m)| m))
}

fn check_rotation(points: &[DVec2], seed: &Seed) -> Result<(), LabelError> {
    let [right, down, left, up] = seed.around.map(|m| points[m]);
    let (row, col) = (right - left, down - up);
    let angles = [atan2(row.y, row.x), atan2(-col.x, col.y)].map(f64::to_degrees);
    match angles.into_iter().find(|angle| angle.abs() > MOST_ROTATION_DEG) {
        Some(found_deg) => Err(LabelError::Rotated { found_deg, most_deg: MOST_ROTATION_DEG }),
        None => Ok(()),
    }
}

/// Labels on a canvas that is wide enough for the lattice wherever in it the seed lies, with a place to spare on each side.
struct Growth<'a> {
    points: &'a [DVec2],
    grid: &'a Grid,
    tolerance_pitches: f64,
    /// Canvas size, odd; the seed lies in the middle.
    rows: isize,
    cols: isize,
    /// Detection at each place.
    at: Vec<Option<u32>>,
    taken: Vec<bool>,
}

impl<'a> Growth<'a> {
    fn new(points: &'a [DVec2], grid: &'a Grid, near_px: f64, tolerance_pitches: f64) -> Self {
        let (low, high) = points.iter().fold((points[0], points[0]), |(l, h), &p| (l.min(p), h.max(p)));
        // A labelled place every half pitch at most, in both directions from the seed.
        let side = |extent: f64| 2 * ((2.0 * extent / near_px) as usize).clamp(2, MOST_MARKERS) + 1;
        let (rows, cols) = (side(high.y - low.y), side(high.x - low.x));
        Self {
            points,
            grid,
            tolerance_pitches,
            rows: rows as isize,
            cols: cols as isize,
            at: vec![None; rows * cols],
            taken: vec![false; points.len()],
        }
    }

    fn index(&self, row: isize, col: isize) -> Option<usize> {
        let inside = (0..self.rows).contains(&row) && (0..self.cols).contains(&col);
        inside.then(|| (row * self.cols + col) as usize)
    }

    fn position(&self, row: isize, col: isize) -> Option<DVec2> {
        self.at[self.index(row, col)?].map(|m| self.points[m as usize])
    }

    fn label(&mut self, place: (isize, isize), detection: usize) -> Option<()> {
        let index = self.index(place.0, place.1)?;
        self.at[index] = Some(detection as u32);
        self.taken[detection] = true;
        Some(())
    }

    /// From the seed outwards.
    fn grow(&mut self, seed: &Seed) {
        let middle = (self.rows / 2, self.cols / 2);
        let mut places = vec![middle];
        self.label(middle, seed.centre);
        for (&(dr, dc), &detection) in STEPS.iter().zip(&seed.around) {
            let place = (middle.0 + dr, middle.1 + dc);
            self.label(place, detection);
            places.push(place);
        }
        // Sure steps first: a speck or the middle of two merged dots, once labelled, would mislead those that follow.
        for share in [0.5, 1.0] {
            self.spread(&mut places, share * self.tolerance_pitches);
        }
    }

    /// Labels what lies one step from a labelled place, until nothing new is found.
    ///
    /// What could not be predicted, or was predicted badly, when its neighbour's turn came may be found later, when more
    /// is known around it: the list is gone through until it stays the same.
    fn spread(&mut self, places: &mut Vec<(isize, isize)>, tolerance_pitches: f64) {
        let mut before = 0;
        while before < places.len() {
            before = places.len();
            let mut next = 0;
            while let Some(&place) = places.get(next) {
                next += 1;
                for step in STEPS {
                    places.extend(self.step(place, step, tolerance_pitches));
                }
            }
        }
    }

    /// Labels the neighbour of a labelled place, if that is new and found.
    fn step(
        &mut self,
        from: (isize, isize),
        step: (isize, isize),
        tolerance_pitches: f64,
    ) -> Option<(isize, isize)> {
        let place = (from.0 + step.0, from.1 + step.1);
        let index = self.index(place.0, place.1)?;
        if self.at[index].is_some() {
            return None;
        }
        let detection = self.find(from, step, tolerance_pitches)?;
        self.label(place, detection)?;
        Some(place)
    }

    /// The free detection at one step from a labelled place; none if a labelled one is nearer to the prediction.
    fn find(&self, from: (isize, isize), (dr, dc): (isize, isize), tolerance_pitches: f64) -> Option<usize> {
        let here = self.position(from.0, from.1)?;
        let straight = self.position(from.0 - dr, from.1 - dc).map(|before| here * 2.0 - before);
        // The same step one row or column to either side.
        let beside = [-1, 1].into_iter().filter_map(|side| {
            let (r, c) = (from.0 + side * dc, from.1 + side * dr);
            Some(here + self.position(r + dr, c + dc)? - self.position(r, c)?)
        });
        let predicted = mean(straight.into_iter().chain(beside))?;
        let radius_px = tolerance_pitches * predicted.distance(here);
        self.grid.nearest(self.points, predicted, radius_px, |_| true).filter(|&m| !self.taken[m])
    }

    /// The rectangle that is labelled, without outer rows and columns of which less than a quarter is.
    fn place(&self, lattice: &LatticeParams) -> Result<Partial, LabelError> {
        let (mut top, mut bottom, mut left, mut right) = (0, self.rows, 0, self.cols);
        let row = |r: isize, left: isize, right: isize| {
            (left..right).filter(|&c| self.position(r, c).is_some()).count() * 4 < (right - left) as usize
        };
        let col = |c: isize, top: isize, bottom: isize| {
            (top..bottom).filter(|&r| self.position(r, c).is_some()).count() * 4 < (bottom - top) as usize
        };
        let used = || (0..self.at.len() as isize).filter(|&n| self.at[n as usize].is_some());
        if let (Some(first), Some(last)) = (used().next(), used().next_back()) {
            (top, bottom) = (first / self.cols, last / self.cols + 1);
            left = used().map(|n| n % self.cols).min().unwrap_or(0);
            right = used().map(|n| n % self.cols + 1).max().unwrap_or(0);
        }
        loop {
            let before = (top, bottom, left, right);
            top += isize::from(top < bottom && row(top, left, right));
            bottom -= isize::from(top < bottom && row(bottom - 1, left, right));
            left += isize::from(left < right && col(left, top, bottom));
            right -= isize::from(left < right && col(right - 1, top, bottom));
            if before == (top, bottom, left, right) {
                break;
            }
        }
        let (rows, cols) = ((bottom - top) as usize, (right - left) as usize);
        let cell = |n: usize| self.index(top + (n / cols) as isize, left + (n % cols) as isize);
        let detection: Vec<Option<u32>> =
            (0..rows * cols).map(|n| cell(n).and_then(|index| self.at[index])).collect();
        let labelled = detection.iter().flatten().count();
        let as_set = lattice.rows.is_none_or(|n| n == rows) && lattice.cols.is_none_or(|n| n == cols);
        let max_missing = lattice.max_missing(rows * cols);
        if !as_set || rows.min(cols) < 3 || labelled + max_missing < rows * cols {
            let (expected_rows, expected_cols) = (lattice.rows, lattice.cols);
            return Err(LabelError::Shape {
                rows,
                cols,
                labelled,
                expected_rows,
                expected_cols,
                max_missing,
            });
        }
        let at = detection.iter().map(|d| d.map(|m| self.points[m as usize])).collect();
        Ok(Partial { rows, cols, at, detection })
    }

    /// Refuses a marker that was filled in although an unlabelled detection lies within the tolerance of it: the labels
    /// around it have slipped. (The middle of two merged dots is half a pitch from both.)
    fn check_gaps(
        &self,
        positions_px: &[DVec2],
        detection: &[Option<u32>],
        pitch_px: f64,
        cols: usize,
    ) -> Result<(), LabelError> {
        let most_px = self.tolerance_pitches * pitch_px;
        for n in (0..detection.len()).filter(|&n| detection[n].is_none()) {
            let slipped = self.grid.nearest(self.points, positions_px[n], most_px, |m| !self.taken[m]);
            if let Some(m) = slipped {
                let off_px = positions_px[n].distance(self.points[m]);
                return Err(LabelError::Irregular { row: n / cols, col: n % cols, off_px, most_px });
            }
        }
        Ok(())
    }
}

/// Median distance between neighbours of a row or a column.
fn pitch(partial: &Partial) -> f64 {
    let mut distances = Vec::new();
    for row in 0..partial.rows as isize {
        for col in 0..partial.cols as isize {
            for (dr, dc) in [(0, 1), (1, 0)] {
                if let (Some(a), Some(b)) = (partial.get(row, col), partial.get(row + dr, col + dc)) {
                    distances.push(a.distance(b));
                }
            }
        }
    }
    median(&mut distances).unwrap_or(0.0)
}

//! The lattice of one view, before rows and columns are chosen from it.

use super::beyond::with_lines_beyond;
use super::cells::{CellShape, reduced};
use super::fill::Partial;
use super::found::{FoundLattice, Sites};
use super::hexagonal::{HexagonalSites, offset};
use super::hexagonal_rest;
use super::layout::{Layout, MIN_RECTANGULAR};
use super::window::{Chosen, PartialBorders, Window};
use super::{LabelError, LatticeFinder, RestLattice, Topology, check_regular};
use crate::math::{DVec2, atan2, median, round};
use crate::params::{LatticeParams, PrintLayout};
use crate::spatial::Grid;
use alloc::vec::Vec;

/// Detections of one view and their places in a lattice.
#[derive(Clone, Debug)]
pub(crate) struct ViewLattice {
    /// The first `whole` are whole markers; the others only show that a marker exists.
    detected_px: Vec<DVec2>,
    whole: usize,
    pub(super) places: Places,
    shape: CellShape,
    /// Mean steps along the rows and the columns that were found first, pixels.
    steps_px: [DVec2; 2],
    /// Median distance of neighbours, pixels.
    pitch_px: f64,
}

#[derive(Clone, Debug)]
pub(super) enum Places {
    Square(Sites),
    Hexagonal(HexagonalSites),
}

impl ViewLattice {
    /// Finds the lattice of detections. With the other view's rows, a hexagonal print has the same ones.
    pub fn find(
        finder: &mut LatticeFinder,
        detected_px: Vec<DVec2>,
        whole: usize,
        layout: PrintLayout,
        max_off_pitches: f64,
        other_row_px: Option<DVec2>,
    ) -> Result<Self, LabelError> {
        let mut found = FoundLattice::default();
        match layout {
            PrintLayout::Square => finder.run_with_specks(&detected_px, &mut found)?,
            PrintLayout::Hexagonal => finder.run_slanted(&detected_px, &mut found)?,
        }
        let none = || LabelError::NoLattice { found: detected_px.len() };
        let steps_px = [found.row_step_px, found.col_step_px];
        let shape = CellShape::usual(&found.sites(), &detected_px).ok_or_else(none)?;
        let places = match layout {
            PrintLayout::Square => {
                let max_px = max_off_pitches * found.pitch_px;
                Places::Square(with_lines_beyond(found.sites(), &detected_px, max_px))
            }
            PrintLayout::Hexagonal if !shape.is_hexagonal(false) => {
                return Err(other_layout(&found, &detected_px, layout));
            }
            PrintLayout::Hexagonal => {
                finder.run_with_specks(&at_right_angles(&found, &detected_px), &mut found)?;
                let named = HexagonalSites::of(&found, &detected_px, other_row_px);
                Places::Hexagonal(named.ok_or_else(none)?)
            }
        };
        let mut view = Self { pitch_px: found.pitch_px, detected_px, whole, places, shape, steps_px };
        if layout == PrintLayout::Hexagonal {
            view.pitch_px = view.median_step_px().ok_or(LabelError::NoLattice { found: whole })?;
        }
        Ok(view)
    }

    /// Direction of the rows in the image, if the print is hexagonal.
    pub const fn hexagonal_row_px(&self) -> Option<DVec2> {
        match &self.places {
            Places::Square(_) => None,
            Places::Hexagonal(named) => Some(named.row_step_px),
        }
    }

    /// With rows in the direction of another view's rows. A hexagonal print has them already.
    #[must_use]
    pub fn turned_like(self, other: &Self) -> Self {
        let Places::Square(sites) = &self.places else { return self };
        let angle_deg = |[row, col]: [DVec2; 2]| {
            let (a, b) = (row.normalize_or_zero(), col.normalize_or_zero());
            atan2(a.y - b.x, a.x + b.y).to_degrees()
        };
        let off_deg = angle_deg(other.steps_px) - angle_deg(self.steps_px);
        let turns = (round(off_deg / 90.0) as i32).rem_euclid(4) as u8;
        Self { places: Places::Square(sites.turned(turns)), ..self }
    }

    /// Centres of the detections, pixels.
    pub fn detected_px(&self) -> &[DVec2] {
        &self.detected_px
    }

    /// Median distance of neighbours, pixels.
    pub const fn pitch_px(&self) -> f64 {
        self.pitch_px
    }

    /// Chooses rows and columns, and completes them.
    pub fn label(
        &self,
        lattice: &LatticeParams,
        max_off_pitches: f64,
        borders: PartialBorders,
    ) -> Result<RestLattice, LabelError> {
        let sites = self.sites();
        let whole = Window::choose(&sites, self.whole, lattice, PartialBorders::Refuse);
        // The sheared cells of a hexagonal print would pass for a lattice with incomplete borders.
        self.check_shape(lattice, whole.is_ok())?;
        let chosen = match (whole, borders) {
            (Err(_), PartialBorders::LeaveOut) => Window::choose(&sites, self.whole, lattice, borders)?,
            (whole, _) => whole?,
        };
        self.complete(&sites, &chosen, self.odd_rows_forward(), max_off_pitches)
    }

    /// Names the layout if the print is hexagonal but should not be.
    pub(super) fn check_shape(&self, lattice: &LatticeParams, is_whole: bool) -> Result<(), LabelError> {
        let is_other = lattice.layout == PrintLayout::Square && self.shape.is_hexagonal(is_whole);
        let (found, expected) = (self.detected_px.len(), lattice.layout);
        let other = LabelError::Layout { found, layout: Layout::Hexagonal, expected };
        if is_other { Err(other) } else { Ok(()) }
    }

    /// How odd rows of a hexagonal print stand to even ones.
    pub(super) const fn odd_rows_forward(&self) -> Option<bool> {
        match &self.places {
            Places::Square(_) => None,
            Places::Hexagonal(named) => Some(named.odd_rows_forward),
        }
    }

    /// The rows and columns of a rectangle, checked, with undetected markers filled in.
    pub(super) fn complete(
        &self,
        sites: &Sites,
        chosen: &Chosen,
        odd_rows_forward: Option<bool>,
        max_off_pitches: f64,
    ) -> Result<RestLattice, LabelError> {
        let max_px = max_off_pitches * self.pitch_px;
        let window = &chosen.window;
        let (rows, cols) = (window.rows(), window.cols());
        let taken: Vec<Option<u32>> = window.places().map(|p| sites.at(p).map(|m| m as u32)).collect();
        let is_whole = |&m: &u32| (m as usize) < self.whole;
        let detection: Vec<Option<u32>> = taken.iter().map(|d| d.filter(is_whole)).collect();
        let at: Vec<Option<DVec2>> =
            detection.iter().map(|d| d.map(|m| self.detected_px[m as usize])).collect();
        let positions_px = match odd_rows_forward {
            None => {
                check_regular(rows, cols, max_px, |r, c| at[r * cols + c])?;
                Partial { rows, cols, at }.filled()
            }
            Some(forward) => {
                // A first row that is odd in all rows found turns forward into backward.
                let forward = forward != (window.top() % 2 == 1);
                let topology = Topology::hexagonal(rows, cols, forward);
                hexagonal_rest::check(topology, &at, max_px)?;
                hexagonal_rest::filled(topology, at)
            }
        };
        let positions_px = positions_px.ok_or(LabelError::NoLattice { found: self.detected_px.len() })?;
        check_gaps(&self.detected_px, &positions_px, &taken, max_px, cols)?;
        let (pitch_px, left_out) = (self.pitch_px, chosen.left_out);
        Ok(RestLattice { rows, cols, positions_px, detection, pitch_px, left_out })
    }

    /// Rows and columns found.
    fn sites(&self) -> Sites {
        match &self.places {
            Places::Square(sites) => sites.clone(),
            Places::Hexagonal(named) => offset(&named.sites, named.odd_rows_forward),
        }
    }

    /// Median distance of neighbours along the three axes of a hexagonal print.
    fn median_step_px(&self) -> Option<f64> {
        let Places::Hexagonal(HexagonalSites { sites, .. }) = &self.places else { return None };
        let mut lengths = Vec::new();
        for place in sites.places() {
            let Some(here) = sites.at(place) else { continue };
            for step in [(0, 1), (1, 0), (1, -1)] {
                if let Some(next) = sites.at(place.step(step)) {
                    lengths.push(self.detected_px[here].distance(self.detected_px[next]));
                }
            }
        }
        median(&mut lengths)
    }
}

/// The layout of markers that stand at right angles, as an error.
fn other_layout(found: &FoundLattice, points: &[DVec2], expected: PrintLayout) -> LabelError {
    let (short, long) = reduced(found.row_step_px, found.col_step_px);
    let (short_px, long_px) = (short.length(), long.length());
    let is_rectangular = long_px > MIN_RECTANGULAR * short_px;
    let layout = if is_rectangular {
        Layout::Rectangular { short_px, long_px }
    } else {
        Layout::Square { pitch_px: found.pitch_px }
    };
    LabelError::Layout { found: points.len(), layout, expected }
}

/// The points after the affine map that makes the mean steps of a lattice equal and square on each other. The
/// finder's limits are those of such lattices.
pub(super) fn at_right_angles(found: &FoundLattice, points: &[DVec2]) -> Vec<DVec2> {
    let (row, col) = (found.row_step_px, found.col_step_px);
    let area = row.perp_dot(col);
    let map = |at: DVec2| DVec2::new(at.perp_dot(col), row.perp_dot(at)) * (found.pitch_px / area);
    points.iter().map(|&at| map(at)).collect()
}

/// Refuses a filled-in marker if an unlabelled detection lies within the tolerance of it: the labels
/// around it have slipped. (The midpoint of two merged dots is half a pitch from both.)
fn check_gaps(
    points: &[DVec2],
    positions_px: &[DVec2],
    detection: &[Option<u32>],
    most_px: f64,
    cols: usize,
) -> Result<(), LabelError> {
    if detection.iter().all(Option::is_some) {
        return Ok(());
    }
    let mut taken = alloc::vec![false; points.len()];
    for &m in detection.iter().flatten() {
        taken[m as usize] = true;
    }
    let mut grid = Grid::default();
    grid.build(points, most_px);
    for n in (0..detection.len()).filter(|&n| detection[n].is_none()) {
        if let Some(m) = grid.nearest(points, positions_px[n], most_px, |m| !taken[m]) {
            let off_px = positions_px[n].distance(points[m]);
            return Err(LabelError::Slipped { row: n / cols, col: n % cols, off_px });
        }
    }
    Ok(())
}

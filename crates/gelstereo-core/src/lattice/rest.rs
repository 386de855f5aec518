//! The rest lattice: counts rows and columns, labels every marker and fills in missing ones.

use super::beyond::with_lines_beyond;
use super::fill::Partial;
use super::found::FoundLattice;
use super::layout::{Layout, is_hexagonal};
use super::window::{PartialBorders, Window};
use super::{LabelError, LatticeFinder, RestLattice, check_regular};
use crate::detect::Markers;
use crate::math::{DVec2, atan2};
use crate::params::LatticeParams;
use crate::spatial::Grid;
use alloc::vec::Vec;

/// Counts the rows and columns of a frame, labels it, and fills in up to `lattice.max_missing_share` of
/// its markers where none was detected. The frame should be undisturbed, as later frames are compared
/// with it; a frame under contact is labelled as well.
///
/// The lattice is that of [`LatticeFinder`]. A border row counts if at least half of it is detected. It
/// is discarded as false detections if it has a single marker, or one in twelve. In between,
/// `lattice.rows` and `lattice.cols` decide. Without them, border rows and columns that are seen in part
/// are left out, the least seen first, until no more markers are missing than allowed:
/// [`RestLattice::left_out`] counts them. With fewer rows or columns set than are seen, the rectangle with
/// the most markers is labelled; of equals, the one in the middle.
///
/// So the lattice may be wider than the field of view. A pipeline of two views leaves none out, as its views
/// might then differ by a column.
///
/// The labels can be turned in four ways (two where rows and columns are set and differ). The turn whose
/// rows run most nearly from left to right is taken, except that `lattice.missing` has priority: a turn
/// with a marker where none was printed is wrong. At 45 degrees two turns are equally near;
/// [`RestLattice::turned_like`] aligns the labels of one view with those of another.
///
/// # Errors
/// [`LabelError`] with what was found: a lattice whose rows or columns differ from the settings, if set,
/// one with too many gaps, or one with fewer than 3 x 3 markers.
pub fn rest_lattice(
    detected_px: &[DVec2],
    lattice: &LatticeParams,
    tolerance_pitches: f64,
) -> Result<RestLattice, LabelError> {
    let finder = &mut LatticeFinder::default();
    let borders = PartialBorders::LeaveOut;
    label_all(finder, detected_px, detected_px.len(), lattice, tolerance_pitches, borders)
        .map_err(|error| named(error, detected_px))
}

/// As [`rest_lattice`], but if the whole markers form no valid lattice, markers cut by the image border
/// are added as evidence that their rows and columns are printed. The centre of a cut marker is not
/// measured: it is filled in and held until the marker is seen whole.
///
/// A border row without any whole marker counts only if `lattice.rows` or `lattice.cols` requires it: it
/// contributes no point.
///
/// # Errors
/// As [`rest_lattice`].
pub fn rest_lattice_of(
    detected: &Markers,
    lattice: &LatticeParams,
    tolerance_pitches: f64,
) -> Result<RestLattice, LabelError> {
    let finder = &mut LatticeFinder::default();
    match rest_lattice_by(finder, detected, lattice, tolerance_pitches) {
        Err(LabelError::Border { .. } | LabelError::Shape { .. }) => {
            rest_lattice(&detected.centres_px, lattice, tolerance_pitches)
        }
        labelled => labelled,
    }
}

/// As [`rest_lattice_of`], reusing the memory of a finder. No border row or column that is seen in part is
/// left out.
pub(crate) fn rest_lattice_by(
    finder: &mut LatticeFinder,
    detected: &Markers,
    lattice: &LatticeParams,
    tolerance_pitches: f64,
) -> Result<RestLattice, LabelError> {
    let whole = &detected.centres_px;
    let borders = PartialBorders::Refuse;
    let without = label_all(finder, whole, whole.len(), lattice, tolerance_pitches, borders)
        .map_err(|error| named(error, whole));
    if detected.cut.is_empty()
        || !matches!(without, Err(LabelError::Border { .. } | LabelError::Shape { .. }))
    {
        return without;
    }
    let all_px: Vec<DVec2> =
        whole.iter().copied().chain(detected.cut.iter().map(|cut| cut.centre_px)).collect();
    // If cut markers do not help, the error of the whole markers is the clearer one.
    label_all(finder, &all_px, whole.len(), lattice, tolerance_pitches, borders).or(without)
}

/// Labels detections. The first `whole` are whole markers; the others only show that a marker exists.
fn label_all(
    finder: &mut LatticeFinder,
    detected_px: &[DVec2],
    whole: usize,
    lattice: &LatticeParams,
    tolerance_pitches: f64,
    borders: PartialBorders,
) -> Result<RestLattice, LabelError> {
    let mut found = FoundLattice::default();
    finder.run_with_specks(detected_px, &mut found)?;
    let most_px = tolerance_pitches * found.pitch_px;
    let sites = with_lines_beyond(found.sites(), detected_px, most_px);
    let chosen = Window::choose(&sites, whole, lattice, PartialBorders::Refuse).or_else(|error| {
        // The sheared cells of a hexagonal print would pass for a lattice with incomplete borders.
        if is_hexagonal(&sites, detected_px) {
            return Err(LabelError::Layout { found: detected_px.len(), layout: Layout::Hexagonal });
        }
        if borders == PartialBorders::Refuse {
            Err(error)
        } else {
            Window::choose(&sites, whole, lattice, borders)
        }
    })?;
    let window = chosen.window;
    let (rows, cols) = (window.rows(), window.cols());
    let taken: Vec<Option<u32>> = window.places().map(|p| sites.at(p).map(|m| m as u32)).collect();
    let detection: Vec<Option<u32>> = taken.iter().map(|d| d.filter(|&m| (m as usize) < whole)).collect();
    let at = detection.iter().map(|d| d.map(|m| detected_px[m as usize])).collect();
    let partial = Partial { rows, cols, at };
    check_regular(rows, cols, most_px, |r, c| partial.at[r * cols + c])?;
    let positions_px = partial.filled().ok_or(LabelError::NoLattice { found: detected_px.len() })?;
    check_gaps(detected_px, &positions_px, &taken, most_px, cols)?;
    let (pitch_px, left_out) = (found.pitch_px, chosen.left_out);
    let rest = RestLattice { rows, cols, positions_px, detection, pitch_px, left_out };
    turn_as_printed(&rest, lattice)
}

/// Names the layout of markers that form no square lattice.
fn named(error: LabelError, detected_px: &[DVec2]) -> LabelError {
    let layout = match error {
        LabelError::NoLattice { .. } | LabelError::Torn { .. } => Layout::of(detected_px),
        _ => None,
    };
    layout.map_or(error, |layout| LabelError::Layout { found: detected_px.len(), layout })
}

/// Quarter turns that make columns rows. Of the two directions, the one nearer to left to right is taken.
/// If both are equally near, to 5 degrees, rows run from top to bottom, so that noise does not decide.
pub(super) fn sideways(row_step: DVec2, col_step: DVec2) -> u8 {
    // Direction of the columns without shear.
    let across = col_step.normalize_or_zero() + row_step.perp().normalize_or_zero();
    if across.x > -0.087 * across.length() { 1 } else { 3 }
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

/// The turn that the settings allow and whose rows run most nearly from left to right.
fn turn_as_printed(rest: &RestLattice, lattice: &LatticeParams) -> Result<RestLattice, LabelError> {
    let fits = |turns: &u8| {
        let (rows, cols) =
            if turns.is_multiple_of(2) { (rest.rows, rest.cols) } else { (rest.cols, rest.rows) };
        lattice.rows.is_none_or(|n| n == rows) && lattice.cols.is_none_or(|n| n == cols)
    };
    let [row_step, col_step] = rest.directions();
    let aside = sideways(row_step, col_step);
    let mut error = LabelError::NoLattice { found: rest.detection.len() };
    for turns in [0, aside, (aside + 2) % 4, 2].iter().filter(|turns| fits(turns)) {
        let turned = rest.turned(*turns);
        let printed_anyway = lattice.missing.iter().find(|&&[row, col]| {
            row >= turned.rows || col >= turned.cols || turned.detection[row * turned.cols + col].is_some()
        });
        match printed_anyway {
            None => return Ok(turned),
            Some(&[row, col]) => {
                error = LabelError::NeverPrinted { row, col, rows: rest.rows, cols: rest.cols }
            }
        }
    }
    Err(error)
}

impl RestLattice {
    /// The same lattice after reading columns as rows `quarter_turns` times: down becomes right, and
    /// right becomes up.
    #[must_use]
    pub fn turned(&self, quarter_turns: u8) -> Self {
        if quarter_turns.is_multiple_of(4) {
            return self.clone();
        }
        let (rows, cols) =
            if quarter_turns.is_multiple_of(2) { (self.rows, self.cols) } else { (self.cols, self.rows) };
        let (last_row, last_col) = (self.rows.saturating_sub(1), self.cols.saturating_sub(1));
        let old = |n: usize| {
            let (row, col) = (n / cols, n % cols);
            let (r, c) = match quarter_turns % 4 {
                0 => (row, col),
                1 => (col, last_col - row),
                2 => (last_row - row, last_col - col),
                _ => (last_row - col, row),
            };
            r * self.cols + c
        };
        let order = || (0..rows * cols).map(old);
        Self {
            rows,
            cols,
            positions_px: order().map(|n| self.positions_px[n]).collect(),
            detection: order().map(|n| self.detection[n]).collect(),
            pitch_px: self.pitch_px,
            // After a quarter turn, the right side is the upper one.
            left_out: core::array::from_fn(|side| self.left_out[(side + usize::from(quarter_turns)) % 4]),
        }
    }

    /// Mean direction of the rows from their first marker to their last, and of the columns; not unit
    /// vectors.
    #[must_use]
    pub fn directions(&self) -> [DVec2; 2] {
        let at = |r: usize, c: usize| self.positions_px.get(r * self.cols + c).copied().unwrap_or_default();
        let (last_row, last_col) = (self.rows.saturating_sub(1), self.cols.saturating_sub(1));
        let row = (0..self.rows).fold(DVec2::ZERO, |sum, r| sum + at(r, last_col) - at(r, 0));
        let col = (0..self.cols).fold(DVec2::ZERO, |sum, c| sum + at(last_row, c) - at(0, c));
        [row, col]
    }

    /// The lattice after the quarter turns that best align its rows with those of `other`. The two views
    /// of one print get the same labels, even at 45 degrees.
    #[must_use]
    pub fn turned_like(&self, other: &Self) -> Self {
        let angle = |[row, col]: [DVec2; 2]| {
            let (a, b) = (row.normalize_or_zero(), col.normalize_or_zero());
            atan2(a.y - b.x, a.x + b.y).to_degrees()
        };
        let off = angle(other.directions()) - angle(self.directions());
        self.turned((crate::math::round(off / 90.0) as i32).rem_euclid(4) as u8)
    }
}
